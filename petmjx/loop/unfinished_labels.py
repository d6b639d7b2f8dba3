"""The labels of a set that is not finished yet: Parquet files (parts) in the set's folder, and a file that lists the
parts.

    DIR/unfinished.json        description of the set (orders, options, engine), number of labels that the set is to
                               have, number of labels in the parts, next episode, list of parts
    DIR/parts/part-*.parquet   labels of whole episodes, in order

Parts are written and read like the parts of a run (petmjx.results.table_parts): a part is ignored until the list names
it and its digest. So if a process is killed, only the labels of the last minute and of unfinished episodes are lost.
Another process can then continue the unfinished set.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from petmjx.common.checked_records import option
from petmjx.common.deferred_signals import defer_signals
from petmjx.common.errors import InputError
from petmjx.common.parquet_files import open_for_arrow
from petmjx.common.safe_read import read_regular
from petmjx.common.text import count_text
from petmjx.loop.placement_labels import SCHEMA, Label
from petmjx.results.result_files import write_text
from petmjx.results.run_folder import part_files, part_name, part_number
from petmjx.results.run_manifest import differing_settings, with_later_options
from petmjx.results.schema import SCHEMA_VERSION
from petmjx.results.table_parts import LISTED, Parts

UNFINISHED: Final = "unfinished.json"
TABLE: Final = "parts"
SPLIT: Final = "split"

_MOST_BYTES: Final = 1 << 26
"""Largest size of the list of parts, bytes. A list of a million parts is smaller."""

_PART_SCHEMA: Final = SCHEMA.append(pa.field(SPLIT, pa.string())).with_metadata(
    {"schema_version": str(SCHEMA_VERSION), "table": TABLE}
)


class LabelParts:
    """The parts of a set of labels. Methods of this class raise OSError if a file cannot be written.

    Args:
        folder: folder of the set; ``head``: description of the set, as plain JSON values.
        count: number of labels that the set is to have.
        resume: whether to continue with the parts in the folder, if there are any. If ``resume`` is False, the parts in
            the folder are deleted.

    Attributes:
        n_labels: number of labels in the parts; ``next_episode``: number of the first episode whose labels are not in
            the parts.

    Raises:
        InputError: the parts belong to another set, are damaged, or have more labels than ``count``.
    """

    def __init__(self, folder: Path, head: Mapping[str, Any], count: int, *, resume: bool) -> None:
        self._folder, self._head, self._count = folder, json.loads(json.dumps(head)), count
        self.n_labels = self.next_episode = 0
        self._parts = Parts(folder, {})
        if resume and (entries := _entries(folder)) and entries["labels"]:
            check_same_set(folder, entries["set"], self._head)
            self.n_labels, self.next_episode = entries["labels"], entries["next_episode"]
            self._parts = _CheckedParts.of(folder, entries)
            self._check_parts()
            # Parts hold only whole episodes, so they may have more labels than the earlier command asked for. The
            # ``count`` of that command is still allowed.
            if count < self.n_labels and count != entries["count"]:
                raise InputError(
                    f"{folder}: holds {count_text(self.n_labels, 'label')}; pass {option('-n', python='count')} "
                    f"{self.n_labels} or more"
                )
        else:
            self._list()  # the new list is written before parts are deleted, so that no list names deleted parts
        listed = self._parts.files(TABLE)
        for file in part_files(folder, TABLE):
            if file not in listed:
                file.unlink()

    def _check_parts(self) -> None:
        """Check all parts, before hours are spent on making further labels. Raises InputError if a part is damaged,
        missing or of another version."""
        parts, n_rows, next_episode = self._parts, 0, 0
        for file in parts.files(TABLE):
            episodes = parts.read(file, ["episode"])["episode"]
            with open_for_arrow(file) as stream:
                if not pq.read_schema(stream).equals(_PART_SCHEMA):
                    raise InputError(f"{file}: has labels of another version of petmjx; {label_cure()}")
            n_rows += len(episodes)
            next_episode = (pc.max(episodes).as_py() or 0) + 1
        if (n_rows, next_episode) != (self.n_labels, self.next_episode):
            raise _damaged(self._folder / UNFINISHED)

    def add(self, labels: Sequence[Label]) -> None:
        """Write the labels of whole episodes as one part."""
        if not labels:
            return
        with defer_signals(afterwards=True):
            number = self._parts.next_number(TABLE)
            self._parts = self._parts.plus(self._parts.write(TABLE, number, table_of(labels)))
            self.n_labels += len(labels)
            self.next_episode = labels[-1]["episode"] + 1
            self._list()

    def tables(self) -> Iterator[pa.Table]:
        """The parts in order, as tables with the columns of ``SCHEMA`` and the column ``SPLIT``."""
        # the files were written or checked by petmjx, so it is safe to read columns of lists
        for file in self._parts.files(TABLE):
            with open_for_arrow(file) as stream:
                yield pq.read_table(stream)

    def remove(self) -> None:
        """Delete the list and the parts."""
        (self._folder / UNFINISHED).unlink(missing_ok=True)
        for file in part_files(self._folder, TABLE):
            file.unlink()
        with suppress(OSError):  # an OSError means that the folder has other files, or does not exist
            (self._folder / TABLE).rmdir()

    def _list(self) -> None:
        entries = {
            "set": self._head,
            "count": self._count,
            "labels": self.n_labels,
            "next_episode": self.next_episode,
            LISTED: self._parts.digests,
        }
        write_text(json.dumps(entries, indent=2) + "\n", self._folder / UNFINISHED)


class _CheckedParts(Parts):
    """The parts of a set of labels. If a part is damaged, the error message tells how to make the labels again."""

    def _cure(self, file: Path) -> str:
        return label_cure()


def n_unfinished(folder: Path) -> int:
    """The number of labels in the parts of an unfinished set in a folder. The number is 0 if there is no unfinished
    set, or if it has no labels yet.

    Raises:
        InputError: the folder's list of parts is damaged.
    """
    entries = _entries(folder)
    return 0 if entries is None else int(entries["labels"])


def check_same_set(folder: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise InputError if the labels in a folder belong to another set. The message names the difference.

    A file of orders with a new name but the same content is not a difference. An option that an earlier version did not
    have is no difference, either, if it has its default now.
    """
    orders, orders_now = before.get("orders"), now["orders"]
    if isinstance(orders, Mapping) and orders_now["sha256"] and orders.get("sha256") == orders_now["sha256"]:
        before = {**before, "orders": {**orders, "source": orders_now["source"]}}
    if isinstance(simulation := before.get("simulation"), Mapping):
        before = {**before, "simulation": with_later_options(simulation)}
    for name, earlier, later in differing_settings(before, now):
        if earlier != later:  # both are None if one setting is null and the other is missing
            different = f"{name} was {json.dumps(earlier)}, is {json.dumps(later)}"
            raise InputError(f"{folder}: cannot be resumed, because its labels were made in another way ({different})")


