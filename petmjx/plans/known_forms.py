"""Known forms of other tools' lists of boxes (``KnownForm``, ``BoxSource``): what a form tells about units, coordinates
and sizes.

Sources of the forms: py3dbp's fork with a web API (github.com/jerry800416/3D-bin-packing), packingsolver's
certificates, 3d-bin-container-packing's placements, the solution file of D-Wave's example
(github.com/dwave-examples/3d-bin-packing), packvium's results.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from petmjx.common.text import count_text, printable_name
from petmjx.plans.cell_numbers import cell_number, cell_text
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS, PALLET_WORDS, plain_text, word_set, words_of
from petmjx.plans.header_and_total_rows import computed_row
from petmjx.plans.nested_fields import flattened
from petmjx.plans.pose_cells import with_pose_column
from petmjx.plans.raw_tables import BoxList, rows_by_name
from petmjx.plans.turn_columns import is_matrix


@dataclass(frozen=True, slots=True)
class KnownForm:
    """A form (the layout in which a tool writes boxes), and what is known about the meaning of its columns. If a field
    is empty, its value is unknown, and is later chosen by plausibility.

    Attributes:
        name: name of the form, in words.
        units: name of the unit of lengths (one of ``column_names.LENGTH_UNITS``).
        masses: name of the unit of masses (one of ``column_names.MASS_UNITS``).
        anchor: the point of a box that coordinates describe, such as "corner" or "centre".
        up: the vertical axis, "x", "y" or "z". If the form does not tell the anchor, heights may be counted
            downwards.
        sizes: which sizes of a box the columns have: "placed": the sizes as the box is placed; "item": the sizes before
            the box is turned.
        rule: how a column of rotations turns a box (a key of ``readings.ROTATION_RULES``).
    """

    name: str
    units: str = ""
    masses: str = ""
    anchor: str = ""
    up: str = ""
    sizes: str = ""
    rule: str = ""


@dataclass(frozen=True, eq=False)
class BoxSource:
    """The boxes of a file, before the meaning of their columns is known.

    Attributes:
        boxes: list of boxes with their places.
        form: the form of the list, with what the form states about units, coordinates and sizes.
        notes: lines for the user about how the file was read.
    """

    boxes: BoxList
    form: KnownForm
    notes: tuple[str, ...] = ()


MOST_BYTES: Final = 32 << 20
"""Largest size of a file of another tool, in bytes. A file of the largest size holds about 200,000 boxes. As Python
values, the boxes take ten times as much memory as the file."""

PY3DBP: Final = KnownForm("py3dbp", anchor="corner", rule="py3dbp", sizes="item")
_UPRIGHT: Final = KnownForm("", anchor="corner", up="z", sizes="placed")
PACKINGSOLVER: Final = replace(_UPRIGHT, name="packingsolver's certificate")
JAVA: Final = replace(_UPRIGHT, name="3d-bin-container-packing")
D_WAVE: Final = replace(_UPRIGHT, name="the solution of D-Wave's example")
PACKVIUM: Final = replace(_UPRIGHT, name="packvium's result")
BENCHMARK: Final = KnownForm("centres and dimensions as placed", anchor="centre", up="z", sizes="placed")
EB_AFIT: Final = KnownForm("3DContainerPacking", anchor="corner", up="y", sizes="placed")
SCENE: Final = KnownForm("a MuJoCo scene (MJCF)", "m", "kg", "centre", "z", "placed")
THREE_JS: Final = KnownForm("a three.js scene", anchor="centre", up="y", sizes="placed")
UNITY: Final = KnownForm("Unity", up="y")
GLTF: Final = KnownForm("a glTF scene", "m", anchor="centre", up="y", sizes="placed")
X3D: Final = replace(GLTF, name="an X3D scene", sizes="")
_OWN_NAMES: Final = frozenset(("plan_id", "sequence", "article", "orientation"))
"""Further columns of petmjx's tables. A table with petmjx's names for sizes, weights and coordinates counts as petmjx's
own only if it also has one of these columns. Tables of other tools may have the same names for sizes and
coordinates."""
OWN: Final = KnownForm("petmjx's table", "mm", "kg", "corner", "z", "item", "swap")
BED_BPP: Final = KnownForm("BED-BPP", anchor="corner", up="z", sizes="item", rule="swap")
_OF_CERTIFICATE: Final = frozenset(("type", "id", "bin", "lx", "ly", "lz"))
"""Columns of packingsolver's certificate."""
ARRAY: Final = KnownForm("an array of numbers", anchor="corner", up="z")
POSES: Final = KnownForm("poses", up="z")


