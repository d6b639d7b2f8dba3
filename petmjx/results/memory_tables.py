"""The tables of a run without a folder. They stay in memory if they fit into one part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from petmjx.results.run_folder import part_name, write_table
from petmjx.results.run_table_files import Tables
from petmjx.results.run_tables import Parts, with_columns


@dataclass(frozen=True, eq=False)
class MemoryParts(Parts):
    """Tables under the names that their files would have in the run's folder."""

    tables: dict[Path, pa.Table] = field(default_factory=dict)

    def files(self, table: str) -> list[Path]:
        """The names of a table's parts, in order."""
        return [file for file in self.tables if file.parent.name == table]

    def read(self, file: Path, columns: Sequence[str] | None = None) -> pa.Table:
        """One part, or some of its columns."""
        return with_columns(self.tables[file], file, columns)

    def write(self, folder: Path) -> dict[Path, str]:
        """Write the tables as files; returns the digest of each. Raises OSError."""
        return {folder / file: write_table(table, folder / file) for file, table in self.tables.items()}


class MemoryTables(Tables):
    """Takes the tables of a new run like ``Tables``, but keeps them in memory. No table replaces an earlier one."""

    parts: MemoryParts

    def __init__(self) -> None:
        super().__init__(Path(), MemoryParts(Path(), {}))

    def write_plans(self, plans: pa.Table, placements: Callable[[], pa.Table | None] = lambda: None) -> bool:
        """Keep the table ``plans``. The placements are not kept: the caller has the plans, or their files have them."""
        self.write_part(0, [("plans", plans)])
        return True

    def write_part(self, number: int, tables: Iterable[tuple[str, pa.Table]]) -> None:
        """Keep the tables of a part."""
        self.parts.tables.update({Path(table) / part_name(number): content for table, content in tables})
