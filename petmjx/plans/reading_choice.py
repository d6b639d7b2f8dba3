"""Chooses a reading (``choose_reading``): candidates get costs, the most plausible one wins, and a tie is refused."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.column_extraction import LAST_CELLS, XYZ
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS
from petmjx.plans.plausibility import (
    Layout,
    are_listed_downwards,
    converted_share,
    deck_cost,
    density_cost,
    fits_a_carrier,
    footprint_cost,
    is_wall,
    layout_cost,
    load_fit,
    order_cost,
    same_layouts,
    share_at_other_heights,
    side_cost,
    vote_for_other_points,
)
from petmjx.plans.reading_candidates import (
    Candidate,
    candidates,
    candidates_downwards,
    candidates_of_corners,
    candidates_on_side,
    layout_of,
    tipping_cost,
)
from petmjx.plans.readings import (
    POSES,
    AmbiguousFile,
    Evidence,
    Reading,
    Wishes,
    differences,
    implausible_text,
    tie_text,
    up_words,
)

TIE: Final = 1.5
"""Two readings whose costs differ by less than this value are a tie. Costs behave like negative log likelihoods: a
difference of 1.5 corresponds to odds of 4 to 1."""
_FEW_BOXES, _FEW_MORE = 6, 0.8
"""In files with fewer than ``_FEW_BOXES`` boxes, ``_FEW_MORE`` is added to ``TIE``: by chance, a wrong reading of so
few boxes is often as plausible as the right reading."""
WEAK: Final = 5.0
"""A reading is weak if the cost of its layout exceeds this value. A layout has this cost if a fifth of its boxes
overlap, or if a quarter of them float."""
_POOR: Final = 0.8 * WEAK
"""If the layouts of all readings cost more than this, readings are tried in which coordinates have another unit than
sizes. A reading with x upwards, or with rotations in a column of unknown name, whose layout costs more than this is not
considered."""
WEAK_LEAD: Final = 3.0
"""A weak reading (see ``WEAK``) wins only if its cost is lower than the cost of every other reading by at least this
value. If a plan really has odd boxes, even more boxes are odd in wrong readings."""
_OTHER_POINT_COST: Final = 3.6
"""Cost of a reading in which coordinates are those of corners, if they are probably those of other points
(``vote_for_other_points``). The cost exceeds the priors of all other points of a box, which are at most 3.0 if the file
does not name the point (see ``reading_candidates``). So if two readings are otherwise equally plausible, the reading
with the other point has the lower cost. With 3.8, corners of loads whose origin is the middle of a deck would be read
as centres (``test_answers_of_graphql``). For a reading with coordinates of centres, the cost is half as large: such
coordinates may be those of the middles of tops, if y is the vertical axis."""
_WALL_COST: Final = 2.0
"""Cost of a reading in which boxes form a wall (``is_wall``) in all plans. If only some plans are walls, the cost is
multiplied by their share. If y is as likely to be the vertical as z, and the file has more than a few boxes, the
reading as a flat layer wins. Otherwise, the user is asked for the vertical axis."""
_MOST_BOXES: Final = 400
_MOST_PLANS: Final = 12
"""Largest number of boxes, and largest number of plans, that are used to judge readings. The chosen reading applies to
all boxes."""

_LOWEST_UNIT_COST: Final = -2.5
"""Smallest possible cost of units: the cost for boxes of usual sizes and densities on a usual carrier."""

_ALTERNATIVES: Final = 3
"""Number of readings that are listed as alternatives to the chosen one."""
_UNIT_PRIOR: Final = {"mm": 0.0, "cm": 0.0, "m": 0.0, "in": 0.7, "tick": 1.0, "ft": 3.0}
MASS_PRIOR: Final = {"kg": 0.0, "g": 0.0, "lb": 0.7, "t": 3.0}
"""Unit of masses that is tried if the file names no unit of masses → cost of this unit, before any numbers are
considered."""


class _Units(NamedTuple):
    """One choice of units for a layout.

    Attributes:
        cost: how implausible the units are; a smaller cost is better.
        length: unit of coordinates.
        mass: unit of masses.
        density_kg_m3: median density; NaN if there are no weights.
        side_mm: mean of the boxes' sides.
    """

    cost: float
    length: str
    mass: str
    density_kg_m3: float
    side_mm: float


@dataclass(frozen=True, eq=False)
class _Judged:
    """A candidate (a possible reading) with its costs. All costs except that of the layout are computed when they are
    used, because most candidates have layouts that are too implausible.

    Attributes:
        columns, wishes: the boxes of the file, and the options of the caller.
        layouts: the layout of each plan that is used to judge readings.
        rows: the row numbers of all boxes of the layouts.
    """

    columns: BoxColumns
    wishes: Wishes
    candidate: Candidate
    layout_cost: float
    origin: str
    evidence: Evidence
    layouts: tuple[Layout, ...]
    rows: NDArray[np.int64]

    @property
    def least_cost(self) -> float:
        """A lower bound of ``cost``."""
        return self.candidate.prior + self.layout_cost + _LOWEST_UNIT_COST

    @cached_property
    def cost(self) -> float:
        return self.candidate.prior + self.layout_cost + self.units[0].cost + self.begin_cost + self.order_cost

    @cached_property
    def units(self) -> list[_Units]:
        """All choices of units, cheapest first. The costs of units depend on which sides of the load lie on the
        deck."""
        return _units(self)

    @cached_property
    def begin_cost(self) -> float:
        """How implausible it is that the loads begin where they do."""
        if self.candidate.geometry.anchor or self.wishes.anchor or self.layout_cost > 2 * WEAK:
            return 0.0  # the point of a box that coordinates describe is known, or the reading cannot win
        mm, point = LENGTH_UNITS[self.units[0].length], self.candidate.point
        is_other = sum(vote_for_other_points(layout, mm, point) for layout in self.layouts) > 0
        return _OTHER_POINT_COST * is_other * (1.0 if "corner" in self.candidate.anchor else 0.5)

    @cached_property
    def order_cost(self) -> float:
        """How implausible the candidate's packing order and its turns of boxes are, and whether its loads are walls."""
        weight = _PY3DBP_ORDER_WEIGHT if self.columns.source.form.rule == "py3dbp" else 1.0
        walls = float(np.mean([is_wall(layout) for layout in self.layouts]))
        cost = weight * order_cost(self.layouts) + _WALL_COST * walls
        return cost + tipping_cost(self.columns, self.candidate, self.rows)


