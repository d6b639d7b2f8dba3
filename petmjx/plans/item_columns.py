"""Columns of tables of items (``ItemColumns``): sizes, weights, quantities, layers and names of goods that have not
been placed yet.

Names of columns are interpreted as in tables of boxes (``petmjx.plans.column_names``). This module adds the names that
only orders have: weights of whole rows, boxes per layer, numbers of cartons.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import weight_column
from petmjx.plans.cell_numbers import cell_number, cell_text, number_fault_of
from petmjx.plans.column_extraction import ROLES, ColumnExtraction
from petmjx.plans.column_names import (
    MASS_UNITS,
    ColumnMeaning,
    Kind,
    is_content,
    split_unit,
    unit_in,
    word_set,
    words_of,
)
from petmjx.plans.known_forms import BoxSource
from petmjx.plans.order import MOST_ITEMS
from petmjx.plans.plan_fields import sparse_fault
from petmjx.plans.raw_tables import BoxList
from petmjx.plans.size_and_place_columns import sizes_in

ITEM_ROLES: Final[tuple[Kind, ...]] = ("quantity", "layers", "per layer", "total weight")
"""Roles of columns that only orders have, in addition to ``ROLES``. ``quantity`` is the number of boxes in a row of the
table. ``per layer`` is the number of boxes in each of the row's ``layers``. ``weight`` is the weight of one box, and
``total weight`` the weight of all boxes of a row."""
TWO_WAYS: Final = "can be read in two ways:"
_LEAST_RISING: Final = 8
"""Whole numbers that increase from row to row, by unequal steps, are identifiers if there are at least this many rows.
Quantities in this many rows would hardly be sorted by chance."""
MOST_PIECES: Final = 100_000
"""Largest number of boxes that one row of a table may stand for."""

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
    "scatole kartony kartonow paczki units unit einheiten items cs ctn ctns szt pz pzas st"
)
_BOXES: Final = word_set(
    "box boxes bx carton cartons karton kartons kartonanzahl case cases cs ctn ctns colli collo kolli packstucke caja "
    "cajas bulto bultos colis scatole kartony kartonow paczki packages parcels kisten doos"
)
"""Words for boxes in names of columns that count boxes and not pieces."""
_BOX: Final = word_set("box carton karton case ctn kiste caja collo colis kartonu scatola doos caixa")
"""Words for one box in names of columns with the weight of one box."""
_COUNTED: Final = _PIECES | word_set(
    "nb nbr nombre n no num number of ordered order total gesamt totale bestellt bestellmenge de di anz "
    "pro per commandes pedidas ordinati zamowione pick picked"
)
"""A column has quantities if four conditions hold: its name has a word of ``_PIECES``; all words of its name are in
``_COUNTED``; its cells are whole numbers; and no other column is named as a quantity."""
_QUANTITY: Final = word_set("qta bestellmenge bestellt ordered commande pedida ordinata zamowiono need demand bedarf")
"""Names that by themselves mean a column of quantities."""
_NO_QUANTITY: Final = word_set(
    "price preis prix precio prezzo cena priority prio profit value wert zone temperature temp color colour farbe date "
    "datum year zip plz line zeile row ligne riga rotation rotations stackable fragile max min limit layer level class "
    "klasse vpe lot batch charge stack stacking position pos volume weight index stop destination family customer "
    "store route dock door aisle"
)
"""Words in names of columns whose whole numbers are not quantities."""
_LAYER: Final = word_set("layer lage schicht couche capa strato warstwa warstwe warstwie")
_PER: Final = word_set("per pro je par por na w each a")
_ORDERS: Final = word_set(
    "order orders auftrag auftrage auftragsnr auftragsnummer bestellung bestellnr bestellnummer commande commandes "
    "pedido pedidos ordine ordini zamowienie zamowienia po lieferschein lieferung sendung delivery shipment livraison "
    "entrega consegna dostawa"
)
_NUMBERED: Final = word_set("nr no number nummer numero n id num sales purchase customer kunden name code deg")
"""A column has ids of orders if its name has a word of ``_ORDERS``, and all its other words are in ``_NUMBERED``."""
_ARTICLE: Final = word_set("indeks towar goods ware good mercancia merce marchandise")
_TYPE: Final = word_set("type typ kind name code")
_PIECE: Final = word_set("box carton karton case item package")
"""A column of unknown meaning has articles if its name is a word of ``_ARTICLE``. It also has articles if its name has
a word of ``_TYPE``, and all its other words are in ``_TYPE`` or ``_PIECE``, such as "Box type"."""
_ORDER: Final = word_set("order orders ordre")
"""Names of columns that may have a packing order or customers' orders. The values in such a column decide which of the
two meanings it has."""


STRENGTH: Final = "strength_n"
UPRIGHT: Final = "upright"
BOX_PROPERTIES: Final = (STRENGTH, UPRIGHT)
"""Columns that are read only for environments in which packers are trained (``OrderReading.for_episodes``). These
columns are recognised only under exactly these names."""
SIZE_LETTERS: Final = "lwh"
"""The letters that the column ``upright`` may have: "l" for length, "w" for width, "h" for height."""


@dataclass(frozen=True, eq=False)
class ItemColumns:
    """The items of a source, by column.

    Attributes:
        source: where the items come from.
        size: (n, 3) length, width and height in the file's unit; NaN if a cell is bad.
        size_unit: unit according to names or cells; "": none is given.
        size_names: names of the columns of the three sizes, or of the one column that has all three.
        weight: (n,) weights in the file's unit; None: no column has weights.
        weight_unit: unit according to the name or the cells, for densities one of ``DENSITY_UNITS``; "": none is given.
        weight_is: meaning of ``weight``: the weight of a "box", the weight of a "row", or a "density"; "": the name
            does not tell whether it is the weight of a box or of a row.
        quantity: (n,) whole numbers of boxes; NaN if a cell is bad; None: one box per row.
        layers: (n,) whole numbers of layers; None: no column has them.
        per_layer: whether ``quantity`` is the number of boxes of one layer; None: the name does not tell.
        order, article, item_id, group: (n,) names; None: no column has them.
        sequence: (n,) order of arrival; None: no column has it.
        columns: role → name of its column.
        faults: row → (column, error text) of the first bad cell in the row.
        unread: names of columns that are not empty but are not used.
        maybe_quantity: the column with an unknown name that may have quantities, if no column is known to have them;
            "": there is none.
        strength: (n,) loads that the boxes can bear, N, NaN if unknown; None: no column ``strength_n``, or not
            requested.
        upright: (n,) letters of the sizes that may be vertical; None: no column ``upright``, or not requested.
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
    unread: tuple[str, ...]
    maybe_quantity: str
    strength: FloatArray | None
    upright: list[str] | None

    @property
    def n_rows(self) -> int:
        return len(self.source.boxes.table.rows)

    @property
    def is_empty(self) -> NDArray[np.bool_]:
        """(n,) whether a row has the quantity 0."""
        return np.zeros(self.n_rows, bool) if self.quantity is None else self.quantity == 0

    @property
    def weight_is_density(self) -> bool:
        return self.weight_is == "density"

    @property
    def boxes(self) -> BoxList:
        return self.source.boxes


