"""The tables of docs/criteria.md: agreement of criteria of stability with physics, and examples of disagreement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import pandas as pd

from petmjx.analysis.criteria import Criterion
from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.criteria_vs_physics import with_physics
from petmjx.common.text import count_text, printable_name, three_digits
from petmjx.engines.metrics import DIMENSIONLESS
from petmjx.results.run_reader import RunResults

BEGIN: Final = "<!-- study: begin (made by python -m benchmarks criteria) -->"
END: Final = "<!-- study: end -->"

CLEAREST: Final = 3
"""Largest number of plans that a row of the table of disagreements names."""

DISAGREEING: Final = ("support_75", "centre", "stacking_tree", "equilibrium", "force_balance_leaning")
"""Criteria with tables of disagreements: the criteria that packers use most, and those whose answers are nearest to
physics."""


def study(results: CriteriaResults, run: RunResults) -> str:
    """All tables as Markdown."""
    worlds = run.worlds[run.worlds["variant"] == 0]
    both = with_physics(results.plans, worlds)
    parts = [
        _introduction(results, run, both),
        _judged(results),
        "The next table has thresholds. Each threshold was found on one half of the plans and judged on the other "
        "half. Distances are positive inside an edge and negative outside it:",
        _thresholds(results),
        "The next table has the disagreements between the criteria and the simulation. A row names the "
        f"{CLEAREST} plans whose disagreement is clearest: plans are sorted by the margin of the simulation, then by "
        "the slack of the criterion.",
        _disagreements(both, [criterion for criterion in results.criteria if criterion.name in DISAGREEING]),
    ]
    return "\n\n".join(parts) + "\n"


def _introduction(results: CriteriaResults, run: RunResults, both: pd.DataFrame) -> str:
    options, info = results.info["options"], run.info
    stands = int(both["stands"].sum())
    engine = ", ".join(sorted(set(run.worlds["engine"])))
    return (
        f"**{count_text(len(both), 'plan')}** with {results.info['n_boxes']:,} boxes; engine `{engine}` of petmjx "
        f"{info['versions']['petmjx']}. {stands:,} stand, {len(both) - stands:,} fall.\n"
        f"The friction coefficient is {options['friction']:g} ({options['side_friction']:g} at the sides of boxes), "
        f"and the tolerance {options['tolerance_mm']:g} mm."
    )


def _judged(results: CriteriaResults) -> str:
    heads = [
        "criterion",
        "accepted: stand",
        "fall",
        "refused: stand",
        "fall",
        "precision",
        "recall",
        "MCC",
        "same first",
    ]
    assert results.judged is not None
    rows = [
        [
            f"`{row['criterion']}`",
            *(f"{row[cell]:,}" for cell in ("accepted_stands", "accepted_falls", "refused_stands", "refused_falls")),
            *(_interval(row, score) for score in ("precision", "recall", "mcc")),
            f"{row['same_first_box']:,}",
        ]
        for row in results.judged.to_dict("records")
    ]
    return _table(heads, rows)


def _thresholds(results: CriteriaResults) -> str:
    thresholds = "found threshold", "published threshold", "MCC, found", "MCC, published"
    heads = ["criterion", *thresholds, "precision", "recall"]
    assert results.thresholds is not None
    rows = []
    for row in results.thresholds.to_dict("records"):
        unit = "" if row["unit"] == DIMENSIONLESS else f" {row['unit']}"
        numbers = [f"{three_digits(row[name])}{unit}" for name in ("threshold", "published")]
        scores = [_interval(row, "mcc"), f"{row['mcc_published']:.2f}"]
        scores += [_interval(row, score) for score in ("precision", "recall")]
        rows.append([f"`{row['criterion']}`: {row['number']}", *numbers, *scores])
    return _table(heads, rows)


def _disagreements(both: pd.DataFrame, criteria: Sequence[Criterion]) -> str:
    heads = ["criterion", "says", "physics", "how many", "clearest cases: plan (slack; margin of physics)"]
    return _table(heads, [row for criterion in criteria for row in _of_one(both, criterion)])


def _of_one(both: pd.DataFrame, criterion: Criterion) -> Iterator[list[str]]:
    """A row for each kind of disagreement of one criterion."""
    slack, unit = f"{criterion.name}_slack", "" if criterion.unit == DIMENSIONLESS else f" {criterion.unit}"
    for accepted, stands in ((True, False), (False, True)):
        wrong = both[(both[criterion.name] == accepted) & (both["stands"] == stands)]
        clearest = wrong.assign(by_margin=wrong["margin"].round(1)).sort_values(
            ["by_margin", slack], ascending=[not stands, stands]
        )
        named = [
            f"`{_id(row['plan_id'])}` ({_number(row[slack])}{unit}; {_number(row['margin'])})"
            for row in clearest.head(CLEAREST).to_dict("records")
        ]
        says, is_so = "stable" if accepted else "not stable", "stands" if stands else "falls"
        yield [f"`{criterion.name}`", says, is_so, f"{len(wrong):,}", ", ".join(named) or "none"]


def _id(plan_id: str) -> str:
    """A plan's id as code in a cell of a table."""
    return printable_name(plan_id).replace("`", "'").replace("|", "\\|")


def _number(value: Any) -> str:
    return "none" if pd.isna(value) else three_digits(value)


def _interval(row: dict[str, Any], score: str) -> str:
    if pd.isna(row[score]):
        return "-"
    return f"{row[score]:.2f} ({row[f'{score}_low']:.2f} … {row[f'{score}_high']:.2f})"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
