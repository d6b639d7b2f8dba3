"""Changes the folders of finished runs, as users might."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from petmjx.results.result_files import digest_of


def edit_info(folder: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    """Change the ``run.json`` of a folder as users do on purpose: the digest is removed."""
    file = folder / "run.json"
    info = json.loads(file.read_text(encoding="utf-8"))
    info.pop("digest", None)
    edit(info)
    file.write_text(json.dumps(info), encoding="utf-8")


def keep_nothing(folder: Path) -> None:
    """Make a run look like one of an earlier version, which did not store its plans and its sweep."""

    def forget(info: dict[str, Any]) -> None:
        info["parts"].pop("placements", None)
        info["config"].get("sweep", {}).pop("tables", None)

    edit_info(folder, forget)


def leave_unfinished(folder: Path) -> None:
    """Make a run look interrupted."""
    edit_info(folder, lambda info: info.update(status="interrupted"))


def relisted(folder: Path) -> None:
    """List the files of a run with the digests that they have now, as after a change on purpose."""

    def relist(info: dict[str, Any]) -> None:
        for table, files in info["parts"].items():
            for name in files:
                with (folder / table / name).open("rb") as stream:
                    files[name] = digest_of(stream)

    edit_info(folder, relist)
