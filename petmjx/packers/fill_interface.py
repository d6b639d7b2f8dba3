"""The interface between Python and fill.cpp, which fills up a packing: the tables that describe a packing (``AXES``),
and enumerations that name positions and values in two of these tables (``counts``, ``numbers``)."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final

import numpy as np


class End(IntEnum):
    """How the compiled code ended.

    ``FILLED``: the packing is full. ``HIGHER``: filling up was aborted, because a top is too high. ``UNSURE``: rounding
    errors may have changed the result, so Python must fill up the packing. ``ASKS``: Python must decide whether the
    next box tips over, and the compiled code is then called again.
    """

    FILLED, HIGHER, UNSURE, ASKS = range(4)


class Begin(IntEnum):
    """How the compiled code begins.

    ``WITH_BEST``: with the best candidate. ``WITH_FIRST``: with a candidate that is known to keep the balance.
    ``WITH_ANSWER``: with Python's answer whether the next box tips over.
    """

    WITH_BEST, WITH_FIRST, WITH_ANSWER = range(3)


class Answer(IntEnum):
    """Answers to the question whether a pile keeps its balance with the next box.

    ``TIPS``: no. ``KEEPS``: yes. ``UNKNOWN``: the next box is so close to tipping that Python must decide. ``NEAR``: a
    box below is so close to tipping that rounding errors might decide; the compiled code then ends with ``End.UNSURE``.
    """

    TIPS, KEEPS, UNKNOWN, NEAR = range(4)


class Count(IntEnum):
    """Entries of the table ``counts``.

    ``BOXES``, ``POINTS``, ``SHAPES``, ``PLANES``: numbers of boxes, corner points, shapes, and edges of hulls.
    ``MADE``: number of boxes that the compiled code has placed. ``POINT``, ``SHAPE``: point and shape of a candidate.
    ``HOW``: how the compiled code begins (``Begin``). ``OWN``: Python's answer about the next box (``Answer``).
    ``END``: how the compiled code ended (``End``). ``UNDER``: number of boxes under the next box.
    """

    BOXES, POINTS, SHAPES, PLANES, MADE, POINT, SHAPE, HOW, OWN, END, UNDER = range(11)


class Number(IntEnum):
    """Entries of the table ``numbers``.

    ``HIGHEST`` is the largest allowed height, and ``TOP`` the height of the packing's highest top. The other entries
    are weights with which candidates are rated, and constants.
    """

    HIGHEST, TOP, PER_OVERHANG, PER_DISTANCE, EXTENT_X, EXTENT_Y, MOST_HEIGHT, LEAST_SUPPORT = range(8)
    TOUCH, MARGIN, MARGIN_SHARE, SLACK, LEAST_TURN, DECIMALS = range(8, 14)


def names_in_cpp() -> str:
    """The enumerations, written as C++ code."""
    kinds = (End, Begin, Answer, Count, Number)
    enums = (f"enum {kind.__name__} {{ {', '.join(kind.__members__)} }};" for kind in kinds)
    return "namespace petmjx {\n" + "\n".join(enums) + "\n}\n"


_F, _I, _B = np.float64, np.int32, np.bool_

AXES: Final[Mapping[str, tuple[Any, str]]] = {
    "counts": (_I, str(len(Count))),
    "numbers": (_F, str(len(Number))),
    "base": (_F, "shape 2"),
    "own_base": (_F, "shape 2"),
    "height": (_F, "shape"),
    "area": (_F, "shape"),
    "weight": (_F, "shape"),
    "worth": (_F, "shape"),
    "kind": (_I, "shape"),
    "stock": (_I, "shape"),
    "points": (_F, "point 2"),
    "z": (_F, "point shape"),
    "carried": (_F, "point shape"),
    "cost": (_F, "point shape"),
    "open": (_B, "point shape"),
    "inside": (_B, "point shape"),
    "low": (_F, "box 3"),
    "high": (_F, "box 3"),
    "low_m": (_F, "box 2"),
    "high_m": (_F, "box 2"),
    "top": (_F, "box"),
    "load": (_F, "box 3"),
    "passed": (_F, "box box 9"),
    "planes": (_F, "plane 3"),
    "owner": (_I, "plane"),
    "made_shape": (_I, "box"),
    "made_corner": (_F, "box 3"),
    "areas": (_F, "box"),
    "under": (_I, "box"),
    "reached": (_I, "box"),
    "rectangles": (_F, "box 4"),
    "own_load": (_F, "3"),
    "moments": (_F, "box 9"),
    "new_passed": (_F, "box 9"),
    "new_planes": (_F, "corner 3"),
    "corners": (_F, "corner 2"),
    "chain": (_F, "corner 2"),
}
"""Name of a table → type of its elements, and its axes. The tables have room for all boxes that will be placed.

``base`` includes the free space beside a box, ``own_base`` does not. ``stock`` is the number of remaining boxes of each
kind. Lengths are in m in the tables of the balance (``low_m`` to ``owner``), and in mm in all other tables.
``made_shape`` and ``made_corner`` describe the boxes that the compiled code has placed. All tables after
``made_corner`` are scratch memory."""
