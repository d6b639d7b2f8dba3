"""Meanings of the columns of other tools' tables (``BoxColumns``): sizes, places, rotations, weights and names of
boxes.

In this module cells become numbers, and each bad cell becomes a line that names its row and column. The meaning of the
numbers (units, axes, anchors) is decided later (``petmjx.plans.readings``).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.column_names import (
    BASE_WORDS,
    LENGTH_UNITS,
    MASS_UNITS,
    ColumnMeaning,
    column_meanings,
    may_count,
    plain_text,
    word_set,
    words_of,
)
from petmjx.plans.known_forms import BED_BPP, BoxSource
from petmjx.plans.plan_fields import joined_names
from petmjx.plans.raw_cells import CellNumber, cell_number, cell_text, cell_triple, number_fault_of
from petmjx.plans.turn_columns import (
    Turns,
    angles_of,
    bad_member,
    is_matrix,
    is_rotation,
    letters_of,
    matrix_of,
    rotations_of_angles,
    rotations_of_quaternions,
    tilt,
    turns_of,
)

ROLES: Final = (
    "length", "width", "height", "depth", "x size", "y size", "z size", "x", "y", "z", "sizes", "position", "weight",
    "rotation", "plan", "sequence", "article", "item_id",
)  # fmt: skip
"""Roles that the option ``columns`` can assign to a column. ``sizes`` and ``position`` are three numbers in one
column."""
IGNORED: Final = "-"
"""If a user gives this instead of a column's name, no column has the role."""

_ON_AXES: Final = {"0": "x", "1": "y", "2": "z", "length": "x", "width": "y", "height": "z", "depth": "z"}
_XYZ: Final = ("x", "y", "z")
_WORDS: Final = ("length", "width", "height", "depth")
_SIZE_SETS: Final = (
    ("length", "width", "height"), ("width", "height", "depth"), ("length", "width", "depth"),
    ("length", "height", "depth"), _XYZ, ("0", "1", "2"),
)  # fmt: skip


_READ_CELLS: Final = 200
"""Number of cells of a column that are read to find its meaning."""
_NO_WEIGHT: Final = word_set(
    "max maximum limit capacity total load bears bearing strength allowed pallet palette container tare tara"
)
"""Words in names of columns whose masses are not the weights of boxes."""
GROSS: Final = word_set("gross brutto bruttogewicht bruto brut lordo")
"""Words for gross weights, which are preferred to net weights."""
_GOALS: Final = word_set("to bis top")
"""Words that mean far corners beside near ones ("from" and "to"), and otherwise any point of the box."""
_UNIT_WORDS: Final = word_set("unit units uom einheit masseinheit unite unites unidad unidades unita jednostka")
_SURE_UNITS: Final = frozenset(("mm", "cm", "kg", "lb", "lbs", "inch", "inches"))
"""Units that a column may have under any name. Others, such as "m" or "in", also have other meanings."""
_PICKED: Final = word_set("pick picked grasp source from")
"""Words in names of the places from which a robot takes boxes."""
_ORDER_WORDS: Final = frozenset(("order", "ordre", "orden", "ordine"))


def role_of(axis: str) -> str:
    """The role of a column that holds the sizes along this axis (one of ``Geometry.axes``)."""
    return {"0": "1st size", "1": "2nd size", "2": "3rd size"}.get(axis, axis if axis in _WORDS else f"{axis} size")


@dataclass(frozen=True, eq=False)
class Geometry:
    """Sizes and places of boxes in the file's units, for one choice of columns.

    Attributes:
        size: (n, 3) sizes in the order of ``axes``; NaN if a cell is bad.
        place: (n, 3) coordinates along the file's first, second and third axis; NaN if a cell is bad.
        axes: names of the axes of the sizes: words, or x, y, z, or "0", "1", "2" if they have no names.
        size_unit, place_unit: unit according to names or cells; "": none is given.
        anchor: the point of a box according to the names; "": none is given.
        placed: whether the sizes are known to be those of the box as placed.
        columns: role → name of its column.
        prior: how unlikely this choice of columns is, before any numbers are considered; 0: usual.
        turn: (n, 3, 3) rotations of poses; None: no poses.
        named_up: the vertical axis according to the names of places; "": none is given.
    """

    size: FloatArray
    place: FloatArray
    axes: tuple[str, str, str]
    size_unit: str = ""
    place_unit: str = ""
    anchor: str = ""
    placed: bool = False
    columns: Mapping[str, str] = field(default_factory=dict)
    prior: float = 0.0
    turn: FloatArray | None = None
    named_up: str = ""


