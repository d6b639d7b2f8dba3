"""``petmjx.leaderboard``: packers rated by physics, as a folder of static pages."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.basics.arguments import flag_of, list_of, path_of, whole_of
from petmjx.basics.errors import InputError
from petmjx.basics.option_names import option
from petmjx.basics.text import printable, shown
from petmjx.basics.whole import whole_file, writing
from petmjx.packers.compare import PackerComparison, compare_packers
from petmjx.packers.rating import rate
from petmjx.pages.leaderboard.board import Board, Told, board_page
from petmjx.pages.leaderboard.entries import Entry, Watch, enter, keep_plans, named, pack_ours
from petmjx.pages.leaderboard.files import ORDERS, PAGE, PLANS, STORIES, BoardFolder, names_of
from petmjx.pages.story_page import story_page
from petmjx.plans.samples.packers import PACKERS
from petmjx.results.sources import source_files
from petmjx.story.tell import tell
from petmjx.verdict import Verdict

MOST_STORIES: Final = 100
"""Of each packer: a story is a page of 0.1 to 1 MB."""


def leaderboard(
    packers: Mapping[str, str | PathLike[str]] | Sequence[str | PathLike[str]],
    out: str | PathLike[str],
    *,
    orders: str | PathLike[str] | None = None,
    baselines: bool = False,
    stories: int = 3,
    watch: Watch | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Path:
    """Rate packers by physics, and write a folder of static pages about them: a site that works offline.

    ``petmjx.leaderboard({"mine": "mine.json"}, "board", orders="orders.json", baselines=True)``

    The folder has ``index.html``, ``leaderboard.json`` with the same numbers, the pages of stories, and everything that
    is needed to make it again: ``plans/`` and ``orders.json``, and the command in the page. Plans are scored into
    ``runs/`` there; what was scored already is not simulated again.

    Args:
        packers: name → a run's folder, or plans. Without given names they are named as their folders and files.
        out: the folder.
        orders: BED-BPP orders of the plans: what was left out and KPIs are counted with them.
        baselines: also pack the orders with each of petmjx's packers.
        stories: how many plans of each packer get a page. Plans that fall while another packer's stands come first.
        watch: packer → what follows its run, entered before and left after it.
        overwrite: replace a leaderboard that is there.
        options: of ``petmjx.score``, for plans that are scored.

    Returns:
        The path of ``index.html``.

    Raises:
        InputError: fewer than two packers, unusable plans, runs or options, or the folder cannot be written or holds
            something that is no leaderboard.
    """
    flag_of(baselines, "baselines")
    whole_of(stories, "stories", 0, MOST_STORIES)
    folder = path_of(out, "out")
    given = packers if isinstance(packers, Mapping) else list_of(packers, "packers", object, "runs or files of plans")
    paths = named(given)  # type: ignore[arg-type]  # what they hold is checked there
    source = None if orders is None else path_of(orders, "orders")
    if baselines and source is None:
        raise InputError(f"{option('--baselines')} needs {option('--orders')}: petmjx's packers pack them")
    if baselines and (taken := next((name for name in paths if name in PACKERS), None)):
        raise InputError(
            f"{taken}: {option('--baselines')} has a packer of this name; give yours another, as NAME=PATH"
        )
    keeps_orders = source is not None and not _is_same(source, folder / ORDERS)
    packed = [*(PACKERS if baselines else ()), *paths]
    names = names_of(packed, stories, keeps_orders)
    read = source_files(paths, source if keeps_orders else None)
    files_of_board = BoardFolder(folder, packed, names, read, overwrite)
    if len(packed) < 2:
        raise InputError(f"give at least two packers to rate, or one with {option('--baselines')}")
    with writing(folder):
        files_of_board.begin()
        entries = _entries(paths, folder, source, baselines, watch, options)
        found = compare_packers({entry.name: entry.run for entry in entries}, orders=source)
        files_of_board.check()
        files = {entry.name: keep_plans(entry, folder) for entry in entries}
        if source is not None and keeps_orders:
            with whole_file(folder / ORDERS) as file:
                shutil.copyfile(source, file)
        digests = {name: _digest(folder / PLANS / file) for name, file in files.items() if file}
        told = _stories(entries, found, folder / STORIES, stories)
        board = Board(entries, found, rate(found), digests, told, orders=source is not None, stories=stories)
        with whole_file(folder / PAGE) as file:
            file.write_text(board_page(board), encoding="utf-8", errors="backslashreplace")
        kept = [ORDERS] if ORDERS in files_of_board.own and source is not None else []
        plan_files = [f"{PLANS}/{name}" for name in files.values() if name]
        files_of_board.finish(board.to_dict(), [PAGE, *kept, *plan_files, *(each.file for each in told)])
    return folder / PAGE


def _entries(
    paths: Mapping[str, Path],
    folder: Path,
    orders: Path | None,
    baselines: bool,
    watch: Watch | None,
    options: Mapping[str, Any],
) -> list[Entry]:
    options = options if orders is None else {**options, "orders": orders}
    ours: dict[str, Path] = {}
    if baselines and orders is not None:
        ours = pack_ours(orders, folder)
    first = [enter(name, path, folder, watch, options, ours=True) for name, path in ours.items()]
    return first + [enter(name, path, folder, watch, options) for name, path in paths.items()]


def _is_same(source: Path, target: Path) -> bool:
    """Whether the board's own file of orders is the one that it is made with."""
    return source.exists() and target.is_file() and not target.is_symlink() and source.samefile(target)


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _stories(entries: Sequence[Entry], found: PackerComparison, folder: Path, most: int) -> list[Told]:
    """Tell some plans of each packer, each simulated again as its run did."""
    folder.mkdir(exist_ok=True)
    told: list[Told] = []
    for number, entry in enumerate(entries, start=1):
        for plan_id in worth_telling(found, entry.name, entry.plans)[:most]:
            story = tell(plan_id, entry.run, plans=[entry.plans[plan_id]])
            file = folder / f"{number}-{sum(each.packer == entry.name for each in told) + 1}.html"
            with whole_file(file) as page:
                page.write_text(story_page(story), encoding="utf-8", errors="backslashreplace")
            told.append(Told(entry.name, plan_id, story.outcome.verdict.value, f"{STORIES}/{file.name}"))
    return told


def worth_telling(found: PackerComparison, packer: str, plans: Mapping[str, Any]) -> list[str]:
    """Plans of a packer: first those that do not stand while another packer's do, then others that do not stand, then
    those that stand while another packer's do not, then the rest; with most boxes first."""
    mine = found.plans[(found.plans["packer"] == packer) & found.plans["plan_id"].isin(list(plans))]
    lost = set(found.decided.loc[found.decided["lost_by"] == packer, "plan_id"])
    falls = mine["verdict"] == Verdict.UNSTABLE.value
    won = set(found.decided.loc[found.decided["won_by"] == packer, "plan_id"])
    rest = np.where(mine["plan_id"].isin(won), 2, 3)
    group = np.where(mine["plan_id"].isin(lost), 0, np.where(falls, 1, rest))
    order = mine.assign(group=group, large=-mine["boxes"].fillna(0))
    return [str(name) for name in order.sort_values(["group", "large", "plan_id"])["plan_id"]]


def board_line(page: Path) -> str:
    """What the command line says at the end."""
    return f"leaderboard in {printable(str(page.parent))}: open {shown(page.name)}"