def _entries(folder: Path) -> dict[str, Any] | None:
    """The content of the list of parts in a folder; None if there is no list.

    Raises:
        InputError: the list of parts is damaged.
    """
    file = folder / UNFINISHED
    if not os.path.exists(file):
        return None
    try:
        entries: dict[str, Any] = json.loads(read_regular(file, _MOST_BYTES))
        numbers = [entries[name] for name in ("count", "labels", "next_episode")]
        whole = all(type(number) is int and number >= 0 for number in numbers)
        tables = entries[LISTED]
        whole = whole and isinstance(entries["set"], dict) and set(tables) <= {TABLE}
        files = dict(tables.get(TABLE, {}))
        whole = whole and all(part_name(part_number(Path(name))) == name for name in files)
        whole = whole and bool(files) == bool(entries["labels"])
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        whole = False
    if not whole:
        raise _damaged(file)
    return entries


def _damaged(file: Path) -> InputError:
    return InputError(f"{file}: damaged; {label_cure()}")


def label_cure() -> str:
    """Text that tells what to do about a damaged or missing file of labels."""
    return f"make the labels again, with {option('--overwrite', 'True')}"


def table_of(labels: Sequence[Label]) -> pa.Table:
    """The labels as a table with the columns of ``SCHEMA`` and the column ``SPLIT``."""
    columns = []
    for name, kind in zip(_PART_SCHEMA.names, _PART_SCHEMA.types, strict=True):
        values = [label[name] for label in labels]
        columns.append(_lists(values, kind) if pa.types.is_list(kind) else pa.array(values, kind))
    return pa.Table.from_arrays(columns, schema=_PART_SCHEMA)


def _lists(values: Sequence[NDArray[Any] | None], kind: pa.DataType) -> pa.Array:
    """An Arrow array whose values are lists of numbers, or lists of triples of numbers."""
    items = kind.value_type
    number = items.value_type if pa.types.is_fixed_size_list(items) else items
    rows = [np.zeros(0) if row is None else np.asarray(row, number.to_pandas_dtype()) for row in values]
    ends = np.cumsum([0, *(len(row) for row in rows)])
    flat = pa.array(np.concatenate([row.ravel() for row in rows]), number)
    content = pa.FixedSizeListArray.from_arrays(flat, 3) if pa.types.is_fixed_size_list(items) else flat
    missing = np.array([row is None for row in values])
    offsets = pa.array(ends, pa.int32(), mask=np.append(missing, False))
    return pa.ListArray.from_arrays(offsets, content, kind)


def labels_of(table: pa.Table) -> list[Label]:
    """The labels in a table, as dicts. Lists with a value for each box become NumPy arrays."""
    labels: list[Label] = table.to_pylist()
    for label in labels:
        for name in ("size_mm", "corner_mm", "mass_kg"):
            label[name] = np.array(label[name], float)
    return labels
