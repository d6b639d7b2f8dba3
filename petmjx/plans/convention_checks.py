"""Detects plans in other conventions: centres given as corners, metres as millimetres, or y and z swapped.

A plan is odd if boxes float or overlap. An odd plan is read in other conventions. If the plan is no longer odd in one
of these conventions, it probably follows that convention. A plan whose boxes really float or overlap is odd in every
convention.
If all lengths or all masses have a wrong unit, the layout looks right; such a unit is recognised by the density of the
boxes.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import PlanWarning
from petmjx.common.text import box_in_words, count_text, printable_name, three_digits
from petmjx.common.units import LENGTHS_MM, MASSES_KG, FloatArray
from petmjx.plans.input_conventions import ANCHORS
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_warnings import (
    DEFAULT_TOLERANCE_MM,
    PlanWarnings,
    check_layout,
    gaps_mm,
    odd_layouts,
    overlaps_mm,
)

MOST_UNEXPLAINED: Final = 100
ONE_IN: Final = 50
"""Limits of the search for conventions. The search is limited because reading a plan in all conventions takes 2 ms.
After ``MOST_UNEXPLAINED`` odd plans that no convention explains, odd plans are read only in conventions that explain at
least ``LEAST_SHARE`` of the odd plans so far. One in ``ONE_IN`` of the plans that no convention explains is still read
in all conventions."""

LIGHTEST_KG_M3, HEAVIEST_KG_M3 = 2.0, 5000.0
"""Densities of boxes outside these limits, kg/m³, suggest wrong weights or lengths: a wrong unit if most boxes of a
plan have such densities, else wrong values of single boxes. The lower limit is below the density of foam, and the upper
limit above the density of iron parts."""
_USUAL_KG_M3: Final = 300.0
_USUAL_M3: Final = 0.015
"""Usual density and volume of a carton, from BED-BPP's orders. A plan is too dense by a factor of 1000 if masses in
grams are read as kilograms, and also if lengths in centimetres are read as millimetres. The usual volume shows which of
the two units is wrong."""

LEAST_SHARE: Final = 0.25
"""A convention is reported only if it explains at least this share of the plans with odd layouts. If a packer uses
another convention, all its plans have this convention. By chance, one in 300 plans with three floating boxes looks as
if y and z were swapped."""

_LEAST_FILLED: Final = 0.3
"""A convention explains a plan only if the boxes, when read in this convention, fill at least this share of the plan's
bounding box. Without this rule, any plan would be explained by a convention that enlarges coordinates, since larger
coordinates separate even boxes that really overlap."""

_MM3_PER_M3: Final = 1e9

_MOST_ROUNDS: Final = 5
"""Largest number of passes over the turned boxes in ``_overlapping_less``. Two passes are usually enough."""

_Layout = tuple[FloatArray, FloatArray]
"""Corners and sizes, (n, 3) each, mm, in packing order."""


@dataclass(frozen=True, eq=False)
class Convention:
    """A convention other than petmjx's. petmjx tries whether an odd plan is less odd if it is read in this convention.

    Attributes:
        looks: text for messages: how plans in this convention look.
        advice: text for messages: how to correct the plan. ``{lowest}`` stands for the z of the lowest box, ``{x}`` and
            ``{y}`` for the middle of the carrier, mm.
        read: function that converts corners and sizes to petmjx's convention. None: the convention does not change
            corners and sizes.
        least_odd: smallest number of floating boxes and overlaps that a plan must have before this convention may
            explain it. ``least_odd`` applies only if the lowest box does not float.
        of_turned: whether ``read`` changes only turned boxes (boxes with orientation 1). All other boxes stay
            unchanged.
        of_some: whether ``read`` changes only those turned boxes that overlap fewer boxes after the change.
        least_share: the convention is considered only under two conditions. Of the boxes that do not stand directly on
            the carrier, at least this share must float or overlap. And at least one box must float or overlap by more
            than ``_SMALL_MM``. 0: there are no such conditions.
    """

    looks: str
    advice: str
    read: Callable[[FloatArray, FloatArray], _Layout] | None = None
    least_odd: int = 2
    of_turned: bool = False
    of_some: bool = False
    least_share: float = 0.0

    def layout_of(self, plan: Plan) -> _Layout:
        """The corners and sizes of a plan's boxes if the plan is read in this convention."""
        assert self.read is not None
        corner, size = self.read(plan.corner_mm, plan.size_mm)
        if not self.of_turned:
            return corner, size
        turned = _overlapping_less(plan, size) if self.of_some else plan.turned
        return np.where(turned[:, None], corner, plan.corner_mm), np.where(turned[:, None], size, plan.size_mm)


