"""Packings filled up in machine code: :meth:`petmjx.plans.samples.packing.Packing.fill` in C++ (fill.cpp).

Warp compiles it, once for a machine. It puts the same boxes into the same places, to the last bit. Where it cannot be
sure of that, it has no answer.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib import resources
from math import inf
from typing import Any, Final

import numpy as np
import warp as wp
from numpy.typing import NDArray

from petmjx.basics.warp_setup import set_up_warp
from petmjx.plans.samples.balance import (
    LEAST_TURN_M2,
    MARGIN_M,
    MARGIN_SHARE,
    SAME_PLACE_DECIMALS,
    SLACK_KG_M,
    TOUCH_MM,
    hull_planes,
    margin_m,
    tips,
)
from petmjx.plans.samples.packer import MAX_HEIGHT_MM
from petmjx.plans.samples.packing import LEAST_SUPPORT, Filled, Next, Packing

FILLED, HIGHER, ASKS = 0, 1, 3
"""How it ended. ``ASKS``: whether the box that comes next keeps its own balance."""

WITH_BEST, WITH_FIRST, WITH_ANSWER = 0, 1, 2
"""How it begins: by the best candidate, by one that is known to keep the balance, or where it ended to ask."""

TIPS, KEEPS, UNKNOWN = 0, 1, 2

MADE, POINT, SHAPE, HOW, OWN, END, UNDER = range(4, 11)
"""Places in ``counts``."""

GRAIN_MM: Final = 2.0**-10
"""If sides and free space are multiples of this, sums of areas are exact, and no sequence of them is another sum."""

POINTS, POINTS_PER_BOX, PLANES_PER_BOX = 64, 4, 16
"""Room for corner points and for edges of hulls. Piles of 80 boxes have 2 points and 5 edges a box."""

_F, _I, _B = np.float64, np.int32, np.bool_

AXES: Final[Mapping[str, tuple[Any, str]]] = {
    "counts": (_I, "11"),
    "numbers": (_F, "14"),
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
"""The tables of a packing: element type and axes, with room for what will be placed.

``counts``: boxes, points, shapes and planes there are, then what has a name above. ``numbers``: the height at which it
is given up, its top and its taste; then constants. ``base`` is with the free space, ``own_base`` without; ``stock`` are
the boxes left by kind. Lengths are in mm, in balances (``low_m`` to ``owner``) in m. From ``made_shape`` on: what was
put, and scratch."""

_KINDS: Final = {_F: wp.float64, _I: wp.int32, _B: wp.bool}

Tables: Any = wp.struct(
    type(
        "Tables",
        (),
        {
            "__module__": __name__,
            "__annotations__": {
                name: wp.array(dtype=_KINDS[kind], ndim=len(axes.split())) for name, (kind, axes) in AXES.items()
            },
        },
    )
)


@wp.func_native("petmjx::fill(tables);")  # type: ignore[untyped-decorator]
def _fill(tables: Tables) -> None: ...


@functools.cache
def _kernel() -> Any:
    """What fills packings up. No multiplication is fused with a sum: Python does not either."""

    def fill(tables: Tables) -> None:
        _fill(tables)

    set_up_warp()
    text = resources.files(__package__).joinpath("fill.cpp").read_text(encoding="utf-8")
    build = wp.ModuleBuildOptions(extra_cuda_preamble=text, extra_cpu_preamble=text)
    options = {"extra_build_options": build, "fuse_fp": False}
    return wp.kernel(fill, enable_backward=False, module="unique", module_options=options)


class Compiled:
    """Fills up packings of one order with one taste and one clearance. Not for several threads at a time.

    Args:
        start: a packing of the order.
    """

    def __init__(self, start: Packing) -> None:
        kernel = _kernel()
        boxes = start.n_items
        sizes = {
            "box": boxes,
            "shape": start.n_shapes,
            "point": POINTS + POINTS_PER_BOX * boxes,
            "plane": PLANES_PER_BOX * boxes,
            "corner": 8 * (boxes + 1),
        }
        self._of: dict[str, NDArray[Any]] = {}
        tables = Tables()
        for name, (kind, axes) in AXES.items():
            shape = tuple(sizes[axis] if axis in sizes else int(axis) for axis in axes.split())
            self._of[name] = np.zeros(shape, kind)
            setattr(tables, name, wp.array(self._of[name], dtype=_KINDS[kind], device="cpu", copy=False))
        self._launch = wp.launch(kernel, dim=1, inputs=[tables], device="cpu", record_cmd=True)
        self._of["numbers"][4:] = [
            *(side + TOUCH_MM for side in start.extent_mm),
            MAX_HEIGHT_MM + TOUCH_MM,
            LEAST_SUPPORT - 1e-9,
            TOUCH_MM,
            MARGIN_M,
            MARGIN_SHARE,
            SLACK_KG_M,
            LEAST_TURN_M2,
            10.0**SAME_PLACE_DECIMALS,
        ]
        self._exact = start.grain_mm >= GRAIN_MM

    def __call__(self, packing: Packing, first: Next | None = None, highest_mm: float = inf) -> Filled | None:
        """As :meth:`petmjx.plans.samples.packing.Packing.filled`."""
        if not self._exact:
            return packing.filled(first, highest_mm)
        packing.write(self._of)
        counts = self._of["counts"]
        counts[MADE : END + 1] = 0, -1, -1, WITH_BEST, UNKNOWN, -1
        if first is not None:
            counts[POINT : OWN + 1] = first.point, first.shape, WITH_FIRST, KEEPS
        self._of["numbers"][0] = highest_mm
        self._launch.launch()
        while counts[END] == ASKS:
            counts[HOW : OWN + 1] = WITH_ANSWER, TIPS if self._tips() else KEEPS
            self._launch.launch()
        if counts[END] == HIGHER:
            return None
        if counts[END] != FILLED:
            return packing.filled(first, highest_mm)
        made = int(counts[MADE])
        return packing.filled_with(self._of["made_shape"][:made].tolist(), self._of["made_corner"][:made].tolist())

    def _tips(self) -> bool:
        """Whether the box that is asked about would tip over on what it stands on."""
        low, high = np.split(self._of["rectangles"][: self._of["counts"][UNDER]], 2, axis=1)
        length, width = self._of["own_base"][self._of["counts"][SHAPE]].tolist()
        return tips(hull_planes(low, high, margin_m((length, width))), self._of["own_load"])
