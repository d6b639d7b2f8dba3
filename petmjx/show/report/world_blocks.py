"""The worlds that a report shows in 3D, stored in blocks (compact arrays): the final poses of the boxes, and the
histories of recorded worlds, which the page can play. The page unpacks a block when the user opens a world in it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.analysis.run_comparison import KEY
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.results.history_tables import read_history
from petmjx.results.run_reader import boxes_of_worlds
from petmjx.show.pages.page_arrays import PackedArray, block, integer_column, quantised_column
from petmjx.show.report.report_runs import ReportRun
from petmjx.world.body_shapes import Body
from petmjx.world.history import History
from petmjx.world.scene import build_scene

MOST_BOXES: Final = 600_000
"""Largest number of boxes on a page. A box takes about 17 bytes, so all boxes take at most 10 MB. If a run has more
boxes, the page leaves out worlds. Worlds that stand are left out first."""

WORLDS_PER_BLOCK: Final = 64
"""Number of worlds in a block. A block of this size is unpacked in some milliseconds, and a larger block would not be
compressed better."""

TENTHS_PER_M: Final = 10_000
"""Number of tenths of a millimetre in a metre. Planned places are stored as whole tenths of a millimetre."""

_POSITION: Final = ("pos_x_m", "pos_y_m", "pos_z_m")
_QUATERNION: Final = ("quat_w", "quat_x", "quat_y", "quat_z")
_METRICS: Final = ("max_tilt_deg", "max_top_force_n", "rest_top_force_n", "drop_s")
_NUMBERS: Final = (*_POSITION, *_QUATERNION, *_METRICS)


@dataclass(frozen=True, eq=False)
class BoxBlocks:
    """The boxes on a page.

    Attributes:
        blocks: name → block. The blocks "boxes-0", "boxes-1", … contain ``WORLDS_PER_BLOCK`` worlds each.
        drawn: (rows of the table,) for each row, the number of its world among all worlds in the blocks; −1 if the
            world is not in a block.
        without_boxes: number of worlds that are left out because there are too many boxes.
    """

    blocks: dict[str, str]
    drawn: NDArray[np.int64]
    without_boxes: int


def box_blocks(runs: Sequence[ReportRun], table: pd.DataFrame, most: int = MOST_BOXES) -> BoxBlocks:
    """Store, in blocks, the boxes of all worlds that a table lists. Worlds whose plans were not found are left out.

    Args:
        table: data frame with the rows of the table, from :func:`petmjx.show.report.report_plan_table.table_rows`.
        most: largest number of boxes.
    """
    chosen, left = _drawn_rows(runs, table, most)
    drawn = np.full(len(table), -1)
    drawn[chosen] = np.arange(len(chosen))
    worlds = _worlds(runs, table.iloc[chosen])
    blocks: dict[str, str] = {}
    for first in range(0, len(chosen), WORLDS_PER_BLOCK):
        part = [next(worlds) for _ in range(first, min(first + WORLDS_PER_BLOCK, len(chosen)))]
        blocks[f"boxes-{first // WORLDS_PER_BLOCK}"] = block(_block_columns_of_boxes(part))
    return BoxBlocks(blocks, drawn, left)


def _drawn_rows(runs: Sequence[ReportRun], table: pd.DataFrame, most: int) -> tuple[NDArray[np.int64], int]:
    """The row numbers, in the table, of the worlds that are stored in blocks; and the number of worlds that are left
    out because there are too many boxes."""
    has_plan = np.zeros(len(table), dtype=bool)
    for at, run in enumerate(runs):
        if run.results.keeps_boxes:
            has_plan |= ((table["run"] == at) & table["plan_id"].isin(run.plan_files.plans.keys())).to_numpy()
    return _fitting_rows(table, np.flatnonzero(has_plan), table["n_boxes"].to_numpy(np.int64), most)


def _fitting_rows(
    table: pd.DataFrame, rows: NDArray[np.int64], sizes: NDArray[np.int64], most: int
) -> tuple[NDArray[np.int64], int]:
    """Leave out rows until the sizes of the remaining rows add up to at most ``most``. Worlds that stand are left out
    first. Returns the numbers of the rows that are kept, and the number of rows that are left out.

    Args:
        rows: numbers of the rows from which the kept rows are chosen.
        sizes: (rows of the table,) size of each row.
    """
    stands = (table["verdict"].iloc[rows] == Verdict.STABLE.value).to_numpy()
    rows = rows[np.argsort(stands, kind="stable")]
    n_kept = int(np.searchsorted(np.cumsum(sizes[rows]), most, side="right"))
    return np.sort(rows[:n_kept]), len(rows) - n_kept


@dataclass(frozen=True, eq=False)
class _World:
    """The boxes of one world in packing order, with data from the plan.

    Attributes:
        numbers: (n, columns) values of the columns ``_NUMBERS``.
        names: (item, article) of each box.
        plan: the plan.
        target: (n, 3) planned centres of the boxes, m.
        carrier: the carrier.
    """

    numbers: FloatArray
    names: Sequence[tuple[str, str]]
    plan: Plan
    target: FloatArray
    carrier: Body


def _worlds(runs: Sequence[ReportRun], table: pd.DataFrame) -> Iterator[_World]:
    for at, part in table.groupby("run", sort=True):
        run = runs[int(at)]
        sim = simulation_of(run.info)
        columns = (*KEY, "box", "item_id", "article", *_NUMBERS)
        boxes = boxes_of_worlds(run.results, part[KEY], columns).sort_values([*KEY, "box"], kind="stable")
        places = boxes.reset_index().groupby(KEY, sort=False).indices
        numbers = boxes[[*_NUMBERS]].to_numpy(np.float64)
        names = list(zip(boxes["item_id"], boxes["article"], strict=True))
        scenes: dict[str, tuple[FloatArray, Body]] = {}
        for plan_id, variant in zip(part["plan_id"], part["variant"], strict=True):
            plan = run.plan_files.plans[plan_id]
            if plan_id not in scenes:
                scene = build_scene(plan, sim)
                scenes[plan_id] = scene.target, scene.carrier
            rows = places[plan_id, variant]
            world_rows = slice(rows[0], rows[-1] + 1)
            yield _World(numbers[world_rows], names[world_rows], plan, *scenes[plan_id])


def simulation_of(info: Mapping[str, Any]) -> Simulation:
    """The simulation options of a run, or the default options if the run does not state its options, or states options
    that this version of petmjx cannot read."""
    settings = info.get("config", {}).get("simulation")
    try:
        return Simulation.read(settings) if isinstance(settings, Mapping) else Simulation()
    except InputError:
        return Simulation()


def _block_columns_of_boxes(worlds: Sequence[_World]) -> dict[str, NDArray[Any] | PackedArray]:
    """The arrays of a block (compact arrays on a page) with the boxes of some worlds. The array ``items`` is JSON in
    UTF-8, with an entry for each kind of box: [item, article, length, width and height in mm, mass in kg]."""
    numbers = np.concatenate([world.numbers for world in worlds])
    pos, quat, (tilt, force, rest_force, drop) = numbers[:, :3], numbers[:, 3:7], numbers[:, 7:].T
    target = np.concatenate([world.target for world in worlds])
    size = np.concatenate([world.plan.size_mm for world in worlds])
    mass = np.concatenate([world.plan.mass_kg for world in worlds])
    kinds: dict[tuple[Any, ...], int] = {}
    names = [name for world in worlds for name in world.names]
    rows = zip(names, *size.T.tolist(), mass.tolist(), strict=True)
    kind = np.array([kinds.setdefault(row, len(kinds)) for row in rows])
    items = [[printable(item), printable(article), *of_plan] for (item, article), *of_plan in kinds]
    quat = np.where(quat[:, :1] < 0, -quat, quat)
    planned = np.rint(target * TENTHS_PER_M).astype(np.int64)
    return {
        "count": integer_column(np.array([len(world.names) for world in worlds])),
        "carrier": np.array([world.carrier.pos for world in worlds], dtype=np.float32),
        "n_boards": integer_column(np.array([len(world.carrier.boards) for world in worlds])),
        "n_walls": integer_column(np.array([len(world.carrier.walls) for world in worlds])),
        "boards": np.concatenate([world.carrier.boards for world in worlds]).astype(np.float32),
        "items": np.frombuffer(json.dumps(items).encode(), dtype=np.uint8),
        "kind": integer_column(kind),
        "planned": integer_column(planned),
        "moved": quantised_column(pos - planned / TENTHS_PER_M),
        "turn": quantised_column(quat[:, 1:]),
        "tilt": quantised_column(tilt),
        "force": quantised_column(np.log1p(force)),
        "rest": quantised_column(np.log1p(rest_force)),
        "drop": quantised_column(drop),
    }


MOST_POSES: Final = 500_000
"""Largest number of poses (boxes × frames) on a page. A pose takes about 7 bytes. If there are more poses, worlds that
stand are left out first."""


@dataclass(frozen=True, eq=False)
class Replays:
    """The histories (recorded worlds) on a page.

    Attributes:
        blocks: name → block (compact arrays), one block per history: "replay-0", "replay-1", …
        number: (rows of the table,) number of the block with the history of each row's world; −1 if there is no block.
        left_out: number of recorded worlds that were left out because the page would be too large.
    """

    blocks: dict[str, str]
    number: NDArray[np.int64]
    left_out: int


def replays(runs: Sequence[ReportRun], table: pd.DataFrame, drawn: NDArray[np.int64]) -> Replays:
    """Store, in blocks, the histories of all worlds that a table lists. Worlds without a 3D picture are left out.

    Args:
        table: data frame with the rows of the table, from :func:`petmjx.show.report.report_plan_table.table_rows`.
        drawn: (rows of the table,) negative if the row's world has no 3D picture; see ``BoxBlocks.drawn``.
    """
    poses = _poses(runs, table)
    recorded, left_out = _fitting_rows(table, np.flatnonzero((poses > 0) & (drawn >= 0)), poses, MOST_POSES)
    number = np.full(len(table), -1)
    blocks: dict[str, str] = {}
    for row in recorded:
        world = table.iloc[row]
        run = runs[int(world["run"])].results
        history = read_history(run, world["plan_id"], int(world["variant"]), int(world["n_boxes"]))
        if history is not None:
            number[row] = len(blocks)
            blocks[f"replay-{len(blocks)}"] = block(_frames(history))
    return Replays(blocks, number, left_out)


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
