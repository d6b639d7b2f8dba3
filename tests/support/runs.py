"""Runs as they are left behind, and as somebody changes them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from petmjx.results.run_folder import digest_of


def edit_info(folder: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    """Change what a folder's ``run.json`` says, as people do who mean it: its digest goes."""
    file = folder / "run.json"
    info = json.loads(file.read_text(encoding="utf-8"))
    info.pop("digest", None)
    edit(info)
    file.write_text(json.dumps(info), encoding="utf-8")


def keep_nothing(folder: Path) -> None:
    """Let a run be one as before runs kept their plans and their sweeps."""

    def forget(info: dict[str, Any]) -> None:
        info["parts"].pop("placements", None)
        info["config"].get("sweep", {}).pop("tables", None)

    edit_info(folder, forget)


def leave_unfinished(folder: Path) -> None:
    """Say of a run that it was interrupted."""
    edit_info(folder, lambda info: info.update(status="interrupted"))


def relisted(folder: Path) -> None:
    """List a run's files as they are now, as somebody does who has changed them on purpose."""

    def relist(info: dict[str, Any]) -> None:
        for table, files in info["parts"].items():
            for name in files:
                with (folder / table / name).open("rb") as stream:
                    files[name] = digest_of(stream)

    edit_info(folder, relist)
