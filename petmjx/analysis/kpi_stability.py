"""Finds out, from the results of runs, which plans stand. There are two answers for a plan: petmjx's verdict, and the
answer by the rule of BED-BPP (a public benchmark for packing)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.engines.verdict import Verdict
from petmjx.options.simulation import Check
from petmjx.plans.articles import read_articles, with_articles
from petmjx.plans.plan import Plan
from petmjx.results.plan_digests import plan_digest
from petmjx.results.plan_lookup import how_read
from petmjx.results.run_reader import RunResults, opened_run

MOST_SHIFT_Z_M: Final = 0.01
"""Largest distance along z that a box of a stable plan may move according to BED-BPP's rule, m."""


@dataclass(frozen=True)
class Stability:
    """Whether plans stand. The fields ``verdicts``, ``stable`` and ``their_rule`` map ids of plans to answers. A plan
    whose answer is unknown has no entry.

    Attributes:
        verdicts: petmjx's verdict on each plan, as text.
        stable: whether petmjx's verdict on the plan is ``stable``. Plans whose verdict is ``invalid`` have no entry.
        their_rule: whether the plan stands according to BED-BPP's rule.
        notes: lines for the user about unfinished runs, and about runs that the user must still make to get all
            answers.
    """

    verdicts: Mapping[str, str] = field(default_factory=dict)
    stable: Mapping[str, bool] = field(default_factory=dict)
    their_rule: Mapping[str, bool] = field(default_factory=dict)
    notes: Sequence[str] = ()
    all_stand: bool = False

    @classmethod
    def assumed(cls) -> Stability:
        """A ``Stability`` without simulations: all plans are assumed to stand according to BED-BPP's rule."""
        return cls(all_stand=True, notes=("all plans are assumed to be stable; none was simulated",))

    def column(self, known: Mapping[str, bool], plan_ids: Iterable[str]) -> pd.Series:
        """A column with one value per plan, which is 1 if the plan stands, 0 if the plan does not stand, and null if
        the answer is unknown."""
        is_assumed = known is self.their_rule and self.all_stand
        values = [1 if is_assumed else None if plan_id not in known else int(known[plan_id]) for plan_id in plan_ids]
        return pd.Series(values, dtype="Int64")


def read_stability(sources: Sequence[RunResults | Path], plans: Collection[Plan]) -> Stability:
    """Read from the results of runs whether plans stand.

    Args:
        sources: runs, or their folders.

    Raises:
        InputError: a folder has no run, its run is a sweep, or a plan in a run differs from the given plan with the
            same id.
    """
    if not sources:
        command = "give --run DIR with a run made by 'petmjx score PLANS --check static --out DIR'"
        return Stability(notes=(f"no run was given, so it is unknown which plans stand: {command}",))
    runs = [opened_run(run) for run in sources]
    for run in runs:
        _check_same(run, plans)
    static = next((run for run in runs if _check(run) == Check.STATIC), None)
    verdicts = _verdicts(runs[0])
    notes = [line for run in runs for line in run.doubts(run.where)]
    if static is None:
        notes.append(
            f"kpi_6 needs a run with --check static, but the run {runs[0].where} was made with --check "
            f"{_check(runs[0])}: give also "
            "--run DIR with a run made by 'petmjx score PLANS --check static --out DIR'"
        )
    invalid = Verdict.INVALID.value
    stable = {name: verdict == Verdict.STABLE.value for name, verdict in verdicts.items() if verdict != invalid}
    if static is not None and not static.keeps_boxes:
        notes.append(f"{static.where}: has no table of boxes, which BED-BPP's rule needs")
    return Stability(verdicts, stable, {} if static is None else _by_their_rule(static), tuple(notes))


def _check(run: RunResults) -> Any:
    return run.info["config"]["simulation"]["check"]


def _check_same(run: RunResults, plans: Iterable[Plan]) -> None:
    if run.info["config"]["command"] == "sweep":
        raise InputError(f"{run.where}: is a sweep; KPIs need a run of 'petmjx score'")
    digests = dict(zip(run.plans["plan_id"], run.plans["digest"], strict=True))
    if (file := how_read(run.info).articles) is not None:
        articles = read_articles(file)
        plans = [with_articles(plan, articles) for plan in plans]
    for plan in plans:
        if digests.get(plan.plan_id, digest := plan_digest(plan)) != digest:
            raise InputError(f"{run.where}: plan {printable_name(plan.plan_id)} differs from the simulated one")


def _verdicts(run: RunResults) -> dict[str, str]:
    """The verdict on each plan of a run, by the plan's id. If a plan has several simulations, the verdict of the
    simulation without errors is used."""
    columns = ("plan_id", "variant", "verdict")
    tables = run.parts.table("worlds", columns)
    worlds = pa.concat_tables(tables).filter(pc.field("variant") == 0) if tables else None
    if worlds is None:
        return {}
    return dict(zip(worlds["plan_id"].to_pylist(), worlds["verdict"].to_pylist(), strict=True))


def _by_their_rule(run: RunResults) -> dict[str, bool]:
    """Whether each plan stands according to BED-BPP's rule. The run must have used the check ``static``, which puts all
    boxes in place at once."""
    verdicts = _verdicts(run)
    largest: dict[str, float] = {}
    for part in run.parts.table("boxes", ("plan_id", "variant", "shift_z_m")):
        boxes = part.filter(pc.field("variant") == 0)
        boxes = boxes.set_column(2, "shift_z_m", pc.abs(boxes["shift_z_m"]))
        grouped = boxes.group_by("plan_id").aggregate([("shift_z_m", "max")])
        largest |= dict(zip(grouped["plan_id"].to_pylist(), grouped["shift_z_m_max"].to_pylist(), strict=True))
    return {
        plan_id: shift <= MOST_SHIFT_Z_M
        for plan_id, shift in largest.items()
        if shift is not None and verdicts.get(plan_id) not in (None, Verdict.INVALID.value)
    }
