"""The records and lines of ``petmjx info``: the kind of each file of packing plans, how the file is read, and what is
odd in it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from petmjx.common.errors import InputError, PlanWarning
from petmjx.common.text import count_text, first_names, printable, printable_name, three_digits
from petmjx.options.run_options import OF_ORDERS, RunOptions
from petmjx.plans.bedbpp_orders import OF_PLAN
from petmjx.plans.column_extraction import XYZ
from petmjx.plans.convention_checks import find_conventions
from petmjx.plans.item_columns import TWO_WAYS
from petmjx.plans.item_joins import has_named_places
from petmjx.plans.item_units_and_quantities import OrderReading
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan_reader import OPTIONS_OF_OTHERS, REPEATED, idle_options, load_plans
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.readings import NOT_READ, Reading

_MOST_LINES: Final = 5
"""Largest number of lines of one kind that are shown for a file."""
_MOST_NAMES: Final = 12
"""Largest number of column names in a line."""
_WIDTH: Final = 11


def file_infos(paths: Sequence[Path], options: Mapping[str, Any]) -> tuple[list[dict[str, Any]], PlanSet]:
    """A record for each file, and the plans in the files.

    A reading states how a file of another tool is read: columns, units, axes and so on.

    Args:
        paths: files and folders.
        options: options of ``petmjx.load_plans``.

    Raises:
        InputError: a path does not exist, or an option is invalid.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlanWarning)  # no warnings, since the record of each file lists them
        plan_set = load_plans(list(paths), **options)
    sources = dict.fromkeys(
        [*(plan.source for plan in plan_set), *(skipped.source for skipped in plan_set.skipped), *plan_set.readings]
    )
    given = RunOptions(**{name: options.get(name) for name, _ in OPTIONS_OF_OTHERS})
    infos = [_info(plan_set, source, given) for source in sources]
    names_places = not {*XYZ, "position"}.isdisjoint(given.columns or ())
    for record in infos:
        are_plans = (
            record["plans"] or names_places or any(TWO_WAYS in line or REPEATED in line for line in record["skipped"])
        )
        record["orders"], fault = ("", "") if are_plans else _orders_line(Path(record["file"]), options)
        if fault:
            record["skipped"].append(fault)
    return infos, plan_set


def _orders_line(path: Path, options: Mapping[str, Any]) -> tuple[str, str]:
    """Two texts about a file without plans: how the file would be read as orders, and the error of its first order.

    The text about orders is "" if the file has no orders. If there are two equally plausible readings, the text about
    orders names both. The error is "" if any order is usable. A file with columns of places should contain plans. If
    the plans in such a file cannot be read, the file is not read as orders either, since that would hide why its plans
    cannot be read.
    """
    errors: list[InputError] = []
    try:
        reading = OrderReading.of(RunOptions(**{name: options[name] for name in OF_ORDERS if name in options}))
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always", PlanWarning)
            sizes = [len(order.items) for _, order in read_orders(path, errors.append, reading)]
    except InputError as error:
        line = str(error).removeprefix(f"{printable(str(path))}: ")
        return line if line.startswith(TWO_WAYS) and not has_named_places(path) else "", ""
    if not sizes or has_named_places(path):
        # No error is returned if the orders' reader reported none, or reported that the file holds plans. In both
        # cases, the record already has the error of the plans' reader.
        of_plans = not errors or OF_PLAN in str(errors[0])
        return "", "" if sizes or of_plans else str(errors[0])
    plain = f"read as BED-BPP's orders; {count_text(len(sizes), 'order')}, {count_text(sum(sizes), 'box', 'boxes')}"
    line = str(notes[0].message).removeprefix(f"{printable(str(path))}: ") if notes else plain
    return f"{line}; unusable: {errors[0]}" if errors else line, ""


