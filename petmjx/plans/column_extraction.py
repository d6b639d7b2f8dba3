"""Extracts the columns of a list of boxes (``ColumnExtraction``): the meaning of each column, by its name and cells;
its numbers, converted to one unit; and the names of boxes and plans.

Cells are converted to numbers. For each bad cell, an error line names the row and the column.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import (
    CellNumber,
    are_grouped,
    cell_corners,
    cell_number,
    cell_text,
    cell_triple,
    has_groups_with_decimals,
    is_number,
    number_fault_of,
    without_groups,
)
from petmjx.plans.column_names import (
    LENGTH_UNITS,
    MASS_UNITS,
    ColumnMeaning,
    column_meanings,
    plain_text,
    split_unit,
    unit_in,
    unknown_density_unit,
    word_set,
    words_of,
)
from petmjx.plans.header_and_total_rows import geometric_columns
from petmjx.plans.known_forms import BED_BPP, PACKINGSOLVER, BoxSource
from petmjx.plans.plan_fields import joined_names
from petmjx.plans.turn_columns import letters_of

XYZ: Final = ("x", "y", "z")
SIZE_WORDS: Final = ("length", "width", "height", "depth")
HALF_EXTENTS: Final = "half extents"
"""An additional role of a column of sizes, if the sizes are half extents."""
LAST_CELLS: Final = "last cells"
"""An additional role of a column of far corners, if boxes stand on a grid and each far corner is the last cell of its
box. For example, a box from 1 to 40 is 40 cells long."""
ROLES: Final = (
    "length", "width", "height", "depth", "x size", "y size", "z size", "x", "y", "z", "sizes", "position", "weight",
    "rotation", "plan", "sequence", "article", "item_id", HALF_EXTENTS, LAST_CELLS,
)  # fmt: skip
"""Roles that the option ``columns`` can assign to a column of a table of boxes. ``sizes`` and ``position`` are three
numbers in one column."""
IGNORED: Final = "-"
"""With this text instead of a column's name, a user says that no column has the role."""
_READ_CELLS: Final = 200
"""Number of cells of a column that are read to find its meaning."""
_NO_WEIGHT: Final = word_set(
    "max maximum limit capacity total load bears bearing strength allowed pallet palette container tare tara"
)
"""Words in names of columns whose masses are not the weights of boxes."""
_BEARS: Final = (
    *("last", "trag", "festigkeit", "draag", "portata", "carico", "resist", "admis", "charge", "soport", "carga"),
    *("nosno", "udzwig", "obciaz", "capac"),
)
"""Parts of words for what a box can bear, in several languages: Traglast, Belastbarkeit, portata, charge admissible,
carga soportada, nośność. A column whose name has one of these parts does not have the weights of boxes."""
_UNIT_WORDS: Final = word_set("unit units uom einheit masseinheit unite unites unidad unidades unita jednostka")
_SURE_UNITS: Final = frozenset(("mm", "cm", "kg", "lb", "lbs", "inch", "inches"))
"""Texts that are recognised as units in a column of any name. Other units, such as "m" or "in", may also be words with
another meaning."""
_ORDER_WORDS: Final = frozenset(("order", "ordre", "orden", "ordine", "ordem"))


def _names_mass(name: str) -> bool:
    """Whether the name of a column has a unit of mass. A "t" may be another abbreviation."""
    return unit_in(name, MASS_UNITS) not in ("", "t")


def _is_other_mass(words: Sequence[str]) -> bool:
    """Whether the words of a column's name say that its masses are not the weights of boxes."""
    return bool(_NO_WEIGHT.intersection(words)) or any(part in word for word in words for part in _BEARS)


def role_of(axis: str) -> str:
    """The role of a column that holds the sizes along this axis (one of ``Geometry.axes``)."""
    return {"0": "1st size", "1": "2nd size", "2": "3rd size"}.get(axis, axis if axis in SIZE_WORDS else f"{axis} size")


def _count_rows(numbers: Sequence[float]) -> bool:
    """Whether numbers count rows from 0 or 1, perhaps anew in each plan."""
    counts = all(b in (a + 1, numbers[0]) for a, b in pairwise(numbers))
    return counts and numbers[:4] in ([0, 1, 2, 3], [1, 2, 3, 4])


