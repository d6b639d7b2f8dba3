"""Stackable scenes: groups of scenes whose arrays can be stacked.

Stacked worlds are computed at once, identical to the last bit with each world alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.world.scene import Scene

AT_A_TIME: Final = 64
"""Largest number of scenes of a group: arrays of all pairs of 43 boxes then take 1 MB."""


def stackable_groups(scenes: Sequence[Scene]) -> Iterator[tuple[list[int], bool]]:
    """Groups of scenes that can be stacked, by their numbers, and whether each group is plain (``is_plain``). A scene
    that is not plain is a group by itself. Plain worlds of one plan can be stacked."""
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
    """Whether a scene's boxes differ only in places, sizes, masses and friction."""
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
    """(m, …) one field of each scene, by the field's name, such as ``carrier.mass``."""
    return np.array([*map(attrgetter(name), scenes)])