def _info(plan_set: PlanSet, source: str, given: RunOptions) -> dict[str, Any]:
    plans = [plan for plan in plan_set if plan.source == source]
    reading = plan_set.readings.get(source)
    sizes = [float((plan.corner_mm + plan.size_mm).max(axis=0)[axis]) for plan in plans for axis in range(3)]
    skipped_lines = [skipped.message for skipped in plan_set.skipped if skipped.source == source]
    is_read = plans or any(REPEATED in line for line in skipped_lines)
    form = "petmjx's own form" if is_read else "cannot be read"
    odd = [layout for layout in plan_set.warnings if layout.source == source]
    lines = find_conventions(plans, odd if reading is None else (), None)
    idle = idle_options(given, [source] if reading is None and is_read else ())
    record: dict[str, Any] = {
        "file": source,
        "form": form if reading is None else reading.form,
        "plans": len(plans),
        "boxes": sum(plan.n_boxes for plan in plans),
        "plan_ids": [plan.plan_id for plan in plans[:100]],
        "mass_kg": round(sum(float(plan.mass_kg.sum()) for plan in plans), 6),
        "largest_mm": [max(sizes[axis::3]) for axis in range(3)] if plans else [],
        "skipped": skipped_lines,
        "odd": [*idle, *(line.removeprefix(f"{source}: ") for line in lines), *map(str, odd)],
        "reading": None,
    }
    if reading is not None:
        record["reading"] = {
            **{name: getattr(reading, name) for name in ("units", "masses", "anchor", "up", "sizes", "rule", "origin")},
            "order": reading.order,
            "along": list(reading.along),
            "columns": dict(reading.columns),
            "notes": list(reading.notes),
            "unread": list(reading.unread),
            "evidence": str(reading.evidence),
            "line": reading.line(),
            "unused": list(reading.unused),
            "alternatives": [
                {
                    "line": other.line(),
                    "cost": round(other.cost - reading.cost, 3),
                    "evidence": str(other.evidence),
                    "why": _why_worse(reading, other),
                }
                for other in reading.alternatives
            ],
        }
    return record


def _why_worse(reading: Reading, other: Reading) -> str:
    """Why another reading is less plausible than the chosen reading: because of the boxes' places, or because of names,
    units and usual values."""
    extra_cost, of_layout = other.cost - reading.cost, other.layout_cost - reading.layout_cost
    cause = (
        "because of the boxes' places" if of_layout > extra_cost / 2 else ("because of names, units and usual values")
    )
    return (
        f"less plausible {cause} (cost {reading.cost:.1f} against {other.cost:.1f})"
        if extra_cost > 0
        else "as plausible"
    )


def info_lines(infos: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The lines about files for the terminal."""
    for number, record in enumerate(infos):
        if number:
            yield ""
        yield from _lines(record)


def _lines(record: Mapping[str, Any]) -> Iterator[str]:
    counts = f"{count_text(record['plans'], 'plan')}, {count_text(record['boxes'], 'box', 'boxes')}"
    if record["orders"]:
        yield f"{record['file']}: orders, which have no places"
        yield _line("read", record["orders"].removeprefix("read as "))
        yield _line("pack them", f"petmjx samples --orders {record['file']} -o plans.json")
        return
    yield f"{record['file']}: {record['form']}; {counts}"
    if record["plans"]:
        size = " × ".join(three_digits(length) for length in record["largest_mm"])
        yield _line(
            "plans", f"{first_names(record['plan_ids'])}; up to {size} mm, {three_digits(record['mass_kg'])} kg in all"
        )
    reading = record["reading"]
    if reading is not None:
        yield _line("read", reading["line"].removeprefix("read as "))
        for line in reading["unread"][:_MOST_LINES]:
            yield _line("not read", line.removeprefix(NOT_READ))
        columns = ", ".join(f"{role} = {printable_name(name)}" for role, name in reading["columns"].items())
        yield _line("columns", columns)
        if reading["unused"]:
            yield _line("not used", first_names(reading["unused"], _MOST_NAMES))
        yield _line("evidence", reading["evidence"])
        if reading["alternatives"]:
            other = reading["alternatives"][0]
            yield _line("next best", f"{other['line'].removeprefix('read as ')}; {other['evidence']}; {other['why']}")
    for name in ("odd", "skipped"):
        for line in record[name][:_MOST_LINES]:
            yield _line(name, line.removeprefix(f"{record['file']}: "))
        if len(record[name]) > _MOST_LINES:
            yield _line(name, f"{len(record[name]) - _MOST_LINES:,} more")


def _line(name: str, text: str) -> str:
    return f"  {name:<{_WIDTH}}{text}"
