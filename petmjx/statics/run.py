"""The criteria of many plans: ``petmjx.criteria``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from petmjx.basics.arguments import flag_of, path_of
from petmjx.basics.errors import InputError
from petmjx.basics.processes import process_pool
from petmjx.basics.text import counted, shown
from petmjx.basics.units import PLAN_UNITS
from petmjx.options.carrier import Carrier, OwnCarrier
from petmjx.options.config import Simulation
from petmjx.options.run_options import Anchor, RunOptions
from petmjx.plans.conventions import warn
from petmjx.plans.gather import PlanSource, gather_plans
from petmjx.plans.plan import Plan
from petmjx.results.plans_again import how_read
from petmjx.results.reader import RunResults, load_run
from petmjx.results.sources import source_files
from petmjx.statics.answers import Answers, answer
from petmjx.statics.friction import Friction
from petmjx.statics.judged import best_thresholds, judge
from petmjx.statics.options import CriteriaOptions
from petmjx.statics.record import CriteriaResults, check_criteria_free
from petmjx.statics.tables import boxes_frame, plans_frame
from petmjx.world.carriers import pallet

CHUNK: Final = 16
"""Plans that a process takes at a time: half a second of force balance."""


def criteria(
    plans: PlanSource | None = None,
    *,
    run: RunResults | str | Path | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    limit: int | None = None,
    strict: bool = False,
    units: str = PLAN_UNITS,
    anchor: Anchor = "corner",
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> CriteriaResults:
    """Evaluate closed-form criteria of static stability, and compare them with a simulation.

    ``petmjx.criteria("plans.json", run="results", only=("support_75", "equilibrium")).judged``

    Args:
        plans: as for ``petmjx.score``; None: the bundled samples.
        run: results of the same plans, or their folder, with whose verdicts the criteria are compared. If a plan has
            several worlds, the nominal one counts.
        out: a folder for the tables, as Parquet and CSV.
        overwrite: whether tables that are there are replaced.
        limit: at most so many plans.
        strict: raise at the first plan that would be skipped.
        units: of files and data frames, as for ``petmjx.load_plans``.
        anchor: the same.
        progress: called with the number of plans done, and of all.
        options: fields of ``petmjx.statics.options.CriteriaOptions``: ``friction``, ``side_friction``,
            ``tolerance_mm``, ``carrier`` (by default the run's), ``only``, ``processes``, ``seed``. With
            ``processes`` a script needs its ``if __name__``.

    Raises:
        InputError: unusable plans, run or options; or SciPy or shapely is missing.
    """
    chosen = CriteriaOptions(**options)
    flag_of(overwrite, "overwrite")
    read = RunOptions(limit=limit, strict=strict, units=units, anchor=anchor)
    _need_packers()
    if out is not None:
        out = path_of(out, "out")
        check_criteria_free(out, overwrite, judged=run is not None, inputs=source_files(plans, run))
    physics = run if isinstance(run, RunResults) or run is None else load_run(run)
    if physics is not None and "carrier" not in options:
        chosen = chosen.changed(carrier=physics.carrier)
    doubts = [] if physics is None else [*physics.doubts("the run"), *_other_carrier(chosen.carrier, physics)]
    if physics is not None:
        read = read.changed(articles=how_read(physics.info).articles)
    plan_set = gather_plans(plans, Simulation(), read)
    warn(plan_set.conventions)
    if not plan_set.plans:
        first = f"; the first: {plan_set.skipped[0].message}" if plan_set.skipped else ""
        raise InputError(f"no usable plan ({len(plan_set.skipped)} skipped){first}")
    start = time.perf_counter()
    answers = list(_answers(plan_set.plans, chosen, progress))
    selected_criteria = chosen.criteria
    by_plan = plans_frame(plan_set.plans, answers, selected_criteria)
    judged = thresholds = None
    if physics is not None:
        worlds = _nominal_worlds(physics, plan_set.plans)
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
    """A line where the criteria are asked on another carrier than that on which boxes stood."""
    if carrier == run.carrier:
        return []
    here, run_carrier = (
        shown(carrier_option if isinstance(carrier_option, Carrier) else carrier_option.name)
        for carrier_option in (carrier, run.carrier)
    )
    return [f"the criteria are evaluated on the carrier {here}, but the run's boxes stood on {run_carrier}"]


def _need_packers() -> None:
    try:
        import scipy  # noqa: F401  # only whether it is there
        import shapely  # noqa: F401
    except ImportError as error:
        raise InputError(f"criteria need {error.name}: pip install 'petmjx[packers]'") from None


def _answers(
    plans: Sequence[Plan], options: CriteriaOptions, progress: Callable[[int, int], None] | None
) -> Iterator[Answers]:
    """Answers in the order of the plans."""
    chunks = [plans[start : start + CHUNK] for start in range(0, len(plans), CHUNK)]
    ask = partial(_ask, options=options)
    done = 0

    def told(answers: list[Answers]) -> list[Answers]:
        nonlocal done
        done += len(answers)
        if progress is not None:
            progress(done, len(plans))
        return answers

    processes = min(options.processes, len(chunks))
    if processes == 1:
        for chunk in chunks:
            yield from told(ask(chunk))
        return
    with process_pool(processes) as pool:
        for answers in pool.map(ask, chunks):
            yield from told(answers)


def _ask(plans: Sequence[Plan], options: CriteriaOptions) -> list[Answers]:
    friction = Friction(options.friction, options.side_friction)
    boards = pallet(options.carrier)
    deck_mm = None if boards is None else boards.deck_mm
    return [answer(plan, options.criteria, friction, options.tolerance_mm, deck_mm) for plan in plans]


def _nominal_worlds(run: RunResults, plans: Sequence[Plan]) -> Any:
    """The worlds of variant 0.

    Raises:
        InputError: none is of these plans, or one has another number of boxes.
    """
    worlds = run.worlds[run.worlds["variant"] == 0]
    counts = {plan.plan_id: plan.n_boxes for plan in plans}
    common = worlds[worlds["plan_id"].isin(list(counts))]
    if common.empty:
        raise InputError(f"{run.path}: has none of the {counted(len(plans), 'plan')}")
    other = common[common["n_boxes"] != common["plan_id"].map(counts)]
    if len(other):
        first = other.iloc[0]
        raise InputError(
            f"{run.path}: plan {shown(str(first['plan_id']))} has {first['n_boxes']} boxes there and "
            f"{counts[first['plan_id']]} here: not the same plans"
        )
    return worlds
