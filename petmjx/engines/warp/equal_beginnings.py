"""Keys that show which worlds are the same until a certain box is placed (``beginnings``)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.padded_sizes import round_up
from petmjx.engines.mjx.scene_rows import rows_of
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.engines.mjx.world_state import second_axes
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene

KEY_BYTES: Final = 16

_NOT_COMPARED: Final = ("n_boxes", "first_shape", "shape_body")
"""Fields that are not compared: the lengths of the compared rows already tell the numbers of boxes and shapes."""


def beginnings(scenes: Sequence[Scene], sim: Simulation) -> list[list[bytes]]:
    """For each scene, the keys by which equal beginnings of worlds are recognised. A scene of n boxes has the keys 0 to
    n. If two scenes have the same key k, and both have more than k boxes, their worlds are the same to the last bit
    until box k is placed.

    All constants of a world that the kernels read are compared, for the carrier and the first k boxes.
    """
    width = round_up(max(scene.n_boxes for scene in scenes))
    rows = rows_of(scenes, width, sim)
    first = rows["first_shape"]
    along: dict[str, list[NDArray[Any]]] = {"": [], "box": [], "body": [], "shape": []}
    for name, values in rows.items():
        if name not in _NOT_COMPARED:
            along[_axis_of(name)].append(values)
    of_shapes = along["shape"]
    of_boxes = along["box"] + [values[:, 1:] for values in along["body"]]
    row_numbers, box_shapes = np.arange(len(scenes))[:, None], first[:, 1 : width + 1]
    of_boxes += [values[row_numbers, box_shapes] for values in of_shapes]
    boxes = np.concatenate([_bytes_of(values) for values in of_boxes], axis=2)
    of_worlds = along[""] + [values[:, 0] for values in along["body"]]
    keys = []
    for row, scene in enumerate(scenes):
        begins = [values[row] for values in of_worlds] + [values[row, : first[row, 1]] for values in of_shapes]
        digest = hashlib.blake2b(b"".join(values.tobytes() for values in begins), digest_size=KEY_BYTES)
        its_keys = [digest.digest()]
        for box in range(scene.n_boxes):
            digest.update(boxes[row, box])
            # ``boxes`` has only the first shape of each box, but a box that is a sheet or a pallet may have more shapes
            for shape in range(first[row, box + 1] + 1, first[row, box + 2]):
                digest.update(b"".join(values[row, shape].tobytes() for values in of_shapes))
            its_keys.append(digest.digest())
        keys.append(its_keys)
    return keys


def _bytes_of(values: NDArray[Any]) -> NDArray[np.uint8]:
    """(row, box, byte) the bytes of an array whose first axes are rows and boxes."""
    flat = np.ascontiguousarray(values.reshape(*values.shape[:2], -1))
    return flat.view(np.uint8)


@cache
def _axis_of(name: str) -> str:
    """The second axis of a row of ``Worlds``, if it is "box", "body" or "shape"; "" for rows of a whole world, such as
    tables of pairs."""
    second = second_axes(Worlds).get(name, "")
    return second if second in ("box", "body", "shape") else ""
