"""The files of a leaderboard (board): which files will be written, and which existing files belong to the board, so
that they may be replaced."""

from __future__ import annotations

import itertools
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Final

from petmjx.common.atomic_write import atomic_write, write_errors
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_folder, check_outputs
from petmjx.common.safe_read import read_regular
from petmjx.common.text import printable, printable_name
from petmjx.results.to_json import to_json
from petmjx.version import __version__

PAGE: Final = "index.html"
DATA: Final = "leaderboard.json"
STORIES: Final = "stories"
PLANS: Final = "plans"
RUNS: Final = "runs"
ORDERS: Final = "orders.json"
"""Names of files and folders of a leaderboard."""

FILES: Final = "files"
UNFINISHED: Final = "unfinished"
"""Two keys in ``leaderboard.json``: ``FILES`` for the list of the files that belong to the board, and ``UNFINISHED``
for the mark of an unfinished board."""

_MOST_BYTES: Final = 1 << 30
_NO_FILE: Final = ".none"
"""Name of a file that no run has. In the check of the paths that a board will write, a file of this name stands for all
files in the folder of a run."""


class BoardFolder:
    """The folder of a leaderboard while it is being made.

    Args:
        folder: the folder. :meth:`begin` creates it if it does not exist.
        packers: names of the packers.
        stories: largest number of stories per packer.
        orders: whether a file of orders is written.
        inputs: files and folders that are read.
        overwrite: whether to replace an existing board. An unfinished board is continued even if ``overwrite`` is
            False.

    Attributes:
        board_files: the files that belong to the board, as paths relative to the board's folder.

    Raises:
        InputError: the folder contains something other than a leaderboard, a foreign file with the name of a board's
            file, or a board that must not be replaced.
    """

    def __init__(
        self,
        folder: Path,
        packers: Sequence[str],
        stories: int,
        orders: bool,
        inputs: Iterable[Path],
        overwrite: bool,
    ) -> None:
        pages = itertools.product(range(1, len(packers) + 1), range(1, stories + 1))
        self._names = [
            *(PAGE, DATA, *([ORDERS] if orders else ())),
            *(f"{PLANS}/{name}.json" for name in packers),
            *(f"{STORIES}/{packer}-{story}.html" for packer, story in pages),
        ]
        self._folder, self._inputs = folder, list(inputs)
        self._runs = [f"{RUNS}/{name}/{_NO_FILE}" for name in packers]
        check_folder(folder)
        before = _board_in(folder)
        self._before: Mapping[str, Any] = before or {}
        listed = self._before.get(FILES)
        names = listed if isinstance(listed, list) else []
        self.board_files = frozenset(name for name in names if isinstance(name, str) and _is_a_board_file(name))
        self._overwrite = overwrite or bool(self._before.get(UNFINISHED))
        if before is None and folder.is_dir():
            with write_errors(folder):
                first = min((path.name for path in folder.iterdir()), default=None)
            if first is not None:
                raise InputError(
                    f"{printable(str(folder))}: already contains {printable_name(first)}; name a new folder for the "
                    "leaderboard"
                )
        self.check()

    def check(self) -> None:
        """Check that only files that belong to the board would be replaced or deleted. Making a board may take hours,
        so the check is made at the beginning and again before files are written."""
        check_outputs(
            [self._folder / name for name in dict.fromkeys((*self._names, *self.board_files, *self._runs))],
            overwrite=self._overwrite,
            inputs=self._inputs,
            folder=self._folder,
            is_ours=lambda file: file.relative_to(self._folder).as_posix() in self.board_files,
        )

    def begin(self) -> None:
        """Create the folder, and write ``leaderboard.json`` with the list of the board's files, before any of these
        files is written."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self.board_files |= frozenset(self._names)
        self._write({**self._before, "petmjx": __version__, UNFINISHED: True, FILES: sorted(self.board_files)})
        self._overwrite = True  # from now on, files with these names belong to this board, which may replace them

    def finish(self, board: Mapping[str, Any], written: Collection[str]) -> None:
        """Write ``leaderboard.json``, and delete files of an earlier board that this board does not have.

        Args:
            board: content of ``leaderboard.json``.
        """
        self.check()
        for name in self.board_files.difference(written, (DATA,)):
            (self._folder / name).unlink(missing_ok=True)
        self._write({**board, FILES: sorted({*written, DATA})})

    def _write(self, data: Mapping[str, Any]) -> None:
        with atomic_write(self._folder / DATA) as file:
            text = json.dumps(to_json(data), indent=1) + "\n"
            file.write_text(text, encoding="utf-8", errors="backslashreplace")


def _board_in(folder: Path) -> Mapping[str, Any] | None:
    """The content of ``leaderboard.json`` in a folder; None if there is no board.

    Raises:
        InputError: petmjx did not write the file.
    """
    file = folder / DATA
    try:
        data = json.loads(read_regular(file, _MOST_BYTES))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        data = None
    if not isinstance(data, dict) or not data.keys() >= {"petmjx", FILES}:
        raise InputError(f"{printable(str(file))}: was not written by petmjx; name a new folder for the leaderboard")
    return data


def _is_a_board_file(name: str) -> bool:
    """Whether a board can have a file with this name. If petmjx did not check names, an edited ``leaderboard.json``
    could make petmjx delete other files."""
    path = PurePosixPath(name)
    if len(path.parts) == 1:
        return name in (PAGE, DATA, ORDERS)
    inner = len(path.parts) == 2 and path.name not in ("", ".", "..") and "\0" not in name
    return inner and (path.parts[0], path.suffix) in ((PLANS, ".json"), (STORIES, ".html"))
