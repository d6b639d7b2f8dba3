"""Force windows from Parquet or TOML files, and PSD tables from CSV files."""

from __future__ import annotations

import csv
import io
import itertools
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, StrictFloat, model_validator

from petmjx.common.checked_records import CheckedRecord, reason, shown_value, within
from petmjx.common.errors import InputError
from petmjx.common.safe_read import read_regular
from petmjx.common.text import printable, printable_name
from petmjx.common.toml_files import read_toml
from petmjx.world.profiles.force_windows import Window
from petmjx.world.profiles.profile import MAX_PROFILE_S
from petmjx.world.profiles.random_vibration import PsdTable, psd_rms_g

MAX_WINDOWS = 100_000
MAX_FORCE = 10_000.0
"""Largest component of a force, in units of total mass × 9.81 m/s². A larger component is probably a typing mistake."""
MIN_DENSITY = 1e-30
"""Smallest density of a PSD, g²/Hz. With smaller densities, ratios of densities might overflow."""
MAX_RMS_G = 1000.0
"""Largest RMS acceleration of a random vibration, g."""
MIN_HZ, MAX_HZ = 0.0001, 1e6
MAX_DENSITY = 1e6
MAX_PSD_ROWS = 1000
"""Largest number of rows of a PSD. The PSDs of test standards have up to 30 rows."""
MAX_CSV_BYTES = 1 << 20
MAX_PARQUET_BYTES = 64 << 20

MAX_PUSH_S = 100 * MAX_PROFILE_S
"""Largest sum of the durations of all windows of a profile, s. Every window is added to the samples separately, so the
limit also bounds the computing time."""

Seconds = Annotated[StrictFloat, Field(ge=0), within(0, MAX_PROFILE_S)]
LongerThanNothing = Annotated[StrictFloat, Field(gt=0), within(0, MAX_PROFILE_S)]
Component = Annotated[StrictFloat, within(-MAX_FORCE, MAX_FORCE)]
Hertz = Annotated[StrictFloat, Field(gt=0), within(MIN_HZ, MAX_HZ)]
Density = Annotated[StrictFloat, Field(gt=0), within(0, MAX_DENSITY)]


class WindowRow(CheckedRecord):
    """One push. Sweep files may also give a push as a list of its five numbers: ``start_s``, ``duration_s``, ``x``,
    ``y``, ``z``."""

    start_s: Seconds = Field(description="time at which the push begins, s after the beginning of the profile")
    duration_s: LongerThanNothing = Field(description="how long the push acts, s")
    x: Component = Field(description="force along x in units of scale × mass of boxes and carrier × 9.81 m/s²")
    y: Component = Field(description="force along y in units of scale × mass of boxes and carrier × 9.81 m/s²")
    z: Component = Field(description="force along z in units of scale × mass of boxes and carrier × 9.81 m/s²")

    @model_validator(mode="before")
    @classmethod
    def _from_numbers(cls, row: Any) -> Any:
        if not isinstance(row, list | tuple):
            return row
        if len(row) != len(cls.model_fields):
            raise ValueError(f"must be [{', '.join(cls.model_fields)}], {shown_value(row)}")
        return dict(zip(cls.model_fields, row, strict=True))

    @property
    def window(self) -> Window:
        return Window(self.start_s, self.duration_s, (self.x, self.y, self.z))


def _not_endless(rows: tuple[WindowRow, ...]) -> tuple[WindowRow, ...]:
    total_s = sum(row.duration_s for row in rows)
    if total_s > MAX_PUSH_S:
        raise ValueError(f"must last at most {MAX_PUSH_S:g} s in all, got {total_s:g} s")
    return rows


Rows = Annotated[tuple[WindowRow, ...], Field(min_length=1, max_length=MAX_WINDOWS), AfterValidator(_not_endless)]


class _WindowFile(CheckedRecord):
    window: Rows = Field(description="one table [[window]] for each push, with start_s, duration_s, x, y, z")


