"""The worlds that a run's folder already has, for a run that goes on with it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from petmjx.errors import InputError
from petmjx.results.counts import COUNTED, Counts
from petmjx.results.files import part_files
from petmjx.results.reader import read_part

_COLUMNS: Final = ("plan_id", "variant", *COUNTED, "culprit", "n_steps")


class Recorded:
    """Which worlds there are, and what their rows in the table ``worlds`` say.

    Args:
        folder: a run's; None: there is no world.
        columns: of ``worlds``, beside those that every run has.

    Raises:
        InputError: a part is damaged, lacks its boxes, or has a world that another one has too.
    """

    def __init__(self, folder: Path | None = None, columns: Sequence[str] = ()) -> None:
        parts = part_files(folder, "worlds") if folder is not None else []
        for file in parts:
            boxes = file.parents[1] / "boxes" / file.name
            if not boxes.is_file():
                raise InputError(f"{boxes}: missing, though the worlds of this part are there")
        wanted = [*_COLUMNS, *columns]
        self._table = pa.concat_tables([read_part(file, wanted) for file in parts]) if parts else None
        self._rows: dict[str, dict[int, int]] = {}
        for row, (plan_id, variant) in enumerate(zip(self._column("plan_id"), self._column("variant"), strict=True)):
            if self._rows.setdefault(plan_id, {}).setdefault(variant, row) != row:
                raise InputError(f"{folder}: has plan {plan_id}, variant {variant} more than once")

    def __len__(self) -> int:
        return self._table.num_rows if self._table is not None else 0

    def __contains__(self, world: tuple[str, int]) -> bool:
        plan_id, variant = world
        return variant in self._rows.get(plan_id, ())

    def row(self, plan_id: str, variant: int) -> dict[str, Any] | None:
        """Column → value of one world, null as None; None where it is not recorded."""
        row = self._rows.get(plan_id, {}).get(variant)
        return None if row is None else {name: values[row] for name, values in self._values.items()}

    def counts(self) -> Counts:
        """How many worlds came to what."""
        counts = Counts()
        if self._table is not None:
            counts.add_worlds(self._table)
        return counts

    def _column(self, name: str) -> list[Any]:
        values: list[Any] = self._table.column(name).to_pylist() if self._table is not None else []
        return values

    @cached_property
    def _values(self) -> dict[str, list[Any]]:
        return {name: self._column(name) for name in self._table.column_names} if self._table is not None else {}