_Sample = list[tuple[NDArray[np.int64], Mapping[str, float]]]
"""The rows, in packing order, and the container of each plan that is used to judge readings."""


def _sample_of(columns: BoxColumns, plans: Mapping[str, NDArray[np.int64]], damaged: Collection[str]) -> _Sample:
    """The first plans that have no faults. If all plans have faults, the result has the first plans, without their bad
    rows.

    Args:
        damaged: names of plans that lack rows.
    """
    is_good = np.ones(columns.n_boxes, bool)
    is_good[[*columns.faults, *(columns.turns.faults if columns.turns is not None else ())]] = False
    is_good &= np.any([geometry.is_positive for geometry in columns.geometries], axis=0)
    sample: _Sample = []
    taken = 0
    good_plans = {name: rows for name, rows in plans.items() if name not in damaged and is_good[rows].all()}
    for name, rows in (good_plans or plans).items():
        used = rows[is_good[rows]]
        if columns.sequence is not None:
            used = used[np.argsort(columns.sequence[used], kind="stable")]
        if len(used) and len(sample) < _MOST_PLANS and taken < _MOST_BOXES:
            sample.append((used, container_of(columns.source.boxes.containers, name)))
            taken += len(used)
    return sample


def container_of(containers: Mapping[str, Mapping[str, float]], name: str) -> Mapping[str, float]:
    """The container of a plan: the plan's own container, else the file's container, else an empty one."""
    return (
        containers.get(name) or containers.get("") or (next(iter(containers.values())) if len(containers) == 1 else {})
    )


