"""Lists the files that a command reads, so that the command does not overwrite them (petmjx.common.overwrite_guard)."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

from petmjx.plans.plan_reader import plan_files_in
from petmjx.results.run_folder import RUN_FILE, TABLES


def input_files(*sources: Any) -> list[Path]:
    """The files and folders that a command reads if it gets the given sources. For a run's folder, the result is
    ``run.json`` and the tables; for another folder, the files of plans in it; for a file, the file itself.

    Args:
        sources: paths, lists of paths, or None. Sources of other types, such as data frames and runs in memory, have no
            files.
    """
    files: list[Path] = []
    for source in sources:
        if isinstance(source, Mapping):
            files += input_files(*source.values())
        elif isinstance(source, list | tuple):
            files += input_files(*source)
        elif isinstance(source, str | PathLike):
            with suppress(OSError, ValueError):  # the function that reads the source reports the error
                files += _files_of(Path(source))
    return files


def _files_of(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    if (path / RUN_FILE).is_file():
        return [path / RUN_FILE, *(path / table for table in TABLES)]
    return plan_files_in(path)