def has_sizes_of_items(source: BoxSource) -> bool:
    """Whether a list has sizes. In packingsolver's items, X, Y and Z are sizes."""
    return source.boxes.has_sizes or _is_of_packingsolver(source.boxes.table.header)


def _is_of_packingsolver(header: Sequence[str]) -> bool:
    """Whether a table has the columns of packingsolver's items, in which X, Y and Z are sizes, not coordinates."""
    upper = {name.upper() for name in header}
    marks = upper & {"COPIES", "PROFIT"} or any(name.startswith("ROTATION") for name in upper)
    return upper >= {"X", "Y", "Z"} and not upper & {"LX", "LY", "LZ"} and bool(marks)


_PIECES_OF: Final = re.compile(
    r"^(\d+)\s*(?:x|pcs?|pieces?|stk|stck|st|stück|ea|each|units?|uds?|szt|pz|ctns?|cartons?|boxes|box)\.?$",
    re.IGNORECASE,
)
"""A number of pieces with its unit."""


class _ItemExtraction(ColumnExtraction):
    """The columns of one source while their meanings are being determined, including columns that only orders have.

    Attributes:
        of_box: columns of weights whose names say that a weight is the weight of one box.
    """

    roles = (*ROLES, *ITEM_ROLES)

    def __init__(self, source: BoxSource, chosen: Mapping[str, str], units: str, masses: str) -> None:
        super().__init__(source, chosen, units, masses)
        header = self.table.header
        self.of_box: set[int] = set()
        if _is_of_packingsolver(header):
            for index, name in enumerate(header):
                if name.upper() in ("X", "Y", "Z"):
                    self.meanings[index] = ColumnMeaning("size", name.lower())
        self._take_names_of_orders()
        for role in ITEM_ROLES:
            if role in self.fixed:
                self.meanings[self.fixed[role]] = ColumnMeaning(role)

    def _take_names_of_orders(self) -> None:
        """Determine the meanings of column names that only orders have."""
        kinds = self.kinds
        for index, name in enumerate(self.table.header):
            if name in self.unit_columns:
                continue
            listed = words_of(split_unit(name)[0])
            words, joined = set(listed), "".join(listed)
            meaning = self.meanings[index]
            if words & _WEIGHT and words & _TOTAL:
                self.meanings[index] = ColumnMeaning("total weight", unit=unit_in(name, MASS_UNITS))
            elif (
                joined in _UNIT_WEIGHT
                or (words & _WEIGHT and words & {"unit", "piece", "each", "stuck", "per"})
                or (meaning is not None and meaning.kind == "weight" and words & _BOX)
            ):
                self.meanings[index] = ColumnMeaning("weight", unit=unit_in(name, MASS_UNITS))
                self.of_box.add(index)
            elif words & _LAYER and words & _PER:
                self.meanings[index] = ColumnMeaning("per layer")
            elif (
                "quantity" not in kinds
                and not is_content(name)
                and ((self._is_quantity(words, joined) and self._is_whole(index)) or self._counts_pieces(index))
            ):
                self.meanings[index] = ColumnMeaning("quantity")
            elif ("plan" not in kinds and words & _ORDERS and words & _NUMBERED and words <= _ORDERS | _NUMBERED) or (
                meaning is None and joined in _ORDERS
            ):
                self.meanings[index] = ColumnMeaning("plan")
            elif meaning is None and (joined in _ARTICLE or (words & _TYPE and words <= _TYPE | _PIECE)):
                self.meanings[index] = ColumnMeaning("article")

    def check_pieces(self, quantity: int) -> None:
        """Refuse a column of quantities that may count pieces instead of boxes: its name has no word for boxes, and
        another column has the number of pieces in each box."""
        name = self.table.header[quantity]
        if set(words_of(name)) & _BOXES:
            return
        for index, content in enumerate(self.table.header):
            if self.meanings[index] is not None or not is_content(content):
                continue
            if any(number is not None and number.value > 1 for number in self.cell_numbers(index)):
                counted, content = printable_name(name), printable_name(content)
                raise InputError(
                    f"{TWO_WAYS} {counted} counts boxes, or pieces ({content} is the number of pieces in a box); if it "
                    f"counts boxes, say --columns quantity={counted}"
                )

    @staticmethod
    def _is_quantity(words: set[str], joined: str) -> bool:
        if words & _PER:
            return False
        return joined in _QUANTITY | _PIECES or bool(words & _PIECES and words <= _COUNTED)

    def _counts_pieces(self, index: int) -> bool:
        """Whether all cells of a column are numbers of pieces: "3 pcs"."""
        cells = [cell for cell in self.cells(index) if cell not in (None, "")]
        return bool(cells) and all(isinstance(cell, str) and _PIECES_OF.match(cell.strip()) for cell in cells)

    def _is_whole(self, index: int) -> bool:
        """Whether most cells of a column are whole numbers, but no identifiers. Numbers are identifiers if they
        increase by equal steps (10, 20, 30), if they increase over many rows, or if they are all large."""
        numbers = self.cell_numbers(index)
        integers = [number.value for number in numbers if number is not None and number.value.is_integer()]
        if len(integers) * 2 <= len(numbers):
            return False
        steps = np.diff(integers)
        is_rising = len(integers) > 2 and bool((steps > 0).all())
        is_even = is_rising and bool((steps == steps[0]).all())
        return not is_even and not (is_rising and len(integers) >= _LEAST_RISING) and min(integers) <= MOST_ITEMS

    def maybe_quantity(self) -> str:
        """A column with an unknown name that may have quantities, because its cells are small whole numbers; "" if
        there is none.

        If articles are repeated, and no column has the names of orders, each row is a single box, so no column has
        quantities.
        """
        articles = next((texts for kind in ("article", "item_id") if (texts := self.texts(kind)[0])), None)
        if articles is not None and len(set(articles)) < len(articles) and "plan" not in self.kinds:
            return ""
        for index, name in enumerate(self.table.header):
            is_other = name in BOX_PROPERTIES or bool(set(words_of(name)) & _NO_QUANTITY) or is_content(name)
            is_other |= bool(split_unit(name)[1])  # a number with a unit of length or mass is no quantity
            if self.meanings[index] is not None or index in self.fixed.values() or is_other:
                continue
            numbers = self.cell_numbers(index)
            values = [number.value for number in numbers if number is not None and not number.unit]
            all_integers = len(values) == len(numbers) and all(value.is_integer() for value in values)
            if all_integers and self._is_whole(index) and 1 < max(values) <= MOST_ITEMS and min(values) >= 0:
                return name
        return ""

    def column_of(self, role: Kind) -> int | None:
        """The column that an option names for a role of ``ITEM_ROLES``, or else the first column whose name means this
        role. The result is None if the role has no column."""
        if role in self.fixed or role in self.ignored:
            return self.fixed.get(role)
        return next((index for index in self.indices(role) if index not in self.fixed.values()), None)

    def counts(self, index: int, smallest: int, otherwise: float | None = None) -> FloatArray:
        """(n,) whole numbers of a column; NaN if a cell is bad.

        Args:
            otherwise: the number for an empty cell; None: an empty cell is bad.
        """
        values = np.full(len(self.table.rows), np.nan)
        for row, cell in enumerate(self.cells(index)):
            if otherwise is not None and cell in (None, ""):
                values[row] = otherwise
                continue
            pieces = _PIECES_OF.match(cell.strip()) if isinstance(cell, str) else None
            number = cell_number(pieces[1] if pieces else cell, self.table.decimal)
            if number is not None and number.value.is_integer() and smallest <= number.value <= MOST_PIECES:
                values[row] = number.value
                continue
            shown = f'from {smallest} to {MOST_PIECES:,}, got "{printable_name(cell_text(cell))}"'
            self.bad(row, index, "is missing" if cell in (None, "") else f"must be a whole number {shown}")
        return values

    def strengths(self) -> FloatArray | None:
        """(n,) loads that the boxes can bear, N; NaN if the cell is empty or bad; None if there is no such column."""
        if STRENGTH not in self.table.header:
            return None
        index = self.table.header.index(STRENGTH)
        values = np.full(len(self.table.rows), np.nan)
        for row, cell in enumerate(self.cells(index)):
            if cell in (None, ""):
                continue
            number = cell_number(cell, self.table.decimal)
            if number is None or number.unit:
                self.bad(row, index, number_fault_of(cell, self.table.decimal))
                continue
            values[row] = number.value
            if (fault := sparse_fault(STRENGTH, number.value)) is not None:
                self.bad(row, index, fault.removeprefix(f"{STRENGTH} "))
        return values

    def sides(self) -> list[str] | None:
        """(n,) letters of the sizes that may be vertical, in lower case; None if there is no such column."""
        if UPRIGHT not in self.table.header:
            return None
        index = self.table.header.index(UPRIGHT)
        texts = [cell_text(cell).lower() for cell in self.cells(index)]
        for row, text in enumerate(texts):
            if not set(text) <= set(SIZE_LETTERS):
                self.bad(row, index, f'must be letters of l, w and h, or empty, got "{printable_name(text)}"')
        return texts

    def _check_single(self, columns: Mapping[str, str]) -> None:
        """Refuse a table with another column for one of the sizes in ``columns`` (role → name), such as the size of the
        content of a carton, unless an option names the right one."""
        for role, name in columns.items():
            index = self.table.header.index(name)
            meaning = self.meanings[index]
            if role in self.fixed or meaning is None:
                continue
            for other, rival in enumerate(self.meanings):
                if other == index or rival is None or rival.of_container or rival.placed != meaning.placed:
                    continue
                if (rival.kind, rival.axis) == (meaning.kind, meaning.axis) and self.cells(other) != self.cells(index):
                    raise self.tie(role, name, self.table.header[other])

    @staticmethod
    def tie(role: str, name: str, other: str) -> InputError:
        """The error for two columns that could have the same role."""
        return InputError(
            f"{TWO_WAYS} the {role} is {printable_name(name)}, or {printable_name(other)}; say which with --columns "
            f"{role}={name} or --columns {role}={other}"
        )

    def sizes(self) -> tuple[FloatArray, str, tuple[str, ...]] | None:
        """(n, 3) length, width and height, their unit, and the names of their columns; None if there are no sizes."""
        sizes = sizes_in(self)
        if sizes is None:
            return None
        values, axes, unit, _, columns, *_ = sizes
        self._check_single(columns)
        upright = next((axis for axis in ("height", "z", "2", "depth") if axis in axes), axes[2])
        order = [index for index, axis in enumerate(axes) if axis != upright] + [axes.index(upright)]
        names = tuple(columns.values())
        return values[:, order], unit, tuple(names[index] for index in order) if len(names) == 3 else names


