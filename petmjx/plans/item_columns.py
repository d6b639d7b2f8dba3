"""Columns of tables of items (``ItemColumns``): sizes, weights, quantities, layers and names of goods that have no
places yet.

Names of columns are understood as in tables of boxes (``petmjx.plans.column_names``); here are also those that only
orders have: weights of whole rows, boxes of a layer, numbers of cartons.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import IGNORED, ROLES, Extraction
from petmjx.plans.column_names import MASS_UNITS, ColumnMeaning, Kind, split_unit, word_set, words_of
from petmjx.plans.foreign_formats import BoxSource
from petmjx.plans.nested_json import BoxList
from petmjx.plans.raw_cells import cell_number, cell_text

ITEM_ROLES: Final = ("quantity", "layers", "per layer", "total weight")
"""Roles of columns that only orders have, beside ``ROLES``. ``quantity`` counts all boxes of a row, ``per layer`` those
of one of its ``layers``; ``weight`` is of a box, ``total weight`` of all boxes of a row."""
_KINDS: Final[dict[str, Kind]] = {
    "quantity": "quantity", "layers": "layers", "per layer": "quantity", "total weight": "weight",
}  # fmt: skip
MOST_PIECES: Final = 100_000
"""Largest quantity of a row."""

_TOTAL: Final = word_set(
    "total totale gesamt gesamtgewicht summe totalgewicht positionsgewicht zeilengewicht razem laczna calkowita sum "
    "complessivo"
)
_UNIT_WEIGHT: Final = word_set(
    "stuckgewicht stueckgewicht einzelgewicht kartongewicht kistengewicht artikelgewicht nettogewicht unitweight "
    "caseweight boxweight itemweight"
)
_WEIGHT: Final = word_set(
    "weight mass gewicht poids peso waga masa ciezar gesamtgewicht totalgewicht positionsgewicht zeilengewicht"
)
_PIECES: Final = word_set(
    "boxes cartons kartons kartonanzahl cases packages colli packstucke packstuecke stuck stueck cajas bultos colis "
    "scatole colli kartony kartonow paczki units unit einheiten items"
)
"""Names of columns with quantities, if their cells are whole numbers and no column is called a quantity."""
_LAYER: Final = word_set("layer lage schicht couche capa strato warstwa warstwe warstwie")
_PER: Final = word_set("per pro je par por na w each a")
_ARTICLE: Final = word_set("towar goods ware good mercancia merce marchandise")
_ORDER: Final = word_set("order orders ordre")
"""Names of columns with a packing order, which are also those of customers' orders: the values decide."""


@dataclass(frozen=True, eq=False)
class ItemColumns:
    """The items of a source by column.

    Attributes:
        source: where they come from.
        size: (n, 3) length, width and height in the file's unit; NaN where a cell is bad.
        size_unit: unit that names or cells give; "": none.
        size_names: columns of the three sizes; one, if they are in one column.
        weight: (n,) weights in the file's unit; None: no column has any.
        weight_unit: unit that the name or the cells give; "": none.
        weight_is: what ``weight`` is of: "box", "row", or "density"; "": the name does not say whether of a box or row.
        quantity: (n,) whole numbers of boxes; NaN where a cell is bad; None: one box a row.
        layers: (n,) whole numbers of layers; None: no column.
        per_layer: whether ``quantity`` counts the boxes of a layer; None: the name does not say.
        order, article, item_id, group: (n,) names; None: no column.
        sequence: (n,) order of arrival; None: no column.
        columns: role → name of its column.
        faults: row → (column, text) of its first bad cell.
    """

    source: BoxSource
    size: FloatArray
    size_unit: str
    size_names: tuple[str, ...]
    weight: FloatArray | None
    weight_unit: str
    weight_is: str
    quantity: FloatArray | None
    layers: FloatArray | None
    per_layer: bool | None
    order: list[str] | None
    article: list[str] | None
    item_id: list[str] | None
    group: list[str] | None
    sequence: FloatArray | None
    columns: Mapping[str, str]
    faults: Mapping[int, tuple[str, str]]

    @property
    def n_rows(self) -> int:
        return len(self.source.boxes.table.rows)

    @property
    def boxes(self) -> BoxList:
        return self.source.boxes


def has_sizes_of_items(source: BoxSource) -> bool:
    """Whether a list has sizes, also as packingsolver's items have them: X, Y and Z."""
    return source.boxes.has_sizes or _is_of_packingsolver(source.boxes.table.header)


def _is_of_packingsolver(header: Sequence[str]) -> bool:
    """Whether columns are those of packingsolver's items: X, Y, Z are sizes there, and no coordinates."""
    upper = {name.upper() for name in header}
    return upper >= {"X", "Y", "Z"} and not upper & {"LX", "LY", "LZ"} and bool(upper & {"COPIES", "PROFIT"})


