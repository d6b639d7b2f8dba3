"""Arrays with the values of several scenes. The arrays of these scenes have equal shapes, so that they can be stacked.

The worlds of stacked scenes are computed together. The results are bit-identical to the results of each world alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.world.scene import Scene

AT_A_TIME: Final = 64
"""Largest number of scenes in a group. With 43 boxes per scene, an array with one value per pair of boxes then takes
1 MB."""


def equal_shape_groups(scenes: Sequence[Scene]) -> Iterator[tuple[list[int], bool]]:
    """Groups of scenes whose arrays have equal shapes. A group is given as the numbers of its scenes, and whether these
    scenes are plain.

    ``is_plain`` defines plain scenes. A scene that is not plain is a group of its own. All plain scenes of the same
    plan can be stacked.
    """
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
    """Whether boxes of this scene differ only in places, sizes, masses and friction, but not in other properties, such
    as stiffness."""
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
    """(m, …) the values that m scenes have in one field. ``name`` is the field's name, such as ``carrier.mass``."""
    return np.array([*map(attrgetter(name), scenes)])
