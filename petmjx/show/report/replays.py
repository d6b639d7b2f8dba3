"""Histories of those worlds that were recorded during the run. The page of a report can play these worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.analysis.run_comparison import KEY
from petmjx.engines.verdict import Verdict
from petmjx.results.history_tables import read_history
from petmjx.show.pages.page_arrays import PackedArray, block, integer_column, quantised_column
from petmjx.show.report.report_runs import ReportRun
from petmjx.world.history import History

MOST_POSES: Final = 500_000
"""Largest number of poses (boxes × frames) on a page. A pose takes about 7 bytes. If there are more poses, worlds that
stand are left out first."""


@dataclass(frozen=True, eq=False)
class Replays:
    """The histories on a page.

    Attributes:
        blocks: name → block (compact arrays), one block per history: "replay-0", "replay-1", …
        number: (rows of the table,) number of the block with the history of each row's world; −1 if there is no block.
        left_out: number of recorded worlds that were left out because the page would be too large.
    """

    blocks: dict[str, str]
    number: NDArray[np.int64]
    left_out: int


def replays(
    runs: Sequence[ReportRun], table: pd.DataFrame, drawn: NDArray[np.int64], most: int = MOST_POSES
) -> Replays:
    """Store the histories of the worlds in a table in blocks. Worlds without a 3D picture are left out.

    Args:
        runs: the runs of the report.
        table: data frame with the rows of the table, from :func:`petmjx.show.report.plan_rows.table_rows`.
        drawn: (rows of the table,) negative if the row's world has no 3D picture; see ``BoxBlocks.drawn``.
        most: largest number of poses.
    """
    poses = _poses(runs, table)
    recorded = np.flatnonzero((poses > 0) & (drawn >= 0))
    stands = (table["verdict"].iloc[recorded] == Verdict.STABLE.value).to_numpy()
    recorded = recorded[np.argsort(stands, kind="stable")]
    fits = int(np.searchsorted(np.cumsum(poses[recorded]), most, side="right"))
    number = np.full(len(table), -1)
    blocks: dict[str, str] = {}
    for row in np.sort(recorded[:fits]):
        world = table.iloc[row]
        run = runs[int(world["run"])].results
        history = read_history(run, world["plan_id"], int(world["variant"]), int(world["n_boxes"]))
        if history is not None:
            number[row] = len(blocks)
            blocks[f"replay-{len(blocks)}"] = block(_frames(history))
    return Replays(blocks, number, len(recorded) - fits)


def _poses(runs: Sequence[ReportRun], table: pd.DataFrame) -> NDArray[np.int64]:
    """(rows of the table,) number of recorded poses of each row's world."""
    counts = np.zeros(len(table), dtype=np.int64)
    for at, run in enumerate(runs):
        if not run.results.parts.files("frames"):
            continue
        frames = run.results.frames.groupby(KEY)["n_placed"].sum().rename("poses")
        rows = np.flatnonzero(table["run"] == at)
        counts[rows] = table.iloc[rows][KEY].merge(frames, on=KEY, how="left")["poses"].fillna(0).to_numpy(np.int64)
    return counts


def _frames(history: History) -> dict[str, NDArray[Any] | PackedArray]:
    """The arrays of a history, which the script ``static/frames.js`` plays."""
    return {
        "time": history.time_s.astype(np.float64),
        "placed": integer_column(history.n_placed, steps=True),
        "pos": quantised_column(history.pos, steps=True),
        "quat": quantised_column(history.quat, steps=True),
        "carrier_pos": quantised_column(history.carrier_pos, steps=True),
        "carrier_quat": quantised_column(history.carrier_quat, steps=True),
    }
