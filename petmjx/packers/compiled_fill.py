"""Fills up packings with compiled code: :meth:`petmjx.packers.packing_state.Packing.fill` in C++ (fill.cpp).

Warp compiles the code once per machine. The compiled code places the same boxes at the same places as Python, bit for
bit. If rounding could make compiled code and Python differ, Python fills up the packing.
"""

from __future__ import annotations

import functools
from importlib import resources
from math import inf
from typing import Any, Final

import numpy as np
import warp as wp
from numpy.typing import NDArray

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.packers.baseline_packer import MAX_HEIGHT_MM
from petmjx.packers.fill_interface import AXES, Answer, Begin, Count, End, Number, names_in_cpp
from petmjx.packers.packing_state import LEAST_SUPPORT, FullPacking, NextCandidate, Packing
from petmjx.packers.pile_balance import (
    LEAST_TURN_M2,
    MARGIN_M,
    MARGIN_SHARE,
    SAME_PLACE_DECIMALS,
    SHARE_SLACK,
    SLACK_KG_M,
    TOUCH_MM,
    hull_planes,
    margin_m,
    tips,
)

GRAIN_MM: Final = 2.0**-10
"""Length, mm, of which the sides of all boxes and the free space must be multiples. Sums of areas are then exact, in
whatever sequence the areas are added."""

POINTS, POINTS_PER_BOX, PLANES_PER_BOX = 64, 4, 16
"""Capacities of the tables that the compiled code uses. There is room for ``POINTS`` corner points and for
``POINTS_PER_BOX`` further corner points per box, and for ``PLANES_PER_BOX`` edges of hulls per box. Piles of 80 boxes
have 2 points and 5 edges per box."""

_KINDS: Final = {np.float64: wp.float64, np.int32: wp.int32, np.bool_: wp.bool}

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
    """The Warp kernel that fills up packings. The kernel uses no fused multiply-add, since NumPy uses none and both
    must round in the same way."""

    def fill(tables: Tables) -> None:
        _fill(tables)

    set_up_warp()
    text = names_in_cpp()
    for name in ("fill_arithmetic.cpp", "fill.cpp"):
        text += f'#line 1 "{name}"\n' + resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
    return with_cpp(fill, text, fuse_fp=False)


class FillKernel:
    """Fills up packings of one order, with one set of weights and one free space between boxes. Not thread-safe.

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
        constants = {
            Number.EXTENT_X: start.extent_mm[0] + TOUCH_MM,
            Number.EXTENT_Y: start.extent_mm[1] + TOUCH_MM,
            Number.MOST_HEIGHT: MAX_HEIGHT_MM + TOUCH_MM,
            Number.LEAST_SUPPORT: LEAST_SUPPORT - SHARE_SLACK,
            Number.TOUCH: TOUCH_MM,
            Number.MARGIN: MARGIN_M,
            Number.MARGIN_SHARE: MARGIN_SHARE,
            Number.SLACK: SLACK_KG_M,
            Number.LEAST_TURN: LEAST_TURN_M2,
            Number.DECIMALS: 10.0**SAME_PLACE_DECIMALS,
        }
        for place, value in constants.items():
            self._of["numbers"][place] = value
        self._exact = start.grain_mm >= GRAIN_MM

    def __call__(
        self, packing: Packing, first: NextCandidate | None = None, highest_mm: float = inf
    ) -> FullPacking | None:
        """The full packing that results from filling up a copy of ``packing``, as
        :meth:`petmjx.packers.packing_state.Packing.filled` returns it."""
        if not self._exact:
            return packing.filled(first, highest_mm)
        packing.write(self._of)
        counts = self._of["counts"]
        self._of["numbers"][Number.HIGHEST] = highest_mm
        counts[Count.MADE] = 0
        if first is None:
            self._go_on(Begin.WITH_BEST)
        else:
            counts[Count.POINT], counts[Count.SHAPE] = first.point, first.shape
            self._go_on(Begin.WITH_FIRST, Answer.KEEPS)
        while counts[Count.END] == End.ASKS:
            self._go_on(Begin.WITH_ANSWER, Answer.TIPS if self._tips() else Answer.KEEPS)
        if counts[Count.END] == End.HIGHER:
            return None
        if counts[Count.END] == End.UNSURE:
            return packing.filled(first, highest_mm)
        n_placed = int(counts[Count.MADE])
        return packing.filled_with(
            self._of["made_shape"][:n_placed].tolist(), self._of["made_corner"][:n_placed].tolist()
        )

    def _go_on(self, how: Begin, answer: Answer = Answer.UNKNOWN) -> None:
        counts = self._of["counts"]
        counts[Count.HOW], counts[Count.OWN] = how, answer
        self._launch.launch()

    def _tips(self) -> bool:
        """Whether the next box would tip over on its supports. If the box is close to tipping, the kernel leaves this
        question to Python."""
        low, high = np.split(self._of["rectangles"][: self._of["counts"][Count.UNDER]], 2, axis=1)
        length, width = self._of["own_base"][self._of["counts"][Count.SHAPE]].tolist()
        return tips(hull_planes(low, high, margin_m((length, width))), self._of["own_load"])