def _scale_convention(unit: str, sizes: bool) -> Convention:
    """The convention in which either the sizes or the coordinates of boxes are not in millimetres, but in ``unit``.

    Args:
        sizes: True: the sizes are in ``unit``; False: the coordinates are in ``unit``.
    """
    factor, name = LENGTHS_MM[unit]
    subject, other = ("sizes", "coordinates") if sizes else ("coordinates", "sizes")
    return Convention(
        f"{subject} look as if they were in {name}, unlike {other}",
        f"multiply {subject} by {factor:g}",
        lambda corner, size: (corner, size * factor) if sizes else (corner * factor, size),
    )


def _anchor_convention(anchor: str, looks: str) -> Convention:
    share = np.array(ANCHORS[anchor])
    return Convention(looks, f"give anchor {anchor}", lambda corner, size: (corner - share * size, size))


_ANCHORS: Final = (
    _anchor_convention("centre", "coordinates look like those of centres, not of corners"),
    _anchor_convention("base-centre", "x and y look like those of centres, not of corners"),
    _anchor_convention("far-corner", "coordinates look like those of the corners with the largest x, y and z"),
    _anchor_convention("top-centre", "coordinates look like those of the centres of tops"),
    *(
        _anchor_convention(
            f"corner-{axes}", f"coordinates look like those of the corners with the largest {' and '.join(axes)}"
        )
        for axes in ("x", "y", "xy", "z", "xz", "yz")
    ),
)
"""The conventions in which coordinates describe another point of a box. If several of them explain a plan, the one in
which the load begins closest to the corner of the deck is used."""
CENTRES: Final = _ANCHORS[0]
_TURNED: Final = (
    "lengths and widths of boxes that are turned by their orientation look swapped",
    "give the item's own length and width and the orientation, or the extents along x and y without an orientation",
)
_YZ: Final = ("y and z look swapped", "give heights as z")
_MOST: Final = 0.5
"""Swapped y and z are considered only if at least this share of the boxes that do not stand directly on the carrier
floats or overlaps. A few boxes that float or overlap are no evidence: in a correct plan whose rows are flush in y,
no box floats or overlaps even after y and z are swapped."""
_SMALL_MM: Final = 20.0
"""Gaps and overlaps up to this size come from sheets, rounded heights or careless packers, not from a convention."""

_WALL: Final = Convention(*_YZ, lambda corner, size: (corner[:, [0, 2, 1]], size[:, [0, 2, 1]]), least_share=_MOST)
"""The convention of a plan in which y and z are swapped, and whose boxes form a single wall or row. In such a plan no
box floats or overlaps, but the plan reaches beyond the carrier."""

LAYOUTS: Final[tuple[Convention, ...]] = (
    Convention(*_TURNED, lambda corner, size: (corner, size[:, [1, 0, 2]]), least_odd=1, of_turned=True),
    Convention(*_TURNED, lambda corner, size: (corner, size[:, [1, 0, 2]]), of_turned=True, of_some=True),
    *_ANCHORS,
    Convention(
        "z looks counted from the floor, not from the top of the carrier",
        "subtract {lowest:g} mm from each z",
        lambda corner, size: (corner - [0.0, 0.0, corner[:, 2].min()], size),
    ),
    Convention(
        "the packing order looks reversed",
        "begin with the box that is placed first",
        lambda corner, size: (corner[::-1], size[::-1]),
        least_odd=1,
    ),
    Convention(*_YZ, lambda corner, size: (corner[:, [0, 2, 1]], size), least_share=_MOST),
    Convention(*_YZ, lambda corner, size: (corner[:, [0, 2, 1]], size[:, [0, 2, 1]]), least_odd=3, least_share=_MOST),
    Convention(
        "length and width look swapped",
        "give the extents along x and y of the boxes as they stand, or also give the orientation",
        lambda corner, size: (corner, size[:, [1, 0, 2]]),
    ),
    *(_scale_convention(unit, sizes=False) for unit in ("cm", "in", "m")),
    *(_scale_convention(unit, sizes=True) for unit in ("cm", "in", "m")),
)
"""Conventions that may explain an odd layout. The first convention that explains the plan is used."""