class ColumnExtraction:
    """The columns of one source, while their meanings are being determined.

    Attributes:
        roles: roles that the option ``columns`` can assign to a column.
        fixed: role → column that the option ``columns`` assigns to it.
        ignored: roles that no column has, according to the option ``columns``.
    """

    roles: tuple[str, ...] = ROLES

    def __init__(self, source: BoxSource, chosen: Mapping[str, str], units: str, masses: str) -> None:
        self.source = source
        self.units, self.masses = units, masses
        self.table = source.boxes.table
        self.groups_thousands = has_groups_with_decimals(self.table.rows, self.table.decimal)
        self.faults: dict[int, tuple[str, str]] = {}
        self.meanings = column_meanings(self.table.header)
        if source.form == PACKINGSOLVER:
            upper = {name.upper(): index for index, name in enumerate(self.table.header)}
            self.meanings[upper["ID"]] = ColumnMeaning("article")
            self.meanings[upper["TYPE"]] = None
            self.meanings[upper.get("COPIES", upper["TYPE"])] = None
        if source.form == BED_BPP:  # ``item.sequence`` counts the items of the order; it is not the packing order
            for index in self.indices("sequence", of_container=True):
                self.meanings[index] = None
        eulers = self.indices("euler", of_container=True)
        if len(eulers) == 1:  # "rot_z" alone: the box turns about the vertical
            self.meanings[eulers[0]] = ColumnMeaning("rotation")
        self._mean_by_cells()
        self.fixed: dict[str, int] = {}
        self.ignored: set[str] = set()
        for role, name in chosen.items():
            if role not in self.roles:
                raise InputError(f"columns: unknown {printable_name(role)}; there are {', '.join(self.roles)}")
            if name == IGNORED:
                self.ignored.add(role)
                self.meanings = [
                    None if meaning is not None and _role_of(meaning) == role else meaning for meaning in self.meanings
                ]
                continue
            without_units = [split_unit(column)[0].strip() for column in self.table.header]
            if name not in self.table.header and without_units.count(name) == 1:
                name = self.table.header[without_units.index(name)]
            if name not in self.table.header:
                names = ", ".join(map(printable_name, self.table.header[:20]))
                raise InputError(f"has no column {printable_name(name)} ({role}); there are {names}")
            self.fixed[role] = self.table.header.index(name)
        # a column that the user has chosen for a size is a size, even if its name ("bounds[0]") has another meaning
        for axis in (*SIZE_WORDS, *XYZ):
            column = self.fixed.get(role_of(axis))
            if column is not None and ((meaning := self.meanings[column]) is None or meaning.kind != "size"):
                self.meanings[column] = ColumnMeaning("size", axis, unit_in(self.table.header[column]))

    def _mean_by_cells(self) -> None:
        """Determine meanings of columns from their cells.

        A column "order" has customers' orders, not a packing order, if it has at most half as many different values as
        cells. A column of sizes whose cells count the rows has running numbers, not sizes: "Br" may mean width
        ("Breite"), but it is also "number" in Croatian. A column with an unknown name has weights if its name or its
        cells have a unit of mass. It has rotations if its cells are angles such as 90°, or letters such as "WLH", which
        tell the size that lies along each axis."""
        self.row_units: dict[bool, list[str]] = {}
        self.object_units: dict[str, list[str]] = {}  # path of an object → unit of the lengths in it, in each row
        self.unit_columns: list[str] = []
        self.axis_columns: dict[str, int] = {}  # "x" or "y" → column with the directions of the boxes' x or y axes
        if not self.table.has_header:
            return
        kinds = self.kinds
        for index, (name, meaning) in enumerate(zip(self.table.header, self.meanings, strict=True)):
            cells = [row[index] for row in self.table.rows[:_READ_CELLS] if row[index] not in (None, "")]
            if not cells:
                continue
            words = words_of(name)
            if any(isinstance(cell, str) and cell[:1] in "([{" and cell_corners(cell) for cell in cells[:3]) and sum(
                map(bool, map(cell_corners, cells))
            ) * 2 > len(cells):
                unit = "" if meaning is None else meaning.unit
                self.meanings[index] = ColumnMeaning("corners", unit=unit if unit in LENGTH_UNITS else "")
                continue
            if not kinds & {"position", "positions", "low"} and all(map(_has_named_axes, cells)):
                self.meanings[index] = ColumnMeaning("positions")
                continue
            is_named = words[-1:] == ["origin"] or words[1:] == ["axis"]
            if is_named and sum(cell_triple(cell) is not None for cell in cells) * 2 > len(cells):
                if words[-1] == "origin":  # the origin of a plane (Rhino, Grasshopper) or of a frame
                    self.meanings[index] = ColumnMeaning("positions")
                else:
                    self.meanings[index] = None
                    self.axis_columns[words[0]] = index
                continue
            if self._has_units(index, cells):
                self.meanings[index] = None
                self.unit_columns.append(name)
            elif meaning is not None:
                of_order = meaning.kind == "sequence" and _ORDER_WORDS.intersection(words)
                numbers = [number.value for cell in cells if (number := cell_number(cell, self.table.decimal))]
                texts = map(cell_text, self.cells(index))
                # pairs of plan and text, since each plan may count from 1
                distinct = set(zip(self.source.boxes.parts, texts, strict=True))
                if of_order and "plan" not in kinds and len(distinct) * 2 <= len(self.table.rows):
                    self.meanings[index] = ColumnMeaning("plan")
                elif meaning.kind == "size" and _count_rows(numbers):
                    self.meanings[index] = ColumnMeaning("number")
            elif (
                "weight" not in kinds
                and (all(map(self._is_mass, cells)) or (_names_mass(name) and all(map(is_number, cells))))
                and not _is_other_mass(words)
            ):
                self.meanings[index] = ColumnMeaning("weight", unit=unit_in(name, MASS_UNITS))
            elif "rotation" not in kinds and (
                (len({*map(cell_text, cells)}) > 1 and all(map(letters_of, cells))) or _are_quarter_turns(cells)
            ):
                self.meanings[index] = ColumnMeaning("rotation")

    def _has_units(self, index: int, cells: Sequence[Any]) -> bool:
        """Whether the cells of a column are names of units; ``cells`` are its first cells. If the cells are units, they
        apply to the numbers in the same rows, or, if all units are equal, to the whole list. A unit of lengths in an
        object ("Dimensions.uom") applies only to the lengths in this object, if there are any."""
        for units in (LENGTH_UNITS, MASS_UNITS):
            sure = units.keys() if _UNIT_WORDS.intersection(words_of(self.table.header[index])) else _SURE_UNITS
            if not all(isinstance(cell, str) and _as_unit(cell) in units.keys() & sure for cell in cells):
                continue
            texts = [_as_unit(cell_text(cell)) for cell in self.cells(index)]
            form, is_mass = self.source.form, units is MASS_UNITS
            path = _path_of(self.table.header[index])
            of_lengths = {_path_of(self.table.header[other]) for other in geometric_columns(self.table.header)}
            if not is_mass and path in of_lengths:
                self.object_units[path] = texts
            elif len(set(texts)) > 1:
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

    @property
    def kinds(self) -> set[str]:
        return {meaning.kind for meaning in self.meanings if meaning is not None}

    def cells(self, index: int) -> list[Any]:
        return self.table.cells(index)

    def is_empty(self, index: int) -> bool:
        return all(cell in (None, "") for cell in self.cells(index))

    def cell_numbers(self, index: int) -> list[CellNumber | None]:
        """The numbers of a column; None for cells without a number."""
        return [cell_number(cell, self.table.decimal) for cell in self.cells(index)]

    def bad(self, row: int, index: int, text: str) -> None:
        self.faults.setdefault(row, (self.table.header[index], text))

    def numbers(self, index: int, units: Mapping[str, float]) -> tuple[FloatArray, str]:
        """(n,) numbers of a column, NaN if a cell is bad. The function also returns the unit according to the column's
        name or cells ("": none is given)."""
        rows: list[Sequence[CellNumber]] = []
        cells, decimal = self.cells(index), self.table.decimal
        is_grouped = self.groups_thousands or are_grouped(cells, decimal)
        for row, cell in enumerate(cells):
            cell = without_groups(cell, decimal) if is_grouped else cell
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

    def weights(self, index: int) -> tuple[FloatArray | None, str]:
        """(n,) weights of a column, NaN if a cell is bad; None if all cells are empty or 0. The function also returns
        their unit."""
        if all(cell in (None, "", 0, "0", 0.0) for cell in self.cells(index)):
            return None, ""
        return self.numbers(index, MASS_UNITS)

    def densities(self, index: int) -> tuple[FloatArray, str]:
        """(n,) densities of a column, NaN if a cell is bad. The function also returns their unit according to the
        column's name, one of ``DENSITY_UNITS`` ("": none is given).

        Raises:
            InputError: the name has an unknown unit.
        """
        name = self.table.header[index]
        if self.table.has_header and (unknown := unknown_density_unit(name)):
            raise InputError(
                f"{printable_name(name)}: {printable_name(unknown)} is no known unit of density, such as kg/m3, g/cm3 "
                "or lb/ft3"
            )
        meaning = self.meanings[index]
        unit = meaning.unit if meaning is not None and meaning.kind == "density" else ""
        return self.numbers(index, {"kg/m3": 1.0})[0], unit

    def triples(self, index: int) -> tuple[FloatArray, str]:
        """(n, 3) numbers of a column with three numbers per cell. The function also returns the unit of the numbers."""
        cells = [cell_triple(cell, self.table.decimal) for cell in self.cells(index)]
        return self._lists(index, cells, "three", 3)

    def corners(self, index: int) -> tuple[FloatArray, str]:
        """(n, 6) coordinates of a column with two corners per cell. The function also returns the unit of the
        numbers."""
        pairs = [cell_corners(cell, self.table.decimal) for cell in self.cells(index)]
        cells = [None if pair is None else [*pair[0], *pair[1]] for pair in pairs]
        return self._lists(index, cells, "two times three", 6)

    def _lists(
        self, index: int, cells: Sequence[Sequence[CellNumber] | None], count_words: str, count: int
    ) -> tuple[FloatArray, str]:
        """(n, count) numbers of a column with several numbers per cell. The function also returns their unit.

        Args:
            cells: the numbers of each cell; None: the cell is bad.
            count_words: how many numbers a cell must have, in words.
        """
        rows: list[Sequence[CellNumber]] = []
        for row, numbers in enumerate(cells):
            finite = numbers is not None and all(np.isfinite(number.value) for number in numbers)
            rows.append(numbers if numbers is not None and finite else ())
            if not finite:
                cell = self.table.rows[row][index]
                wanted = f"{count_words} numbers" if numbers is None else f"{count_words} finite numbers"
                shown = "is missing" if cell in (None, "") else f'must be {wanted}, got "{printable_name(str(cell))}"'
                self.bad(row, index, shown)
        return self._in_one_unit(index, rows, LENGTH_UNITS, count)

    def _in_one_unit(
        self, index: int, rows: Sequence[Sequence[CellNumber]], units: Mapping[str, float], width: int
    ) -> tuple[FloatArray, str]:
        """(n, width) numbers of a column, NaN for rows without numbers. The function also returns the unit of the
        numbers ("": none is given).

        A number without a unit gets the unit that the column's name, an option or the form gives. If neither the
        column's name nor an option nor the form gives a unit, but other cells of the column have units, the number is
        bad. The unit of one cell does not imply the unit of another cell. Zero needs no unit.
        """
        values = np.full((len(rows), width), np.nan)
        is_mass = "kg" in units
        of_rows = self.row_units.get(is_mass) if units in (LENGTH_UNITS, MASS_UNITS) else None
        of_object = self.object_units.get(_path_of(self.table.header[index])) if units is LENGTH_UNITS else None
        if (of_rows := of_object if of_object and len({*of_object}) > 1 else of_rows) is not None:
            rows = [
                [number if number.unit else number._replace(unit=unit) for number in numbers]
                for numbers, unit in zip(rows, of_rows, strict=True)
            ]
        meaning, form = self.meanings[index], self.source.form
        of_name = meaning.unit if meaning is not None and meaning.unit in units else ""
        if not of_name and index in self.fixed.values():  # the meaning of a chosen column may be unknown
            of_name = unit_in(self.table.header[index], units)
        of_name = of_name or (of_object[0] if of_object else "")
        wish = self.masses if is_mass else self.units
        wish = wish if wish in units else ""
        written = {number.unit for numbers in rows for number in numbers if number.unit in units} - {""}
        usual = of_name or wish or (form.masses if is_mass else form.units)
        target = wish or ("kg" if is_mass else "mm")  # if an option gives a unit, it is the unit of all results
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

    def columns_of(self, *kinds: str) -> dict[str, list[int]]:
        """Axis → indices of the columns for this axis whose meaning has one of the given kinds. Columns about
        containers are left out."""
        by_axis: dict[str, list[int]] = {}
        for index, meaning in self.named(*kinds):
            by_axis.setdefault(meaning.axis, []).append(index)
        return by_axis

    def numbers_or_median(self, index: int) -> FloatArray:
        """(n,) numbers of a column. In place of a bad cell, the median of the column is returned; the bad cell is not
        reported here."""
        values = np.array([np.nan if number is None else number.value for number in self.cell_numbers(index)])
        with np.errstate(invalid="ignore"):
            return np.where(np.isnan(values), np.nanmedian(values) if np.isfinite(values).any() else 1.0, values)

    def texts(self, *kinds: str, role: str = "") -> tuple[list[str] | None, str]:
        """(n,) texts of a column, and the name of the column. The column is the one to which an option gives the role
        ``role``, or else the first column whose meaning is one of ``kinds``. The result is None and "" if there is no
        such column."""
        index = self.fixed.get(role)
        if index is None:
            columns = (index for kind in kinds for index in self.indices(kind, of_container=True))
            index = next((index for index in columns if index not in self.fixed.values()), None)
        if index is None:
            return None, ""
        return [cell_text(cell) for cell in self.cells(index)], self.table.header[index]

    def filled_down(self, names: list[str] | None, column: str, least_rows: float = 1.0) -> list[str] | None:
        """(n,) the name of the plan or order of each row. Blank cells below a name, as in sheets with merged cells, get
        this name. If there are blank cells, each name must occur only once, in the first row of its block.

        Args:
            names: texts of the cells; None: there is no column.
            column: name of the column.
            least_rows: if the column has fewer rows per name than this on average, it is not changed.

        Raises:
            InputError: there are blank cells that cannot be filled in this manner.
        """
        if names is None or "" not in names or not any(names):
            return names
        written = [name for name in names if name]
        if len(set(written)) * least_rows > len(names) + 2:
            return names
        parts = self.source.boxes.parts
        filled_names: list[str] = []
        for row, (name, part) in enumerate(zip(names, parts, strict=True)):
            begins = row == 0 or part != parts[row - 1]
            if not name and (begins or len(set(written)) < len(written)):
                raise InputError(f"{self.table.places[row]}: {printable_name(column)} is missing")
            filled_names.append(name or filled_names[-1])
        self.source = replace(self.source, notes=(*self.source.notes, f"{printable_name(column)} filled down"))
        return filled_names

    def check_numbers(self, names: list[str] | None, column: str) -> None:
        """Check the names of plans or orders. If all rows except one have whole numbers as names, the name of this one
        row is a damaged number. This applies only if a name occurs in at least two rows on average.

        Args:
            names: the name of each row; None: there is no column.
            column: name of the column.

        Raises:
            InputError: a name is a damaged number.
        """
        odd = [row for row, name in enumerate(names or ()) if not name.isdecimal()]
        if names is None or len(odd) != 1 or 2 * len(set(names)) > len(names):
            return
        text = f'{printable_name(column)} must be a whole number ≥ 0, as in all other rows, got "{names[odd[0]]}"'
        raise InputError(f"{self.table.places[odd[0]]}: {text}")

    def named(self, *kinds: str, of_container: bool = False) -> list[tuple[int, ColumnMeaning]]:
        """Index and meaning of each column whose meaning has one of the given kinds. Columns about containers are left
        out unless ``of_container`` is True."""
        return [
            (index, meaning)
            for index, meaning in enumerate(self.meanings)
            if meaning is not None and meaning.kind in kinds and (of_container or not meaning.of_container)
        ]

    def indices(self, *kinds: str, of_container: bool = False) -> list[int]:
        """Indices of the columns that :meth:`named` returns."""
        return [index for index, _ in self.named(*kinds, of_container=of_container)]

    def first(self, kind: str, role: str = "") -> int | None:
        """The column with the role ``role``, or else the first column whose meaning has the kind ``kind``; None if
        there is no such column."""
        return self.fixed[role] if role in self.fixed else next(iter(self.indices(kind)), None)


