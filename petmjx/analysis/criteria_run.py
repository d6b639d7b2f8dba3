"""Evaluates criteria for many plans: ``petmjx.criteria``, its options, its tables, and its results as files."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.analysis.criteria import NO, NOT_ASKED, YES, Answers, CriteriaOptions, Criterion, answer, chosen_criteria
from petmjx.analysis.criteria_vs_physics import ARRIVES, CELLS, SCORES, best_thresholds, judge
from petmjx.analysis.force_balance import Friction
from petmjx.common.argument_checks import flag_of, path_of
from petmjx.common.atomic_write import write_errors
from petmjx.common.errors import InputError
from petmjx.common.processes import process_pool
from petmjx.common.text import count_text, printable_name
from petmjx.engines.metrics import DIMENSIONLESS, TEXT
from petmjx.engines.verdict import Verdict
from petmjx.options.carriers import Carrier, OwnCarrier
from petmjx.options.run_options import Anchor, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.convention_checks import warn
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PlanSource, gather_plans, without_narrow_walls
from petmjx.results.documented_tables import Described, check_tables_free, has_keys, write_documented_tables
from petmjx.results.input_files import input_files
from petmjx.results.plan_lookup import how_read, plans_in_place, plans_of
from petmjx.results.result_files import text
from petmjx.results.run_reader import RunResults, is_chain, opened_run
from petmjx.results.to_json import to_json
from petmjx.runs.chain_summary import arrivals
from petmjx.world.carrier_boards import has_walls, pallet
from petmjx.world.scene import carrier_of

_PLAN_ID: Final = {"plan_id": (TEXT, "id of the packing plan")}


def boxes_frame(plans: Sequence[Plan], answers: Sequence[Answers], criteria: Sequence[Criterion]) -> pd.DataFrame:
    """The table ``boxes``: one row per box, in packing order. If a criterion was not evaluated for a box, its answer is
    null."""
    counts = [plan.n_boxes for plan in plans]
    columns: dict[str, object] = {
        "plan_id": np.repeat(np.array([plan.plan_id for plan in plans], dtype=object), counts),
        "box": np.concatenate([np.arange(count, dtype=np.int32) for count in counts]),
        "item_id": [name for plan in plans for name in plan.item_ids],
        "article": [name for plan in plans for name in plan.articles],
        "n_supports": np.concatenate([plan_answers.n_supports for plan_answers in answers]).astype(np.int32),
        "support_share": np.concatenate([plan_answers.share for plan_answers in answers]),
        "corners": np.concatenate([plan_answers.corners for plan_answers in answers]).astype(np.int32),
    }
    slack = np.concatenate([plan_answers.slack for plan_answers in answers])
    stable = np.concatenate([plan_answers.stable for plan_answers in answers])
    for number, criterion in enumerate(criteria):
        answer = stable[:, number]
        columns[criterion.name] = pd.arrays.BooleanArray(answer == YES, answer == NOT_ASKED)
        columns[f"{criterion.name}_slack"] = slack[:, number]
    return pd.DataFrame(columns)


def plans_frame(plans: Sequence[Plan], answers: Sequence[Answers], criteria: Sequence[Criterion]) -> pd.DataFrame:
    """The table ``plans``: one row per plan. For each criterion, a row says whether all boxes are stable, which box is
    the first unstable one, and what the smallest slack of a box is."""
    counts = np.array([plan.n_boxes for plan in plans])
    starts = np.r_[0, counts.cumsum()[:-1]]
    columns: dict[str, object] = {
        "plan_id": np.array([plan.plan_id for plan in plans], dtype=object),
        "n_boxes": counts.astype(np.int32),
        "support_share": np.minimum.reduceat(np.concatenate([plan_answers.share for plan_answers in answers]), starts),
    }
    slack = np.concatenate([plan_answers.slack for plan_answers in answers])
    stable = np.concatenate([plan_answers.stable for plan_answers in answers])
    box = np.concatenate([np.arange(count) for count in counts])
    never = int(counts.max())
    for number, criterion in enumerate(criteria):
        failed = stable[:, number] == NO
        first = np.minimum.reduceat(np.where(failed, box, never), starts)
        # Boxes without an answer are ignored. If a box fails and has the slack NaN, the smallest slack of the plan is
        # NaN, too.
        with np.errstate(invalid="ignore"):
            least = np.minimum.reduceat(np.where(stable[:, number] == NOT_ASKED, np.inf, slack[:, number]), starts)
        columns[criterion.name] = first == never
        columns[f"{criterion.name}_first"] = pd.arrays.IntegerArray(first.astype(np.int32), first == never)
        columns[f"{criterion.name}_slack"] = least
    return pd.DataFrame(columns)


def documented_boxes(criteria: Sequence[Criterion]) -> Described:
    """The units and descriptions of the columns of the table ``boxes``."""
    columns = dict(_PLAN_ID)
    columns["box"] = (DIMENSIONLESS, "index of the box in packing order, from 0")
    columns["item_id"] = (TEXT, "id of the item in the plan")
    columns["article"] = (TEXT, "article of the item")
    columns["n_supports"] = (
        DIMENSIONLESS,
        "number of areas on which the box lies: one for each box below, one for the carrier or for each of its boards",
    )
    columns["support_share"] = (DIMENSIONLESS, "share of the box's base that is borne")
    columns["corners"] = (DIMENSIONLESS, "number of bottom corners that lie on something")
    for criterion in criteria:
        columns[criterion.name] = (DIMENSIONLESS, f"whether, when the box is placed, {criterion.asks}")
        columns[f"{criterion.name}_slack"] = (criterion.unit, criterion.slack)
    return columns


def documented_plans(criteria: Sequence[Criterion]) -> Described:
    """The units and descriptions of the columns of the table ``plans``."""
    columns = dict(_PLAN_ID)
    columns["n_boxes"] = (DIMENSIONLESS, "number of boxes of the plan")
    columns["support_share"] = (
        DIMENSIONLESS,
        "smallest value, among the plan's boxes, of the share of the base that is borne",
    )
    for criterion in criteria:
        columns[criterion.name] = (
            DIMENSIONLESS,
            f"whether this holds for each box when it is placed: {criterion.asks}",
        )
        columns[f"{criterion.name}_first"] = (
            DIMENSIONLESS,
            "number (in packing order, from 0) of the first box that the criterion does not accept; null if it accepts "
            "all boxes",
        )
        columns[f"{criterion.name}_slack"] = (
            criterion.unit,
            f"smallest value among the boxes of the plan: {criterion.slack}",
        )
    return columns


def criteria_vs_physics_columns() -> Described:
    """The units and descriptions of the columns of the table ``judged``, which compares the criteria with a run."""
    columns = {
        "criterion": (TEXT, "name of the criterion"),
        "n_plans": (DIMENSIONLESS, "number of plans with a valid verdict"),
    }
    for cell in CELLS:
        says, stands = cell.split("_")
        columns[cell] = (
            DIMENSIONLESS,
            f"number of cases in which the criterion {says} the plan, and the plan {stands} in the simulation",
        )
    meanings = ("share of the accepted plans that stand", "share of the standing plans that are accepted")
    for name, meaning in zip(SCORES, (*meanings, "Matthews' correlation coefficient"), strict=True):
        columns[name] = (DIMENSIONLESS, meaning)
        columns[f"{name}_low"] = (DIMENSIONLESS, f"lower end of the 95 % interval of {name}, by bootstrap over plans")
        columns[f"{name}_high"] = (DIMENSIONLESS, f"upper end of the 95 % interval of {name}, by bootstrap over plans")
    columns["same_first_box"] = (
        DIMENSIONLESS,
        "number of plans that the criterion refuses, that fall in the simulation, and whose first refused box is "
        "also the first box that fails in the simulation",
    )
    for name, says in zip(ARRIVES, ("accepts", "refuses"), strict=True):
        columns[name] = (
            DIMENSIONLESS,
            "share of a plan's worlds that arrive at the end of the chain, as a mean over the plans that the criterion "
            f"{says}",
        )
    return columns


def documented_thresholds() -> Described:
    """The units and descriptions of the columns of the table ``thresholds``. Thresholds of different criteria have
    different units, so each row states the unit of its threshold."""
    in_row = "as in the column `unit`"
    columns = {
        "criterion": (TEXT, "name of the criterion"),
        "number": (
            TEXT,
            "quantity whose smallest value among the boxes of a plan is compared with the threshold",
        ),
        "unit": (TEXT, "unit of the threshold"),
        "threshold": (
            in_row,
            "threshold that the search found: a plan is accepted if the quantity in the column `number` is at "
            "least this value for all boxes of the plan",
        ),
        "published": (in_row, "threshold that the criterion's source states"),
        "n_found_on": (DIMENSIONLESS, "number of plans on which the threshold was found"),
        "mcc_found_on": (
            DIMENSIONLESS,
            "MCC (Matthews' correlation coefficient) on the plans on which the threshold was found",
        ),
    }
    judged = dict(criteria_vs_physics_columns())
    for name in ("criterion", "same_first_box", *ARRIVES):
        del judged[name]
    return (
        columns
        | judged
        | {
            "mcc_published": (
                DIMENSIONLESS,
                "MCC (Matthews' correlation coefficient) of the published threshold, on the half of the plans on which "
                "thresholds are tested",
            )
        }
    )


INFO_FILE: Final = "criteria.json"


@dataclass(frozen=True, eq=False)
class CriteriaResults:
    """The answers of closed-form criteria, and their comparison with the verdicts of a run.

    Attributes:
        boxes: one row per box: for each criterion, its answer and its slack (``<criterion>_slack``).
        plans: one row per plan: for each criterion, whether all boxes are stable, the first unstable box (``_first``),
            and the smallest slack.
        judged: one row per criterion: the comparison of its answers with the verdicts of a run; None without a run.
        thresholds: one row per criterion that has a threshold: the threshold that agrees best with the simulation; None
            without a run.
        info: options, counts, skipped plans and times.
    """

    boxes: pd.DataFrame
    plans: pd.DataFrame
    judged: pd.DataFrame | None
    thresholds: pd.DataFrame | None
    info: dict[str, Any]

    def __repr__(self) -> str:
        criteria = count_text(len(self.criteria), "criterion", "criteria")
        return f"CriteriaResults({count_text(len(self.plans), 'plan')}, {criteria})"

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The criteria that were evaluated."""
        return chosen_criteria(self.info["criteria"])

    def units(self, table: str) -> dict[str, str]:
        """The unit of each column of a table: ``""`` for text, ``"1"`` for counts and shares.

        Raises:
            KeyError: there is no table with this name.
        """
        columns_by_table = {name: described for name, _, described in self._tables()}
        return {column: unit for column, (unit, _) in columns_by_table[table].items()}

    def write(self, folder: str | Path, overwrite: bool = False) -> None:
        """Write every table as CSV and as Parquet, with units in the metadata of the Parquet columns. ``info`` is
        written as JSON.

        Raises:
            InputError: the folder already has files with these names and ``overwrite`` is not set, or the folder is not
                writable.
        """
        folder = Path(folder)
        check_criteria_free(folder, overwrite, judged=self.judged is not None)
        with write_errors(folder):
            info = text(json.dumps(to_json(self.info), indent=2, allow_nan=False))
            write_documented_tables(folder, self._tables(), {INFO_FILE: info})

    def _tables(self) -> Iterator[tuple[str, pd.DataFrame, Described]]:
        yield "boxes", self.boxes, documented_boxes(self.criteria)
        yield "plans", self.plans, documented_plans(self.criteria)
        if self.judged is not None:
            yield "judged", self.judged, criteria_vs_physics_columns()
        if self.thresholds is not None:
            yield "thresholds", self.thresholds, documented_thresholds()