def with_known_form(boxes: BoxList, kind: str = "JSON") -> BoxSource:
    """A list of boxes with the form that the names of its fields imply. Rows of totals are removed."""
    boxes, up = _without_totals(with_pose_column(boxes)), ""
    if not {name.lower() for name in boxes.table.header} >= _OF_CERTIFICATE:
        boxes, up = _by_pallet_rows(boxes)
    source = _with_form_of_names(boxes, kind)
    return replace(source, form=replace(source.form, up=up)) if up and not source.form.up else source


def _with_form_of_names(boxes: BoxList, kind: str) -> BoxSource:
    names = {name.lower() for name in boxes.table.header}
    plain = {re.sub(r"[^a-z0-9]", "", name) for name in names}
    around = {str(name).lower() for name in boxes.around}
    if names >= _OF_CERTIFICATE:
        return _certificate(boxes)
    if any(name.startswith("x'") or name.endswith("x'") for name in names):
        return _of_d_wave(boxes)
    if "stackable.dx" in names:
        return BoxSource(boxes, JAVA)
    if "rotationtype" in plain and (names & {"width", "whd[0]", "whd"}):
        boxes_only, left = _without_corner_posts(boxes)
        lines = (f"{count_text(left, 'corner post is', 'corner posts are')} left out",) if left else ()
        name = "py3dbp's web API" if "fititem" in boxes.path.lower() else f"py3dbp ({kind})"
        return BoxSource(boxes_only, replace(PY3DBP, name=name), lines)
    if {"item_type", "dimensions.length", "position.x", "orientation"} <= names:
        return BoxSource(boxes, PACKVIUM)
    if {"position.x", "rotation"} <= names and names & {"sku_id", "sku", "skuid"}:
        if {"dimensions.width", "dimensions.depth", "dimensions.height"} <= names and "container" in around:
            return BoxSource(boxes, BENCHMARK)
        if not boxes.has_sizes:
            return BoxSource(boxes, replace(BENCHMARK, name=f"centres of articles ({kind})", sizes=""))
    if {"coordx", "packdimx"} <= plain:
        return BoxSource(boxes, replace(EB_AFIT, name=f"{EB_AFIT.name} ({kind})"))
    if {"flb_coordinates[0]", "orientation"} <= names:
        return BoxSource(boxes, BED_BPP)
    if {"length_mm", "width_mm", "height_mm", "weight_kg", "x_mm", "y_mm", "z_mm"} <= names and names & _OWN_NAMES:
        return BoxSource(boxes, OWN)
    if not boxes.table.has_header:
        return BoxSource(boxes, replace(ARRAY, up=""))
    if any("localposition" in name or "localscale" in name for name in plain):
        return BoxSource(boxes, replace(UNITY, name=f"Unity ({kind})"))
    matrices = any(is_matrix(cell) for cell in boxes.table.rows[0]) if boxes.table.rows else False
    if matrices or any("matrix" in name or "pose" in name or "transform" in name for name in names):
        # boxes with a depth or a "transform" may come from a scene with y upwards, so the vertical stays unknown
        any_up = any(name.endswith("depth") or "transform." in name for name in names)
        return BoxSource(boxes, replace(POSES, up="") if any_up else POSES)
    return BoxSource(boxes, KnownForm(kind))


def with_named_units(source: BoxSource) -> BoxSource:
    """A list of boxes with the units that fields around it give, as in "units": {"length": "in", "weight": "lb"}."""
    words = {
        plain_text(value).strip(" .").lower()
        for name, value in flattened(source.boxes.around).items()
        if isinstance(value, str) and {"unit", "units"}.intersection(words_of(name))
    }
    lengths, masses = words & LENGTH_UNITS.keys(), words & MASS_UNITS.keys()
    form = source.form
    if len(lengths) == 1 and not form.units:
        form = replace(form, units=lengths.pop())
    if len(masses) == 1 and not form.masses:
        form = replace(form, masses=masses.pop())
    return replace(source, form=form)


