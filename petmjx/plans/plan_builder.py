"""Builds plans from plain Python values and NumPy arrays, with the same checks as for files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from petmjx.common.argument_checks import array_of, list_of, text_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.plans.input_conventions import InputConventions
from petmjx.plans.placement_table import PlanFields, RefusedPlan, Table, as_column, sorted_columns, table_plans
from petmjx.plans.plan_fields import PALLET_KINDS, SPARSE, joined_names, plan_id_fault

SOURCE: Final = "python"

_ARRAYS: Final = {
    "size_mm": ("length_mm", "width_mm", "height_mm"),
    "corner_mm": ("x_mm", "y_mm", "z_mm"),
    "mass_kg": ("weight_kg",),
}
"""Argument of ``Plan.from_boxes`` → the columns of a table that it replaces."""


def fields_from_boxes(
    plan_id: str,
    boxes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None,
    arrays: Mapping[str, Any],
    more: Mapping[str, Any],
    given: InputConventions,
) -> PlanFields:
    """The checked fields of a plan. Arguments are as in ``Plan.from_boxes``.

    Raises:
        InputError: a field is missing, unknown or unusable, or fields have different lengths.
    """
    if fault := plan_id_fault(text_of(plan_id, "plan_id")):
        raise InputError(fault)
    where = f"plan {printable_name(plan_id)}"
    columns = {**_columns_of(boxes, where), **_columns_of_arrays(arrays, where), **more}
    if arrays["size_mm"] is not None and "orientation" in columns:
        columns |= _of_items(columns)
    lengths = {name: _length(values, f"{where}: {name}") for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {number}" for name, number in lengths.items())
        raise InputError(f"{where}: all fields must have one value for each box, got {counts}")
    n_boxes = next(iter(lengths.values()), 0)
    if not n_boxes:
        raise InputError(f"{where}: has no box")
    columns = {
        "sequence": np.arange(1, n_boxes + 1),
        "article": [""] * n_boxes,
        **columns,
        "plan_id": [plan_id] * n_boxes,
    }
    names = list(columns)
    try:
        positions, unread = sorted_columns(names)
    except InputError as error:
        raise InputError(f"{where}: {str(error).partition(';')[0]}") from None
    if unread:
        raise InputError(f"{where}: unknown field {printable_name(unread[0])}")
    table = Table({name: as_column(columns[names[index]]) for name, index in positions.items()}, (), np.arange(n_boxes))
    (plan,) = table_plans(table, SOURCE, n_boxes, [], given)
    if isinstance(plan, RefusedPlan):
        raise InputError(plan.message.removeprefix(f"{SOURCE}: ").replace(", row ", ", box ", 1))
    return plan


def fields_of_units(
    plan_id: str, loads: Sequence[Any], corner_mm: Any, pallet: str, pallet_kg: float | None, material: str
) -> dict[str, Any]:
    """The fields of a plan made from loaded pallets. Arguments are as in ``Plan.of_units``; ``loads`` are plans.

    Raises:
        InputError: an argument is unusable.
    """
    if fault := plan_id_fault(text_of(plan_id, "plan_id")):
        raise InputError(fault)
    if pallet not in PALLET_KINDS:
        raise InputError(f"pallet must be {joined_names([*PALLET_KINDS], 'or')}, {shown_value(pallet)}")
    size, corners = np.array(PALLET_KINDS[pallet].size_mm), array_of(corner_mm, "corner_mm", (3,))
    if not loads or len(corners) != len(loads):
        raise InputError(f"corner_mm must have a corner for each of {len(loads)} loads, got {len(corners)}")
    if pallet_kg is None:
        pallet_kg = PALLET_KINDS[pallet].mass_kg
    of_pallet = {"item_ids": "pallet", "articles": pallet, "product_groups": "", "materials": material, "kinds": pallet}
    usual = {"mass_center_mm": np.zeros(3), "orientation": 0, **dict.fromkeys(SPARSE, np.nan)}
    fields: dict[str, Any] = {"plan_id": plan_id, "source": SOURCE}
    placed = [load.corner_mm + at + [0.0, 0.0, size[2]] for load, at in zip(loads, corners, strict=True)]
    fields["corner_mm"] = _joined([*corners], placed)
    fields["size_mm"] = _joined([size] * len(loads), [load.size_mm for load in loads])
    fields["mass_kg"] = _joined([pallet_kg] * len(loads), [load.mass_kg for load in loads])
    fields["sequence"] = np.arange(1, len(fields["mass_kg"]) + 1)
    for name, value in of_pallet.items():
        texts = [text for load in loads for text in (value, *(getattr(load, name) or ("",) * load.n_boxes))]
        fields[name] = tuple(texts) if any(texts) else ()
    for name, number in usual.items():
        values = [getattr(load, name) for load in loads]
        if any(of_load is not None for of_load in values):
            filled = [
                np.array([number] * load.n_boxes) if of_load is None else of_load
                for of_load, load in zip(values, loads, strict=True)
            ]
            fields[name] = _joined([number] * len(loads), filled)
    return fields


def _joined(of_pallets: Sequence[Any], of_loads: Sequence[Any]) -> Any:
    """For each pallet, its own value followed by the values of its load."""
    return np.concatenate([part for one, load in zip(of_pallets, of_loads, strict=True) for part in ([one], load)])


def _columns_of(boxes: Any, where: str) -> dict[str, Any]:
    """The columns in a list of dictionaries, a dictionary of lists, or a data frame."""
    if boxes is None:
        return {}
    if isinstance(boxes, Mapping) or (hasattr(boxes, "iloc") and hasattr(boxes, "columns")):
        return {str(name): boxes[name] for name in boxes if name != "plan_id"}
    rows: list[Any] = list_of(boxes, f"{where}: boxes", object, "dictionaries")
    if not all(isinstance(row, Mapping) for row in rows):
        raise InputError(f"{where}: boxes must be dictionaries, or one dictionary of lists")
    names = dict.fromkeys(str(name) for row in rows for name in row if name != "plan_id")
    return {name: [row.get(name) for row in rows] for name in names}


def _columns_of_arrays(arrays: Mapping[str, Any], where: str) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    for argument, names in _ARRAYS.items():
        if arrays[argument] is None:
            continue
        try:
            values = np.asarray(arrays[argument])
        except Exception:  # converting an object of an unknown class may raise any exception
            raise InputError(
                f"{where}: {argument} must be an array of numbers, {shown_value(arrays[argument])}"
            ) from None
        shape = (len(names),) if len(names) > 1 else ()
        if values.ndim != 1 + len(shape) or values.shape[1:] != shape:
            expected = "(n, 3)" if shape else "(n,)"
            raise InputError(f"{where}: {argument} must have the shape {expected}, got {values.shape}")
        columns |= dict(zip(names, values.reshape(len(values), len(names)).T, strict=True))
    return columns


def _of_items(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the lengths and widths of items from the extents of the placed boxes, since tables need them. Wrong
    orientations are refused later.
    """
    turned = np.zeros(len(columns["length_mm"]), bool)
    try:
        orientations = list(columns["orientation"])
    except TypeError:  # the value is not a list
        orientations = []
    for box, value in enumerate(orientations[: len(turned)]):
        turned[box] = isinstance(value, int | float | np.number) and value == 1
    length, width = columns["length_mm"], columns["width_mm"]
    return {"length_mm": np.where(turned, width, length), "width_mm": np.where(turned, length, width)}


def _length(values: Any, name: str) -> int:
    with suppress(Exception):  # the length of an object of an unknown class may raise any exception
        if not isinstance(values, str | bytes):
            return len(values)
    raise InputError(f"{name} must be a list of values, one for each box, {shown_value(values)}")
