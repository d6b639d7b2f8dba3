"""The run that is in a folder, for one that goes on with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from petmjx.basics.errors import InputError
from petmjx.basics.option_names import option
from petmjx.basics.text import counted
from petmjx.options.run_options import WORLDS
from petmjx.results.files import part_name
from petmjx.results.listed import Parts
from petmjx.results.manifest import Manifest
from petmjx.results.reader import read_info, told_apart


def engine_of_run(folder: Path) -> str | None:
    """The engine of the run in a folder; None: no run of petmjx can be read there."""
    try:
        engine = read_info(folder).get("identity", {}).get("engine")
    except InputError:  # whoever goes on with the run says what is wrong with it
        return None
    return engine if isinstance(engine, str) else None


def run_there(
    folder: Path, manifest: Manifest | None, versions: Mapping[str, str]
) -> tuple[dict[str, Any], Parts, list[str]]:
    """Its ``run.json``, its files, and warnings: those about worlds that are not simulated again.

    Args:
        versions: package → version of the run that goes on.

    Raises:
        InputError: it is another run, or damaged.
    """
    info = read_info(folder)
    if manifest is None:
        raise ValueError("a run without a manifest cannot be resumed")
    parts = Parts.of(folder, info)
    differs = manifest.difference_from(Manifest.read(parts, info))
    if differs:
        raise InputError(f"{folder}: cannot be resumed, it is another run ({differs})")
    warnings = list(told_apart(info)[0])
    for name, version in versions.items():
        before = info["versions"].get(name)
        if before != version:
            warnings.append(f"resumed with {name} {version}; earlier worlds were simulated with {before or 'none'}")
    parts = parts.with_worlds()
    lacking = parts.lacking_boxes() if info["config"].get("keep") != WORLDS else []
    if lacking:  # petmjx before 0.3 left such folders where a merge was cut short
        if parts.files("frames"):
            raise InputError(
                f"{folder / 'boxes' / part_name(lacking[0])}: missing, though the worlds of this part are there; "
                f"simulate the run again, with {option('--overwrite', 'True')}"
            )
        before = sum(len(table) for table in parts.table("worlds", ("variant",)))
        parts = parts.without_numbers(lacking)
        again = before - sum(len(table) for table in parts.table("worlds", ("variant",)))
        warnings.append(
            f"{counted(again, 'world')} had no boxes, and {'was' if again == 1 else 'were'} simulated again"
        )
    return info, parts, warnings