@dataclass(frozen=True, eq=False)
class BoxColumns:
    """The boxes of a source, by column.

    Attributes:
        source: where the boxes come from.
        geometries: possible choices of columns for sizes and places.
        turns: rotations; None: no column has rotations.
        weight: (n,) weights in the file's unit; None: no column has weights.
        weight_unit: unit according to the name or the cells; "": none is given.
        weight_is_density: whether ``weight`` is a density, relative to water or in kg/m³.
        plan, article, item_id, group: (n,) names; None: no column has them.
        sequence: (n,) packing order; None: no column has it. A column of running numbers is not taken as a packing
            order, since boxes may be numbered in any order.
        counters: columns of whole numbers that may be a packing order because of their names ("Nr", "Pick"): name →
            (n,) numbers; NaN for cells that are not whole numbers.
        columns: role → name of its column, for all roles except sizes and places.
        faults: row → (column, error text) of the first bad cell in the row.
        unread: names of columns that are not used.
        unit_columns: names of columns whose cells are units of the numbers in other columns.
    """

    source: BoxSource
    geometries: list[Geometry]
    turns: Turns | None
    weight: FloatArray | None
    weight_unit: str
    weight_is_density: bool
    plan: list[str] | None
    article: list[str] | None
    item_id: list[str] | None
    group: list[str] | None
    sequence: FloatArray | None
    counters: Mapping[str, FloatArray]
    columns: Mapping[str, str]
    faults: Mapping[int, tuple[str, str]]
    unread: tuple[str, ...]
    unit_columns: tuple[str, ...]

    @property
    def n_boxes(self) -> int:
        return len(self.source.boxes.table.rows)


