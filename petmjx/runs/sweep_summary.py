"""Makes the additions of a sweep to the results: columns of the table ``worlds`` with parameters and answers, and the
table ``summary``."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from petmjx.engines.metrics import DIMENSIONLESS, TEXT
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.results.schema import Param
from petmjx.results.share_statistics import KEYS, by_plan_and_axis, share_standing
from petmjx.results.table_parts import Parts
from petmjx.results.world_ranks import frame_in_order
from petmjx.runs.chain_legs import PLACING
from petmjx.runs.eumos_limits import EUMOS_COLUMNS, EUMOS_PROFILE, eumos_assessment
from petmjx.runs.forked_worlds import PlacementSearch
from petmjx.runs.level_search import MODES_TEXT, failure_mode
from petmjx.runs.study import FinishedWorld
from petmjx.runs.sweep_axes import AXIS_KINDS, Axis
from petmjx.runs.sweep_design import REMEDY
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.profiles.accelerations import Tilt

RANGE_BINS = 8
"""The summary divides an axis with a continuous range into this number of equal intervals."""

MODE = Param("mode", TEXT, f"how the first box failed: {MODES_TEXT}; empty for a stable world", str)
SIGN = Param(
    "sign_in_profile_s",
    "s",
    "time at which the culprit (first box that failed) crossed a threshold, counted from the beginning of the profile",
)
LEG = Param("leg", TEXT, "leg of the chain after which the pallet did not stand; empty: the pallet arrived", str)
EUMOS_WORST = tuple(column.name for column in EUMOS_COLUMNS if column.unit)
"""Columns of the table ``worlds`` with the deformations that a laboratory measures. Each row of the summary of a grid
has the largest values over the worlds that the row is about."""
FAIL_ANGLE = Param(
    "fail_angle_deg",
    "deg",
    "angle of the carrier when the culprit (first box that failed) crossed a threshold; null if the carrier does not "
    "tilt or no box failed",
)


class SweepColumns:
    """Computes the columns that a sweep adds to the table ``worlds``."""

    def __init__(self, plan: SweepPlan) -> None:
        self._plan = plan
        sweep = plan.sweep
        self._sim = sweep.simulation
        self.parameters = [
            Param(name, unit, "parameter of the variant", _type_of(name, sweep.axes))
            for name, unit in plan.parameter_columns.items()
        ]
        self.strength = AXIS_KINDS[sweep.strength].column
        self.has_drives = sweep.has_drives
        self.has_tilt = not sweep.legs and any(isinstance(profile, Tilt) for profile in sweep.profiles.values())
        self.has_eumos = EUMOS_PROFILE in sweep.profiles and not sweep.legs
        self.has_legs = bool(sweep.legs)

    @property
    def params(self) -> list[Param]:
        """All columns that the sweep adds to the table ``worlds``, in order."""
        columns = [*self.parameters, MODE]
        columns += [LEG] if self.has_legs else []
        columns += [SIGN] if self.has_drives else []
        columns += [FAIL_ANGLE] if self.has_tilt else []
        columns += EUMOS_COLUMNS if self.has_eumos else ()
        return columns

    def of(self, world: FinishedWorld) -> dict[str, Any]:
        """The values of one world in the columns that the sweep adds: column → value. Columns without a value become
        null."""
        values: dict[str, Any] = dict(world.variant.parameters)
        values[MODE.name] = failure_mode(world.outcome, self._sim.thresholds)
        if world.variant.legs:
            return values | self._of_leg(world)
        drive = world.variant.drive
        if drive is None:
            return values
        if world.driven:
            sign_s = self._sign_in_profile_s(world.outcome)
            values[SIGN.name] = sign_s
            profile = self._plan.sweep.profiles[drive.profile]
            if isinstance(profile, Tilt) and sign_s is not None:
                values[FAIL_ANGLE.name] = min(sign_s * profile.rate_deg_s, profile.max_deg)
        if drive.profile == EUMOS_PROFILE and world.placement is not None:
            values |= self._eumos(world, world.placement)
        return values

    def _of_leg(self, world: FinishedWorld) -> dict[str, Any]:
        """The leg in which a world of a chain ended, and the time in this leg at which a box crossed a threshold."""
        end = world.ended_in
        if end is None or end.leg == PLACING:
            return {LEG.name: end.leg if end is not None else ""}
        since_s = world.outcome.first_sign_s - end.began_s
        return {LEG.name: end.leg, SIGN.name: since_s if since_s > 0.5 * self._sim.physics.timestep_s else None}

    def _eumos(self, world: FinishedWorld, placement: Outcome) -> dict[str, Any]:
        """The values of one world in the columns about the limits of EUMOS 40509: column → value. Displacements are
        measured from the positions of the boxes before the drive. If the pallet did not stand after its placement, it
        does not pass the test."""
        values: dict[str, Any] = {}
        if world.driven:
            assessment = eumos_assessment(world.outcome.boxes, placement.boxes.pos, world.scene.half_size)
            values = {name: None if value != value else value for name, value in assessment.items()}
        if placement.verdict is not Verdict.STABLE:
            values["eumos_passed"] = False
        if world.outcome.verdict is Verdict.INVALID:
            values["eumos_passed"] = None
        return values

    def _sign_in_profile_s(self, outcome: Outcome) -> float | None:
        """Time from the beginning of the profile to the first sign of failure, s; None if there was no sign, or if the
        sign came before the profile."""
        began_s = outcome.sim_time_s - outcome.n_steps * self._sim.physics.timestep_s
        since_s = outcome.first_sign_s - began_s
        # The comparison allows a difference of half a step, because the time is a running sum of timesteps and has
        # rounding errors.
        return since_s if since_s > 0.5 * self._sim.physics.timestep_s else None


def _type_of(column: str, axes: Mapping[str, Axis]) -> type[float] | type[int] | type[str]:
    if column == "replicate":
        return int
    if column == REMEDY:
        return str
    cells = [axis.cell(value) for axis in axes.values() if axis.kind.column == column for value in axis.values]
    return str if any(isinstance(cell, str) for cell in cells) else float


# Grids and samples.


@dataclass(frozen=True)
class ShareColumns:
    """The columns of the table ``worlds`` from which the shares of standing worlds are computed. ``run.json`` stores
    this record, so that shards of a run can be merged.

    Attributes:
        axes: names of the columns, in the order of the summary.
        ranges: column → (low, high), for columns whose values were drawn from a range.
        eumos, tilt: whether the sweep has the profile of EUMOS 40509, and whether it has profiles that tilt the
            carrier.
        draws: pairs (number of a variant, number of its draw), for each variant with random values. Variants of the
            same draw have the same random numbers (`Design.draws`).
        same_draws: whether a draw has the same random numbers for all plans.
    """

    axes: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    eumos: bool
    tilt: bool
    draws: Sequence[tuple[int, int]]
    same_draws: bool

    @classmethod
    def of(cls, plan: SweepPlan) -> ShareColumns:
        """The columns for a sweep that is a grid or a sample."""
        columns = SweepColumns(plan)
        axes = tuple(AXIS_KINDS[name].column for name in AXIS_KINDS if name in plan.sweep.axes)
        drawn = [axis for axis in plan.sweep.axes.values() if axis.continuous]
        ranges = {axis.kind.column: (axis.low, axis.high) for axis in drawn}
        draws = tuple(plan.draws().items())
        return cls(axes, ranges, columns.has_eumos, columns.has_tilt, draws, plan.sweep.sample is not None)


def summarise_shares(parts: Parts, columns: ShareColumns) -> pd.DataFrame:
    """The summary of a grid or a sample: for each value of each axis, the share of worlds that stand, over all plans
    and per plan.

    Continuous ranges are divided into ``RANGE_BINS`` equal intervals. For the profile of EUMOS 40509, the summary also
    has the share of worlds within the limits of the standard, and the largest deformations. For profiles that tilt the
    carrier, the summary also has the smallest angle at which a world failed.

    Args:
        parts: files of the run's tables, all complete.
    """
    axes = list(columns.axes)
    extra = ["eumos_passed", *EUMOS_WORST] if columns.eumos else []
    extra += [FAIL_ANGLE.name] if columns.tilt else []
    worlds = frame_in_order(parts, "worlds", ["plan_id", "variant", "verdict", *axes, *extra])
    for name, (low, high) in columns.ranges.items():
        worlds[name] = _binned_values(worlds[name], low, high)
    worlds["draw"] = _draws(worlds, columns)
    keys = [*KEYS]
    summary = share_standing(worlds, axes)
    if columns.eumos:
        tested = worlds[worlds["eumos_passed"].notna()]
        verdict = np.where(tested["eumos_passed"].astype(bool), Verdict.STABLE, Verdict.UNSTABLE)
        eumos = share_standing(tested.assign(verdict=verdict), axes)
        names = {"n_worlds": "n_eumos", "n_standing": "n_eumos_passed", "share": "eumos_share"}
        names |= {"low": "eumos_low", "high": "eumos_high"}
        summary = summary.merge(eumos[[*keys, *names]].rename(columns=names), on=keys, how="left")
        summary[["n_eumos", "n_eumos_passed"]] = summary[["n_eumos", "n_eumos_passed"]].fillna(0).astype("int64")
        worst = by_plan_and_axis(tested, axes, **{name: (name, "max") for name in EUMOS_WORST})
        summary = summary.merge(worst, on=keys, how="left")
    if columns.tilt:
        angles = by_plan_and_axis(worlds, axes, smallest_fail_angle_deg=(FAIL_ANGLE.name, "min"))
        summary = summary.merge(angles, on=keys, how="left")
    return summary


def _draws(worlds: pd.DataFrame, columns: ShareColumns) -> pd.Series[float]:
    """For each world, the number of its draw: all worlds with the same random numbers have the same number, and worlds
    without random numbers have NaN."""
    drawn = worlds["variant"].map(dict(columns.draws))
    if columns.same_draws:
        return drawn
    return worlds.assign(draw=drawn).groupby(["plan_id", "draw"]).ngroup().where(drawn.notna())


def _binned_values(values: pd.Series[float], lowest: float, highest: float) -> pd.Series[str]:
    edges = np.linspace(lowest, highest, RANGE_BINS + 1)
    labels = [f"{low:.4g} to {high:.4g}" for low, high in itertools.pairwise(edges)]
    place = np.clip(np.searchsorted(edges, values.to_numpy(), side="right") - 1, 0, RANGE_BINS - 1)
    labelled = pd.Series(pd.Categorical.from_codes(place, labels, ordered=True), index=values.index)
    return labelled.where(values.notna())


# Searches.


def search_row(search: PlacementSearch, plan: SweepPlan, columns: SweepColumns) -> dict[str, Any]:
    """One row of the summary of a search: column → value."""
    group, item, answer = search.group, plan.search_items()[search.number], search.levels
    box = answer.box if answer.box >= 0 else None
    largest, failed = (
        None if level is None else float(plan.sweep.search_levels[level])
        for level in (answer.largest_survived, answer.first_failed)
    )
    at_failure: Mapping[str, Any] = answer.at_failed.values if answer.at_failed is not None else {}
    row: dict[str, Any] = {
        "plan_id": group.plan.plan_id,
        "placement": group.number,
        **group.placement.parameters,
        "profile": item.profile,
        "direction_deg": item.direction_deg,
        "stands_at_rest": answer.stands_at_rest,
        f"largest_{columns.strength}": largest,
        f"first_failed_{columns.strength}": failed,
        "box": box,
        "article": group.plan.articles[box] if box is not None else "",
        "mode": answer.mode,
        SIGN.name: at_failure.get(SIGN.name),
        "monotone": answer.monotone,
        "n_tests": answer.n_tests,
        "n_invalid": answer.n_invalid,
        "n_moving": answer.n_moving,
        "moving": any(probe.moving for probe in (answer.at_survived, answer.at_failed) if probe is not None),
    }
    if columns.has_eumos:
        at_largest: Mapping[str, Any] = answer.at_survived.values if answer.at_survived is not None else {}
        row |= {param.name: at_largest.get(param.name) for param in EUMOS_COLUMNS}
    return row


def search_frame(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The summary of a search as a data frame. The rows are sorted, so that their order does not depend on the order in
    which the answers of the search arrived."""
    frame = pd.DataFrame(list(rows))
    numbers = {
        "box": "Int32",
        "placement": "int32",
        "n_tests": "int32",
        "n_invalid": "int32",
        "n_moving": "int32",
        "eumos_passed": "boolean",
    }
    floats = [name for name in frame if str(name).endswith(("_g", "_s", "_share", "_m", "_scale"))]
    frame = frame.astype({name: kind for name, kind in numbers.items() if name in frame})
    frame = frame.astype(dict.fromkeys(floats, "float64"))
    return frame.sort_values(["plan_id", "placement", "profile", "direction_deg"], ignore_index=True)


