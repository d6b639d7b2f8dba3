"""Determines whether the force on the top of a box crushes the box: surely, possibly, or not (docs/loads.md). Both the
force at rest and the peak of the force can crush a box. For transport chains, this module also computes the share of
pallets that arrive, and the share that arrive without crushed boxes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import pandas as pd

from petmjx.engines.verdict import Verdict

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


WAY_UNITS: Final = {
    "plan_id": ("", "id of the packing plan"),
    "remedy": ("", "name of the remedy (a change of one leg of the chain); empty: the unchanged chain"),
    "n_worlds": ("1", "number of worlds with a verdict"),
    "n_standing": ("1", "number of worlds that arrive at the end of the chain"),
    "n_whole": ("1", "number of worlds that arrive without a possibly crushed box"),
    "n_possibly_whole": ("1", "number of worlds that arrive without a surely crushed box"),
    "share": ("1", "n_standing / n_worlds"),
    "share_whole": ("1", "n_whole / n_worlds"),
    "share_possibly_whole": ("1", "n_possibly_whole / n_worlds"),
}


def ways_of(worlds: pd.DataFrame, plans: pd.DataFrame) -> pd.DataFrame:
    """For each plan and remedy (a change to a transport chain), the share of pallets that arrive at the end of the
    chain, and the share that arrive without crushed boxes.

    Args:
        worlds: the worlds of the run of a chain.
        plans: one row for each of these worlds, with the column ``crushed``.
    """
    drawn = worlds.loc[worlds["variant"] > 0, [*WORLD_KEY, "verdict", "remedy"]]
    drawn = drawn[drawn["verdict"].astype(str) != Verdict.INVALID.value].merge(
        plans[[*WORLD_KEY, "crushed"]], on=WORLD_KEY
    )
    arrives = drawn["verdict"].astype(str) == Verdict.STABLE.value
    counted: Mapping[str, pd.Series] = {
        "n_worlds": pd.Series(True, index=drawn.index),
        "n_standing": arrives,
        "n_whole": arrives & (drawn["crushed"] == NOT),
        "n_possibly_whole": arrives & (drawn["crushed"] != SURELY),
    }
    by_way = drawn[["plan_id", "remedy"]].assign(**counted).groupby(["plan_id", "remedy"], sort=False, as_index=False)
    ways = by_way.sum()
    shares = {"share": "n_standing", "share_whole": "n_whole", "share_possibly_whole": "n_possibly_whole"}
    ways = ways.assign(**{share: ways[count] / ways["n_worlds"] for share, count in shares.items()})
    return ways[[*WAY_UNITS]]
