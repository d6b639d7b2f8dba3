"""Determines whether the force on the top of a box crushes the box: surely, possibly, or not (docs/loads.md). Both the
force at rest and the peak of the force can crush a box."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

SURELY: Final = "surely"
POSSIBLY: Final = "possibly"
NOT: Final = "not"
"""Values of the column ``crushed``."""

BOX_UNITS: Final = {
    "strength_low_n": (
        "N",
        "smallest possible strength of the box as stacked, against forces that act for a short time",
    ),
    "strength_high_n": (
        "N",
        "largest possible strength of the box as stacked, against forces that act for a short time",
    ),
    "crush_share_low": (
        "1",
        "the larger of two quotients. At rest: smallest possible force at rest / largest possible strength against "
        "lasting forces. At the peak: largest force in any step / strength_high_n",
    ),
    "crush_share_high": (
        "1",
        "the larger of two quotients. At rest: largest possible force at rest / smallest possible strength against "
        "lasting forces. At the peak: largest force in any step / strength_low_n",
    ),
}
PLAN_UNITS: Final = {
    "crushed": (
        "",
        "surely, possibly or not: whether a box of the plan is crushed, at rest or at the peak; null if unknown",
    ),
    "crush_box": ("1", "number (in packing order, from 0) of the box with the largest crush_share_high"),
}

SUSTAINED: Final = "sustained_top_force_n"
"""Column of the table ``boxes`` in the run of a transport chain: the largest force at rest on top of the box after any
leg (stage of the transport)."""

WORLD_KEY: Final = ["plan_id", "variant"]
"""The columns that identify a world."""


def with_crush_shares(boxes: pd.DataFrame, time_factors: tuple[float, float]) -> pd.DataFrame:
    """Add the columns ``crush_share_low`` and ``crush_share_high`` to the table of boxes: the smallest and the largest
    possible force on a box as a share of its strength.

    Args:
        boxes: one row per box, with forces and strengths. The forces are the force at rest, the peak of the force, the
            smallest and the largest possible force at rest, and, for a chain, the column ``SUSTAINED``. The smallest
            and the largest possible force and ``SUSTAINED`` may be missing. The strengths are the columns that
            ``BOX_UNITS`` names.
        time_factors: the smallest and the largest share of the strength that a box keeps if the load lasts for days.
    """
    peak, rest = boxes["max_top_force_n"], boxes["rest_top_force_n"]
    sustained = boxes.get(SUSTAINED, rest)
    least, most = (
        np.fmax(rest, sustained) if name not in boxes else boxes[name].fillna(rest)
        for name in ("rest_top_force_low_n", "rest_top_force_high_n")
    )
    if SUSTAINED in boxes:  # in chains, ``most`` is only about the end of the chain; SUSTAINED covers earlier legs
        most = np.fmax(most, sustained)
    low, high = boxes["strength_low_n"], boxes["strength_high_n"]
    shortest, longest = time_factors
    return boxes.assign(
        crush_share_low=np.fmax(least / (high * longest), peak / high),
        crush_share_high=np.fmax(most / (low * shortest), peak / low),
    )


def crushed_worlds(boxes: pd.DataFrame) -> pd.DataFrame:
    """A table with one row per world (one simulation of one plan): whether a box of the world is crushed, and which box
    is most overloaded. ``PLAN_UNITS`` describes the columns."""
    marked = boxes[WORLD_KEY].assign(
        surely=boxes["crush_share_low"] > 1,
        possibly=boxes["crush_share_high"] > 1,
        unknown=boxes["crush_share_high"].isna(),
    )
    worlds = marked.groupby(WORLD_KEY, sort=False, as_index=False).any()
    answers = [worlds["surely"], worlds["possibly"], ~worlds["unknown"]]
    worlds["crushed"] = np.select(answers, [SURELY, POSSIBLY, NOT], "")
    worlds["crushed"] = worlds["crushed"].astype(object).where(worlds["crushed"] != "", None)
    rated_boxes = boxes.dropna(subset="crush_share_high")
    largest = rated_boxes.loc[
        rated_boxes.groupby(WORLD_KEY, sort=False)["crush_share_high"].idxmax(), [*WORLD_KEY, "box"]
    ]
    worlds = worlds.merge(largest.rename(columns={"box": "crush_box"}), on=WORLD_KEY, how="left")
    return worlds[[*WORLD_KEY, *PLAN_UNITS]].astype({"crush_box": "Int32"})