_SIZES_ALONE: Final = LAYOUTS[-3:]

MIDDLE: Final = Convention(
    "the origin looks like the middle of the carrier", "add {x:g} mm to each x and {y:g} mm to each y"
)


def _all_lengths(unit: str) -> tuple[float, Convention]:
    factor, name = LENGTHS_MM[unit]
    looks, advice = f"lengths look as if they were in {name}", f"give units {unit}"
    return factor, Convention(looks, advice, lambda corner, size: (corner * factor, size * factor))


_LENGTHS: Final = tuple(_all_lengths(unit) for unit in ("cm", "in", "m"))
GRAMS: Final = Convention("masses look as if they were in grams", "give units g")
TONNES: Final = Convention("masses look as if they were in tonnes", "give units t")


@dataclass
class _ConventionMatch:
    """The plans that follow one convention: their number, and a line about the first of them."""

    example: str
    advice: str
    of_layout: bool
    count: int = 0


@dataclass
class _Search:
    """The search for conventions in a set of plans, with the matches found so far."""

    extent_mm: tuple[float, float] | None
    found: dict[str, _ConventionMatch] = field(default_factory=dict)
    last: Convention | None = None
    n_odd: int = 0
    unexplained: int = 0

    def look_at(self, plan: Plan, odd: PlanWarnings | None, unit: tuple[Convention, str] | None) -> None:
        """Search for the convention of one plan.

        Args:
            odd: the warnings about the plan's layout; None if there are none.
            unit: the convention whose unit explains the plan's impossible density, and a description of the density;
                None if the density is possible.
        """
        way = None
        if unit is not None and odd is not None:
            way = self._layout_of(plan, odd, _SIZES_ALONE)
        if unit is not None and way is None:
            self._add(unit[0], plan, unit[1])
            if unit[0].read is not None:
                corner, size = unit[0].read(plan.corner_mm, plan.size_mm)
                # ``kinds`` is left out: a box that is a pallet must have a standard size, so a plan with converted
                # sizes would be refused.
                plan = replace(plan, corner_mm=corner, size_mm=size, kinds=())
                odd = check_layout(plan.plan_id, plan.source, corner, size, self.extent_mm)
        if odd is None:
            return
        self.n_odd += bool(odd.n_floating or odd.n_overlapping_pairs)
        way = way or self._layout_of(plan, odd, LAYOUTS)
        if way is not None:
            self._add(way, plan, _first_oddity(plan, odd, way))
        elif odd.n_outside and self.extent_mm is not None and _is_wall_lying(plan, odd, self.extent_mm):
            self._add(_WALL, plan, f"{_box(plan, int(odd.outside[0]))} is outside the carrier")
        if odd.n_outside and self.extent_mm is not None and _from_the_middle(plan, way, self.extent_mm):
            self._add(MIDDLE, plan, f"{_box(plan, int(odd.outside[0]))} is outside the carrier")

    def _layout_of(self, plan: Plan, odd: PlanWarnings, ways: Sequence[Convention]) -> Convention | None:
        """The convention that explains an odd layout; None if no convention explains it. The convention that explained
        the previous plan is tried first.
        """
        n_odd = odd.n_floating + odd.n_overlapping_pairs
        if not n_odd:
            return None
        everything = self.unexplained < MOST_UNEXPLAINED or self.unexplained % ONE_IN == 0
        for way in sorted(ways, key=lambda way: way is not self.last):
            if (everything or self.common(way.looks)) and _explains(way, plan, n_odd):
                if way in _ANCHORS and way is not self.last:
                    anchors = [other for other in _ANCHORS if _explains(other, plan, n_odd)]
                    way = min(anchors, key=lambda one: float(np.abs(one.layout_of(plan)[0][:, :2].min(axis=0)).sum()))
                self.last = way
                return way
        self.unexplained += ways is LAYOUTS
        return None

    def common(self, looks: str) -> bool:
        """Whether the convention with the given ``Convention.looks`` explains enough plans to be reported."""
        finding = self.found.get(looks)
        return finding is not None and (not finding.of_layout or finding.count >= LEAST_SHARE * self.n_odd)

    def _add(self, convention: Convention, plan: Plan, evidence: str) -> None:
        if convention.looks not in self.found:
            x, y = (length / 2 for length in self.extent_mm or (0.0, 0.0))
            advice = convention.advice.format(lowest=plan.corner_mm[:, 2].min(), x=x, y=y)
            example = f"{convention.looks}: in plan {printable_name(plan.plan_id)} {evidence}"
            self.found[convention.looks] = _ConventionMatch(example, advice, convention in LAYOUTS)
        self.found[convention.looks].count += 1


