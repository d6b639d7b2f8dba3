"""``petmjx.leaderboard``: rates packers by simulations of their plans, and writes a folder of static pages (the
board)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.analysis.packer_comparison import PackerComparison, comparison_of
from petmjx.analysis.packer_rating import rate
from petmjx.analysis.packer_runs import runs_by_packer, with_engine_of
from petmjx.analysis.story import tell
from petmjx.common.argument_checks import flag_of, integer_of, list_of, path_of
from petmjx.common.atomic_write import atomic_write, write_errors
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Verdict
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.packers.packer_registry import PACKERS
from petmjx.plans.convention_checks import warn
from petmjx.plans.order_reader import keep_orders, read_orders
from petmjx.results.input_files import input_files
from petmjx.results.share_statistics import DEFAULT_CONFIDENCE
from petmjx.show.leaderboard.entries import (
    Entry,
    Watch,
    enter,
    keep_plans,
    pack_ours,
    packer_sources,
    repair_entries,
    repaired_names,
)
from petmjx.show.leaderboard.entry_replays import Replay, Sample, sample_entry
from petmjx.show.leaderboard.leaderboard_files import ORDERS, PAGE, PLANS, RUNS, STORIES, BoardFolder
from petmjx.show.leaderboard.leaderboard_page import Board, StoryEntry, board_page
from petmjx.show.pages.story_page import story_page

MOST_STORIES: Final = 100
"""Largest number of stories per packer. A story is a page about the simulation of one plan, and takes 0.1 to 1 MB."""


def leaderboard(
    packers: Mapping[str, str | PathLike[str]] | Sequence[str | PathLike[str]],
    out: str | PathLike[str],
    *,
    orders: str | PathLike[str] | None = None,
    baselines: bool = False,
    repairs: Sequence[str] = (),
    stories: int = 3,
    replays: int = 8,
    watch: Watch | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Path:
    """Rate packers by physics, and write a site about them: a folder of static pages that works offline.

    ``petmjx.leaderboard({"mine": "mine.json"}, "board", orders="orders.json", baselines=True)``

    The folder contains ``index.html``, ``leaderboard.json`` with the same numbers, and pages about single plans
    (stories). The folder also contains all that is needed to make the board again: the folder ``plans``,
    ``orders.json``, and the command, which ``index.html`` shows.

    Plans are simulated, with results in the folder ``runs``. Existing runs are used unchanged, but some of their plans
    (number ``replays``) are simulated again. If the new simulations contradict the run of an entry, the entry is not
    rated, and a ``PlanWarning`` states this.

    Args:
        packers: name of a packer → folder of a run, or plans. If no names are given, packers get the names of these
            folders and files.
        out: folder of the site.
        orders: file with the orders of the plans, in any form. With a file of orders, the rating covers these orders,
            and KPIs are added. If ``orders`` is None, the rating covers the orders for which any packer has a plan, so
            the rating of a packer depends on the other packers.
        baselines: whether the orders are also packed by each of petmjx's packers, so that these packers are rated, too.
        repairs: names of packers whose plans are also repaired (docs/repair.md). The repaired plans are rated as an
            additional entry ``NAME-repaired``.
        stories: number of plans per packer that get a page. Plans that fall come first if another packer's plan for the
            same order stands.
        replays: number of plans per entry that are simulated again, unless this call has simulated all plans of the
            entry. The plans are chosen at random. Replays have the options with which ``leaderboard`` was called.
            Without such options, they have the options of the runs, or the defaults if the runs have different options.
        watch: function that returns, for the name of a packer, a context with an object that watches the progress of
            the packer's run.
        overwrite: whether to replace an existing leaderboard.
        options: options of ``petmjx.score`` for plans that are simulated.

    Returns:
        The path of ``index.html``.

    Raises:
        InputError: there are fewer than two packers; plans, runs or options are unusable; the replays of every packer
            contradict its run; or the folder is not writable, or contains something other than a leaderboard.
    """
    flag_of(baselines, "baselines")
    integer_of(stories, "stories", 0, MOST_STORIES)
    integer_of(replays, "replays", 0)
    folder = path_of(out, "out")
    sources = packers if isinstance(packers, Mapping) else list_of(packers, "packers", object, "runs or files of plans")
    paths = packer_sources(sources)
    source = None if orders is None else path_of(orders, "orders")
    if baselines and source is None:
        raise InputError(f"{option('--baselines')} needs {option('--orders')}: petmjx's packers pack these orders")
    if baselines and (clash := next((name for name in paths if name in PACKERS), None)):
        raise InputError(f"{clash}: {option('--baselines')} has a packer of this name; rename yours, as NAME=PATH")
    keeps_orders = source is not None and not _is_same(source, folder / ORDERS)
    repaired = repaired_names(list_of(repairs, "repairs", str, "names of packers"), paths)
    packed = [*(PACKERS if baselines else ()), *paths, *repaired]
    read = input_files(paths, source if keeps_orders else None)
    files_of_board = BoardFolder(folder, packed, stories, keeps_orders, read, overwrite)
    if len(packed) < 2:
        raise InputError(f"give at least two packers to rate, or one with {option('--baselines')}")
    with write_errors(folder):
        files_of_board.begin()
        paths = {**paths, **repair_entries(repaired, paths, folder, options)}
        entries = _entries(paths, folder, source, baselines, watch, options)
        board = _rated_board(entries, folder, source, options, stories, replays)
        files_of_board.check()
        files = {entry.name: keep_plans(entry, folder) for entry in board.entries}
        if source is not None and keeps_orders:
            keep_orders(source, folder / ORDERS)
        digests = {name: _digest(folder / PLANS / file) for name, file in files.items() if file}
        board = replace(board, digests=digests)
        with atomic_write(folder / PAGE) as file:
            file.write_text(board_page(board), encoding="utf-8", errors="backslashreplace")
        own_inputs = [ORDERS] if ORDERS in files_of_board.board_files and source is not None else []
        plan_files = [f"{PLANS}/{name}" for name in files.values() if name]
        files_of_board.finish(
            board.to_dict(), [PAGE, *own_inputs, *plan_files, *(story.file for story in board.story_entries)]
        )
    warn(sample.refusal for sample in board.samples if sample.refusal)
    return folder / PAGE


def _rated_board(
    entries: Sequence[Entry], folder: Path, orders: Path | None, options: Mapping[str, Any], stories: int, replays: int
) -> Board:
    """Check each entry by simulating some of its plans again (samples and stories), and rate the entries that these
    simulations do not contradict. In the returned board, ``digests`` is still empty."""
    runs_by_packer({entry.name: entry.run for entry in entries})
    of_simulation, of_run, _ = sorted_options(options, Confidence)
    sim, run_options = _options_of(of_simulation, entries), RunOptions(**of_run)
    order_ids = None if orders is None else {order_id for order_id, _ in read_orders(orders, lambda error: None)}
    samples = {
        entry.name: Sample(entry.name, "", exact=True)
        if entry.scored
        else sample_entry(entry, replays, sim, run_options, order_ids)
        for entry in entries
    }
    while True:
        left = [entry for entry in entries if not samples[entry.name].refusal]
        if not left:
            lines = "; ".join(sample.refusal for sample in samples.values())
            raise InputError(f"no packer is left to rate: {lines}")
        comparison = comparison_of(
            {entry.name: entry.run for entry in left}, DEFAULT_CONFIDENCE, orders, run_options.articles
        )
        board_stories, replays_by_name = _stories(left, comparison, folder / STORIES, stories)
        samples |= {name: samples[name].with_replays(more) for name, more in replays_by_name.items()}
        if not any(samples[entry.name].refusal for entry in left):
            return Board(
                left,
                comparison,
                rate(comparison),
                {},
                board_stories,
                orders=orders is not None,
                stories=stories,
                options=sim,
                samples=[
                    sample
                    for sample in samples.values()
                    if (sample.replays or sample.fault) and (sample.engine or sample.refusal)
                ],
            )


def _options_of(of_simulation: Mapping[str, Any], entries: Sequence[Entry]) -> Simulation:
    """The simulation options of the board: the options with which ``leaderboard`` was called. Without such options, the
    board has the options of the runs, or the defaults if runs have different options."""
    settings = [entry.run.info.get("config", {}).get("simulation") for entry in entries]
    if of_simulation or not isinstance(settings[0], Mapping) or any(setting != settings[0] for setting in settings):
        return Simulation(**of_simulation)
    return Simulation.read(settings[0])


def _entries(
    paths: Mapping[str, Path],
    folder: Path,
    orders: Path | None,
    baselines: bool,
    watch: Watch | None,
    options: Mapping[str, Any],
) -> list[Entry]:
    options = options if orders is None else {**options, "orders": orders}
    ours = pack_ours(orders, folder) if baselines and orders is not None else {}
    entries: list[Entry] = []
    for name, path in {**ours, **paths}.items():
        first = next((entry.run for entry in entries if entry.scored), None)
        of_packer = options if first is None else with_engine_of(first, options, folder / RUNS / name)
        entries.append(enter(name, path, folder, watch, of_packer, ours=name in ours))
    return entries


def _is_same(source: Path, target: Path) -> bool:
    """Whether the user's file of orders is the file ``orders.json`` of the board itself."""
    return source.exists() and target.is_file() and not target.is_symlink() and source.samefile(target)


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _stories(
    entries: Sequence[Entry], comparison: PackerComparison, folder: Path, most: int
) -> tuple[list[StoryEntry], dict[str, list[Replay]]]:
    """Make stories (pages about single plans) of some plans of each packer. Each plan that gets a story is simulated
    again, as in its run. Returns the stories, and a dict: name of a packer → replays of the plans that its stories
    tell."""
    folder.mkdir(exist_ok=True)
    stories: list[StoryEntry] = []
    replays_by_name: dict[str, list[Replay]] = {}
    claimed = comparison.plans.set_index(["packer", "plan_id"])["verdict"]
    for number, entry in enumerate(entries, start=1):
        for plan_id in worth_telling(comparison, entry.name, entry.plans)[:most]:
            story = tell(plan_id, entry.run, plans=[entry.plans[plan_id]])
            file = folder / f"{number}-{sum(earlier.packer == entry.name for earlier in stories) + 1}.html"
            with atomic_write(file) as page:
                page.write_text(story_page(story), encoding="utf-8", errors="backslashreplace")
            stories.append(StoryEntry(entry.name, plan_id, story.outcome.verdict.value, f"{STORIES}/{file.name}"))
            outcome = story.outcome
            replay = Replay.judged(
                plan_id,
                str(claimed[entry.name, plan_id]),
                outcome.verdict.value,
                outcome.reason.value,
                outcome.margin,
                int(outcome.flags),
            )
            replays_by_name.setdefault(entry.name, []).append(replay)
    return stories, replays_by_name


def worth_telling(comparison: PackerComparison, packer: str, plans: Mapping[str, Any]) -> list[str]:
    """Ids of a packer's plans, sorted by how interesting a page about them is.

    First come plans that fall while another packer's plan stands, then other plans that fall, then plans that stand
    while another packer's plan falls, then all other plans. In each group, the plans with the most boxes come first.
    """
    mine = comparison.plans[(comparison.plans["packer"] == packer) & comparison.plans["plan_id"].isin(list(plans))]
    lost = set(comparison.decided.loc[comparison.decided["lost_by"] == packer, "plan_id"])
    falls = mine["verdict"] == Verdict.UNSTABLE.value
    won = set(comparison.decided.loc[comparison.decided["won_by"] == packer, "plan_id"])
    other_rank = np.where(mine["plan_id"].isin(won), 2, 3)
    group = np.where(mine["plan_id"].isin(lost), 0, np.where(falls, 1, other_rank))
    order = mine.assign(group=group, large=-mine["boxes"].fillna(0))
    return [str(name) for name in order.sort_values(["group", "large", "plan_id"])["plan_id"]]