def _without_totals(boxes: BoxList) -> BoxList:
    """Remove the last row of each part (plan) of a list if this row has the sums or means of the part's other rows."""
    table = boxes.table
    if not table.has_header:
        return boxes
    parts = [rows.tolist() for rows in rows_by_name(boxes.parts).values()]
    computed = {rows[-1]: what for rows in parts if (what := computed_row(table, rows))}
    if not computed:
        return boxes
    without_totals = rows_of(boxes, [index for index in range(len(table.rows)) if index not in computed])
    notes = [
        f"{table.places[index]} has {what} of the rows above it, and is left out" for index, what in computed.items()
    ]
    return replace(without_totals, table=replace(without_totals.table, notes=(*table.notes, *notes)))


_PALLET_RECORDS: Final = PALLET_WORDS - {"unit", "stop", "tote", "totes"}
_BOX_RECORDS: Final = word_set(
    "box case carton item parcel package piece karton kiste paket packstuck packung colis carton boite caja bulto "
    "scatola collo cartone paczka karton pudelko"
)
"""The words, in lower case and without accents, that mark a row of a list as a pallet (``_PALLET_RECORDS``) or as a box
(``_BOX_RECORDS``)."""


def _by_pallet_rows(boxes: BoxList) -> tuple[BoxList, str]:
    """Divide a list into plans by its rows of pallets. In such a list, the row of a pallet comes before the rows of the
    boxes on the pallet. A column has the type of each row: "PALLET", "BOX", "BOX", "PALLET", "BOX" … The rows of
    pallets are removed. A list without rows of pallets is returned unchanged. The function also returns the vertical
    axis that the places of pallets and boxes show ("y", "z"; "": none)."""
    table = boxes.table
    if not table.has_header or any(boxes.parts):
        return boxes, ""
    for index in range(len(table.header)):
        types = [cell_text(row[index]) for row in table.rows]
        words = [plain_text(name).lower() for name in types]
        pallets = [row for row, word in enumerate(words) if word in _PALLET_RECORDS]
        if not pallets or pallets[0] != 0 or not set(words) <= _PALLET_RECORDS | _BOX_RECORDS:
            continue
        last_of_pallet = [*(row - 1 for row in pallets[1:]), len(types) - 1]
        if any(map(int.__eq__, pallets, last_of_pallet)):
            continue  # a pallet would have no boxes, so this column does not show which rows are pallets
        numbers = [sum(pallet <= row for pallet in pallets) for row in range(len(types))]
        names = [_name_in(table.rows[row], index) or str(number) for number, row in enumerate(pallets, start=1)]
        if len(set(names)) < len(names):
            names = [str(number) for number in range(1, len(names) + 1)]
        kept = [row for row in range(len(types)) if row not in pallets]
        parts = tuple(names[numbers[row] - 1] for row in range(len(types)))
        containers = {name: _container_in(boxes, row) for name, row in zip(names, pallets, strict=True)}
        note = f"rows of type {printable_name(types[0])} in {printable_name(table.header[index])} are pallets"
        by_pallets = rows_of(replace(boxes, parts=parts, containers=containers), kept)
        up = _axis_above(boxes, dict(zip(pallets, last_of_pallet, strict=True)))
        return replace(by_pallets, table=replace(by_pallets.table, notes=(*table.notes, note))), up
    return boxes, ""


def _axis_above(boxes: BoxList, last_of_pallet: Mapping[int, int]) -> str:
    """The vertical axis, "y" or "z", as the places of pallets and boxes show it. Along the vertical axis, each box has
    a larger coordinate than its pallet. The result is "" if this is true of both axes, or of none.

    Args:
        last_of_pallet: row of a pallet → the last row of its boxes.
    """
    axes = []
    columns: dict[str, str] = {}
    for name, meaning in zip(boxes.table.header, boxes.meanings, strict=True):
        if meaning is not None and meaning.kind in ("position", "low"):
            columns.setdefault(meaning.axis, name)
    for axis in ("y", "z") if {"y", "z"} <= columns.keys() else ():
        cells = [cell_number(cell, boxes.table.decimal) for cell in boxes.table.column(columns[axis])]
        values = [np.nan if number is None else number.value for number in cells]
        if all(
            values[row] > values[pallet]
            for pallet, last in last_of_pallet.items()
            for row in range(pallet + 1, last + 1)
        ):
            axes.append(axis)
    return axes[0] if len(axes) == 1 else ""


def _name_in(row: Sequence[Any], but: int) -> str:
    """The first cell of a row that is a text and no number, except the cell at the index ``but``. The result is "" if
    there is no such cell."""
    cells = (cell for index, cell in enumerate(row) if index != but)
    return next((cell for cell in cells if isinstance(cell, str) and cell_number(cell) is None), "")