class _ItemExtraction(Extraction):
    """The columns of one source while they are taken apart, with those that only orders have."""

    def __init__(self, source: BoxSource, chosen: Mapping[str, str]) -> None:
        header = source.boxes.table.header
        for role, name in chosen.items():
            if role not in ROLES and role not in ITEM_ROLES:
                known = ", ".join((*ROLES, *ITEM_ROLES))
                raise InputError(f"columns: unknown {printable_name(role)}; there are {known}")
            if role in ITEM_ROLES and name not in (*header, IGNORED):
                names = ", ".join(map(printable_name, header[:20]))
                raise InputError(f"has no column {printable_name(name)} ({role}); there are {names}")
        super().__init__(source, {role: name for role, name in chosen.items() if role in ROLES})
        self.chosen = {role: name for role, name in chosen.items() if role in ITEM_ROLES}
        self.totals: set[int] = set()
        self.of_box: set[int] = set()
        self.of_layer: set[int] = set()
        if _is_of_packingsolver(header):
            self._take_packingsolver()
        self._take_names_of_orders()
        for role, name in self.chosen.items():
            if name != IGNORED:
                index = header.index(name)
                self.meanings[index] = ColumnMeaning(_KINDS[role])
                self.of_layer.discard(index)
                self.totals.discard(index)
                {"per layer": self.of_layer, "total weight": self.totals}.get(role, set()).add(index)

    def _take_packingsolver(self) -> None:
        for index, name in enumerate(self.table.header):
            if name.upper() in ("X", "Y", "Z"):
                self.meanings[index] = ColumnMeaning("size", name.lower())

    def _take_names_of_orders(self) -> None:
        """The meanings of names that only orders have."""
        known = {meaning.kind for meaning in self.meanings if meaning is not None}
        for index, name in enumerate(self.table.header):
            base, unit = split_unit(name)
            words = set(words_of(base))
            joined = "".join(words_of(base))
            meaning = self.meanings[index]
            if words & _WEIGHT and words & _TOTAL:
                self.meanings[index] = ColumnMeaning("weight", unit=unit if unit in MASS_UNITS else "")
                self.totals.add(index)
            elif joined in _UNIT_WEIGHT or (words & _WEIGHT and words & {"unit", "piece", "each", "stuck", "per"}):
                self.meanings[index] = ColumnMeaning("weight", unit=unit if unit in MASS_UNITS else "")
                self.of_box.add(index)
            elif words & _LAYER and words & _PER:
                self.meanings[index] = ColumnMeaning("quantity")
                self.of_layer.add(index)
            elif "quantity" not in known and joined in _PIECES and self._is_whole(index):
                self.meanings[index] = ColumnMeaning("quantity")
            elif meaning is None and joined in _ARTICLE:
                self.meanings[index] = ColumnMeaning("article")

    def _is_whole(self, index: int) -> bool:
        """Whether most cells of a column are whole numbers, and some are there twice: names would differ."""
        numbers = [cell_number(cell, self.table.decimal) for cell in self.cells(index)]
        whole = [number.value for number in numbers if number is not None and number.value.is_integer()]
        return len(whole) * 2 > len(numbers) and (len(set(whole)) < len(whole) or len(whole) < 3)

    def role(
        self, role: str, kind: str, *, within: set[int] | None = None, without: set[int] | None = None
    ) -> int | None:
        """The column of a role: the chosen one, else the first of its kind; None: there is none."""
        name = self.chosen.get(role)
        if name is not None:
            return None if name == IGNORED else self.table.header.index(name)
        for index, meaning in enumerate(self.meanings):
            if meaning is None or meaning.kind != kind or meaning.of_container or index in self.taken:
                continue
            if (within is None or index in within) and (without is None or index not in without):
                return index
        return None

    @property
    def taken(self) -> set[int]:
        return {
            *self.fixed.values(),
            *(self.table.header.index(name) for name in self.chosen.values() if name != IGNORED),
        }

    def counts(self, index: int, smallest: int, otherwise: float | None = None) -> FloatArray:
        """(n,) whole numbers of a column; NaN where a cell is bad.

        Args:
            otherwise: the number of empty cells; None: they are bad.
        """
        values = np.full(len(self.table.rows), np.nan)
        for row, cell in enumerate(self.cells(index)):
            if otherwise is not None and cell in (None, ""):
                values[row] = otherwise
                continue
            number = cell_number(cell, self.table.decimal)
            if number is not None and number.value.is_integer() and smallest <= number.value <= MOST_PIECES:
                values[row] = number.value
                continue
            shown = "is missing" if cell in (None, "") else f'got "{printable_name(cell_text(cell))}"'
            limits = f"must be a whole number from {smallest} to {MOST_PIECES:,}"
            self.bad(row, index, shown if cell in (None, "") else f"{limits}, {shown}")
        return values

    def sizes(self) -> tuple[FloatArray, str, tuple[str, ...]] | None:
        """(n, 3) length, width and height, their unit, and names of their columns; None: there are none."""
        choices = self.size_choices()
        if not choices:
            return None
        values, axes, unit, _, columns = choices[0]
        upright = next((axis for axis in ("height", "z", "2", "depth") if axis in axes), axes[2])
        order = [index for index, axis in enumerate(axes) if axis != upright] + [axes.index(upright)]
        named = tuple(columns.values())
        return values[:, order], unit, tuple(named[index] for index in order) if len(named) == 3 else named