def check_criteria_free(folder: Path, overwrite: bool, *, judged: bool, inputs: Iterable[Path] = ()) -> None:
    """Check that the files of the results may be written into a folder. Call this function first, because computing the
    criteria may take minutes.

    Args:
        judged: whether the criteria are compared with a run.
        inputs: files that the command reads.

    Raises:
        InputError: an existing file must not be replaced (``petmjx.results.documented_tables.check_tables_free``).
    """
    tables = ("boxes", "plans", *(("judged", "thresholds") if judged else ()))
    extra_files = {INFO_FILE: lambda file: has_keys(file, ("criteria", "options", "n_plans"))}
    check_tables_free(folder, tables, overwrite=overwrite, inputs=inputs, others=extra_files)


CHUNK: Final = 16
"""Number of plans that a process receives at a time. Computing force balance for 16 plans takes half a second."""


def criteria(
    plans: PlanSource | None = None,
    *,
    run: RunResults | str | Path | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    limit: int | None = None,
    strict: bool = False,
    units: str | None = None,
    anchor: Anchor | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> CriteriaResults:
    """Evaluate closed-form criteria of static stability for plans, and compare them with a simulation.

    ``petmjx.criteria("plans.json", run="results", only=("support_75", "equilibrium")).judged``

    Args:
        plans: as for ``petmjx.score``. If ``plans`` is None, the plans of the run are used, or, without a run, the
            bundled sample plans.
        run: a run of the same plans, or its folder. The criteria are compared with the verdicts of this run. If the run
            simulated a plan several times, with different errors, the verdict of the simulation without errors is used.
            In the run of a transport chain, a plan counts as standing if at least the share ``p_arrives`` of its
            simulations reach the end of the chain.
        out: a folder for the tables, as Parquet and CSV.
        overwrite: whether existing tables may be replaced.
        limit: largest number of plans to evaluate.
        strict: whether a plan that cannot be used raises an error instead of being skipped.
        units: the units of files and data frames, as for ``petmjx.load_plans``.
        anchor: the point of a box to which its coordinates refer, as for ``petmjx.load_plans``.
        progress: function that is called with the number of finished plans and the number of all plans.
        options: fields of ``petmjx.analysis.criteria.CriteriaOptions``: ``friction``, ``side_friction``,
            ``tolerance_mm``, ``carrier`` (by default the run's), ``only``, ``processes``, ``p_arrives``, ``seed``. A
            script that uses ``processes`` must be protected by ``if __name__ == "__main__"``.

    Raises:
        InputError: the plans, the run or the options are unusable, or SciPy or shapely is missing.
    """
    chosen = CriteriaOptions(**options)
    flag_of(overwrite, "overwrite")
    read = RunOptions(limit=limit, strict=strict, units=units, anchor=anchor)
    need_packers()
    if out is not None:
        out = path_of(out, "out")
        check_criteria_free(out, overwrite, judged=run is not None, inputs=input_files(plans, run))
    physics = None if run is None else opened_run(run)
    if physics is not None and "carrier" not in options:
        chosen = chosen.changed(carrier=physics.carrier)
        chosen = chosen if "walls" in options else chosen.changed(walls=physics.walls)
    doubts = [] if physics is None else [*physics.doubts("the run"), *_other_carrier(chosen.carrier, physics)]
    if physics is not None:
        read = read.changed(articles=how_read(physics.info).articles)
    if plans is None and physics is not None:
        plans, read = plans_of(physics, strict), read.changed(articles=None)
    plan_set = gather_plans(plans_in_place(plans, strict), Simulation(), read)
    warn(plan_set.conventions)
    plan_set = without_narrow_walls(plan_set, chosen.carrier, chosen.walls, strict)
    if not plan_set.plans:
        first = f"; the first: {plan_set.skipped[0].message}" if plan_set.skipped else ""
        raise InputError(f"no usable plan ({len(plan_set.skipped)} skipped){first}")
    start = time.perf_counter()
    answers = list(_answers(plan_set.plans, chosen, progress))
    selected_criteria = chosen.criteria
    by_plan = plans_frame(plan_set.plans, answers, selected_criteria)
    judged = thresholds = None
    if physics is not None:
        worlds = _judging_worlds(physics, plan_set.plans, chosen.p_arrives)
        judged = judge(by_plan, worlds, selected_criteria, chosen.seed)
        thresholds = best_thresholds(by_plan, worlds, selected_criteria, chosen.seed)
    info = {
        "criteria": [criterion.name for criterion in selected_criteria],
        "options": chosen.model_dump(mode="json", exclude={"only"}),
        "run": None if physics is None else str(physics.path),
        "doubts": doubts,
        "n_plans": len(plan_set.plans),
        "n_boxes": sum(plan.n_boxes for plan in plan_set.plans),
        "skipped": [skipped.message for skipped in plan_set.skipped],
        "wall_s": time.perf_counter() - start,
    }
    results = CriteriaResults(
        boxes_frame(plan_set.plans, answers, selected_criteria), by_plan, judged, thresholds, info
    )
    if out is not None:
        results.write(out, overwrite)
    return results


def _other_carrier(carrier: Carrier | OwnCarrier, run: RunResults) -> list[str]:
    """A list with a note if the criteria assume another carrier than the run; otherwise an empty list."""
    if carrier == run.carrier:
        return []
    own_carrier, run_carrier = (
        printable_name(carrier_option if isinstance(carrier_option, Carrier) else carrier_option.name)
        for carrier_option in (carrier, run.carrier)
    )
    return [f"the criteria are evaluated on the carrier {own_carrier}, but the run's boxes stood on {run_carrier}"]


def need_packers() -> None:
    """Raise InputError if SciPy or shapely is missing."""
    try:
        import scipy  # noqa: F401  # only to see whether it is installed
        import shapely  # noqa: F401
    except ImportError as error:
        raise InputError(f"criteria need {error.name}: pip install 'petmjx[packers]'") from None


def _answers(
    plans: Sequence[Plan], options: CriteriaOptions, progress: Callable[[int, int], None] | None
) -> Iterator[Answers]:
    """Yield the answers of the criteria for each plan, in the order of the plans."""
    chunks = [plans[start : start + CHUNK] for start in range(0, len(plans), CHUNK)]
    ask = partial(_ask, options=options)
    n_done = 0

    def report_progress(answers: list[Answers]) -> list[Answers]:
        nonlocal n_done
        n_done += len(answers)
        if progress is not None:
            progress(n_done, len(plans))
        return answers

    report_progress([])  # displays of progress compute the rate from this call on, not from the end of the first chunk
    processes = min(options.processes, len(chunks))
    if processes == 1:
        for chunk in chunks:
            yield from report_progress(ask(chunk))
        return
    with process_pool(processes) as pool:
        for answers in pool.map(ask, chunks):
            yield from report_progress(answers)


def _ask(plans: Sequence[Plan], options: CriteriaOptions) -> list[Answers]:
    friction = Friction(options.friction, options.side_friction)
    boards, sim = pallet(options.carrier), Simulation(carrier=options.carrier, walls=options.walls)
    deck_mm = None if boards is None else boards.deck_mm
    rooms = [carrier_of(plan, sim).room if has_walls(sim) else None for plan in plans]
    return [
        answer(plan, options.criteria, friction, options.tolerance_mm, deck_mm, room)
        for plan, room in zip(plans, rooms, strict=True)
    ]


def _judging_worlds(run: RunResults, plans: Sequence[Plan], p_arrives: float) -> pd.DataFrame:
    """One row for each plan of the run, about its nominal world (the simulation without errors). In the run of a
    transport chain, the row is about all simulations of the plan. ``verdict`` says whether at least the share
    ``p_arrives`` of these simulations reach the end of the chain. ``reason`` is the leg (stage of the transport) with
    the most failures. ``margin`` is the share of simulations that reach the end, minus ``p_arrives``.

    Raises:
        InputError: the run has none of these plans, or a plan has a different number of boxes in the run.
    """
    if not is_chain(run.info) or run.summary is None:
        worlds = run.worlds[run.worlds["variant"] == 0]
        _check_same_plans(worlds, run, plans)
        return worlds
    shares = arrivals(run.summary).merge(run.worlds.drop_duplicates("plan_id")[["plan_id", "n_boxes"]], on="plan_id")
    names = [Verdict.INVALID.value, Verdict.STABLE.value]
    verdict = np.select([shares["share"].isna(), shares["share"] >= p_arrives], names, Verdict.UNSTABLE.value)
    judged = shares.assign(
        verdict=verdict, reason=shares["weakest_leg"], margin=shares["share"] - p_arrives, culprit=shares["box"]
    )
    _check_same_plans(judged, run, plans)
    return judged.astype({"culprit": "Int32"})


def _check_same_plans(worlds: pd.DataFrame, run: RunResults, plans: Sequence[Plan]) -> None:
    """Check that the run simulated the given plans. ``worlds`` has one row per plan of the run.

    Raises:
        InputError: the run has none of these plans, or a plan has a different number of boxes in the run.
    """
    counts = {plan.plan_id: plan.n_boxes for plan in plans}
    common = worlds[worlds["plan_id"].isin(list(counts))]
    if common.empty:
        raise InputError(f"{run.path}: simulated none of the {count_text(len(plans), 'plan')}")
    other = common[common["n_boxes"] != common["plan_id"].map(counts)]
    if len(other):
        first = other.iloc[0]
        raise InputError(
            f"{run.path}: plan {printable_name(str(first['plan_id']))} has {first['n_boxes']} boxes in the run, but "
            f"{counts[first['plan_id']]} in the given plans: these are different plans"
        )