def with_conventions(plan_set: PlanSet, extent_mm: tuple[float, float] | None) -> PlanSet:
    """Add warnings about odd layouts to a set of plans, and lines about the conventions that the plans appear to
    follow.

    Args:
        extent_mm: extent of the carrier along x and y; None: the extent of the plan's bounding box.
    """
    odd = odd_layouts(plan_set.plans, extent_mm)
    readings = [
        f"{source}: {line}"
        for source, reading in plan_set.readings.items()
        for line in (reading.line(), *reading.unread)
    ]
    # Plans of other tools are left out: their places have already been converted to petmjx's convention.
    own_odd = [layout for layout in odd if layout.source not in plan_set.readings]
    conventions = find_conventions(plan_set.plans, own_odd, extent_mm)
    return replace(plan_set, warnings=odd, conventions=[*readings, *conventions])


def find_conventions(
    plans: Sequence[Plan], odd: Iterable[PlanWarnings], carrier_extent_mm: tuple[float, float] | None
) -> list[str]:
    """A line for each convention that plans appear to follow instead of petmjx's, and a line about boxes with
    implausible densities (``_odd_boxes``).

    Args:
        plans: plans with distinct ids.
        odd: warnings about odd layouts of these plans.
        carrier_extent_mm: extent of the carrier along x and y; None: the extent of the plan's bounding box.
    """
    search = _Search(carrier_extent_mm)
    layouts = {layout.plan_id: layout for layout in odd}
    densities = _with_odd_boxes(plans)
    units = _odd_densities(densities)
    for plan in plans if layouts or units else ():
        layout, unit = layouts.get(plan.plan_id), units.get(plan.plan_id)
        if layout is not None or unit is not None:
            search.look_at(plan, layout, unit)
    total = count_text(len(plans), "plan")
    lines = [
        f"{finding.example} ({finding.count:,} of {total}); if that is so, {finding.advice}"
        for looks, finding in search.found.items()
        if search.common(looks)
    ]
    return [*lines, *_odd_boxes(densities)]


def warn(lines: Iterable[str]) -> None:
    """Issue a ``PlanWarning`` for each line. The warning refers to the line of the caller's code, outside petmjx."""
    frame, depth = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "petmjx":
        frame, depth = frame.f_back, depth + 1
    for line in lines:
        warnings.warn(line, PlanWarning, stacklevel=depth)


def _explains(way: Convention, plan: Plan, n_odd: int) -> bool:
    """Whether reading the plan in another convention leaves at most a tenth of its floating boxes and overlapping
    pairs."""
    if n_odd < way.least_odd and plan.corner_mm[:, 2].min() <= DEFAULT_TOLERANCE_MM:
        return False
    if way.of_turned and not plan.turned.any():
        return False
    if way.least_share and not _is_mostly_odd(plan, way.least_share):
        return False
    corner, size = way.layout_of(plan)
    if abs(corner[:, 2].min()) > DEFAULT_TOLERANCE_MM:  # in the right convention, the lowest box stands on the carrier
        return False
    bounds = (corner + size).max(axis=0) - corner.min(axis=0)
    if size.prod(axis=1).sum() < _LEAST_FILLED * bounds.prod():
        return False
    left = check_layout(plan.plan_id, plan.source, corner, size)
    return left.n_floating + left.n_overlapping_pairs <= n_odd // 10