class Extraction:
    """The columns of one source, while their meanings are being determined."""

    def __init__(self, source: BoxSource, chosen: Mapping[str, str], units: str = "", masses: str = "") -> None:
        self.source = source
        self.units, self.masses = units, masses
        self.table = source.boxes.table
        self.faults: dict[int, tuple[str, str]] = {}
        self.meanings = column_meanings(self.table.header)
        if source.form.name == "packingsolver's certificate":
            upper = {name.upper(): index for index, name in enumerate(self.table.header)}
            self.meanings[upper["ID"]] = ColumnMeaning("article")
            self.meanings[upper["TYPE"]] = None
            self.meanings[upper.get("COPIES", upper["TYPE"])] = None
        if source.form == BED_BPP:  # in this form, item.sequence counts the order's items
            self.meanings = [
                None if meaning is not None and meaning.kind == "sequence" else meaning for meaning in self.meanings
            ]
        eulers = [index for index, meaning in enumerate(self.meanings) if meaning and meaning.kind == "euler"]
        if len(eulers) == 1:  # "rot_z" alone: the box turns about the vertical
            self.meanings[eulers[0]] = ColumnMeaning("rotation")
        self._mean_by_cells()
        self.fixed: dict[str, int] = {}
        for role, name in chosen.items():
            if role not in ROLES:
                raise InputError(f"columns: unknown {printable_name(role)}; there are {', '.join(ROLES)}")
            if name == IGNORED:
                self.meanings = [
                    None if meaning is not None and _role_of(meaning) == role else meaning for meaning in self.meanings
                ]
                continue
            if name not in self.table.header:
                names = ", ".join(map(printable_name, self.table.header[:20]))
                raise InputError(f"has no column {printable_name(name)} ({role}); there are {names}")
            self.fixed[role] = self.table.header.index(name)

    def _mean_by_cells(self) -> None:
        """Meanings that cells show. An order without a number is the customer's order. Cells with a unit of mass are
        weights, and cells that name the sizes along the axes are rotations, whatever the name of their column."""
        self.row_units: dict[bool, list[str]] = {}
        self.unit_columns: list[str] = []
        if not self.table.has_header:
            return
        kinds = {meaning.kind for meaning in self.meanings if meaning is not None}
        for index, meaning in enumerate(self.meanings):
            cells = [row[index] for row in self.table.rows[:_READ_CELLS] if row[index] not in (None, "")]
            if not cells:
                continue
            if self._has_units(index, cells):
                self.meanings[index] = None
                self.unit_columns.append(self.table.header[index])
            elif meaning is not None:
                of_order = meaning.kind == "sequence" and _ORDER_WORDS.intersection(words_of(self.table.header[index]))
                numbers = [number.value for cell in cells if (number := cell_number(cell, self.table.decimal))]
                if of_order and "plan" not in kinds and len(set(numbers)) * 2 <= len(cells):
                    self.meanings[index] = ColumnMeaning("plan")
            elif (
                "weight" not in kinds
                and all(map(self._is_mass, cells))
                and not _NO_WEIGHT.intersection(words_of(self.table.header[index]))
            ):
                self.meanings[index] = ColumnMeaning("weight")
            elif "rotation" not in kinds and len({*map(cell_text, cells)}) > 1 and all(map(letters_of, cells)):
                self.meanings[index] = ColumnMeaning("rotation")

    def _has_units(self, index: int, cells: Sequence[Any]) -> bool:
        """Whether a column, whose first cells are given, has units. If so, they become the units of the rows, or, if
        all are the same, the units of the form."""
        for units in (LENGTH_UNITS, MASS_UNITS):
            sure = units.keys() if _UNIT_WORDS.intersection(words_of(self.table.header[index])) else _SURE_UNITS
            if not all(isinstance(cell, str) and _as_unit(cell) in units.keys() & sure for cell in cells):
                continue
            texts = [_as_unit(cell_text(cell)) for cell in self.cells(index)]
            form, is_mass = self.source.form, units is MASS_UNITS
            if len(set(texts)) > 1:
                self.row_units.setdefault(is_mass, texts)
            elif is_mass:
                self.source = replace(self.source, form=replace(form, masses=form.masses or texts[0]))
            else:
                self.source = replace(self.source, form=replace(form, units=form.units or texts[0]))
            return True
        return False

    def _is_mass(self, cell: Any) -> bool:
        number = cell_number(cell, self.table.decimal)
        return number is not None and number.unit in MASS_UNITS

    # Cells.

    def cells(self, index: int) -> list[Any]:
        return [row[index] for row in self.table.rows]

    def bad(self, row: int, index: int, text: str) -> None:
        self.faults.setdefault(row, (self.table.header[index], text))

    def numbers(self, index: int, units: Mapping[str, float]) -> tuple[FloatArray, str]:
        """(n,) numbers of a column, NaN if a cell is bad. Also returns the unit according to the column's name or cells
        ("": none is given)."""
        rows: list[Sequence[CellNumber]] = []
        for row, cell in enumerate(self.cells(index)):
            number = cell_number(cell, self.table.decimal)
            rows.append(())
            if number is None or not np.isfinite(number.value):
                text = number_fault_of(cell, self.table.decimal)
                self.bad(row, index, text if number is None else f"must be finite, got {number.value}")
            elif number.unit and number.unit not in units:
                self.bad(row, index, f"has the unit {number.unit}, which is none of {joined_names(sorted(units))}")
            else:
                rows[row] = (number,)
        values, unit = self._in_one_unit(index, rows, units, 1)
        return values[:, 0], unit

    def triples(self, index: int) -> tuple[FloatArray, str]:
        """(n, 3) numbers of a column with three numbers per cell. Also returns their unit."""
        rows: list[Sequence[CellNumber]] = []
        for row, cell in enumerate(self.cells(index)):
            triple = cell_triple(cell, self.table.decimal)
            finite = triple is not None and all(np.isfinite(number.value) for number in triple)
            rows.append(triple if triple is not None and finite else ())
            if not finite:
                kind = "three numbers" if triple is None else "three finite numbers"
                shown = "is missing" if cell in (None, "") else f'must be {kind}, got "{printable_name(str(cell))}"'
                self.bad(row, index, shown)
        return self._in_one_unit(index, rows, LENGTH_UNITS, 3)

    def _in_one_unit(
        self, index: int, rows: Sequence[Sequence[CellNumber]], units: Mapping[str, float], width: int
    ) -> tuple[FloatArray, str]:
        """(n, width) numbers of a column, NaN for rows without numbers. Also returns their unit ("": none is given).

        A number without a unit gets the unit that the column's name, an option or the form gives. If none of them gives
        a unit, but other cells of the column have units, the number is bad, since the unit of one cell does not imply
        the unit of another cell. Zero needs no unit.
        """
        values = np.full((len(rows), width), np.nan)
        is_mass = "kg" in units
        if is_mass in self.row_units and units in (LENGTH_UNITS, MASS_UNITS):
            rows = [
                [number if number.unit else number._replace(unit=unit) for number in numbers]
                for numbers, unit in zip(rows, self.row_units[is_mass], strict=True)
            ]
        meaning, form = self.meanings[index], self.source.form
        of_name = meaning.unit if meaning is not None and meaning.unit in units else ""
        wish = self.masses if is_mass else self.units
        wish = wish if wish in units else ""
        written = {number.unit for numbers in rows for number in numbers if number.unit in units} - {""}
        usual = of_name or wish or (form.masses if is_mass else form.units)
        target = wish or ("kg" if is_mass else "mm")  # an option sets the unit of all numbers of the file
        for row, numbers in enumerate(rows):
            if not numbers:
                continue
            values[row] = [number.value for number in numbers]
            if not written:
                continue
            lacking = [number.value for number in numbers if number.value and number.unit not in units]
            if lacking and not usual:
                self.bad(row, index, f"has no unit, unlike other rows, got {lacking[0]:g}")
                continue
            factors = [units[number.unit if number.unit in units else usual or target] for number in numbers]
            values[row] *= np.array(factors) / units[target]
        return values, target if written else of_name

    def joined(self, indices: Sequence[int]) -> tuple[FloatArray, str]:
        """(n, 3) numbers of three columns, converted to the same unit."""
        parts = [self.numbers(index, LENGTH_UNITS) for index in indices]
        units = {unit for _, unit in parts if unit}
        if len(units) <= 1:
            return np.stack([values for values, _ in parts], axis=1), next(iter(units), "")
        return np.stack([values * LENGTH_UNITS.get(unit, 1.0) for values, unit in parts], axis=1), "mm"

    # Geometry.

    def columns_of(self, *kinds: str) -> dict[str, list[int]]:
        """Axis → the columns for this axis that describe boxes and whose meaning is of one of these kinds."""
        by_axis: dict[str, list[int]] = {}
        for index, meaning in enumerate(self.meanings):
            if meaning is not None and meaning.kind in kinds and not meaning.of_container:
                by_axis.setdefault(meaning.axis, []).append(index)
        return by_axis

    def size_choices(self) -> list[tuple[FloatArray, tuple[str, str, str], str, bool, dict[str, str]]]:
        """(sizes, axes, unit, placed, columns) for each possible choice of columns for the sizes."""
        header = self.table.header
        if "sizes" in self.fixed:
            values, unit = self.triples(self.fixed["sizes"])
            return [(values, ("0", "1", "2"), unit, False, {"sizes": header[self.fixed["sizes"]]})]
        chosen_columns = {axis: self.fixed[role_of(axis)] for axis in (*_WORDS, *_XYZ) if role_of(axis) in self.fixed}
        sizes = {axis: list(columns) for axis, columns in self.columns_of("size").items()}
        for role, index in chosen_columns.items():
            sizes[role] = [index]
        choices = []
        for placed in (True, False):
            for axes in _SIZE_SETS:
                picked = [
                    [index for index in sizes.get(axis, ()) if self._placed(index) == placed or axis in chosen_columns]
                    for axis in axes
                ]
                if not all(picked):
                    continue
                for indices in _same_prefix(header, picked):
                    values, unit = self.joined(indices)
                    factor = 2.0 if any(self._half(index) for index in indices) else 1.0
                    columns = {role_of(axis): header[index] for axis, index in zip(axes, indices, strict=True)}
                    choices.append((values * factor, axes, unit, placed, columns))
                if choices:
                    return choices
        for index, meaning in enumerate(self.meanings):
            if meaning is not None and meaning.kind == "sizes" and not meaning.of_container:
                values, unit = self.triples(index)
                order = meaning.order if len(meaning.order) == 3 else ("0", "1", "2")
                factor = 2.0 if meaning.half else 1.0
                choices.append((values * factor, order, unit, meaning.placed, {"sizes": header[index]}))
        return choices[:1]

    def _placed(self, index: int) -> bool:
        meaning = self.meanings[index]
        return meaning is not None and meaning.placed

    def _half(self, index: int) -> bool:
        meaning = self.meanings[index]
        return meaning is not None and meaning.half

    def place_choices(self) -> list[tuple[FloatArray, str, str, dict[str, str], str]]:
        """(places, unit, anchor, columns, vertical axis) for each possible choice of columns for the places, most
        certain first."""
        header = self.table.header
        if "position" in self.fixed:
            values, unit = self.triples(self.fixed["position"])
            return [(values, unit, "", {"position": header[self.fixed["position"]]}, "")]
        chosen_columns = [self.fixed.get(axis) for axis in _XYZ]
        if all(index is not None for index in chosen_columns):
            indices = [index for index in chosen_columns if index is not None]
            values, unit = self.joined(indices)
            return [(values, unit, "", {axis: header[index] for axis, index in zip(_XYZ, indices, strict=True)}, "")]
        choices = []
        by_anchor: dict[str, dict[str, list[int]]] = {}
        for index, meaning in enumerate(self.meanings):
            if meaning is None or meaning.kind not in ("position", "low") or meaning.of_container:
                continue
            anchor = meaning.anchor or ("corner" if meaning.kind == "low" else "")
            axis = _ON_AXES.get(meaning.axis, meaning.axis)
            by_anchor.setdefault(anchor, {}).setdefault(axis, []).append(index)
        heights = [
            index for index in by_anchor.get("", {}).get("z", ()) if BASE_WORDS.intersection(words_of(header[index]))
        ]
        for anchor in ("centre", "base-centre"):  # "center_x", "center_y" and "bottom_z"
            if heights and by_anchor.get(anchor, {}).keys() == {"x", "y"}:
                by_anchor["base-centre"] = {**by_anchor.pop(anchor), "z": heights}
        for anchor, by_axis in sorted(by_anchor.items(), key=lambda entry: entry[0] == ""):
            for role in _XYZ:
                if role in self.fixed:
                    by_axis[role] = [self.fixed[role]]
            if not all(axis in by_axis for axis in _XYZ):
                continue
            for chosen in _same_prefix(header, _without_picks(header, [by_axis[axis] for axis in _XYZ])):
                values, unit = self.joined(chosen)
                words = {meaning.axis for index in chosen if (meaning := self.meanings[index]) is not None}
                up = "z" if "height" in words else ""
                columns = {axis: header[index] for axis, index in zip(_XYZ, chosen, strict=True)}
                choices.append((values, unit, anchor, columns, up))
                break
        for index, meaning in enumerate(self.meanings):
            if meaning is not None and meaning.kind == "positions" and not choices:
                values, unit = self.triples(index)
                choices.append((values, unit, meaning.anchor, {"position": header[index]}, ""))
        if not choices:  # the far corners, and sizes instead of the near ones
            far = {_ON_AXES.get(axis, axis): columns[0] for axis, columns in self.columns_of("high").items()}
            if all(axis in far for axis in _XYZ):
                values, unit = self.joined([far[axis] for axis in _XYZ])
                columns = {axis: header[far[axis]] for axis in _XYZ}
                is_goal = any(_GOALS.intersection(words_of(name)) for name in columns.values())
                choices.append((values, unit, "" if is_goal else "far-corner", columns, ""))
        return choices[:1]

    def corner_choices(self) -> list[Geometry]:
        """Geometries from two corners of each box: the corner with the smallest and the corner with the largest
        coordinates."""
        header = self.table.header
        ends = [self.columns_of(kind) for kind in ("low", "position", "edge1", "edge2", "high")]
        low, plain, first, second, high = ends
        pairs = [(low, high), (first, second), (low, first), (plain, high), (plain, second)]
        for begins, finishes in pairs:
            begin = {_ON_AXES.get(axis, axis): columns for axis, columns in begins.items()}
            finish = {_ON_AXES.get(axis, axis): columns for axis, columns in finishes.items()}
            if not all(axis in begin and axis in finish for axis in _XYZ):
                continue
            lows = [begin[axis][0] for axis in _XYZ]
            highs = [finish[axis][0] for axis in _XYZ]
            corner, unit = self.joined(lows)
            far_corner, far_unit = self.joined(highs)
            if unit != far_unit:
                corner, far_corner = (
                    values * LENGTH_UNITS.get(name, 1.0) for values, name in ((corner, unit), (far_corner, far_unit))
                )
                unit = "mm"
            columns = {axis: header[index] for axis, index in zip(_XYZ, lows, strict=True)}
            columns |= {f"{axis} (far)": header[index] for axis, index in zip(_XYZ, highs, strict=True)}
            size = far_corner - corner
            for row in np.flatnonzero((size <= 0).any(axis=1)):
                axis = int(np.flatnonzero(size[row] <= 0)[0])
                self.bad(int(row), highs[axis], f"must be beyond {header[lows[axis]]}, got {far_corner[row, axis]:g}")
                size[row] = np.nan
            return [Geometry(size, corner, _XYZ, unit, unit, "corner", True, columns)]
        return []

    def pose_choices(self) -> list[Geometry]:
        """Geometries from matrices, or from positions and rotations."""
        header = self.table.header
        sizes = self.size_choices()
        if not sizes:
            return []
        size, axes, unit, _, columns = sizes[0]
        matrix = next(
            (index for index in range(len(header)) if any(is_matrix(row[index]) for row in self.table.rows[:3])), None
        )
        if matrix is not None:
            rotations, places = np.full((len(size), 3, 3), np.nan), np.full((len(size), 3), np.nan)
            for row, cell in enumerate(self.cells(matrix)):
                array = matrix_of(cell)
                if array is None:
                    self.bad(row, matrix, f"must be a 4×4 matrix of numbers{bad_member(cell)}")
                else:
                    rotations[row], places[row] = array[:3, :3], array[:3, 3]
            columns = {**columns, "pose": header[matrix]}
            return [self._pose(size, places, axes, unit, unit, rotations, columns, matrix, "")]
        options = self._quaternions() or self._angles() or self._turning_matrices()
        places_of = self.place_choices() if options else []
        if not places_of:
            return []
        place, place_unit, anchor, place_columns, _ = places_of[0]
        tilted = [int((tilt(rotation) > _LEVEL).sum()) for rotation, *_ in options]
        return [
            replace(
                self._pose(
                    size, place, axes, unit, place_unit, rotation, columns | place_columns | named, index, anchor
                ),
                prior=0.4 * number,
            )
            for number, (rotation, named, index) in enumerate(options)
            if tilted[number] == min(tilted)
        ]

    def _quaternions(self) -> list[_Rotations]:
        """Rotations by quaternions, if there are any. In a list without names, w may be the first or the last one."""
        header = self.table.header
        named, turned = self.columns_of("quaternion"), self.columns_of("rotation")
        if "w" in named:
            named = {**self.columns_of("euler"), **named}
        elif "3" in turned:
            named = turned
        components = [named.get(axis, [None])[0] for axis in ("w", "x", "y", "z")]
        listed = [named.get(str(axis), [None])[0] for axis in range(4)]
        orders = (
            [components] if None not in components else [listed, [listed[3], *listed[:3]]] if None not in listed else []
        )
        rotations = []
        for number, order in enumerate(orders):
            indices = [index for index in order if index is not None]
            values = np.stack([self.numbers(index, LENGTH_UNITS)[0] for index in indices], axis=1)
            columns = _roles("quaternion", [header[index] for index in indices])
            columns |= {"order of quaternions": "x, y, z, w"} if number == 1 else {}
            rotations.append((rotations_of_quaternions(values), columns, indices[0]))
        return rotations

    def _angles(self) -> list[_Rotations]:
        """Rotations by angles about at least two of the axes, if there are any: "rx", "ry" and "rz"; roll, pitch and
        yaw; lists of three."""
        named = {axis: columns[0] for axis, columns in self.columns_of("euler").items()}
        quaternions, turned = self.columns_of("quaternion"), self.columns_of("rotation")
        listed = turned if {*"012"} <= turned.keys() else quaternions if {*"012"} <= quaternions.keys() else {}
        if listed:
            named = {axis: listed[str(number)][0] for number, axis in enumerate(_XYZ)}
        elif {*_XYZ} <= quaternions.keys():  # "orientation.x" without a w
            named = {axis: quaternions[axis][0] for axis in _XYZ}
        elif named and "z" not in named:
            yaws = [index for index in turned.get("", ()) if "yaw" in words_of(self.table.header[index])]
            if yaws:
                named["z"] = yaws[0]
        if len(named) < 2:
            return []
        indices = list(named.values())
        angles = np.zeros((len(self.table.rows), 3))
        angles[:, [_XYZ.index(axis) for axis in named]] = angles_of(
            [self.cells(index) for index in indices], self.table.decimal
        )
        for row, axis in np.argwhere(np.isnan(angles)).tolist():
            index = named[_XYZ[axis]]
            self.bad(row, index, number_fault_of(self.table.rows[row][index], self.table.decimal))
        columns = _roles("angle", [self.table.header[index] for index in indices])
        return [
            (rotation, {**columns, **({"order of angles": "z, y, x"} if number else {})}, indices[0])
            for number, rotation in enumerate(rotations_of_angles(angles))
        ]

    def _turning_matrices(self) -> list[_Rotations]:
        """Rotations by matrices (3, 3), if there are any."""
        rows = self.table.rows
        index = next(
            (index for index in range(len(self.table.header)) if any(is_rotation(row[index]) for row in rows[:3])), None
        )
        if index is None:
            return []
        rotations = np.full((len(rows), 3, 3), np.nan)
        for row, cell in enumerate(self.cells(index)):
            try:
                rotations[row] = np.array(cell, float)
            except (TypeError, ValueError):
                self.bad(row, index, f"must be a 3×3 matrix of numbers{bad_member(cell)}")
        return [(rotations, {"rotation": self.table.header[index]}, index)]

    def _pose(
        self,
        size: FloatArray,
        place: FloatArray,
        axes: tuple[str, str, str],
        size_unit: str,
        place_unit: str,
        rotation: FloatArray,
        columns: dict[str, str],
        index: int,
        anchor: str,
    ) -> Geometry:
        """A geometry from poses. Boxes whose rotation is not a multiple of right angles are refused."""
        for row in np.flatnonzero(tilt(rotation) > _LEVEL):
            degrees = np.degrees(np.arccos(np.clip(np.abs(rotation[row]).max(axis=1).min(), 0, 1)))
            self.bad(
                int(row), index, f"is turned by {degrees:.3g}° out of right angles: only level boxes at right angles"
            )
        return Geometry(size, place, axes, size_unit, place_unit, anchor, True, columns, turn=np.abs(np.rint(rotation)))

    def array_choices(self) -> list[Geometry]:
        """Geometries of columns without names. The first columns may be sizes or places, or the columns may be two
        corners."""
        header, width = self.table.header, len(self.table.header)
        starts = [start for start in (0, 1) if width >= start + 6]
        geometries = []
        for start in starts:
            names = header[start : start + 6]
            values = np.stack([self._quiet(start + offset) for offset in range(6)], axis=1)
            first, second = values[:, :3], values[:, 3:]
            prior = 0.8 * start
            is_size = [_mostly(np.asarray((part > 0).all(axis=1))) for part in (first, second)]
            are_ends = _mostly(np.asarray((second > first).all(axis=1)))
            listed = tuple(map(role_of, "012"))
            columns = dict(zip((*listed, *_XYZ), names, strict=True))
            if is_size[0]:
                geometries.append(Geometry(first, second, ("0", "1", "2"), columns=columns, prior=prior))
            if is_size[1]:
                swapped = dict(zip((*_XYZ, *listed), names, strict=True))
                geometries.append(Geometry(second, first, ("0", "1", "2"), columns=swapped, prior=prior + 0.4))
            if are_ends:
                ends = dict(zip((*_XYZ, *(f"{axis} (far)" for axis in _XYZ)), names, strict=True))
                corners = Geometry(second - first, first, _XYZ, "", "", "corner", True, ends, prior + 0.2)
                geometries.append(corners)
        for name in geometries[0].columns.values() if geometries else ():
            self.numbers(header.index(name), LENGTH_UNITS)  # called only to report bad cells under the column's name
        return geometries

    def array_extras(self, geometries: Sequence[Geometry]) -> tuple[Turns | None, int | None, bool]:
        """Interpret the further columns without names. Returns rotations, the column of weights, and whether the
        weights are densities.

        A column of whole numbers from 0 to 5 holds rotations. A column of numbers up to ``_DENSEST`` holds densities
        relative to water. A column of larger numbers holds weights.
        """
        header = self.table.header
        used = {header.index(name) for name in geometries[0].columns.values()} if geometries else set()
        turns, weight, is_density = None, None, False
        for index in range(max(used, default=-1) + 1, len(header)):
            values = self._quiet(index)
            is_integer = bool((values == np.rint(values)).all())
            if is_integer and values.min() >= 0 and values.max() <= 5:
                if values.max() > 0 and turns is None:
                    rules = ("swap", "py3dbp") if values.max() <= 1 else ("py3dbp",)
                    turns = Turns(header[index], rules, values.astype(np.int64))
            elif weight is None and _mostly(values > 0):
                weight, is_density = index, bool(values.max() <= _DENSEST)
        return turns, weight, is_density

    def _quiet(self, index: int) -> FloatArray:
        numbers = [cell_number(cell, self.table.decimal) for cell in self.cells(index)]
        values = np.array([np.nan if number is None else number.value for number in numbers])
        with np.errstate(invalid="ignore"):
            return np.where(np.isnan(values), np.nanmedian(values) if np.isfinite(values).any() else 1.0, values)

    # Other columns.

    def texts(self, *kinds: str, role: str = "") -> tuple[list[str] | None, str]:
        """(n,) names in the first column of these kinds, and the column's name."""
        index = self.fixed.get(role)
        if index is None:
            index = next(
                (
                    number
                    for kind in kinds
                    for number, meaning in enumerate(self.meanings)
                    if meaning is not None and meaning.kind == kind and number not in self.fixed.values()
                ),
                None,
            )
        if index is None:
            return None, ""
        return [cell_text(cell) for cell in self.cells(index)], self.table.header[index]

    def filled_down(self, names: list[str] | None, column: str, least_rows: float = 1.0) -> list[str] | None:
        """(n,) the name of the plan or order of each row. Blank cells below a name, as in sheets with merged cells, get
        this name. If there are blank cells, each name must occur only once, in the first row of its block.

        Args:
            names: texts of the cells; None: there is no column.
            column: name of the column.
            least_rows: a column with fewer rows per name in the mean is not changed.

        Raises:
            InputError: there are blank cells that cannot be filled in this manner.
        """
        if names is None or "" not in names or not any(names):
            return names
        written = [name for name in names if name]
        if len(set(written)) * least_rows > len(names) + 2:
            return names
        parts = self.source.boxes.parts or ("",) * len(names)
        filled_names: list[str] = []
        for row, (name, part) in enumerate(zip(names, parts, strict=True)):
            begins = row == 0 or part != parts[row - 1]
            if not name and (begins or len(set(written)) < len(written)):
                raise InputError(f"{self.table.places[row]}: {printable_name(column)} is missing")
            filled_names.append(name or filled_names[-1])
        self.source = replace(self.source, notes=(*self.source.notes, f"{printable_name(column)} filled down"))
        return filled_names

    def first(self, kind: str, role: str = "") -> int | None:
        if role in self.fixed:
            return self.fixed[role]
        return next(
            (
                index
                for index, meaning in enumerate(self.meanings)
                if meaning is not None and meaning.kind == kind and not meaning.of_container
            ),
            None,
        )

    def weights(self) -> int | None:
        """The column of weights: that of gross weights if there are several."""
        if "weight" in self.fixed:
            return self.fixed["weight"]
        gross = [
            number
            for number, meaning in enumerate(self.meanings)
            if meaning is not None
            and meaning.kind == "weight"
            and not meaning.of_container
            and GROSS.intersection(words_of(self.table.header[number]))
        ]
        return gross[0] if gross else self.first("weight")

    def counters(self, used: Collection[str]) -> dict[str, FloatArray]:
        """Unused columns of whole numbers whose names could mean a packing order."""
        columns: dict[str, FloatArray] = {}
        for index, name in enumerate(self.table.header):
            if name in used or not may_count(name):
                continue
            numbers = [cell_number(cell, self.table.decimal) for cell in self.cells(index)]
            values = np.array([np.nan if number is None or number.unit else number.value for number in numbers])
            with np.errstate(invalid="ignore"):
                columns[name] = np.where(values == np.rint(values), values, np.nan)
        return columns

    def turns(self) -> Turns | None:
        """The column of rotations."""
        index = self.first("rotation", "rotation")
        if index is None:
            return None
        return turns_of(
            self.table.header[index],
            self.cells(index),
            self.table.decimal,
            lambda row, text: self.bad(row, index, text),
        )


