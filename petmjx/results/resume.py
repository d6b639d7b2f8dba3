"""Reads the completed worlds, the ``run.json`` and the files of an earlier run that a new run continues."""

from __future__ import annotations

import itertools
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
from petmjx.results.run_table_reader import Parts
from petmjx.results.world_counts import COUNTED, WorldCounts

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
        for boxes in parts.files("boxes") if parts is not None else ():
            if not boxes.is_file():
                raise InputError(f"{boxes}: missing, although the table `worlds` has a file with the same number")
        tables = parts.table("worlds", [*_COLUMNS, *columns]) if parts is not None else []
        self._table = pa.concat_tables(tables) if tables else None
        self._spans: dict[str, tuple[int, int]] = {}
        self._last: tuple[str | None, dict[int, int]] = None, {}
        self._sorted = self._variants = np.empty(0, np.int64)
        if self._table is not None:
            self._index(self._table, parts)

    def _index(self, table: pa.Table, parts: Parts | None) -> None:
        """Sort the rows by plan and variant. The sorted index takes a few bytes per world; a dictionary would take
        hundreds of bytes per world."""
        plans = table["plan_id"].combine_chunks().dictionary_encode()
        plan = np.asarray(plans.indices, dtype=np.int64)
        variant = np.asarray(table["variant"], dtype=np.int64)
        self._sorted = np.lexsort((variant, plan))
        self._variants, plan = variant[self._sorted], plan[self._sorted]
        ids = plans.dictionary.to_pylist()
        twice = np.flatnonzero((plan[1:] == plan[:-1]) & (self._variants[1:] == self._variants[:-1]))
        if len(twice):
            plan_id, number = ids[plan[twice[0]]], self._variants[twice[0]]
            raise InputError(f"{parts and parts.folder}: has variant {number} of plan {plan_id} more than once")
        ends = np.searchsorted(plan, np.arange(len(ids) + 1)).tolist()
        self._spans = dict(zip(ids, itertools.pairwise(ends), strict=True))

    def __len__(self) -> int:
        return self._table.num_rows if self._table is not None else 0

    def __contains__(self, world: tuple[str, int]) -> bool:
        plan_id, variant = world
        return variant in self._rows_of(plan_id)

    def n_of(self, plan_id: str) -> int:
        """Number of completed worlds of a plan."""
        first, end = self._spans.get(plan_id, (0, 0))
        return end - first

    def _rows_of(self, plan_id: str) -> dict[int, int]:
        """A mapping from variant to number of the row, for the completed worlds of a plan. The mapping of the plan that
        was asked for last is stored, since runs look up worlds plan by plan."""
        if self._last[0] != plan_id:
            span = slice(*self._spans.get(plan_id, (0, 0)))
            rows = dict(zip(self._variants[span].tolist(), self._sorted[span].tolist(), strict=True))
            self._last = plan_id, rows
        return self._last[1]

    def row(self, plan_id: str, variant: int) -> dict[str, Any] | None:
        """The row of a world as a dict: column → value. Null becomes None. The result is None if the world is not
        completed."""
        row = self._rows_of(plan_id).get(variant)
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
