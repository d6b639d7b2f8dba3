"""Sorts options by the record to which they belong (``sorted_options``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from petmjx.common.checked_records import CheckedRecord, CliFlag, hint
from petmjx.common.errors import InputError
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation


def sorted_options(options: Mapping[str, Any], *more: type[CheckedRecord]) -> tuple[dict[str, Any], ...]:
    """Split options by the record to which they belong. Returns a dict for ``Simulation``, a dict for ``RunOptions``,
    and a dict for each record in ``more``.

    Raises:
        InputError: an option is unknown. The message suggests the most similar name.
    """
    records: tuple[type[CheckedRecord], ...] = (Simulation, RunOptions, *more)
    by_record: tuple[dict[str, Any], ...] = tuple({} for _ in records)
    for name, value in options.items():
        home = next((i for i, record in enumerate(records) if name in record.model_fields), None)
        if home is None:
            raise InputError(f"unknown option {name}; {_advice(name, records)}")
        by_record[home][name] = value
    return by_record


def _advice(name: str, records: tuple[type[CheckedRecord], ...]) -> str:
    """Advice about an unknown option: the record within ``Simulation`` that has a field of this name, or an option with
    a similar name."""
    for table, field in Simulation.model_fields.items():
        inner = field.annotation
        if not (isinstance(inner, type) and issubclass(inner, CheckedRecord)):
            continue
        for field_name, info in inner.model_fields.items():
            if name in (
                field_name,
                *(flag.name[2:].replace("-", "_") for flag in info.metadata if isinstance(flag, CliFlag)),
            ):
                return f"it is a field of {table}: {table}={{{field_name!r}: …}}"
    return hint(name, [field for record in records for field in record.model_fields])
