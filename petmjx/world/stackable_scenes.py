"""Stackable scenes: groups of scenes whose arrays can be stacked.

Stacked worlds are computed together. The result is bit-identical to that of each world alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.world.scene import Scene

AT_A_TIME: Final = 64
"""Largest number of scenes in a group. With 43 boxes, arrays of all pairs then take 1 MB."""


def stackable_groups(scenes: Sequence[Scene]) -> Iterator[tuple[list[int], bool]]:
    """Groups of scenes that can be stacked: their numbers, and whether the group is plain (``is_plain``). A scene that
    is not plain forms its own group. Plain worlds of one plan can be stacked."""
    numbers_by_key: dict[Any, list[int]] = {}
    for number, scene in enumerate(scenes):
        if not is_plain(scene):
            yield [number], False
            continue
        carrier = scene.carrier
        key = scene.n_boxes, carrier.n_boards, carrier.walls, id(scene.approach), scene.placing, scene.wrap
        group = numbers_by_key.setdefault(key, [])
        group.append(number)
        if len(group) == AT_A_TIME:
            yield numbers_by_key.pop(key), True
    yield from ((group, True) for group in numbers_by_key.values())


def is_plain(scene: Scene) -> bool:
    """Whether the scene's boxes have no values of their own except places, sizes, masses and friction."""
    optional_fields = (
        scene.mass_center,
        scene.inertia_box,
        scene.surface,
        scene.stiffness,
        scene.soft,
        scene.carrier.surface,
    )
    return not scene.pieces and all(array is None for array in optional_fields)


def stacked_values(scenes: Sequence[Scene], name: str) -> NDArray[Any]:
    """(m, …) the values of one field of all scenes. ``name`` is the name of the field, such as ``carrier.mass``."""
    return np.array([*map(attrgetter(name), scenes)])