_NAMED_AXES: Final = re.compile(r"[^a-z]*x\s*[=:].*\by\s*[=:].*\bz\s*[=:]", re.IGNORECASE)
"""Three coordinates with the names of their axes, in one cell: "x=0 y=300 z=200"."""


def _has_named_axes(cell: Any) -> bool:
    return isinstance(cell, str) and _NAMED_AXES.match(cell) is not None


def _are_quarter_turns(cells: Sequence[Any]) -> bool:
    """Whether cells are angles in degrees, all of them multiples of 90, and some but not all of them turn a box."""
    angles = {None if number is None else number.value for number in map(cell_number, cells)}
    return angles <= {0.0, 90.0, 180.0, 270.0, -90.0, -180.0} and bool(angles & {90.0, 270.0, -90.0}) and 0.0 in angles


def _role_of(meaning: ColumnMeaning) -> str:
    if meaning.kind == "size":
        return role_of(meaning.axis)
    return meaning.axis if meaning.kind == "position" else {"positions": "position"}.get(meaning.kind, meaning.kind)


def _path_of(name: str) -> str:
    """The path of the object that has a field: "item.size.x" → "item.size"."""
    return name.rpartition(".")[0]


def _as_unit(text: str) -> str:
    return plain_text(text).strip(" .").lower()