def item_columns(
    source: BoxSource, chosen: Mapping[str, str], units: str, masses: str, *, properties: bool
) -> ItemColumns | None:
    """Determine the columns of a source of items; None if the source has no sizes.

    Args:
        chosen: role (``ROLES``, ``ITEM_ROLES``) → name of the column that has it, or "-".
        units: the unit that an option sets for all lengths; "" if no such option is given.
        masses: the unit that an option sets for all masses; "" if no such option is given.
        properties: whether ``BOX_PROPERTIES`` are read.

    Raises:
        InputError: a chosen column does not exist.
    """
    work = _ItemExtraction(source, chosen, units, masses)
    sizes = work.sizes()
    if sizes is None:
        return None
    header = source.boxes.table.header
    columns: dict[str, str] = {}
    layer_index = work.column_of("per layer")
    quantity_index, per_layer = work.column_of("quantity"), None
    if layer_index is not None and (quantity_index is None or "per layer" in work.fixed):
        quantity_index, per_layer = layer_index, True
    elif layer_index is not None or "quantity" in chosen:
        per_layer = False
    if quantity_index is not None and "quantity" not in chosen and not per_layer:
        cells = work.cells(quantity_index)
        for index in work.indices("quantity", of_container=True):
            if work.cells(index) != cells:
                raise work.tie("quantity", header[quantity_index], header[index])
        work.check_pieces(quantity_index)
    layers_index = work.column_of("layers")
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
    group, group_name = work.texts("group")
    if order is not None:
        columns["plan"] = order_name or header[sequence_index or 0]
        order = work.filled_down(order, columns["plan"])
    columns |= {role: name for role, name in (("article", article_name), ("item_id", item_name)) if name}
    values, size_unit, names = sizes
    strength, upright = (work.strengths(), work.sides()) if properties else (None, None)
    used = {*names, *columns.values(), group_name, *(BOX_PROPERTIES if properties else ())}
    used |= set() if sequence_index is None else {header[sequence_index]}
    maybe = "" if quantity is not None or "quantity" in chosen else work.maybe_quantity()
    unread = [name for index, name in enumerate(header) if name not in used and not work.is_empty(index)]
    return ItemColumns(
        work.source, values, size_unit, names, weight, unit, weight_is, quantity, layers, per_layer, order, article,
        item_id, group, sequence, columns, work.faults, tuple(unread), maybe, strength, upright,
    )  # fmt: skip


