"""The worlds that a run's folder already has, for a run that goes on with it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Final

import pyarrow as pa

from petmjx.errors import InputError
from petmjx.results.counts import COUNTED, WorldCounts
from petmjx.results.listed import Parts

_COLUMNS: Final = ("plan_id", "variant", *COUNTED, "culprit", "n_steps")


class Recorded:
    """Which worlds there are, and what their rows in the table ``worlds`` say.

    Args:
        parts: of a run; None: there is no world.
        columns: of ``worlds``, beside those that every run has.

    Raises:
        InputError: a part is damaged or missing, or has a world that another one has too.
    """

    def __init__(self, parts: Parts | None = None, columns: Sequence[str] = ()) -> None:
        for boxes in parts.files("boxes") if parts is not None else ():
            if not boxes.is_file():
                raise InputError(f"{boxes}: missing, though the worlds of this part are there")
        tables = parts.table("worlds", [*_COLUMNS, *columns]) if parts is not None else []
        self._table = pa.concat_tables(tables) if tables else None
        self._rows: dict[str, dict[int, int]] = {}
        for row, (plan_id, variant) in enumerate(zip(self._column("plan_id"), self._column("variant"), strict=True)):
            if self._rows.setdefault(plan_id, {}).setdefault(variant, row) != row:
                raise InputError(f"{parts and parts.folder}: has plan {plan_id}, variant {variant} more than once")

    def __len__(self) -> int:
        return self._table.num_rows if self._table is not None else 0

    def __contains__(self, world: tuple[str, int]) -> bool:
        plan_id, variant = world
        return variant in self._rows.get(plan_id, ())

    def row(self, plan_id: str, variant: int) -> dict[str, Any] | None:
        """Column → value of one world, null as None; None where it is not recorded."""
        row = self._rows.get(plan_id, {}).get(variant)
        return None if row is None else {name: values[row] for name, values in self._values.items()}

    def counts(self) -> WorldCounts:
        """How many worlds came to what."""
        counts = WorldCounts()
        if self._table is not None:
            counts.add_worlds(self._table)
        return counts

    def _column(self, name: str) -> list[Any]:
        values: list[Any] = self._table.column(name).to_pylist() if self._table is not None else []
        return values

    @cached_property
    def _values(self) -> dict[str, list[Any]]:
        return {name: self._column(name) for name in self._table.column_names} if self._table is not None else {}
