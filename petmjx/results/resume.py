"""Reads the completed worlds, the ``run.json`` and the files of an earlier run that a new run continues."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.options.run_options import WORLDS
from petmjx.results.run_folder import part_name
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import read_info, split_warnings
from petmjx.results.table_parts import Parts
from petmjx.results.world_counts import COUNTED, WorldCounts
from petmjx.results.world_ranks import MOST_VARIANTS, WorldRanks

_COLUMNS: Final = ("plan_id", "variant", *COUNTED, "culprit", "n_steps")


class CompletedWorlds:
    """The worlds (simulations of one plan each) that a run has completed, and their rows in the table ``worlds``.

    Args:
        parts: files of the run; None if no world is completed yet.
        columns: columns of ``worlds`` to read, in addition to the columns that all runs have.

    Raises:
        InputError: a part is damaged or missing, or a world occurs twice.
    """

    def __init__(self, parts: Parts | None = None, columns: Sequence[str] = ()) -> None:
        self._table: pa.Table | None = None
        self._ranks, self._sorted, self._rows = WorldRanks(), array("q"), np.empty(0, np.int64)
        if parts is None or not parts.files("worlds"):
            return
        for boxes in parts.files("boxes"):
            if not boxes.is_file():
                raise InputError(f"{boxes}: missing, although the table `worlds` has a file with the same number")
        self._table = pa.concat_tables(parts.table("worlds", [*_COLUMNS, *columns]))
        # Two arrays take 16 bytes per world; a dictionary would take hundreds of bytes per world.
        ranks = self._ranks.ranks(self._table)
        self._rows = np.argsort(ranks, kind="stable")
        self._sorted = array("q", ranks[self._rows].tobytes())
        twice = np.flatnonzero(np.diff(self._sorted) == 0)
        if len(twice):
            plan_id, variant = (self._table[name][int(self._rows[twice[0]])] for name in ("plan_id", "variant"))
            raise InputError(f"{parts.folder}: has variant {variant} of plan {plan_id} more than once")

    def __len__(self) -> int:
        return len(self._sorted)

    def __contains__(self, world: tuple[str, int]) -> bool:
        return self._row_of(*world) is not None

    def n_of(self, plan_id: str) -> int:
        """Number of completed worlds of a plan."""
        first, end = (bisect_left(self._sorted, self._ranks.rank(plan_id, variant)) for variant in (0, MOST_VARIANTS))
        return end - first

    def _row_of(self, plan_id: str, variant: int) -> int | None:
        """The number of a world's row; None if the world is not completed."""
        rank = self._ranks.rank(plan_id, variant)
        place = bisect_left(self._sorted, rank)
        completed = place < len(self._sorted) and self._sorted[place] == rank
        return int(self._rows[place]) if completed else None

    def row(self, plan_id: str, variant: int) -> dict[str, Any] | None:
        """The row of a world as a dict: column → value. Null becomes None. The result is None if the world is not
        completed."""
        row = self._row_of(plan_id, variant)
        return None if row is None else {name: values[row] for name, values in self._values.items()}

    def counts(self) -> WorldCounts:
        """The numbers of completed worlds with each verdict and reason."""
        return WorldCounts() if self._table is None else WorldCounts.of(self._table)

    @cached_property
    def _values(self) -> dict[str, list[Any]]:
        return {} if self._table is None else self._table.to_pydict()


def engine_of_earlier_run(folder: Path) -> str | None:
    """The name of the engine of the run in a folder; None if the folder has no readable run of petmjx."""
    try:
        engine = read_info(folder).get("identity", {}).get("engine")
    except InputError:  # the function that resumes the run reports the error
        return None
    return engine if isinstance(engine, str) else None


def resume_state(
    folder: Path, manifest: Manifest | None, versions: Mapping[str, str]
) -> tuple[dict[str, Any], Parts, list[str]]:
    """Three things of the earlier run in a folder: the content of its ``run.json``, its files, and its warnings.
    A warning is added if the version of a package has changed since the earlier run, or if data are missing.

    Args:
        versions: package → version in the run that resumes the earlier run.

    Raises:
        InputError: the folder has a different run, or its run is damaged.
    """
    info = read_info(folder)
    if manifest is None:
        raise ValueError("a run without a manifest cannot be resumed")
    parts = Parts.of(folder, info)
    differs = manifest.difference_from(Manifest.read(parts, info))
    if differs:
        raise InputError(f"{folder}: cannot be resumed, because the folder has another run ({differs})")
    warnings = list(split_warnings(info)[0])
    for name, version in versions.items():
        before = info["versions"].get(name)
        if before != version:
            warnings.append(f"resumed with {name} {version}; earlier worlds were simulated with {before or 'none'}")
    parts = parts.with_worlds()
    lacking = parts.lacking_boxes() if info["config"].get("keep") != WORLDS else []
    # An interrupted merge of petmjx before 0.3 left a folder in which parts of the table ``boxes`` are missing.
    if lacking:
        if parts.files("frames"):
            raise InputError(
                f"{folder / 'boxes' / part_name(lacking[0])}: missing, although the table `worlds` has a file with "
                f"the same number; simulate the run again, with {option('--overwrite', 'True')}"
            )
        before = sum(len(table) for table in parts.table("worlds", ("variant",)))
        parts = parts.without_numbers(lacking)
        n_rerun = before - sum(len(table) for table in parts.table("worlds", ("variant",)))
        warnings.append(
            f"{count_text(n_rerun, 'world')} had no rows in boxes, and "
            f"{'was' if n_rerun == 1 else 'were'} simulated again"
        )
    return info, parts, warnings
