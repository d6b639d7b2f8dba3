"""Histories of recorded worlds, which the page can play."""

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
"""Largest number of poses (boxes × frames) on a page. A pose takes about 7 bytes. Worlds that do not stand have
priority."""


@dataclass(frozen=True, eq=False)
class Replays:
    """The histories on a page.

    Attributes:
        blocks: name → block.
        number: (rows of the table,) number N of the row's block "replay-N"; −1 if there is none.
        left_out: number of recorded worlds that were left out because they would make the page too large.
    """

    blocks: dict[str, str]
    number: NDArray[np.int64]
    left_out: int


def replays(
    runs: Sequence[ReportRun], table: pd.DataFrame, drawn: NDArray[np.int64], most: int = MOST_POSES
) -> Replays:
    """Pack the histories of the worlds in a table. Worlds without a 3D picture are left out.

    Args:
        table: the second result of :func:`petmjx.show.report.plan_rows.table_rows`.
        drawn: for each row of the table, the number of its world among the worlds with a picture; negative: the world
            has no picture.
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
    """(rows of the table,) the number of recorded poses of each world."""
    counts = np.zeros(len(table), dtype=np.int64)
    for at, run in enumerate(runs):
        if not run.results.parts.files("frames"):
            continue
        frames = run.results.frames.groupby(KEY)["n_placed"].sum().rename("poses")
        rows = np.flatnonzero(table["run"] == at)
        counts[rows] = table.iloc[rows][KEY].merge(frames, on=KEY, how="left")["poses"].fillna(0).to_numpy(np.int64)
    return counts


def _frames(history: History) -> dict[str, NDArray[Any] | PackedArray]:
    """The arrays of a history that ``static/frames.js`` plays."""
    return {
        "time": history.time_s.astype(np.float64),
        "placed": integer_column(history.n_placed, steps=True),
        "pos": quantised_column(history.pos, steps=True),
        "quat": quantised_column(history.quat, steps=True),
        "carrier_pos": quantised_column(history.carrier_pos, steps=True),
        "carrier_quat": quantised_column(history.carrier_quat, steps=True),
    }