def summary_units(frame: pd.DataFrame, plan: SweepPlan) -> tuple[dict[str, str], dict[str, str]]:
    """Two dicts for the columns of a summary: column → unit, and column → description."""
    known = {param.name: (param.unit, param.description) for param in SweepColumns(plan).params}
    units: dict[str, str] = {}
    texts = dict(_DESCRIPTIONS)
    for name in map(str, frame):
        if name in known:
            units[name], text = known[name]
            texts.setdefault(name, text)
        elif pd.api.types.is_numeric_dtype(frame[name]):
            units[name] = "g" if name.endswith("_g") else "deg" if name.endswith("_deg") else DIMENSIONLESS
    return units, texts


_DESCRIPTIONS = {
    "scope": "`all`: the row is about all plans together; `plan`: the row is about one plan",
    "plan_id": "id of the packing plan; null if the row is about all plans",
    "axis": "name of the varied parameter; empty: the row is about all worlds",
    "value": "value that the varied parameter has in the worlds of the row",
    "n_standing": "number of stable worlds",
    "n_invalid": "number of worlds without a verdict, which the column `share` does not count",
    "share": "share of stable worlds among the worlds with a verdict",
    "n_draws": "number of independent random draws in the worlds of the row; 0 if any of these worlds is not drawn at "
    "random",
    "low": "lower end of the Wilson 95 % interval of `share`, for `n_draws` draws; null without draws",
    "high": "upper end of the Wilson 95 % interval of `share`, for `n_draws` draws; null without draws",
    "n_eumos": "number of worlds that were checked against the limits of EUMOS 40509",
    "n_eumos_passed": "number of worlds that keep the limits of EUMOS 40509",
    "eumos_share": "n_eumos_passed / n_eumos: share of the checked worlds that keep the limits of EUMOS 40509",
    "smallest_fail_angle_deg": "smallest angle of the tilting carrier at which a world failed; null if no world failed",
    "placement": "number of the plan's placement (the part of a variant that changes how boxes are placed), from 0",
    "stands_at_rest": "whether the pallet stands without a profile; if it does not, the search tests no level",
    "largest_level_g": "largest survived level that is below all failed levels; null if there is no such level",
    "largest_scale": "largest survived scale that is below all failed scales; null if there is no such scale",
    "first_failed_level_g": "smallest level that failed; null if no level failed",
    "first_failed_scale": "smallest scale that failed; null if no scale failed",
    "box": "number of the box that failed first: at rest, if the pallet does not stand without a profile; otherwise at "
    "the smallest failed level",
    "mode": f"how the box in the column `box` failed: {MODES_TEXT}; for an invalid world, the reason why the world is "
    "invalid",
    "monotone": "whether the pallet also failed at every tested level above the smallest failed level",
    "n_tests": "number of levels tested",
    "n_moving": "number of tested levels at which boxes still moved after the longest wait (longest_wait_s)",
    "moving": "whether boxes still moved after the longest wait, at the largest survived level or at the smallest "
    "failed level; if so, a longer wait may change the answer",
}
