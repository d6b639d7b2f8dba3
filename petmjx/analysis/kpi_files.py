"""Writes KPIs as Parquet, CSV and JSON, and on request as an Excel workbook."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from petmjx.analysis.kpis import COLUMNS, MEANS, Kpis
from petmjx.common.atomic_write import write_errors
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import IsOurs
from petmjx.common.text import printable
from petmjx.common.unreadable_files import DAMAGED_ZIP
from petmjx.results.documented_tables import check_tables_free, has_keys
from petmjx.results.result_files import csv, parquet, text, write_together

_CREATOR: Final = "petmjx"
"""Name that petmjx writes as the creator into the properties of Excel workbooks. petmjx recognises its own workbooks by
this name."""
_MOST_PROPERTIES: Final = 1 << 16

_ARROW: Final = {"object": pa.string(), "int64": pa.int64(), "Int64": pa.int64()}
_SUMMED: Final = ("plans", "orders", "ordered_boxes", "rating", "rating_by_verdict", "rating_if_all_stood")


def check_kpis_free(folder: Path, overwrite: bool, *, xlsx: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Check that :func:`write_kpis` may write into a folder. ``inputs`` are the files that the command reads. Raises
    InputError if an existing file must not be replaced (``petmjx.results.documented_tables.check_tables_free``).
    """
    extra_files: dict[str, IsOurs] = {"summary.json": lambda file: has_keys(file, (*_SUMMED, "means", "skipped"))}
    if xlsx:
        extra_files["kpis.xlsx"] = _is_our_workbook
    check_tables_free(folder, ("kpis",), overwrite=overwrite, inputs=inputs, others=extra_files)


def write_kpis(kpis: Kpis, folder: str | Path, *, xlsx: bool = False, overwrite: bool = False) -> None:
    """Write ``kpis.parquet``, ``kpis.csv`` and ``summary.json``, and with ``xlsx`` also ``kpis.xlsx``, into a folder.

    Either all files are written or none. The folder is made if it does not exist.

    Args:
        overwrite: whether files that petmjx wrote into the folder earlier may be replaced.

    Raises:
        InputError: the folder is not writable, it has a file of one of these names that must not be replaced, or
            ``xlsx`` is set and openpyxl is not installed.
    """
    folder = Path(folder)
    check_kpis_free(folder, overwrite, xlsx=xlsx)
    workbook = _workbook(kpis) if xlsx else b""
    table = kpis_table(kpis)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        summary = {**kpis.summary, "notes": kpis.notes, "skipped": kpis.skipped}
        files = {folder / "kpis.parquet": parquet(table), folder / "kpis.csv": csv(table)}
        files[folder / "summary.json"] = text(json.dumps(summary, indent=2) + "\n")
        if xlsx:
            files[folder / "kpis.xlsx"] = lambda file: file.write(workbook)
        write_together(files)


def kpis_table(kpis: Kpis) -> pa.Table:
    """The KPIs as an Arrow table, with units and meanings in the metadata of the columns."""
    fields = [
        pa.field(
            column.name,
            _ARROW.get(column.pandas, pa.float64()),
            metadata={"unit": column.unit, "description": column.meaning},
        )
        for column in COLUMNS
    ]
    arrays = [pa.array(kpis.plans[field.name], field.type, from_pandas=True) for field in fields]
    return pa.table(arrays, schema=pa.schema(fields))


def _workbook(kpis: Kpis) -> bytes:
    """The bytes of an Excel workbook with the sheets ``overview`` and ``orderwise``, as written by the evaluator of
    BED-BPP (a public benchmark for packing)."""
    try:
        from openpyxl import Workbook
        from openpyxl.cell import WriteOnlyCell
    except ImportError:
        raise InputError("a workbook needs openpyxl: pip install 'petmjx[packers]'") from None
    workbook = Workbook(write_only=True)
    workbook.properties.creator = _CREATOR

    def add(sheet: Any, values: Iterable[Any]) -> None:
        cells = []
        for value in values:
            cell = WriteOnlyCell(sheet, printable(value) if isinstance(value, str) else value)
            if isinstance(value, str):
                cell.data_type = "s"  # with any other type, Excel would read text such as "=1+1" as a formula
            cells.append(cell)
        sheet.append(cells)

    overview = workbook.create_sheet("overview")
    for name in _SUMMED:
        add(overview, (name, kpis.summary[name]))
    for name in MEANS:
        add(overview, (f"mean of {name}", kpis.summary["means"][name]))
    orderwise = workbook.create_sheet("orderwise")
    table = kpis_table(kpis)
    add(orderwise, table.column_names)
    for row in zip(*(column.to_pylist() for column in table.columns), strict=True):
        add(orderwise, row)
    content = io.BytesIO()  # a file in memory, because openpyxl prints an error if it cannot save to a path
    workbook.save(content)
    return content.getvalue()


def _is_our_workbook(file: Path) -> bool:
    try:
        with zipfile.ZipFile(file) as parts, parts.open("docProps/core.xml") as properties:
            return f">{_CREATOR}<".encode() in properties.read(_MOST_PROPERTIES)
    except (*DAMAGED_ZIP, KeyError):  # petmjx did not write the file, or it is damaged
        return False