def _overlapping_less(plan: Plan, size: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether each box is turned, and overlaps fewer boxes if it gets its size in ``size`` instead of its size in
    the plan.

    A turned box can have either of these two sizes. In each pass over the turned boxes, a box changes to its other size
    if it then overlaps fewer boxes. Since such a change also affects the other boxes, passes are repeated until a pass
    changes no size, but at most ``_MOST_ROUNDS`` times.

    Args:
        size: (n, 3) sizes of the boxes in the other convention, mm.
    """
    chosen, sizes, low = np.zeros(plan.n_boxes, bool), plan.size_mm.copy(), plan.corner_mm
    turned = np.flatnonzero(plan.turned & (plan.size_mm != size).any(axis=1))

    def overlaps(box: int, extent: FloatArray) -> int:
        common = np.minimum(low + sizes, low[box] + extent) - np.maximum(low, low[box])
        reaches = (common > DEFAULT_TOLERANCE_MM).all(axis=1)
        reaches[box] = False
        return int(np.count_nonzero(reaches))

    for _ in range(_MOST_ROUNDS):
        before = chosen.copy()
        for box in turned.tolist():
            other = plan.size_mm[box] if chosen[box] else size[box]
            if overlaps(box, other) < overlaps(box, sizes[box]):
                chosen[box], sizes[box] = not chosen[box], other
        if np.array_equal(before, chosen):
            break
    return chosen


def _is_mostly_odd(plan: Plan, least_share: float) -> bool:
    """Whether enough boxes of a plan are odd. At least one box of the plan must float or overlap by more than
    ``_SMALL_MM``. In addition, at least the share ``least_share`` of the boxes that do not stand directly on the
    carrier must float or overlap. If all boxes stand directly on the carrier, at least this share of all boxes must
    float or overlap."""
    gap, overlap = gaps_mm(plan.corner_mm, plan.size_mm), overlaps_mm(plan.corner_mm, plan.size_mm)
    above = plan.corner_mm[:, 2] > DEFAULT_TOLERANCE_MM
    above |= not above.any()
    odd = np.maximum(gap, overlap)
    share = int((above & (odd > DEFAULT_TOLERANCE_MM)).sum()) / max(int(above.sum()), 1)
    return bool(share >= least_share and odd.max() > _SMALL_MM)


def _is_wall_lying(plan: Plan, odd: PlanWarnings, extent_mm: tuple[float, float]) -> bool:
    """Whether the boxes of a plan are a wall (boxes stacked in one plane) with y and z swapped. All boxes must have z =
    0, and two further conditions must hold. The plan extends beyond the carrier in y. After y and z are swapped, some
    boxes lie on others, all boxes have support, and none is outside the carrier. A layer that would fit on the carrier
    if it were turned by 90° is not taken for a wall."""
    if odd.n_floating or odd.n_overlapping_pairs or plan.corner_mm[:, 2].max() > DEFAULT_TOLERANCE_MM:
        return False
    length, width = np.array(extent_mm) + DEFAULT_TOLERANCE_MM
    high_mm = (plan.corner_mm + plan.size_mm).max(axis=0)
    if plan.corner_mm[:, 1].max() < width or (high_mm[0] <= width and high_mm[1] <= length):
        return False
    corner, size = _WALL.layout_of(plan)
    bounds = (corner + size).max(axis=0) - corner.min(axis=0)
    if corner[:, 2].max() <= DEFAULT_TOLERANCE_MM or size.prod(axis=1).sum() < _LEAST_FILLED * bounds.prod():
        return False
    return not check_layout(plan.plan_id, plan.source, corner, size, extent_mm).any


def _from_the_middle(plan: Plan, way: Convention | None, extent_mm: tuple[float, float]) -> bool:
    """Whether all boxes would be on the carrier if the origin of the plan were the carrier's middle."""
    corner, size = plan.corner_mm, plan.size_mm
    if way is not None and way.read is not None:
        corner, size = way.layout_of(plan)
    half = np.array(extent_mm) / 2 + DEFAULT_TOLERANCE_MM
    on_it = (corner[:, :2] >= -half).all() and ((corner + size)[:, :2] <= half).all()
    return bool(on_it and (corner[:, :2] < -DEFAULT_TOLERANCE_MM).any())


def _odd_boxes(densities: Sequence[tuple[Plan, FloatArray]]) -> list[str]:
    """A list with one line about boxes with implausible densities, such as one of 5,000 kg among boxes of 5 kg. The
    list is empty if there are no such boxes. Plans in which most boxes have such densities are left out, because
    they have lines about units.

    Args:
        densities: the result of ``_with_odd_boxes``.
    """
    odd = [
        (abs(math.log(density[box] / _USUAL_KG_M3)), plan, box, density[box])
        for plan, density in densities
        if not _are_odd(np.median(density))
        for box in np.flatnonzero(_are_odd(density)).tolist()
    ]
    if not odd:
        return []
    _, plan, box, density = max(odd, key=lambda one: one[0])
    weight = f"{three_digits(float(plan.mass_kg[box]))} kg, {three_digits(float(density))} kg/m³"
    limits = f"not between {LIGHTEST_KG_M3:g} and {HEAVIEST_KG_M3:,g} kg/m³"
    count = f"; {len(odd):,} such boxes in all" if len(odd) > 1 else ""
    return [f"{plan.source}: plan {printable_name(plan.plan_id)}: {_box(plan, box)} has {weight}, {limits}{count}"]


def _are_odd(density: FloatArray | np.floating[Any]) -> NDArray[np.bool_]:
    return np.asarray((density < LIGHTEST_KG_M3) | (density > HEAVIEST_KG_M3))


def _with_odd_boxes(plans: Sequence[Plan]) -> list[tuple[Plan, FloatArray]]:
    """The plans that have a box with an implausible density. With each plan, (n,) the density of its boxes, kg/m³."""
    if not plans:
        return []
    size_mm, mass_kg = (np.concatenate([getattr(plan, name) for plan in plans]) for name in ("size_mm", "mass_kg"))
    density = mass_kg / (size_mm.prod(axis=1) / _MM3_PER_M3)
    begins = np.cumsum([0, *(plan.n_boxes for plan in plans)])
    odd = np.unique(np.searchsorted(begins, np.flatnonzero(_are_odd(density)), side="right") - 1)
    return [(plans[index], density[begins[index] : begins[index + 1]]) for index in odd.tolist()]


def _odd_densities(densities: Sequence[tuple[Plan, FloatArray]]) -> dict[str, tuple[Convention, str]]:
    """Plan id → the unit that explains why most boxes have impossible densities, and a description of the box with the
    most extreme density. ``densities``: as in ``_odd_boxes``."""
    reasons = {}
    for plan, density in densities:
        median = np.median(density)
        if _are_odd(median):
            light = median < LIGHTEST_KG_M3
            box = int(density.argmin() if light else density.argmax())
            volume = float(plan.size_mm.prod(axis=1).mean()) / _MM3_PER_M3
            reason = TONNES if light else _why_dense(float(median), volume)
            reasons[plan.plan_id] = reason, f"{_box(plan, box)} has {three_digits(density[box])} kg/m³"
    return reasons


def _why_dense(density: float, volume_m3: float) -> Convention:
    """The convention in which the density and the mean volume of a plan's boxes are closest to the usual values."""

    def unusual(length: float, mass: float) -> float:
        of_volume = length**3
        denser = density * mass / of_volume / _USUAL_KG_M3
        return abs(math.log(denser)) + abs(math.log(volume_m3 * of_volume / _USUAL_M3))

    ways = [*((unusual(factor, 1.0), way) for factor, way in _LENGTHS), (unusual(1.0, MASSES_KG["g"][0]), GRAMS)]
    return min(ways, key=lambda way: way[0])[1]


def _first_oddity(plan: Plan, odd: PlanWarnings, way: Convention) -> str:
    """Describe the first odd box of a plan."""
    lowest = int(plan.corner_mm[:, 2].argmin())
    bottom = plan.corner_mm[lowest, 2]
    if bottom > DEFAULT_TOLERANCE_MM:
        share = "half its height, " if way is CENTRES else ""
        return f"the lowest box, {_box(plan, lowest)}, floats by {share}{three_digits(bottom)} mm"
    if odd.n_overlapping_pairs:
        return f"{count_text(odd.n_overlapping_pairs, 'pair')} of boxes overlap, such as {odd.overlapping[0]}"
    gap = gaps_mm(plan.corner_mm, plan.size_mm)
    box = int(gap.argmax())
    return (
        f"{count_text(odd.n_floating, 'box floats', 'boxes float')}, {_box(plan, box)} by {three_digits(gap[box])} mm"
    )


def _box(plan: Plan, box: int) -> str:
    """The name of a box in messages: "box 22 (candy-00100723)". Boxes are numbered from 0, in packing order."""
    return box_in_words(box, plan.articles[box])
