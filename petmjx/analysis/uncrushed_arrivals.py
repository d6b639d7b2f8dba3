"""The share of pallets that arrive at the end of a transport chain, and the share that arrive without crushed boxes
(docs/loads.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import pandas as pd

from petmjx.analysis.crushing import NOT, SURELY, WORLD_KEY
from petmjx.engines.verdict import Verdict

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
