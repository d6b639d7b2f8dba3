"""The code of a process that reads plans of a run (petmjx.runs.reading_processes starts the process)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from petmjx.engines.subprocess.task_pipe import serve
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import UnreadFields
from petmjx.plans.plan_segments import Segment, SegmentContent, read_segment
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import PlanSource, carrier_extent_mm, gather_plans
from petmjx.plans.plan_transfer_arrays import JoinedPlans
from petmjx.results.plan_digests import PlanRecord, records_of
from petmjx.world.edge_distances import edge_risks
from petmjx.world.scene import build_scenes

MOST_EXAMINED: Final = 4096
"""Largest number of plans whose ``EdgeRisk`` a process computes before it sends the plans to the run. For this number
of plans, the computation takes about a second. If there are more plans, the run itself computes the ``EdgeRisk`` of the
other plans while it simulates."""


class ReadingAnswer(NamedTuple):
    """The plans that a process has read, and values that it has computed from them.

    Attributes:
        columns: all plans, joined into a few arrays and lists, which are sent faster than thousands of plan objects.
        rest: the set of plans without its list of plans. It has the skipped entries, the warnings and all other
            attributes.
        unread: how often each field that petmjx ignores occurs. These fields are counted only if the process has read a
            segment of a file.
        records: plan id → record of the plan.
        edge_risks: plan id → ``EdgeRisk`` of the plan's scene, for the first ``MOST_EXAMINED`` plans.
    """

    columns: JoinedPlans
    rest: PlanSet
    unread: UnreadFields
    records: dict[str, PlanRecord]
    edge_risks: dict[str, int]

    @property
    def content(self) -> SegmentContent:
        """The set of plans, and the counts of ignored fields."""
        return SegmentContent(replace(self.rest, plans=self.columns.plans), self.unread)


def main() -> None:
    """Read the plans that a task from standard input names, and write the answer to standard output."""
    serve(lambda task: answer_to(*task), nice=0)


def answer_to(source: PlanSource | Segment | None, sim: Simulation, options: RunOptions) -> ReadingAnswer | None:
    """The plans of a source, or of a segment of a file. The result is None after an error or a warning, or if a file
    cannot be read. The process of the run then reads the plans itself, because only that process can show errors and
    warnings to the user, ask the user how to read a file, and read pipes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            if isinstance(source, Segment):
                content = read_segment(source, options, carrier_extent_mm(sim))
            else:
                content = SegmentContent(gather_plans(source, sim, options), UnreadFields())
        except Exception:
            return None
    plan_set, unread = content
    if caught or any(skipped.number is None for skipped in plan_set.skipped):
        return None
    records = records_of(plan_set.plans, plan_set.numbers)
    risks = _risks(plan_set.plans[:MOST_EXAMINED], sim)
    return ReadingAnswer(JoinedPlans.of(plan_set.plans), replace(plan_set, plans=[]), unread, records, risks)


def _risks(plans: Sequence[Plan], sim: Simulation) -> dict[str, int]:
    """Plan id → ``EdgeRisk`` of the plan's scene. The dict is empty after an error, since the run can begin without
    these values."""
    try:
        risks = edge_risks(list(build_scenes(plans, sim))).tolist()
    except Exception:
        return {}
    return {plan.plan_id: risk for plan, risk in zip(plans, risks, strict=True)}
