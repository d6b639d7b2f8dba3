"""Single worlds in a run's tables, without reading the rest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from petmjx.results.files import part_files
from petmjx.results.reader import RunResults, read_part


def world_row(run: RunResults, plan_id: str, variant: int) -> dict[str, Any] | None:
    """A world's row of ``worlds``, column → value, null as None; None where there is no such world."""
    for table in rows_of(run.path, "worlds", plan_id, variant):
        row: dict[str, Any] = table.to_pylist()[0]
        return row
    return None


def rows_of(folder: Path, table: str, plan_id: str, variant: int) -> Iterator[pa.Table]:
    """A world's rows of a table, from each part that has some."""
    for file in part_files(folder, table):
        part = read_part(file)
        wanted = pc.and_(pc.equal(part["plan_id"], plan_id), pc.equal(part["variant"], variant))
        rows = part.filter(wanted)
        if len(rows):
            yield rows
