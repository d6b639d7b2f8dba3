"""The tables of the criteria: data frames, and their columns with units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from petmjx.metrics.spec import DIMENSIONLESS, TEXT
from petmjx.plans.plan import Plan
from petmjx.results.described import Described
from petmjx.statics.answers import NO, NOT_ASKED, YES, Answers
from petmjx.statics.judged import CELLS, SCORES
from petmjx.statics.named import Criterion

_PLAN_ID: Final = {"plan_id": (TEXT, "id of the packing plan")}


def boxes_frame(plans: Sequence[Plan], answers: Sequence[Answers], criteria: Sequence[Criterion]) -> pd.DataFrame:
    """A row a box, in packing order. Answers are nullable: null where a criterion was not asked."""
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
    """A row a plan: whether all boxes are stable, the first that is not, and the least slack."""
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
        # what was not asked has no slack; a box that failed without one leaves its plan without one
        with np.errstate(invalid="ignore"):
            least = np.minimum.reduceat(np.where(stable[:, number] == NOT_ASKED, np.inf, slack[:, number]), starts)
        columns[criterion.name] = first == never
        columns[f"{criterion.name}_first"] = pd.arrays.IntegerArray(first.astype(np.int32), first == never)
        columns[f"{criterion.name}_slack"] = least
    return pd.DataFrame(columns)


def described_boxes(criteria: Sequence[Criterion]) -> Described:
    """The columns of ``boxes``."""
    columns = dict(_PLAN_ID)
    columns["box"] = (DIMENSIONLESS, "index of the box in packing order, from 0")
    columns["item_id"] = (TEXT, "id of the item in the plan")
    columns["article"] = (TEXT, "article of the item")
    columns["n_supports"] = (
        DIMENSIONLESS,
        "areas on which the box lies: one a box below; of the carrier one, or one a board",
    )
    columns["support_share"] = (DIMENSIONLESS, "borne share of the base")
    columns["corners"] = (DIMENSIONLESS, "bottom corners that lie on something")
    for criterion in criteria:
        columns[criterion.name] = (DIMENSIONLESS, f"whether {criterion.asks}, at its placement")
        columns[f"{criterion.name}_slack"] = (criterion.unit, criterion.slack)
    return columns


def described_plans(criteria: Sequence[Criterion]) -> Described:
    """The columns of ``plans``."""
    columns = dict(_PLAN_ID)
    columns["n_boxes"] = (DIMENSIONLESS, "boxes of the plan")
    columns["support_share"] = (DIMENSIONLESS, "least borne share of a base")
    for criterion in criteria:
        columns[criterion.name] = (DIMENSIONLESS, f"whether of each box {criterion.asks}")
        columns[f"{criterion.name}_first"] = (
            DIMENSIONLESS,
            "first box for which this is not true; null if there is none",
        )
        columns[f"{criterion.name}_slack"] = (criterion.unit, f"least of all boxes: {criterion.slack}")
    return columns


def described_judged() -> Described:
    """The columns of ``judged``."""
    columns = {"criterion": (TEXT, "name of the criterion"), "n_plans": (DIMENSIONLESS, "plans with a valid verdict")}
    for cell in CELLS:
        says, stands = cell.split("_")
        columns[cell] = (DIMENSIONLESS, f"plans {says} by the criterion; of physics each {stands}")
    meanings = ("share of the accepted plans that stand", "share of the standing plans that are accepted")
    for name, meaning in zip(SCORES, (*meanings, "Matthews' correlation coefficient"), strict=True):
        columns[name] = (DIMENSIONLESS, meaning)
        columns[f"{name}_low"] = (DIMENSIONLESS, "lower end of its 95 % interval, by bootstrap over plans")
        columns[f"{name}_high"] = (DIMENSIONLESS, "upper end of it")
    columns["same_first_box"] = (DIMENSIONLESS, "refused falling plans of which both name the same first box")
    return columns


def described_thresholds() -> Described:
    """The columns of ``thresholds``. Those of the threshold itself are in the unit that the row names."""
    in_row = "as in the column unit"
    columns = {
        "criterion": (TEXT, "name of the criterion"),
        "number": (TEXT, "what the threshold is about: the smallest value of all boxes"),
        "unit": (TEXT, "of the threshold"),
        "threshold": (in_row, "plans with at least this number are accepted"),
        "published": (in_row, "the criterion's own threshold"),
        "n_found_on": (DIMENSIONLESS, "plans on which the threshold was found"),
        "mcc_found_on": (DIMENSIONLESS, "MCC on them"),
    }
    judged = dict(described_judged())
    del judged["criterion"], judged["same_first_box"]
    return (
        columns | judged | {"mcc_published": (DIMENSIONLESS, "MCC of the criterion's own threshold, on the same plans")}
    )