def _weight(work: _ItemExtraction, columns: dict[str, str]) -> tuple[FloatArray | None, str, str]:
    """(n,) weights or densities, their unit, and their meaning (``ItemColumns.weight_is``). The role and the name of
    their column are added to ``columns``."""
    header = work.table.header
    index = None if "total weight" in work.fixed and "weight" not in work.fixed else weight_column(work)
    is_of_box = index in work.of_box or "weight" in work.fixed or "total weight" in work.ignored
    role, weight_is = "weight", "box" if is_of_box else ""
    if index is None:
        index, role, weight_is = work.column_of("total weight"), "total weight", "row"
    if index is not None:
        weight, unit = work.weights(index)
        if weight is None:
            return None, "", ""
        columns[role] = header[index]
        return weight, unit, weight_is
    index = work.first("density")
    if index is None:
        return None, "", ""
    columns["density"] = header[index]
    return *work.densities(index), "density"


def _orders_in(work: _ItemExtraction, index: int) -> list[str] | None:
    """(n,) customers' orders from a column called "order". The column counts as a column of customers' orders if some
    of its values are repeated or are not numbers. If all its values are different numbers, the column is a packing
    order, and the result is None."""
    if not _ORDER.intersection(words_of(work.table.header[index])) or "sequence" in work.fixed:
        return None
    cells = [cell_text(cell) for cell in work.cells(index)]
    numbers = [cell_number(cell) for cell in cells]
    if len(set(cells)) == len(cells) and all(numbers):
        return None
    return cells