def _judge(columns: BoxColumns, wishes: Wishes, candidate: Candidate, sample: _Sample) -> _Judged:
    layouts: list[Layout] = []
    costs: list[float] = []
    origins: list[str] = []
    sums = np.zeros(4)
    is_positive = candidate.geometry.is_positive
    sample = [(rows[is_positive[rows]], container) for rows, container in sample if is_positive[rows].any()]
    for rows, container in sample:
        layouts.append(layout_of(columns, candidate, rows, container))
        cost, origin, counts = layout_cost(layouts[-1])
        costs.append(cost * len(rows))
        origins.append(origin)
        sums += counts
    all_rows = np.concatenate([rows for rows, _ in sample])
    n_boxes = len(all_rows)
    evidence = Evidence(n_boxes, int(sums[0]), int(sums[1]), int(sums[2]), float(sums[3] / n_boxes))
    origin = max(origins, key=origins.count)
    cost = sum(costs) / n_boxes + _UNEQUAL_FLOOR_COST * share_at_other_heights(layouts)
    return _Judged(columns, wishes, candidate, cost, origin, evidence, tuple(layouts), all_rows)


_UNEQUAL_FLOOR_COST: Final = 5.0
"""Cost of a reading in which the lowest boxes of a file's plans are at different heights. The cost is multiplied by the
share of plans whose lowest box is at an unusual height (``share_at_other_heights``). Different heights are implausible,
since a program measures the heights in all plans of a file from the same level."""
_PY3DBP_ORDER_WEIGHT: Final = 0.4
"""Weight with which the order of boxes counts in the cost of a reading, for files of py3dbp. The weight is low because
py3dbp fills a container along x, then y, then z, whichever axis is the vertical."""


def _units(judged: _Judged) -> list[_Units]:
    """All choices of units, cheapest first."""
    columns, wishes, geometry = judged.columns, judged.wishes, judged.candidate.geometry
    form = columns.source.form
    size = np.concatenate([layout.size for layout in judged.layouts])
    side = float(np.exp(np.log(size).mean(axis=1)).mean())
    of_places = _unit_of_places(judged.candidate) if _has_unnamed_places(judged.candidate) else geometry.place_unit
    unit = wishes.length_units[1] or of_places or geometry.size_unit or form.units
    lengths = {unit: 0.0} if unit else dict(_UNIT_PRIOR)
    if not unit and not columns.source.boxes.table.has_header:
        lengths["dm"] = 0.3
    masses: dict[str, float] = {"kg": 0.0}
    unit_density = math.nan  # in the file's units
    if columns.weight is not None and not columns.weight_is_density:
        mass_unit = wishes.masses or columns.weight_unit or form.masses
        masses = {mass_unit: 0.0} if mass_unit else dict(MASS_PRIOR)
        with np.errstate(invalid="ignore", divide="ignore"):
            densities = columns.weight[judged.rows] / size.prod(axis=1)
        densities = densities[np.isfinite(densities) & (densities > 0)]
        unit_density = float(np.median(densities)) if len(densities) else math.nan
    choices = []
    deck, is_deck = _deck_of(judged)
    largest_side, smallest_side, free = float(size.max()), float(size.min()), float(size[:, :2].min())
    for length, length_prior in lengths.items():
        factor = LENGTH_UNITS[length]
        mean_mm = side * factor
        cost = length_prior + side_cost(mean_mm)
        deck_mm = deck * factor
        cost += deck_cost(deck_mm) if is_deck else footprint_cost(deck_mm, free * factor, length)
        cost += 20.0 * (largest_side * factor > 6_000.0) + 20.0 * (smallest_side * factor < 1.0)
        for mass, mass_prior in masses.items():
            density = unit_density * MASS_UNITS[mass] / (factor / 1000.0) ** 3
            total = cost + mass_prior + (0.0 if math.isnan(density) else density_cost(density))
            if (length in ("in", "ft")) != (mass == "lb") and len(masses) > 1:
                total += 0.7
            choices.append(_Units(total, length, mass, density, mean_mm))
    return sorted(choices)


def _deck_of(judged: _Judged) -> tuple[FloatArray, bool]:
    """If the container is known: its extents along x and y in the file's unit, and True. If it is unknown: the extents
    of the load, and False."""
    layout = judged.layouts[0]
    if not np.isnan(layout.container[:2]).any():
        return layout.container[:2], True
    extents = [(load.low + load.size).max(axis=0) - load.low.min(axis=0) for load in judged.layouts]
    extent: FloatArray = np.max(extents, axis=0)[:2]
    return extent, False