_Rotations = tuple[FloatArray, dict[str, str], int]
"""(n, 3, 3) rotation matrices; role → name of its column; the column that is named in errors."""
_DENSEST: Final = 1.5
"""Largest density, relative to water, in a column without a name. No carton reaches this density."""
_LEVEL: Final = 2e-3
"""Largest deviation of a rotation matrix from right angles: 3.6°. Poses are written with three digits."""


_MOST_SOUND: Final = 0.9
"""In a table without a header, at least this share of the rows must match the guessed meaning of a column. Rows that do
not match have bad cells."""


def _mostly(rows: NDArray[np.bool_]) -> bool:
    sound = int(np.count_nonzero(rows))
    return sound >= _MOST_SOUND * len(rows) or sound >= len(rows) - 1 > 1


def _role_of(meaning: ColumnMeaning) -> str:
    if meaning.kind == "size":
        return role_of(meaning.axis)
    return meaning.axis if meaning.kind == "position" else {"positions": "position"}.get(meaning.kind, meaning.kind)


def _roles(role: str, names: Sequence[str]) -> dict[str, str]:
    """Role → name of its column, for columns that have one role together. Members of a list have one name."""
    names = list(dict.fromkeys(name.rpartition("[")[0] or name for name in names))
    return {role if number == 1 else f"{role} ({number})": name for number, name in enumerate(names, start=1)}


