"""Keys by which worlds are recognised that are the same until a box is placed (``beginnings``)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from typing import Any, Final, get_type_hints

from numpy.typing import NDArray

from petmjx.engines.mjx.host_to_device import round_up
from petmjx.engines.mjx.scene_rows import Rows, rows_of
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene

KEY_BYTES: Final = 16

_NOT_COMPARED: Final = ("n_boxes", "first_shape", "shape_body")
"""Numbers of boxes, and numbers of shapes, which the lengths of the compared rows contain."""


def beginnings(scenes: Sequence[Scene], sim: Simulation) -> list[list[bytes]]:
    """For each scene of n boxes, n + 1 keys. If two scenes have the same key k, then their worlds are the same to the
    last bit until the box k is placed, for k less than the numbers of boxes of both.

    All constants of a world that the kernels read are compared, for the carrier and the first k boxes.
    """
    width = round_up(max(scene.n_boxes for scene in scenes))
    rows = rows_of(scenes, width, sim)
    return [_keys(rows, row, scene.n_boxes) for row, scene in enumerate(scenes)]


def _keys(rows: Rows, row: int, n_boxes: int) -> list[bytes]:
    """The keys of the scene in this row."""
    first = rows["first_shape"][row]

    def of_body(body: int) -> list[NDArray[Any]]:
        return [rows[name][row, body] for name in _axis("body") if name in rows] + [
            rows[name][row, first[body] : first[body + 1]] for name in _axis("shape") if name in rows
        ]

    digest = hashlib.blake2b(digest_size=KEY_BYTES)
    for name in _axis(""):
        if name in rows:
            digest.update(rows[name][row].tobytes())
    keys = []
    for body in range(n_boxes + 1):
        values = of_body(body)
        if body:
            values += [rows[name][row, body - 1] for name in _axis("box") if name in rows]
        for array in values:
            digest.update(array.tobytes())
        keys.append(digest.digest())
    return keys


@cache
def _axis(axis: str) -> tuple[str, ...]:
    """Names of the compared fields of ``Worlds`` whose second axis is this one; "": fields of the whole world."""
    names = []
    for name, kind in get_type_hints(Worlds).items():
        second = (kind.dim_str.split()[1:2] or [""])[0]
        if name not in _NOT_COMPARED and axis == (second if second in ("box", "body", "shape") else ""):
            names.append(name)
    return tuple(names)