def item_columns(source: BoxSource, chosen: Mapping[str, str] | None = None) -> ItemColumns | None:
    """The columns of a source of items; None: it has no sizes.

    Args:
        chosen: role (``ROLES``, ``ITEM_ROLES``) → name of the column that holds it, or "-".

    Raises:
        InputError: a chosen column does not exist.
    """
    work = _ItemExtraction(source, chosen or {})
    sizes = work.sizes()
    if sizes is None:
        return None
    header = source.boxes.table.header
    columns: dict[str, str] = {}
    layer_index = work.role("per layer", "quantity", within=work.of_layer)
    quantity_index, per_layer = work.role("quantity", "quantity", without=work.of_layer), None
    if layer_index is not None and (quantity_index is None or "per layer" in work.chosen):
        quantity_index, per_layer = layer_index, True
    elif layer_index is not None or "quantity" in work.chosen:
        per_layer = False
    layers_index = work.role("layers", "layers")
    copies = _is_of_packingsolver(header)
    quantity = layers = None
    if quantity_index is not None:
        quantity = work.counts(quantity_index, 0, 1.0 if copies else None)
        columns["per layer" if per_layer else "quantity"] = header[quantity_index]
    if layers_index is not None and quantity_index is not None:
        layers = work.counts(layers_index, 1, 1.0)
        columns["layers"] = header[layers_index]
    weight, unit, weight_is = _weight(work, columns)
    sequence_index = work.first("sequence", "sequence")
    sequence, order = None, None
    if sequence_index is not None:
        order = _orders_in(work, sequence_index)
        if order is None:
            sequence, _ = work.numbers(sequence_index, {"": 1.0})
    named_order, order_name = work.texts("plan", role="plan")
    order = named_order if named_order is not None else order
    article, article_name = work.texts("article", role="article")
    item_id, item_name = work.texts("item_id", role="item_id")
    group, _ = work.texts("group")
    if order is not None:
        columns["plan"] = order_name or header[sequence_index or 0]
    columns |= {role: name for role, name in (("article", article_name), ("item_id", item_name)) if name}
    values, size_unit, names = sizes
    return ItemColumns(
        source, values, size_unit, names, weight, unit, weight_is, quantity, layers, per_layer, order, article, item_id,
        group, sequence, columns, work.faults,
    )  # fmt: skip


def _weight(work: _ItemExtraction, columns: dict[str, str]) -> tuple[FloatArray | None, str, str]:
    """(n,) weights or densities, their unit, and of what they are (``ItemColumns.weight_is``)."""
    header = work.table.header
    row_index = work.role("total weight", "weight", within=work.totals)
    index = work.fixed.get("weight")
    if index is None and "total weight" not in work.chosen:
        index = work.role("weight", "weight", without=work.totals)
    if index is not None:
        weight_is = "box" if index in work.of_box or "weight" in work.fixed else ""
        columns["weight"] = header[index]
    elif row_index is not None:
        index, weight_is = row_index, "row"
        columns["total weight"] = header[index]
    else:
        index, weight_is = work.first("density"), "density"
        if index is None:
            return None, "", ""
        columns["density"] = header[index]
        return work.numbers(index, {"kg/m3": 1.0})[0], "", weight_is
    if all(cell in (None, "", 0, "0", 0.0) for cell in work.cells(index)):
        columns.pop("weight", None), columns.pop("total weight", None)
        return None, "", ""
    weight, unit = work.numbers(index, MASS_UNITS)
    return weight, unit, weight_is


def _orders_in(work: _ItemExtraction, index: int) -> list[str] | None:
    """(n,) customers' orders in a column called "order", whose values are no packing order: some are there twice, or
    are no numbers; None: it is a packing order."""
    if not _ORDER.intersection(words_of(work.table.header[index])) or "sequence" in work.fixed:
        return None
    cells = [cell_text(cell) for cell in work.cells(index)]
    numbers = [cell_number(cell) for cell in cells]
    if len(set(cells)) == len(cells) and all(numbers):
        return None
    return cells


def with_rows(source: BoxSource, kept: NDArray[np.bool_], notes: tuple[str, ...] = ()) -> BoxSource:
    """A source with some of its rows, and more notes.

    Args:
        kept: (n,) whether a row is kept.
    """
    table = source.boxes.table

    def chosen(values: Sequence[Any]) -> list[Any]:
        return [value for value, keeps in zip(values, kept.tolist(), strict=True) if keeps]

    parts = tuple(chosen(source.boxes.parts)) if source.boxes.parts else ()
    boxes = replace(
        source.boxes, table=replace(table, rows=chosen(table.rows), places=chosen(table.places)), parts=parts
    )
    return replace(source, boxes=boxes, notes=(*source.notes, *notes))