def choose_reading(
    columns: BoxColumns, plans: Mapping[str, NDArray[np.int64]], wishes: Wishes, damaged: Collection[str] = ()
) -> tuple[Reading, Candidate]:
    """Choose the most plausible reading. The function returns the reading, and its candidate, which :func:`layout_of`
    needs.

    Args:
        plans: name of a plan → its rows.
        damaged: names of plans that lack rows.

    Raises:
        AmbiguousFile: two readings are almost equally plausible, or no reading is plausible.
        InputError: no row is usable; or the option ``--sizes item`` states that sizes are those before turning, but no
            column has rotations.
    """
    if wishes.sizes == "item" and columns.turns is None and all(one.turn is None for one in columns.geometries):
        raise InputError("--sizes item: no column of rotations is known; say which with --columns rotation=NAME")
    sample = _sample_of(columns, plans, damaged)
    if not sample:
        raise InputError("no row can be used")
    judged = _judged_candidates(columns, wishes, sample)
    best = _without_last_cells(judged)
    tie = TIE + _FEW_MORE * (len(best.rows) < _FEW_BOXES)
    is_weak = best.layout_cost > WEAK
    lead = max(tie, WEAK_LEAD * is_weak)
    turned = [other for other in judged[1:] if _may_be_turned(best, other)]
    close = [
        other
        for other in judged[1:]
        if (other.cost < best.cost + lead or _lies_better(best, other))
        and not same_layouts(best.layouts, other.layouts)
    ]
    if rivals := close or [other for other in turned if other.candidate.prior < best.candidate.prior]:
        possible = [best, *rivals, *(other for other in turned if other not in rivals)]
        if possible[1].candidate.up != best.candidate.up and not is_weak:
            further = _along_further_axes(judged, possible[:2])
            possible = [*possible[:2], *further, *(other for other in possible[2:] if other not in further)]
        readings = [_reading(one) for one in possible[:4]]
        raise AmbiguousFile(tie_text(readings, is_weak), readings)
    if _is_impossible(best, columns, wishes):
        reading = _reading(best)
        raise AmbiguousFile(implausible_text(reading), [reading])
    units = _likely_units(best)
    readings = [_reading(best, choice) for choice in units]
    if len(units) > 1:
        raise AmbiguousFile(tie_text(readings, weak=False), readings)
    (reading,) = readings
    if (rival := _other_mass(best)) is not None:
        reading = replace(reading, notes=(f"weights may also be in {rival} (say which with --units)",))
    for other in (*turned[:1], *_reversed_piles(judged)[:1]):
        note = f"{up_words(other.candidate.up).replace(' ', ' may be ')}, too (--up)"
        reading = replace(reading, notes=(*reading.notes, note))
    if wishes.anchor and not wishes.exact:
        reading = replace(reading, notes=(*reading.notes, *_changes_by_anchor(reading, columns, wishes, sample)))
    alternatives = tuple(_reading(one) for one in judged[1 : 1 + _ALTERNATIVES])
    return replace(reading, alternatives=alternatives), best.candidate


def _without_last_cells(judged: Sequence[_Judged]) -> _Judged:
    """The most plausible reading. The far corner of a box may be the end of the box, or the last grid cell inside the
    box. If the most plausible reading assumes last cells, another reading may replace it. The other reading must assume
    ends, be about as plausible, and give the same piles in other units."""
    best = judged[0]
    if LAST_CELLS not in best.candidate.geometry.columns:
        return best
    ends = (
        other
        for other in judged
        if LAST_CELLS not in other.candidate.geometry.columns
        and other.cost < best.cost + TIE
        and same_layouts(best.layouts, other.layouts)
    )
    return next(ends, best)