def _container_in(boxes: BoxList, row: int) -> Mapping[str, float]:
    """Axis → size of the deck, from the row of a pallet. The smallest of the three sizes is left out: it is the height
    of the pallet, and does not limit the load."""
    sizes = {}
    for index, meaning in enumerate(boxes.meanings):
        number = cell_number(boxes.table.rows[row][index], boxes.table.decimal)
        if meaning is not None and meaning.kind == "size" and number is not None and meaning.axis != "height":
            sizes[meaning.axis] = number.value
    if len(sizes) == 3:
        del sizes[min(sizes, key=sizes.__getitem__)]
    return sizes


def _without_corner_posts(boxes: BoxList) -> tuple[BoxList, int]:
    """Remove the posts that the fork of py3dbp puts into the corners of its container. The function also returns the
    number of removed posts."""
    kinds = boxes.table.column("type") if "type" in boxes.table.header else []
    box_rows = [index for index, kind in enumerate(kinds) if kind != "corner"]
    return (rows_of(boxes, box_rows), len(kinds) - len(box_rows)) if box_rows else (boxes, 0)


def rows_of(boxes: BoxList, kept: Sequence[int]) -> BoxList:
    """The same list of boxes, with only the rows at the indices ``kept``."""
    table = replace(
        boxes.table,
        rows=[boxes.table.rows[index] for index in kept],
        places=[boxes.table.places[index] for index in kept],
    )
    return replace(boxes, table=table, parts=tuple(boxes.parts[index] for index in kept))


def _certificate(boxes: BoxList) -> BoxSource:
    """The boxes of packingsolver's certificate. Rows of type "ITEM" are boxes. A row of type "BIN" stands for one or
    several equal containers; the column "COPIES" has their number."""
    table = boxes.table
    upper = {name.upper(): table.header.index(name) for name in table.header}
    kinds = [cell_text(row[upper["TYPE"]]).upper() for row in table.rows]
    items = [index for index, kind in enumerate(kinds) if kind not in ("BIN", "STACK")]
    containers: dict[str, Mapping[str, float]] = {}
    notes = []
    for row, kind in zip(table.rows, kinds, strict=True):
        if kind != "BIN":
            continue
        numbers = [cell_number(row[upper[name]], table.decimal) for name in ("LX", "LY", "LZ")]
        sizes = {axis: number.value for axis, number in zip("xyz", numbers, strict=True) if number is not None}
        if len(sizes) == 3:
            containers[cell_text(row[upper["BIN"]])] = sizes
        copies = cell_number(row[upper["COPIES"]]) if "COPIES" in upper else None
        if copies is not None and copies.value > 1:
            notes.append(
                f"container {cell_text(row[upper['BIN']])} stands for {copies.value:g} equal ones, and is read once"
            )
    if containers and all(sizes == next(iter(containers.values())) for sizes in containers.values()):
        containers = {"": next(iter(containers.values()))}
    item_boxes = rows_of(boxes, items)
    return BoxSource(replace(item_boxes, containers=containers), PACKINGSOLVER, tuple(notes))


def _of_d_wave(boxes: BoxList) -> BoxSource:
    """The boxes in the solution of D-Wave's example. The bins in such a file stand one behind the other along x, so the
    boxes of each bin are moved to x = 0."""
    table = boxes.table
    x = next((index for index, name in enumerate(table.header) if name.strip().lower() == "x"), None)
    bins = next((index for index, name in enumerate(table.header) if name.lower().startswith("bin")), None)
    if x is None or bins is None or len({row[bins] for row in table.rows}) < 2:
        return BoxSource(boxes, D_WAVE)
    numbers = [cell_number(row[x], table.decimal) for row in table.rows]
    values = np.array([np.nan if number is None else number.value for number in numbers])
    for in_bin in rows_by_name([row[bins] for row in table.rows]).values():
        values[in_bin] -= np.fmin.reduce(values[in_bin])
    moved = [row[x] if np.isnan(value) else value for row, value in zip(table.rows, values.tolist(), strict=True)]
    rows = [(*row[:x], cell, *row[x + 1 :]) for row, cell in zip(table.rows, moved, strict=True)]
    note = "bins stand one behind the other along x: each is moved to x = 0"
    return BoxSource(replace(boxes, table=replace(table, rows=rows)), D_WAVE, (note,))
