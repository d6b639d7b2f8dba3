"""The entries of a leaderboard (board). An entry is given as a run, or as a file of plans. The plans of a file are
simulated for the board."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from petmjx.analysis.packer_runs import check_names
from petmjx.api import score
from petmjx.common.argument_checks import path_of
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_name
from petmjx.options.simulation import Simulation
from petmjx.packers.packer_registry import PACKERS
from petmjx.packers.sample_plans import pack_orders
from petmjx.plans.bedbpp_writer import write_plans
from petmjx.plans.plan import Plan
from petmjx.plans.plan_writer import save_plans
from petmjx.repairs.repair import OF_READING, repair
from petmjx.repairs.trials import OF_RUN
from petmjx.results.plan_lookup import find_plans, is_run
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults, load_run
from petmjx.runs.simulate import Watcher
from petmjx.show.leaderboard.leaderboard_files import PLANS, RUNS

REPAIRED: Final = "-repaired"
"""Suffix in the names of entries whose plans were repaired."""

OF_REPAIR: Final = (*OF_RUN, *OF_READING)
"""Names of the options that runs and repairs have in common."""

Watch = Callable[[str], AbstractContextManager[Watcher]]
"""A function that returns, for the name of a packer, a context with an object that watches the progress of the packer's
run."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A packer on the board.

    Attributes:
        name: name of the packer.
        run: the run in which the packer's plans were simulated.
        plans: id → plan, for those plans of the run that could be read again.
        ours: whether the packer is part of petmjx.
        scored: whether all plans of the run were simulated for this board just now.
    """

    name: str
    run: RunResults
    plans: Mapping[str, Plan]
    ours: bool = False
    scored: bool = False


def packer_sources(paths: Mapping[str, Any] | Sequence[Any]) -> dict[str, Path]:
    """Name of each packer → folder of its run, or file of its plans. If no names are given, packers get the names of
    these folders and files.

    Raises:
        InputError: there is no path, a path does not exist, a name cannot be the name of a folder, or two packers have
            the same name.
    """
    if isinstance(paths, Mapping):
        pairs = [(name, path_of(path, f"packers[{name!r}]")) for name, path in paths.items()]
    else:
        files = [path_of(path, f"packers[{number}]") for number, path in enumerate(paths)]
        pairs = [(_name_of(path), path) for path in files]
    names = [name for name, _ in pairs]
    check_names(names)
    for number, (name, path) in enumerate(pairs):
        if name in names[:number]:
            raise InputError(f"{printable_name(name)}: two packers have this name; name one differently, as NAME=PATH")
        if not path.exists():
            raise InputError(f"{printable(str(path))}: no such file or folder")
    return dict(pairs)


def _name_of(path: Path) -> str:
    """The name of a folder, or of a file without its suffixes."""
    path = path.resolve()
    return path.name if path.is_dir() else path.name.partition(".")[0]


def pack_ours(orders: Path, folder: Path) -> dict[str, Path]:
    """Pack orders with each of petmjx's packers. Returns the name of each packer → the file with its plans.

    Raises:
        InputError: the orders cannot be read, or a file cannot be written.
    """
    files = {name: _plans_file(folder, name) for name in PACKERS}
    for name, file in files.items():
        write_plans(file, pack_orders(orders, packer=name, on_bad_order=lambda error: None))
    return files


def repaired_names(names: Sequence[str], paths: Mapping[str, Path]) -> dict[str, str]:
    """Name of each entry with repaired plans → name of the packer whose plans are repaired.

    Args:
        names: names of the packers whose plans are repaired.
        paths: name of each packer → its run or plans.

    Raises:
        InputError: there is no packer with one of these names, or a packer already has the name of an entry with
            repaired plans.
    """
    entries = {}
    for name in dict.fromkeys(names):
        if name not in paths:
            raise InputError(f"repairs: there is no packer {printable_name(name)}; there are {', '.join(paths)}")
        entry = f"{name}{REPAIRED}"
        if entry in paths:
            raise InputError(f"{printable_name(entry)}: rename this packer; the repaired plans of {name} get this name")
        entries[entry] = name
    return entries


def repair_entries(
    names: Mapping[str, str], paths: Mapping[str, Path], folder: Path, options: Mapping[str, Any]
) -> dict[str, Path]:
    """Repair the plans of packers. Returns the name of each entry → the file with its repaired plans.

    Args:
        names: name of each entry → name of the packer whose plans are repaired.
        paths: name of each packer → its run or plans.
        folder: folder of the board.
        options: options of ``petmjx.score``. Options that repairs do not have are ignored.

    Raises:
        InputError: plans are unusable, or a file cannot be written.
    """
    repair_options = {
        name: value for name, value in options.items() if name in Simulation.model_fields or name in OF_REPAIR
    }
    files = {}
    for entry, name in names.items():
        files[entry] = _plans_file(folder, entry)
        repair(paths[name], worlds=0, **repair_options).save(files[entry])
    return files


def enter(
    name: str, path: Path, folder: Path, watch: Watch | None, options: Mapping[str, Any], *, ours: bool = False
) -> Entry:
    """Make an entry. If ``path`` has a run, the run is used unchanged. If ``path`` has plans, they are simulated, with
    results in the board's folder; if this folder already has results, their run is resumed.

    Args:
        name: name of the packer.
        path: folder of a run, or plans.
        folder: folder of the board.
        watch: function that makes the object that watches the progress of the run (see ``Watch``). If ``watch`` is
            None, nothing watches the run.
        options: options of ``petmjx.score`` for plans.
        ours: whether the packer is part of petmjx.

    Raises:
        InputError: plans or options are unusable, or the board's folder has another run.
    """
    scored = False
    if is_run(path):
        run = load_run(path)
    else:
        scored = not is_run(folder / RUNS / name)
        with nullcontext() if watch is None else watch(name) as watcher:
            run = score(path, watcher=watcher, **{**options, "out": folder / RUNS / name, "resume": True})
    records = Manifest.read(run.parts, run.info).plans
    ids = dict.fromkeys(run.worlds["plan_id"])
    plans = find_plans(run, records, ids).plans
    return Entry(name, run, {plan_id: plans[plan_id] for plan_id in ids if plan_id in plans}, ours, scored)


def keep_plans(entry: Entry, folder: Path) -> str:
    """Write the plans of an entry into the board's folder, so that the board can be made again from this folder.
    Returns the name of the file, or "" if no plans were found."""
    if not entry.plans:
        return ""
    file = _plans_file(folder, entry.name)
    save_plans(list(entry.plans.values()), file)
    return file.name


def _plans_file(folder: Path, name: str) -> Path:
    """The file in a board's folder for the plans of an entry. The folder of the file is made if it does not exist."""
    file = folder / PLANS / f"{name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    return file