def _reversed_piles(judged: Sequence[_Judged]) -> list[_Judged]:
    """The readings in which the pile of the most plausible reading is upside down. There are such readings only if the
    boxes of the pile are listed from the top down, and if no more boxes are odd (overlap, float or are outside) in the
    reversed pile."""
    best = judged[0]
    return [
        other
        for other in judged[1:]
        if other.candidate.up == f"-{best.candidate.up}"
        and other.evidence.n_odd <= best.evidence.n_odd
        and are_listed_downwards(best.layouts)
        and not same_layouts(best.layouts, other.layouts)
    ]


def _lies_better(best: _Judged, other: _Judged) -> bool:
    """Whether another reading is less plausible only because few files are meant in this way. If so, places and units
    speak clearly for the other reading: boxes overlap, float or are outside in the most plausible reading, but not in
    the other reading."""
    of_numbers, of_other_numbers = (one.cost - one.candidate.prior for one in (best, other))
    return best.evidence.n_odd > 0 == other.evidence.n_odd and of_other_numbers + WEAK_LEAD < of_numbers


def _along_further_axes(judged: Sequence[_Judged], two: Sequence[_Judged]) -> list[_Judged]:
    """For each vertical axis that neither of the readings ``two`` has, the most plausible reading with this axis. The
    reading is left out if more of its boxes are odd (overlap, float or are outside) than in the readings ``two``, or if
    its layout is less plausible."""
    axes = {"-y", "-z", *(one.candidate.up for one in two)}
    further = []
    for other in judged:  # most plausible first
        if (
            other.candidate.up not in axes
            and other.evidence.n_odd <= min(one.evidence.n_odd for one in two)
            and other.layout_cost < min(one.layout_cost for one in two) + TIE
        ):
            axes.add(other.candidate.up)
            further.append(other)
    return further


def _changes_by_anchor(reading: Reading, columns: BoxColumns, wishes: Wishes, sample: _Sample) -> list[str]:
    """A list with one line that states what the given anchor changes in the reading; empty if it changes nothing.
    The anchor changes something if, without it, another reading would be as plausible or more plausible: for example, a
    reading with another vertical axis."""
    judged = _judged_candidates(columns, replace(wishes, anchor=""), sample)
    for other in judged:
        if other.cost < judged[0].cost + TIE:
            changes = differences(_reading(other), reading)
            words = ", ".join(f"{new} instead of {old}" for option, old, new in changes if option != "--anchor")
            if words:
                return [f"because of the anchor given: {words}"]
    return []


def _may_be_turned(best: _Judged, other: _Judged) -> bool:
    """Whether the vertical axis of another reading may be the right one: names, odd boxes, contacts and a known carrier
    do not decide between the two axes. The order of boxes, walls and the footprint of the load are weak evidence. If
    the weak evidence speaks against the usual vertical axis, the user is asked; otherwise, a note names the other
    axis."""
    is_known = not np.isnan(best.layouts[0].container[:2]).any()
    firm, other_firm = (one.layout_cost + one.begin_cost + is_known * one.units[0].cost for one in (best, other))
    # A reading in which heights are counted downwards has a higher prior (a cost), even if no height is above 0. So its
    # prior may exceed that of the best reading by ``WEAK_LEAD`` instead of ``TIE``.
    rarer = WEAK_LEAD if other.candidate.up.startswith("-") else TIE
    return (
        other.candidate.up != best.candidate.up
        and other.candidate.prior <= best.candidate.prior + rarer
        and other.units[0].length == best.units[0].length
        and other.evidence.n_odd <= best.evidence.n_odd
        and other_firm < firm + TIE
        and not same_layouts(best.layouts, other.layouts)
    )


def _is_doubtful(best: _Judged) -> bool:
    """Whether another axis may be the vertical, or coordinates may describe another corner. This may be so if, in the
    most plausible reading, boxes overlap, float, are outside or are listed from one side to the other. It may also be
    so if the sizes do not lie along the axes that name them, or if a width lies along x."""
    is_exchanged = best.candidate.geometry.axes == XYZ and best.candidate.pair != (0, 1, 2)
    is_exchanged |= best.candidate.along[:2] == ("width", "length")
    return best.evidence.n_odd > 0 or is_exchanged or best.begin_cost + best.order_cost > 0