def read_windows(path: Path) -> tuple[WindowRow, ...]:
    """The force windows in a file.

    A Parquet file needs the columns ``start_s``, ``duration_s``, ``x``, ``y`` and ``z``; other columns are ignored. A
    TOML file needs an array of tables ``[[window]]`` with these five keys.

    Raises:
        InputError: the file is wrong. The message is one line with the file, the row and the field, such as
            "push.toml: window[3].duration_s must be > 0, got 0".
    """
    content = read_toml(path) if path.suffix == ".toml" else {"window": _parquet_rows(path)}
    try:
        return _WindowFile.read(content).window
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _parquet_rows(path: Path) -> list[dict[str, Any]]:
    # pyarrow is imported here, because the import is slow, and only profile files in Parquet need pyarrow.
    import pyarrow
    import pyarrow.parquet

    name = printable(str(path))
    try:
        # Limits are needed, since the footer of a damaged file may announce millions of columns or gigabytes of names.
        file = pyarrow.parquet.ParquetFile(
            pyarrow.BufferReader(bytes(read_regular(path, MAX_PARQUET_BYTES))),
            thrift_string_size_limit=MAX_PARQUET_BYTES,
            thrift_container_size_limit=MAX_WINDOWS,
        )
        if not 0 <= file.metadata.num_rows <= MAX_WINDOWS:
            raise InputError(f"{name}: must have at most {MAX_WINDOWS:,} rows, got {file.metadata.num_rows:,}")
        for field in file.schema_arrow:
            if field.name in WindowRow.model_fields and not _is_number(field.type):
                raise InputError(f"{name}: column {field.name} must hold numbers, {shown_value(str(field.type))}")
        table = file.read(columns=list(WindowRow.model_fields), use_threads=False)
        rows: list[dict[str, Any]] = table.to_pylist()
    except FileNotFoundError:
        raise InputError(f"{name}: no such file") from None
    except pyarrow.ArrowInvalid as error:
        raise InputError(f"{name}: is not Parquet: {_first_line(error)}") from None
    except (OSError, ValueError, KeyError, pyarrow.ArrowException) as error:
        raise InputError(f"{name}: cannot be read as Parquet: {_first_line(error)}") from None
    return rows


def _is_number(kind: Any) -> bool:
    import pyarrow

    return bool(pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind))


def _first_line(error: Exception) -> str:
    return printable_name((reason(error).splitlines() or [type(error).__name__])[0])


def _is_psd(rows: PsdTable) -> PsdTable:
    for number, ((before_hz, _), (hz, _)) in enumerate(itertools.pairwise(rows), start=1):
        if not hz / before_hz > 1:
            raise ValueError(f"must have frequencies that rise, got {hz:g} Hz after {before_hz:g} Hz in row {number}")
    lowest = min(density for _, density in rows)
    if lowest < MIN_DENSITY:
        raise ValueError(f"must have densities of at least {MIN_DENSITY:g} g²/Hz, got {lowest:g}")
    with np.errstate(all="ignore"):  # an RMS that overflows is refused below
        rms_g = psd_rms_g(rows)
    if not rms_g <= MAX_RMS_G:
        raise ValueError(f"must have an RMS of at most {MAX_RMS_G:g} g, got {rms_g:g} g")
    return rows


PsdRows = Annotated[
    tuple[tuple[Hertz, Density], ...], Field(min_length=2, max_length=MAX_PSD_ROWS), AfterValidator(_is_psd)
]
"""The rows [Hz, g²/Hz] of a PSD, which pydantic checks."""


class _PsdFile(CheckedRecord):
    row: PsdRows


def read_psd(path: Path) -> PsdTable:
    """The PSD in a CSV file with two columns, Hz and g²/Hz. A header line is allowed. Lines that begin with # are
    comments.

    Raises:
        InputError: the file is wrong. The message is one line with the file and the row, such as "truck.csv: row[3][1]
            must be > 0, got -1.0". Rows are counted from 0, without the header and comments.
    """
    try:
        text = read_regular(path, MAX_CSV_BYTES).decode()
        lines = [
            row for row in csv.reader(io.StringIO(text, newline="")) if row and not row[0].lstrip().startswith("#")
        ]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{printable(str(path))}: cannot be read as a PSD table: {reason(error)}") from None
    rows = [[_number_or_text(cell) for cell in line] for line in lines]
    if rows and isinstance(rows[0][0], str):
        rows = rows[1:]
    try:
        return _PsdFile.read({"row": rows}).row
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _number_or_text(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell
