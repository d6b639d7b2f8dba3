"""How many plans that fall can be repaired, with how many changes, and how long it takes (docs/repair.md).

There are three sets of plans: generated plans that fall, third-party plans in which one box is moved so that they fall,
and given files.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any, Final

import numpy as np
import pandas as pd

import petmjx
from petmjx.common.text import count_text
from petmjx.packers.sample_plans import MOST_SAMPLES, generate
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.repairs.draft_rules import Rules
from petmjx.repairs.drafts import Draft
from petmjx.repairs.repair import Repaired

TRIES: Final = 40
"""Number of moves of a box that are tried in each third-party plan."""

SCORED_AT_ONCE: Final = 4
"""Number of moves that are scored together, until one of them makes the plan fall."""

MOVES_MM: Final = (40.0, 200.0)
"""Smallest and largest length of a move, mm."""


def falling(plans: Sequence[Plan], **how: Any) -> list[Plan]:
    """Those of the given plans that do not stand."""
    verdicts = petmjx.score(list(plans), **how).worlds
    return [plan for plan, verdict in zip(plans, verdicts.verdict, strict=True) if verdict != "stable"]


def generated(n: int, seed: int, boxes: tuple[int, int], **how: Any) -> tuple[list[Plan], list[Plan]]:
    """From the mixed set of a seed, and only with a number of boxes in the range ``boxes``: the first ``n`` plans that
    fall, and up to the same number of plans that stand."""
    drawn = (parse_plan(name, placed, DecoderOptions(f"seed {seed}")) for name, placed in generate(MOST_SAMPLES, seed))
    fitting = (plan for plan in drawn if boxes[0] <= plan.n_boxes <= boxes[1])
    plans: list[Plan] = []
    neighbours: list[Plan] = []
    while len(plans) < n:
        some = [*islice(fitting, 2 * (n - len(plans)))]
        fallen = falling(some, **how)
        plans += fallen
        neighbours += [plan for plan in some if plan not in fallen]
    return plans[:n], neighbours[:n]


def share_of(plans: Sequence[Plan], worlds: int, **how: Any) -> str:
    """A text with the number and the share of worlds with errors in which plans stand."""
    summary = petmjx.score(list(plans), confidence=worlds, **how).summary
    assert summary is not None
    standing, n = summary.n_standing.sum(), (summary.n_worlds - summary.n_invalid).sum()
    return (
        f"{standing} of {n} worlds with errors ({100 * standing / n:.1f} %) of {count_text(len(plans), 'plan')} stand"
    )


def disturbed(plans: Sequence[Plan], seed: int, **how: Any) -> Iterator[Plan]:
    """Plans that stand, each with one box moved so that it falls: the first of ``TRIES`` random moves that is allowed
    and makes it fall. Plans without such a move are left out."""
    for plan in plans:
        if falling([plan], **how):
            continue
        rng = np.random.default_rng([seed, len(plan.plan_id), plan.n_boxes])
        rules, start = Rules(plan, petmjx.Simulation(), 0.0, 0), Draft.of(plan)
        moved = []
        for number in range(TRIES):
            box, axis = int(rng.integers(plan.n_boxes)), int(rng.integers(2))
            corner = start.corner_mm[[box]].copy()
            corner[0, axis] += rng.choice((-1, 1)) * round(float(rng.uniform(*MOVES_MM)))
            draft = start.with_places([box], corner, anew=False)
            if rules.allow([draft])[0]:
                moved.append(draft.as_plan(f"{number}"))
        groups = (moved[begin : begin + SCORED_AT_ONCE] for begin in range(0, len(moved), SCORED_AT_ONCE))
        if falls := next(filter(None, (falling(group, **how) for group in groups)), None):
            yield replace(falls[0], plan_id=plan.plan_id)


def repaired_rows(plans: Sequence[Plan], **options: Any) -> Iterator[tuple[dict[str, Any], Repaired]]:
    """A row for each plan, as soon as it is repaired: the row of ``Repairs.table``, with seconds of wall clock and
    CPU."""
    for plan in plans:
        wall, cpu = time.perf_counter(), time.process_time()
        (result,) = petmjx.repair(plan, **options).each
        times = {"wall_s": round(time.perf_counter() - wall, 2), "cpu_s": round(time.process_time() - cpu, 2)}
        moved = {box for change in result.changes for box in change.boxes}
        yield {**result.row(), "stands": result.stands, "boxes_changed": len(moved), **times}, result


def describe(rows: Sequence[dict[str, Any]]) -> str:
    """A summary of the rows."""
    table = pd.DataFrame(rows)
    good = table[table["stands"]]
    whole = good[good["left_out"] == 0]
    text = (
        f"{len(table)} plans; {len(whole)} repaired with all boxes ({100 * len(whole) / len(table):.0f} %), "
        f"{len(good)} in all ({100 * len(good) / len(table):.0f} %); changes: median {good['n_changes'].median():g}, "
        f"mean {good['n_changes'].mean():.1f}; trials: median {table['trials'].median():g}; CPU s: median "
        f"{table['cpu_s'].median():.1f}, most {table['cpu_s'].max():.1f}; "
        f"wall s: median {table['wall_s'].median():.1f}, most {table['wall_s'].max():.1f}"
    )
    if good["n_worlds_after"].any():
        before = table["n_standing_before"].sum() / max(table["n_worlds_before"].sum(), 1)
        after = good["n_standing_after"].sum() / good["n_worlds_after"].sum()
        text += f"; with errors {100 * before:.1f} % of worlds stand before, {100 * after:.1f} % after"
    return text