_LEAST_OVERLAPPING: Final = 6
"""A layout is impossible only if at least this number of its boxes overlap."""


_LARGEST_PRIOR: Final = 7.0
"""A reading whose vertical axis is neither z nor y is refused if its cost before any numbers are considered
(``Candidate.prior``) is at least ``_LARGEST_PRIOR``. A reading with this cost also has an unusual anchor, or
contradicts names. It may seem the most plausible reading only because a number is damaged."""


def _is_impossible(best: _Judged, columns: BoxColumns, wishes: Wishes) -> bool:
    """Whether the most plausible reading must be refused, because more than a fifth of the boxes overlap in it, or
    because it is unusual (``_LARGEST_PRIOR``). The result is False if the caller gives the anchor or a written reading,
    or if the form gives the anchor and the vertical axis."""
    n_overlapping = best.evidence.n_overlapping
    form = columns.source.form
    is_said = bool(wishes.anchor or wishes.exact or (form.anchor and form.up))
    overlaps = n_overlapping >= _LEAST_OVERLAPPING and best.evidence.is_piled
    is_unusual = best.candidate.up not in ("z", "y") and best.candidate.prior >= _LARGEST_PRIOR
    return not is_said and (overlaps or is_unusual)


def _judged_candidates(columns: BoxColumns, wishes: Wishes, sample: _Sample) -> list[_Judged]:
    """Candidates that a result may mention, cheapest first. Candidates whose prior costs are too high to win are left
    out."""
    ranked = sorted(candidates(columns, wishes), key=lambda candidate: candidate.prior)
    judged: list[_Judged] = []
    lowest = math.inf
    for candidate in ranked:
        if judged and candidate.prior + _LOWEST_UNIT_COST > lowest + WEAK_LEAD:
            break
        other = _judge(columns, wishes, candidate, sample)
        if other.layout_cost <= _POOR or not _has_guessed_turns(columns, candidate):
            judged.append(other)
            lowest = min(lowest, other.cost) if other.least_cost < lowest else lowest
    if not judged:
        raise InputError(
            "no reading is plausible in which a guessed column of rotations turns boxes; say which column has "
            "rotations with --columns rotation=NAME"
        )
    for further in (candidates_on_side, candidates_of_corners, candidates_downwards):
        near = (one for one in judged if one.least_cost <= lowest)
        if further is not candidates_of_corners or _is_doubtful(min(near, key=lambda one: one.cost)):
            for candidate in sorted(further(columns, wishes), key=lambda one: one.prior):
                if candidate.prior + _LOWEST_UNIT_COST > lowest + WEAK_LEAD:
                    break
                other = _judge(columns, wishes, candidate, sample)
                judged += [other] if other.layout_cost <= _POOR else []
    # a unit in a column such as "dimensions.uom" is not the unit of coordinates
    are_of_objects = any("." in name for name in columns.unit_columns)
    lacks_unit = not any(one.size_unit and (one.place_unit or not are_of_objects) for one in columns.geometries)
    if lacks_unit and not wishes.units and judged and min(one.layout_cost for one in judged) > _POOR:
        base = sorted(judged, key=lambda one: one.candidate.prior)[:8]
        for factor in (10.0, 0.1, 1000.0, 0.001, 25.4, 100.0, 0.01):
            for one in base:
                scaled = replace(one.candidate, scale=factor, prior=one.candidate.prior + 2.0)
                if _has_unnamed_places(scaled) and not _unit_of_places(scaled):
                    continue
                other = _judge(columns, wishes, scaled, sample)
                if _unit_of_sizes(other, other.units[0].length) is not None and _within_reach(other):
                    judged.append(other)
    return _ranked(judged)


def _ranked(judged: Sequence[_Judged]) -> list[_Judged]:
    """Candidates, cheapest first. Only candidates that a result may mention are ranked: those that may be chosen, be
    rivals or be alternatives by their costs, and those in which no more boxes are odd than in the chosen one."""
    costs = [one.cost for one in sorted(judged, key=lambda one: one.least_cost)[: 1 + _ALTERNATIVES]]
    # the chosen reading may cost almost ``TIE`` more than the cheapest one, and its rivals almost ``WEAK_LEAD`` more
    highest = round(max(*costs, min(costs) + TIE + WEAK_LEAD), 9)
    near = _cheapest_first(one for one in judged if round(one.least_cost, 9) <= highest)
    n_odd = max(one.evidence.n_odd for one in near if one.cost <= near[0].cost + TIE)
    return _cheapest_first(one for one in judged if round(one.least_cost, 9) <= highest or one.evidence.n_odd <= n_odd)


def _cheapest_first(judged: Iterable[_Judged]) -> list[_Judged]:
    # of equally plausible readings, the more usual one comes first; they may differ only in a shift
    return sorted(judged, key=lambda one: (round(one.cost, 9), one.candidate.prior))


def _has_guessed_turns(columns: BoxColumns, candidate: Candidate) -> bool:
    """Whether boxes are turned by a column whose name is unknown."""
    return candidate.rule != "none" and columns.turns is not None and columns.turns.guess_cost > 0


def _within_reach(judged: _Judged) -> bool:
    """Whether each load, in the most plausible units, fits the largest usual carrier. If coordinates were read in a
    larger unit than sizes, boxes could be so far apart that they cannot overlap, and the wrong reading would look
    plausible."""
    factor = LENGTH_UNITS[judged.units[0].length]
    extents = [(load.low + load.size).max(axis=0) - load.low.min(axis=0) for load in judged.layouts]
    return all(fits_a_carrier(extent * factor) for extent in extents)


def _likely_units(best: _Judged) -> list[_Units]:
    """The units of a reading. If two units are a tie, both are returned.

    Two units of lengths are a tie in two cases. Boxes and load fit a carrier equally well in both units, whatever the
    masses; or the costs of the units are almost equal. Units of masses are never a tie, because they do not change
    verdicts.
    """
    first, *others = best.units
    rivals = [choice for choice in others if choice.length != first.length and choice.cost < first.cost + TIE]
    if _are_large_cells(best):
        rivals = [choice for choice in others if choice.length != first.length]
    elif best.candidate.scale == 1.0:
        cheapest: dict[str, _Units] = {}
        for choice in best.units:
            cheapest.setdefault(choice.length, choice)
        fits = {unit: _fit(best, unit) for unit in cheapest if unit in _TRIED or unit == first.length}
        most = max(fits.values())
        equal = [unit for unit, fit in fits.items() if fit == most]
        if most and equal != [first.length]:
            other_units = [unit for unit in equal if unit != first.length]
            is_converted = _are_converted(best, first.length, other_units)
            likely = [cheapest[unit] for unit in other_units if cheapest[unit].cost < first.cost + WEAK_LEAD]
            rivals = [] if is_converted else likely
        elif most > 1:
            rivals = []  # the load fills a pallet only if lengths are in the first unit, so no other unit is possible
    return [first, *rivals[:1]]


def _are_large_cells(best: _Judged) -> bool:
    """Whether boxes consist of a few cells of a grid. Cells may have any size, so nothing shows their unit."""
    size = best.candidate.geometry.size[best.rows]
    return LAST_CELLS in best.candidate.geometry.columns and bool(np.median(size.min(axis=1)) < _FEW_CELLS)


_FEW_CELLS: Final = 5
"""If the shortest side of most boxes has fewer cells of a grid than this number, the cells are probably not
millimetres, centimetres or inches."""
_TRIED: Final = ("mm", "cm", "m", "in")
"""Units of lengths that are tried. Two such units are a tie if boxes and load fit a carrier in both units."""
_THIN, _DENSE = 20.0, 2000.0
"""A unit of masses is plausible if it gives a density, in kg/m³, between these two values: those of crisps and of
bricks."""
_CONVERTED, _NOT_CONVERTED = 0.95, 0.6
"""Lengths count as converted to a unit if two conditions hold. If they are read in this unit, at least the share
``_CONVERTED`` of the lengths are whole millimetres. If they are read in any other unit, at most the share
``_NOT_CONVERTED`` are whole millimetres."""