def _same_prefix(header: Sequence[str], picked: Sequence[Sequence[int]]) -> list[tuple[int, ...]]:
    """Three columns that belong to the same object, such as ``dimensions.length``, ``dimensions.width`` and
    ``dimensions.height``. If there are no three such columns, the first column of each size."""
    by_prefix: dict[str, list[int]] = {}
    for number, columns in enumerate(picked):
        for index in columns:
            by_prefix.setdefault(header[index].rpartition(".")[0], [-1] * len(picked))
            slots = by_prefix[header[index].rpartition(".")[0]]
            slots[number] = index if slots[number] < 0 else slots[number]
    full_triples = [tuple(slots) for slots in by_prefix.values() if -1 not in slots]
    return full_triples[:1] or [tuple(columns[0] for columns in picked)]


def _as_unit(text: str) -> str:
    return plain_text(text).strip(" .").lower()


def _without_picks(header: Sequence[str], picked: Sequence[Sequence[int]]) -> list[list[int]]:
    """The columns for each coordinate, without the places from which a robot takes boxes if there are others."""
    others = [[index for index in columns if not _PICKED.intersection(words_of(header[index]))] for columns in picked]
    return others if all(others) else [list(columns) for columns in picked]


def box_columns(
    source: BoxSource, chosen: Mapping[str, str] | None = None, units: str = "", masses: str = ""
) -> BoxColumns:
    """Determine the columns of a source by their meanings.

    Args:
        chosen: role (``ROLES``) → name of the column that has it, or "-".
        units, masses: unit of all lengths and of all masses that an option sets; "": no option.

    Raises:
        InputError: a chosen column does not exist. If places or sizes are missing, ``geometries`` is empty instead.
    """
    work = Extraction(source, chosen or {}, units, masses)
    turns = None
    geometries = work.pose_choices() if source.boxes.table.has_header else work.array_choices()
    if source.boxes.table.has_header and not geometries:
        places, sizes = work.place_choices(), work.size_choices()
        for size, axes, size_unit, placed, columns in sizes:
            for place, place_unit, anchor, more, up in places:
                if size_unit and place_unit and size_unit != place_unit:
                    size = size * LENGTH_UNITS[size_unit]
                    place = place * LENGTH_UNITS[place_unit]
                    size_unit = place_unit = "mm"
                geometries.append(
                    Geometry(size, place, axes, size_unit, place_unit, anchor, placed, {**columns, **more}, named_up=up)
                )
        if not geometries:
            geometries = work.corner_choices()
        turns = work.turns()
    weight_index = work.weights()
    density_index = work.first("density") if weight_index is None else None
    if not source.boxes.table.has_header:
        turns, extra, is_density = work.array_extras(geometries)
        weight_index, density_index = (None, extra) if is_density else (extra, None)
    weight, weight_unit = None, ""
    if weight_index is not None:
        if any(cell not in (None, "", 0, "0", 0.0) for cell in work.cells(weight_index)):
            weight, weight_unit = work.numbers(weight_index, MASS_UNITS)
    elif density_index is not None:
        weight, weight_unit = work.numbers(density_index, {"kg/m3": 1.0})
    sequence_index = work.first("sequence", "sequence")
    sequence = None
    if sequence_index is not None:
        sequence, _ = work.numbers(sequence_index, {"": 1.0})
    used = {name for geometry in geometries for name in geometry.columns.values()}
    plan, plan_name = work.texts("plan", role="plan")
    plan = work.filled_down(plan, plan_name, least_rows=2.0)
    article, article_name = work.texts("article", role="article")
    item_id, item_name = work.texts("item_id", "number", role="item_id")
    if item_id is None and article is not None:
        item_id, item_name = article, article_name
    group, group_name = work.texts("group")
    header = source.boxes.table.header
    named = {
        "weight": "" if weight_index is None else header[weight_index],
        "density": "" if density_index is None else header[density_index],
        "rotation": "" if turns is None else turns.column,
        "sequence": "" if sequence_index is None else header[sequence_index],
        "plan": plan_name,
        "article": article_name,
        "item_id": item_name,
        "product_group": group_name,
    }
    known = used | set(named.values())
    return BoxColumns(
        work.source,
        geometries,
        turns,
        weight,
        weight_unit,
        density_index is not None,
        plan,
        article,
        item_id,
        group,
        sequence,
        {} if sequence is not None else work.counters(used),
        {role: name for role, name in named.items() if name},
        work.faults,
        tuple(name for name in header if not {name, name.rpartition("[")[0]} & known and name not in work.unit_columns),
        tuple(work.unit_columns),
    )
