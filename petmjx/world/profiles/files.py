"""Force windows from Parquet or TOML files, and PSD tables from CSV files."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, StrictFloat, model_validator

from petmjx.checked import Checked, got, read_toml, reason
from petmjx.errors import InputError
from petmjx.text import printable
from petmjx.world.profiles.base import MAX_PROFILE_S
from petmjx.world.profiles.vibration import PsdTable, psd_rms_g
from petmjx.world.profiles.windows import Window

MAX_WINDOWS = 100_000
MAX_FORCE = 10_000.0
"""Largest component of a force, in units of total mass × 9.81 m/s². A larger one is a typing error."""
MIN_DENSITY = 1e-30
"""Smallest PSD, g²/Hz: ratios of densities must not overflow."""
MAX_RMS_G = 1000.0
"""Largest RMS of a random vibration, g."""

Seconds = Annotated[StrictFloat, Field(ge=0, le=MAX_PROFILE_S)]
Component = Annotated[StrictFloat, Field(ge=-MAX_FORCE, le=MAX_FORCE)]
Positive = Annotated[StrictFloat, Field(gt=0, le=1e6)]


class WindowRow(Checked):
    """One push; in sweep files also the list of its five numbers."""

    start_s: Seconds = Field(description="when it begins, s after the profile's beginning")
    duration_s: Annotated[StrictFloat, Field(gt=0, le=MAX_PROFILE_S)] = Field(description="how long it acts, s")
    x: Component = Field(description="force along x in units of scale × total mass × 9.81 m/s²")
    y: Component = Field(description="force along y in the same units")
    z: Component = Field(description="force along z in the same units")

    @model_validator(mode="before")
    @classmethod
    def _from_numbers(cls, row: Any) -> Any:
        if not isinstance(row, list | tuple):
            return row
        if len(row) != len(cls.model_fields):
            raise ValueError(f"must be [{', '.join(cls.model_fields)}], {got(row)}")
        return dict(zip(cls.model_fields, row, strict=True))

    @property
    def window(self) -> Window:
        return Window(self.start_s, self.duration_s, (self.x, self.y, self.z))


Rows = Annotated[tuple[WindowRow, ...], Field(min_length=1, max_length=MAX_WINDOWS)]


class _WindowFile(Checked):
    window: Rows = Field(description="[[window]] tables with start_s, duration_s, x, y, z")


def read_windows(path: Path) -> tuple[WindowRow, ...]:
    """Force windows of a file.

    Parquet: the columns start_s, duration_s, x, y, z; others are ignored. TOML: an array of tables ``[[window]]`` with
    these five keys.

    Raises:
        InputError: one line with file, row and field: "push.toml: window[3].duration_s must be > 0, got 0".
    """
    content = read_toml(path) if path.suffix == ".toml" else {"window": _parquet_rows(path)}
    try:
        return _WindowFile.read(content).window
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _parquet_rows(path: Path) -> list[dict[str, Any]]:
    # Imported here, because the import is slow and only windows in Parquet need it.
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path, columns=list(WindowRow.model_fields))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except pyarrow.ArrowInvalid as error:
        raise InputError(f"{path}: is not Parquet: {str(error).splitlines()[0]}") from None
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise InputError(f"{printable(str(path))}: cannot be read as Parquet: {reason(error)}") from None
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows


def _is_psd(rows: PsdTable) -> PsdTable:
    for number, ((before_hz, _), (hz, _)) in enumerate(itertools.pairwise(rows), start=1):
        if not hz / before_hz > 1:
            raise ValueError(f"must have frequencies that rise, got {hz:g} Hz after {before_hz:g} Hz in row {number}")
    lowest = min(density for _, density in rows)
    if lowest < MIN_DENSITY:
        raise ValueError(f"must have densities of at least {MIN_DENSITY:g} g²/Hz, got {lowest:g}")
    with np.errstate(all="ignore"):  # what overflows is refused
        rms_g = psd_rms_g(rows)
    if not rms_g <= MAX_RMS_G:
        raise ValueError(f"must have an RMS of at most {MAX_RMS_G:g} g, got {rms_g:g} g")
    return rows


PsdRows = Annotated[tuple[tuple[Positive, Positive], ...], Field(min_length=2), AfterValidator(_is_psd)]
"""Rows of [Hz, g²/Hz]."""


class _PsdFile(Checked):
    row: PsdRows


def read_psd(path: Path) -> PsdTable:
    """A PSD from a CSV file: two columns, Hz and g²/Hz, with or without a header line; # begins a comment.

    Raises:
        InputError: one line with file and row (from 0, without header and comments):
            "truck.csv: row[3][1] must be > 0, got -1.0".
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = [row for row in csv.reader(stream) if row and not row[0].lstrip().startswith("#")]
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