def _fit(best: _Judged, unit: str) -> int:
    """How well boxes and load fit a carrier if coordinates are in a certain unit (a result of ``load_fit``)."""
    factor = LENGTH_UNITS[unit]
    size = np.concatenate([layout.size for layout in best.layouts])
    load = np.max([(one.low + one.size).max(axis=0) - one.low.min(axis=0) for one in best.layouts], axis=0)
    deck, is_deck = _deck_of(best)
    side = float(np.exp(np.log(size).mean(axis=1)).mean())
    return load_fit(side * factor, load * factor, deck * factor, is_deck, float(size[:, :2].min()) * factor, unit)


def _are_converted(best: _Judged, unit: str, others: Collection[str]) -> bool:
    """Whether ``unit`` is inches, and the sizes are whole millimetres if read in inches, but not if read in any of the
    units ``others``. If the result is True, the file's author has converted millimetres to inches.

    Only inches are examined. For example, lengths of 30 and 40 are whole millimetres if read in centimetres, but the
    boxes may also be 30 and 40 inches long.
    """
    if unit != "in":
        return False
    size = np.concatenate([layout.size for layout in best.layouts])
    return converted_share(size * LENGTH_UNITS[unit]) >= _CONVERTED and all(
        converted_share(size * LENGTH_UNITS[other]) <= _NOT_CONVERTED for other in others
    )


def _is_likely(units: _Units) -> bool:
    """Whether boxes have a plausible density in these units."""
    return _THIN < units.density_kg_m3 < _DENSE


def _other_mass(best: _Judged) -> str | None:
    """Another unit of masses that is plausible and that no column name excludes; None if there is none.

    The other unit is only mentioned in a note, because a factor on all masses hardly affects a verdict.
    """
    first, *others = best.units
    rivals = (
        choice.mass
        for choice in others
        if choice.length == first.length and (choice.cost < first.cost + TIE or _is_likely(choice))
    )
    return next(rivals, None)


def _has_unnamed_places(candidate: Candidate) -> bool:
    """Whether the file names a unit for sizes but none for coordinates, and coordinates are read in another unit than
    sizes."""
    return candidate.scale != 1.0 and bool(candidate.geometry.size_unit) and not candidate.geometry.place_unit


def _unit_of_places(candidate: Candidate) -> str:
    """The unit of coordinates, from the named unit of sizes; "" if it would be unknown, such as 0.1 mm."""
    mm = LENGTH_UNITS[candidate.geometry.size_unit] / candidate.scale
    return next((name for name in _TRIED if math.isclose(LENGTH_UNITS[name], mm)), "")


def _unit_text(best: _Judged, places: str) -> str:
    """The units of sizes and coordinates, in the form that ``Reading`` uses."""
    return places if best.candidate.scale == 1.0 else f"{_unit_of_sizes(best, places) or places}/{places}"


def _unit_of_sizes(judged: _Judged, places: str) -> str | None:
    """The unit of sizes if coordinates have the unit ``places``; None if this unit would be
    unknown, such as 0.1 mm."""
    mm = LENGTH_UNITS[places] * judged.candidate.scale
    return next((name for name in ("mm", "cm", "dm", "m", "in") if math.isclose(LENGTH_UNITS[name], mm)), None)


def _reading(judged: _Judged, units: _Units | None = None) -> Reading:
    """The ``Reading`` that a possible reading and a choice of units give. If ``units`` is None, the most plausible
    units are used."""
    candidate, columns = judged.candidate, judged.columns
    units = units or judged.units[0]
    names = {**candidate.geometry.columns, **columns.columns}
    if columns.turns is not None and columns.turns.guess_cost and candidate.rule == "none":
        del names["rotation"]
    return Reading(
        form=columns.source.form.name,
        columns=names,
        units=_unit_text(judged, units.length),
        masses=units.mass,
        anchor=candidate.anchor,
        up=candidate.up,
        along=candidate.along,
        sizes="placed" if candidate.rule in ("none", *POSES) else "item",
        rule=candidate.rule,
        origin=judged.wishes.origin or judged.origin,
        cost=judged.cost,
        layout_cost=judged.layout_cost,
        evidence=replace(judged.evidence, density_kg_m3=units.density_kg_m3, side_mm=units.side_mm),
    )
