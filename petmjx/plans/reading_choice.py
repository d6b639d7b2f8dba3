"""Chooses a reading (``choose_reading``): candidates get costs, the most plausible one wins, and a tie is refused."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS
from petmjx.plans.plan_fields import FARTHEST_MM
from petmjx.plans.plausibility import (
    Layout,
    converted_share,
    deck_cost,
    density_cost,
    layout_cost,
    load_fit,
    same_layouts,
    side_cost,
)
from petmjx.plans.reading_candidates import Candidate, candidates, layout_of
from petmjx.plans.readings import AmbiguousFile, Evidence, Reading, Wishes, tie_text

TIE: Final = 1.5
"""Two readings whose costs differ by less than this value are a tie. Costs behave like negative log likelihoods: a
difference of 1.5 corresponds to odds of 4 to 1."""
_FEW_BOXES, _FEW_MORE = 6, 0.8
"""In files with few boxes, the limit of a tie is raised by this amount, because a wrong reading of three boxes is often
as plausible as the right one by chance."""
WEAK: Final = 5.0
"""A reading is weak if the cost of its layout exceeds this value. A layout has this cost if a fifth of its boxes
overlap, or if a quarter of them float."""
WEAK_LEAD: Final = 3.0
"""A weak reading wins only if its cost is lower than the cost of every other reading by at least this value. If a plan
really has odd boxes, even more boxes are odd in wrong readings."""
_UNUSUAL: Final = 1.0
"""A reading is unusual if its prior exceeds the smallest prior by at least this value. An unusual reading that is also
weak wins only if every other layout costs at least twice as much: the right reading may be one that is not tried."""
_MOST_BOXES: Final = 400
_MOST_PLANS: Final = 12
"""Largest number of boxes, and largest number of plans, that are used to judge readings. The chosen reading applies to
all boxes."""

_LOWEST_UNIT_COST: Final = -2.5
"""Smallest possible cost of units: the cost for boxes of usual sizes and densities on a usual carrier."""

_UNIT_PRIOR: Final = {"mm": 0.0, "cm": 0.0, "m": 0.0, "in": 0.7, "tick": 1.0, "ft": 3.0}
MASS_PRIOR: Final = {"kg": 0.0, "g": 0.0, "lb": 0.7, "t": 3.0}
"""Unit that is tried if nothing names it → its cost before any numbers are considered."""


@dataclass(frozen=True, eq=False)
class _Judged:
    """A candidate (a possible reading) with its costs."""

    candidate: Candidate
    layout_cost: float
    origin: str
    evidence: Evidence
    layouts: tuple[Layout, ...]
    rows: NDArray[np.int64]
    """The row numbers of all boxes that the layouts contain."""
    unit_cost: float = 0.0
    """Cost of the most plausible units, which depends on which sides of the load lie on the deck."""

    @property
    def cost(self) -> float:
        return self.candidate.prior + self.layout_cost + self.unit_cost


@dataclass(frozen=True, eq=False)
class _Sample:
    """The plans that are used to judge readings: for each plan, its rows and its container."""

    rows: tuple[NDArray[np.int64], ...]
    containers: tuple[Mapping[str, float], ...]


def _sample_of(columns: BoxColumns, plans: Mapping[str, NDArray[np.int64]], damaged: Collection[str] = ()) -> _Sample:
    """The first plans that have no faults. If all plans have faults, the first plans without their bad rows.

    Args:
        damaged: names of plans that lack rows.
    """
    is_good = np.ones(columns.n_boxes, bool)
    for row in columns.faults:
        is_good[row] = False
    for geometry in columns.geometries:
        with np.errstate(invalid="ignore"):
            is_good &= (geometry.size > 0).all(axis=1) & ~np.isnan(geometry.place).any(axis=1)
    chosen: list[NDArray[np.int64]] = []
    containers: list[Mapping[str, float]] = []
    taken = 0
    containers_by_plan = columns.source.boxes.containers
    good_plans = {name: rows for name, rows in plans.items() if name not in damaged and is_good[rows].all()}
    for name, rows in (good_plans or plans).items():
        used = rows[is_good[rows]]
        if not len(used) or len(chosen) >= _MOST_PLANS or taken >= _MOST_BOXES:
            continue
        chosen.append(used)
        containers.append(container_of(containers_by_plan, name))
        taken += len(used)
    return _Sample(tuple(chosen), tuple(containers))


def container_of(containers: Mapping[str, Mapping[str, float]], name: str) -> Mapping[str, float]:
    """The container of a plan: the plan's own container, else the file's container, else None."""
    return (
        containers.get(name) or containers.get("") or (next(iter(containers.values())) if len(containers) == 1 else {})
    )


def _judge(columns: BoxColumns, candidate: Candidate, sample: _Sample) -> _Judged:
    layouts = []
    costs: list[float] = []
    sums = np.zeros(5)
    origins: list[str] = []
    for rows, container in zip(sample.rows, sample.containers, strict=True):
        whole_layout = layout_of(columns, candidate, container)
        layout = Layout(whole_layout.low[rows], whole_layout.size[rows], whole_layout.container)
        layouts.append(layout)
        cost, origin, counts = layout_cost(layout)
        costs.append(cost * len(rows))
        origins.append(origin)
        sums += [*counts, len(rows)]
    n_boxes = max(int(sums[4]), 1)
    total = sum(costs) / n_boxes
    origin = max(set(origins), key=origins.count) if origins else "given"
    evidence = Evidence(int(sums[4]), int(sums[0]), int(sums[1]), int(sums[2]), float(sums[3] / n_boxes))
    return _Judged(candidate, total, origin, evidence, tuple(layouts), np.concatenate(sample.rows))


def _unit_costs(judged: _Judged, columns: BoxColumns, wishes: Wishes) -> list[tuple[float, str, str, float, float]]:
    """A tuple for each pair of units, cheapest first: cost, unit of lengths, unit of masses, median density in kg/m³,
    mean side in mm.

    The unit of lengths is that of coordinates.
    """
    form, geometry = columns.source.form, judged.candidate.geometry
    size = np.concatenate([layout.size for layout in judged.layouts])
    side = float(np.exp(np.log(size).mean(axis=1)).mean())
    volume = size.prod(axis=1)
    size_unit = wishes.units or geometry.place_unit or geometry.size_unit or form.units
    lengths = {size_unit: 0.0} if size_unit else dict(_UNIT_PRIOR)
    if not size_unit and not columns.source.boxes.table.has_header:
        lengths["dm"] = 0.3
    masses: dict[str, float] = {"kg": 0.0}
    if columns.weight is not None and not columns.weight_is_density:
        mass_unit = wishes.masses or columns.weight_unit or form.masses
        masses = {mass_unit: 0.0} if mass_unit else dict(MASS_PRIOR)
    costs = []
    deck = _deck_of(judged, wishes)
    largest_side, smallest_side, unit_density = float(size.max()), float(size.min()), math.nan
    if columns.weight is not None and not columns.weight_is_density:
        with np.errstate(invalid="ignore", divide="ignore"):
            densities = columns.weight[judged.rows] / volume
        densities = densities[np.isfinite(densities) & (densities > 0)]
        unit_density = float(np.median(densities)) if len(densities) else math.nan  # in the file's units
    for length, length_prior in lengths.items():
        factor = LENGTH_UNITS[length]
        mean_mm = side * factor
        cost = length_prior + side_cost(mean_mm)
        cost += deck_cost(deck[0] * factor, deck[1])
        cost += 20.0 * (largest_side * factor > 6_000.0) + 20.0 * (smallest_side * factor < 1.0)
        for mass, mass_prior in masses.items():
            density = unit_density * MASS_UNITS[mass] / (factor / 1000.0) ** 3
            total = cost + mass_prior + (0.0 if math.isnan(density) else density_cost(density))
            if (length in ("in", "ft")) != (mass == "lb") and len(masses) > 1:
                total += 0.7
            costs.append((total, length, mass, density, mean_mm))
    return sorted(costs)


def _deck_of(judged: _Judged, wishes: Wishes) -> tuple[FloatArray, bool]:
    """Extents of the container along x and y in the file's unit, and True. If the container is unknown, the extents of
    the load, and False."""
    layout = judged.layouts[0]
    if not np.isnan(layout.container[:2]).any():
        return layout.container[:2], True
    extents = [(load.low + load.size).max(axis=0) - load.low.min(axis=0) for load in judged.layouts]
    extent: FloatArray = np.max(extents, axis=0)[:2]
    return extent, False


def choose_reading(
    columns: BoxColumns, plans: Mapping[str, NDArray[np.int64]], wishes: Wishes, damaged: Collection[str] = ()
) -> tuple[Reading, Candidate]:
    """Choose the most plausible reading. Also returns the candidate for :func:`layout_of`.

    Args:
        plans: name of a plan → its rows.
        damaged: names of plans that lack rows.

    Raises:
        AmbiguousFile: two readings are almost equally plausible, or no reading is plausible.
        InputError: no row is usable.
    """
    sample = _sample_of(columns, plans, damaged)
    if not sample.rows:
        raise InputError("no row can be used")
    judged = _judged_candidates(columns, wishes, sample)
    best = judged[0]
    tie = TIE + _FEW_MORE * (len(best.rows) < _FEW_BOXES)
    is_weak = best.layout_cost > WEAK
    unusual = best.candidate.prior - min(one.candidate.prior for one in judged) >= _UNUSUAL
    lead = max(tie, WEAK_LEAD * is_weak, best.layout_cost * (is_weak and unusual))
    close = [
        other for other in judged[1:] if other.cost < best.cost + lead and not same_layouts(best.layouts, other.layouts)
    ]
    readings = [_reading(one, columns, wishes) for one in (best, *close)]
    reading = readings[0]
    if len(judged) > 1 and close:
        raise AmbiguousFile(tie_text(readings, is_weak), readings[:4])
    units = _units_of(best, columns, wishes)
    if len(units) > 1:
        first, second = units[0], units[1]
        other_readings = [
            replace(
                reading,
                units=_unit_text(best, columns, entry[1]),
                masses=entry[2],
                evidence=replace(reading.evidence, density_kg_m3=entry[3], side_mm=entry[4]),
            )
            for entry in (first, second)
        ]
        raise AmbiguousFile(tie_text(other_readings, weak=False), other_readings)
    if (rival := _other_mass(best, columns, wishes)) is not None:
        reading = replace(reading, notes=(f"weights may be in {rival}, too (--units)",))
    alternatives = tuple(_reading(one, columns, wishes) for one in judged[1:4])
    return replace(reading, alternatives=alternatives), best.candidate


def _judged_candidates(columns: BoxColumns, wishes: Wishes, sample: _Sample) -> list[_Judged]:
    """Candidates with their costs, cheapest first. Candidates that cannot win because of their priors are left out."""
    ranked = sorted(candidates(columns, wishes), key=lambda candidate: candidate.prior)
    judged: list[_Judged] = []
    lowest = math.inf
    for candidate in ranked:
        if judged and candidate.prior + _LOWEST_UNIT_COST > lowest + WEAK_LEAD:
            break
        judged.append(_with_units(_judge(columns, candidate, sample), columns, wishes))
        lowest = min(lowest, judged[-1].cost)
    unnamed = not wishes.units and not any(geometry.size_unit or geometry.place_unit for geometry in columns.geometries)
    if unnamed and judged and min(one.layout_cost for one in judged) > 0.8 * WEAK:
        base = sorted(judged, key=lambda one: one.candidate.prior)[:8]
        for factor in (10.0, 0.1, 1000.0, 0.001, 25.4, 100.0, 0.01):
            for one in base:
                scaled = replace(one.candidate, scale=factor, prior=one.candidate.prior + 2.0)
                other = _with_units(_judge(columns, scaled, sample), columns, wishes)
                if _within_reach(other, columns, wishes):
                    judged.append(other)
    return sorted(judged, key=lambda one: one.cost)


def _within_reach(judged: _Judged, columns: BoxColumns, wishes: Wishes) -> bool:
    """Whether coordinates are in their range in the most plausible units. If coordinates were read in a larger unit
    than sizes, boxes could be so far apart that they cannot overlap."""
    factor = LENGTH_UNITS[_unit_costs(judged, columns, wishes)[0][1]]
    return all(float(np.abs(layout.low).max()) * factor <= FARTHEST_MM for layout in judged.layouts)


def _with_units(judged: _Judged, columns: BoxColumns, wishes: Wishes) -> _Judged:
    """A judged candidate, with the cost of its most plausible units added."""
    return replace(judged, unit_cost=_unit_costs(judged, columns, wishes)[0][0])


def _units_of(best: _Judged, columns: BoxColumns, wishes: Wishes) -> list[tuple[float, str, str, float, float]]:
    """The units of a reading. If two units are a tie, both are returned.

    Two units of lengths are a tie if boxes and load fit a carrier equally well in both, whatever the masses, or if the
    costs of the units are almost equal. If lengths are in inches, pounds and kilograms are a tie. Other units of masses
    are never a tie, because they do not change verdicts.
    """
    costs = _unit_costs(best, columns, wishes)
    first = costs[0]
    rivals = [entry for entry in costs[1:] if entry[1] != first[1] and entry[0] < first[0] + TIE]
    if best.candidate.scale == 1.0:
        cheapest: dict[str, tuple[float, str, str, float, float]] = {}
        for entry in costs:
            cheapest.setdefault(entry[1], entry)
        fits = {unit: _fit(best, unit, wishes) for unit in cheapest if unit in _TRIED or unit == first[1]}
        most = max(fits.values())
        equal = [unit for unit, fit in fits.items() if fit == most]
        if most and equal != [first[1]]:
            other_units = [cheapest[unit] for unit in equal if unit != first[1]]
            rivals = other_units if not _are_converted(best, first[1], [entry[1] for entry in other_units]) else []
        elif most > 1:
            rivals = []  # the load fills a pallet only if lengths are in this unit
    if not rivals and LENGTH_UNITS[first[1]] == LENGTH_UNITS["in"]:
        rivals = [entry for entry in costs[1:] if entry[1] == first[1] and {first[2], entry[2]} == {"kg", "lb"}]
        rivals = [entry for entry in rivals if _THIN < entry[3] < _DENSE]
    return [first, *rivals[:1]]


_TRIED: Final = ("mm", "cm", "m", "in")
"""Units of lengths that are tried. Two such units are a tie if boxes and load fit a carrier in both units."""
_THIN, _DENSE = 20.0, 2000.0
"""A unit of masses is plausible if it gives a density, in kg/m³, between these two values: those of crisps and of
bricks."""
_CONVERTED, _NOT_CONVERTED = 0.95, 0.6
"""Lengths were converted to a unit if, read in this unit, at least the first share of them are whole millimetres, and,
read in any other unit, at most the second share."""


def _fit(best: _Judged, unit: str, wishes: Wishes) -> int:
    """How well boxes and load fit a carrier if coordinates are in a certain unit (a result of ``load_fit``)."""
    factor = LENGTH_UNITS[unit]
    size = np.concatenate([layout.size for layout in best.layouts])
    load = np.max([(one.low + one.size).max(axis=0) - one.low.min(axis=0) for one in best.layouts], axis=0)
    deck, is_deck = _deck_of(best, wishes)
    side = float(np.exp(np.log(size).mean(axis=1)).mean())
    return load_fit(side * factor, load * factor, deck * factor, is_deck)


def _are_converted(best: _Judged, unit: str, others: Collection[str]) -> bool:
    """Whether ``unit`` is inches, and the sizes are whole millimetres if read in inches, but not if read in any of the
    units ``others``. If so, the file's author has converted millimetres to inches.

    Whole centimetres are no evidence, although they are whole millimetres, because boxes may also have whole inches.
    """
    if unit != "in":
        return False
    size = np.concatenate([layout.size for layout in best.layouts])
    return converted_share(size * LENGTH_UNITS[unit]) >= _CONVERTED and all(
        converted_share(size * LENGTH_UNITS[other]) <= _NOT_CONVERTED for other in others
    )


def _other_mass(best: _Judged, columns: BoxColumns, wishes: Wishes) -> str | None:
    """Another unit of masses that is plausible and that no column name excludes; None if there is none.

    This unit is only mentioned, because a factor on all masses hardly affects a verdict.
    """
    costs = _unit_costs(best, columns, wishes)
    first = costs[0]
    rivals = [entry for entry in costs[1:] if entry[1] == first[1]]
    rivals = [entry for entry in rivals if entry[0] < first[0] + TIE or _THIN < entry[3] < _DENSE]
    return rivals[0][2] if rivals else None


def _unit_text(best: _Judged, columns: BoxColumns, places: str) -> str:
    """The units of sizes and coordinates, in the form that ``Reading`` uses."""
    scale = best.candidate.scale
    if scale == 1.0:
        return places
    mm = LENGTH_UNITS[places] * scale
    sizes = next((name for name in ("mm", "cm", "dm", "m", "in") if math.isclose(LENGTH_UNITS[name], mm)), places)
    return f"{sizes}/{places}"


def _reading(judged: _Judged, columns: BoxColumns, wishes: Wishes) -> Reading:
    candidate = judged.candidate
    _, length, mass, density, side = _units_of(judged, columns, wishes)[0]
    item = candidate.rule not in ("none", "pose")
    return Reading(
        form=columns.source.form.name,
        columns={**candidate.geometry.columns, **columns.columns},
        units=_unit_text(judged, columns, length),
        masses=mass,
        anchor=candidate.anchor,
        up=candidate.up,
        along=candidate.along,
        sizes="item" if item else "placed",
        rule=candidate.rule,
        origin=wishes.origin or judged.origin,
        cost=judged.cost,
        layout_cost=judged.layout_cost,
        evidence=replace(judged.evidence, density_kg_m3=density, side_mm=side),
    )
