"""Turns items, given by column, into orders (``orders_of_items``): chooses units, masses, quantities and targets
(carriers).

If column names do not give a unit, sizes and densities decide which unit is used. A file with two possible readings is
refused. Items without weights get the mass that an assumed density gives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable_name
from petmjx.common.units import FloatArray
from petmjx.options.run_options import RunOptions
from petmjx.plans.cell_numbers import thousands_faults
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS, OWN_COLUMNS, UNIT_WORDS, limits_in
from petmjx.plans.item_columns import TWO_WAYS, ItemColumns
from petmjx.plans.known_forms import KnownForm
from petmjx.plans.masses_and_densities import SET_KG_M3, USUAL_KG_M3, masses_kg
from petmjx.plans.order import MOST_ITEMS, TARGET_EXTENT_MM, Item, Order, target_extent_mm, target_named
from petmjx.plans.order_texts import LENGTHS, MPV, THPACK
from petmjx.plans.placed_boxes import fault_of_rows
from petmjx.plans.plan_fields import LARGEST_MM, LONGEST_NAME, SMALLEST_MM, positive_fault
from petmjx.plans.plausibility import deck_cost, density_cost, side_cost
from petmjx.plans.raw_tables import names_with_lost_rows, rows_by_name
from petmjx.plans.reading_choice import MASS_PRIOR, TIE
from petmjx.plans.readings import Wishes, wishes_of

EURO: Final = "euro-pallet"
_PALLET_MM: Final = (300.0, 1700.0)
"""Limits of the sides of a container that may be a pallet. A container with other sides is not a pallet, so its boxes
are packed on a Euro pallet instead."""

_LENGTH_PRIOR: Final = {"mm": 0.0, "cm": 0.0, "m": 0.0, "in": 0.7, "ft": 3.0}
_MIXED_UNITS_COST: Final = 1.5
"""Cost of a reading that mixes systems of units (inches with kilograms, or pounds with metric lengths), if no names
give the units."""
_DENSEST_KG_M3: Final = 1e6
"""Densities above this value come from damaged weights, so they are no evidence for or against a unit."""
_BIN_PRIOR: Final = {"mm": 0.0, "cm": 0.0, "dm": 0.0}
"""Unit of lengths that test problems of packing research may have → its cost (all are equally plausible). In such
problems, the side of a bin is 10 or 100 units, which stand for 1 m."""
_LIST_PRIOR: Final = {"cm": -1.5, "mm": 0.0, "m": 0.0}
"""Unit that lists of lengths may have → its cost; a smaller cost is more plausible. The unit is cm, as in RoboBPP's
lists, unless the sizes indicate another unit."""
ROW_LEAD: Final = 0.75
"""A weight in a row is usually the weight of one box, even if the row stands for several boxes. But if the reading with
weights of whole rows has a cost that is lower by more than this value, both readings count as possible, and the file is
refused. For example, boxes in rows of ten may have an implausible 1,500 kg/m³ if a weight is the weight of one box, and
150 kg/m³ if it is the weight of the row."""
_FULL: Final = 1.02
"""Largest share of an order's target (its carrier) that one layer can cover. Some column names do not tell whether
quantities count the boxes of one layer or of all layers. In this case, if the boxes of a quantity would cover a larger
share in a single layer, quantities count the boxes of all layers."""

PG: Final = KnownForm("RoboBPP's pg.xlsx", "cm", "kg")
DELI: Final = KnownForm("RoboBPP's deli.xlsx", "cm")
SIZES: Final = KnownForm("an array of sizes")
_WITHOUT_MASSES: Final = (LENGTHS.name, DELI.name)
"""Forms without masses, whose boxes get the density ``SET_KG_M3``."""
_NUMBERED: Final = (THPACK.name, MPV.name, LENGTHS.name, DELI.name, SIZES.name)
"""Forms whose orders only have numbers as names. The name of the file is put before the number."""


@dataclass(frozen=True)
class OrderReading:
    """Options of a caller for reading a file of orders. Files in BED-BPP's own form need no such options.

    Attributes:
        wishes: columns, units and density. Empty values are chosen by plausibility.
        target: carrier of orders that name none: "euro-pallet", "rollcontainer", or sizes in millimetres such as
            "1200x1000"; "": the file's container if it is a pallet, else a Euro pallet.
        most_items: largest number of items of an order.
        items: file with the sizes and weights of articles, for orders that give only the articles; None: no file.
        for_episodes: whether ``strength_n`` and ``upright`` are read. If ``for_episodes`` is True, no line about the
            reading is made for a table that has only petmjx's own column names, because an environment reads its orders
            often.
    """

    wishes: Wishes = field(default_factory=Wishes)
    target: str = ""
    most_items: int = MOST_ITEMS
    items: Path | None = None
    for_episodes: bool = False

    @classmethod
    def of(cls, options: RunOptions, target: str | None = None) -> OrderReading:
        """Make an ``OrderReading`` from the options of a run: ``units``, ``columns``, ``density``, ``items``, and
        ``reading`` (a file that describes how files are read).

        Raises:
            InputError: the target is unknown, or the file with the reading cannot be read.
        """
        return cls(wishes_of(options), "" if target is None else target_named(target), items=options.items)


@dataclass(frozen=True, eq=False)
class ForeignOrders:
    """The orders of a file.

    Attributes:
        orders: (id, order) of each good order, in the order of the file.
        refused: (id, line) of each refused order.
        line: how the file was read; "" if there was nothing to choose and all columns are used.
    """

    orders: tuple[tuple[str, Order], ...]
    refused: tuple[tuple[str, str], ...]
    line: str


class _Units(NamedTuple):
    """One choice of the units of an order's numbers.

    Attributes:
        cost: how implausible the units are; a smaller cost is better.
        length, mass: the units.
        of_rows: whether a weight is the weight of a whole row.
    """

    cost: float
    length: str
    mass: str
    of_rows: bool


def orders_of_items(columns: ItemColumns, source: str, reading: OrderReading) -> ForeignOrders:
    """Read the orders in a list of items.

    Args:
        source: name of the file in messages.

    Raises:
        InputError: the items can be read in two ways, or no item is good. The line does not name the file.
    """
    return _OrderBuilder(columns, source, reading).orders()


class _OrderBuilder:
    """Builds the orders from one list of items."""

    def __init__(self, columns: ItemColumns, source: str, reading: OrderReading) -> None:
        self.columns, self.source, self.reading = columns, source, reading
        self.table = columns.boxes.table
        self.form = columns.source.form
        self.notes: list[str] = [*columns.source.notes, *self.table.notes, *columns.boxes.left_out]
        self.faults = {row: f"{column} {text}" for row, (column, text) in columns.faults.items()}

    def orders(self) -> ForeignOrders:
        if name := self.columns.maybe_quantity:
            raise InputError(
                f"{TWO_WAYS} each row is one box, or {printable_name(name)} counts its boxes; say which with --columns "
                f"quantity=- or --columns quantity={name}"
            )
        names = self._names()
        rows_of = {name: rows.tolist() for name, rows in rows_by_name(names).items()}
        units = self._units()
        size = self.columns.size * LENGTH_UNITS[units.length]
        self._check_sizes(units.length)
        targets = {name: self._target(name, rows[0], units.length) for name, rows in rows_of.items()}
        counts = self._counts(size, targets, names)
        usual_kg_m3 = SET_KG_M3 if self.form.name in _WITHOUT_MASSES else USUAL_KG_M3
        mass = masses_kg(
            *(self.columns, units.mass, size, self.reading.wishes, self.faults, self.notes),
            length_unit=units.length,
            usual_kg_m3=usual_kg_m3,
            counts=counts if units.of_rows else None,
        )
        self._leave_out_empty_rows()
        lost = names_with_lost_rows(self.table, names)
        good_orders: list[tuple[str, Order]] = []
        refused: list[tuple[str, str]] = []
        for name, rows in rows_of.items():
            location = f"{self.source}: order {printable_name(name)}"
            if (fault := self._fault(rows, lost.get(name), counts)) is not None:
                refused.append((name, f"{location}{fault}"))
                continue
            good_orders.append((name, self._order(targets[name], self._sorted(rows), counts, size, mass)))
        return ForeignOrders(tuple(good_orders), tuple(refused), self._line(units, targets, good_orders))

    # Names and rows.

    def _names(self) -> list[str]:
        """(n,) for each row, the id of its order."""
        parts = self.columns.boxes.parts
        column = self.columns.order
        stem = Path(self.source).name.split(".")[0] or "order"
        names = [
            "/".join(filter(None, (part, "" if column is None else column[row])))[:LONGEST_NAME]
            for row, part in enumerate(parts)
        ]
        if column is None and self.form.name in _NUMBERED:
            return [f"{stem}-{name}" if name else stem for name in names]
        if column is not None and (nameless := sum(not name for name in names)):
            self.notes.append(
                f"rows without an order's name are read as order {printable_name(stem)} ({count_text(nameless, 'row')})"
            )
        return [name or stem for name in names]

    def _leave_out_empty_rows(self) -> None:
        """Drop the faults of rows with the quantity 0, since these rows stand for no box, and add a note about the
        rows."""
        empty = np.flatnonzero(self.columns.is_empty).tolist()
        for row in empty:
            self.faults.pop(row, None)
        if empty:
            places = first_names([self.table.places[row] for row in empty], 3)
            name = printable_name(self.columns.columns["per layer" if self.columns.per_layer else "quantity"])
            self.notes.append(f"{count_text(len(empty), 'row')} left out, since {name} is 0: {places}")

    def _fault(self, rows: Sequence[int], lost: tuple[str, str] | None, counts: NDArray[np.int64]) -> str | None:
        """Why an order is refused; None if it is good."""
        if lost is not None:
            return f", {': '.join(lost)}"
        if (fault := fault_of_rows(rows, self.faults, self.table.places.__getitem__)) is not None:
            return f", {fault}"
        n_items = int(counts[list(rows)].sum())
        if not n_items:
            return ": must have at least one item: all quantities are 0"
        if n_items > (most := self.reading.most_items):
            one = " (several orders? name their column: --columns plan=NAME)" if self.columns.order is None else ""
            return f": must have at most {most:,} items, got {n_items:,}{one}"
        return None

    def _sorted(self, rows: Sequence[int]) -> list[int]:
        """The rows of an order, sorted by arrival."""
        sequence = self.columns.sequence
        if sequence is None or np.isnan(sequence[list(rows)]).any():
            return list(rows)
        return sorted(rows, key=lambda row: float(sequence[row]))

    def _order(
        self, target: str, rows: Sequence[int], counts: NDArray[np.int64], size: FloatArray, mass: FloatArray
    ) -> Order:
        columns = self.columns
        items: list[Item] = []
        for row in rows:
            article = "" if columns.article is None else columns.article[row][:LONGEST_NAME]
            item_id = "" if columns.item_id is None else columns.item_id[row][:LONGEST_NAME]
            name = article or item_id or self.table.places[row]
            group = "" if columns.group is None else columns.group[row][:LONGEST_NAME]
            length, width, height = size[row].tolist()
            strength = math.nan if columns.strength is None else float(columns.strength[row])
            item = Item(
                *(name, item_id or name, group, length, width, height, float(mass[row])),
                strength_n=None if math.isnan(strength) else strength,
                upright="" if columns.upright is None else columns.upright[row],
            )
            items += [item] * int(counts[row])
        return Order(target, tuple(items), tuple(range(1, len(items) + 1)))

    # Units.

    def _units(self) -> _Units:
        """The most plausible units.

        Raises:
            InputError: two units of lengths are possible; or it is unclear whether a weight is the weight of a box or
                of a row; or no row is good.
        """
        columns, wishes = self.columns, self.reading.wishes
        is_good = np.array([row not in self.faults for row in range(columns.n_rows)])
        if not columns.is_empty.all():
            is_good &= ~columns.is_empty
        with np.errstate(invalid="ignore"):
            is_good &= (columns.size > 0).all(axis=1)
        if not is_good.any():
            row = min(self.faults, default=0)
            names = columns.size_names
            axis = int(np.argmin(np.nan_to_num(columns.size[row], nan=1.0)))
            value = columns.size[row, axis]
            fault = self.faults.get(row, f"{names[axis if len(names) == 3 else 0]} must be > 0, got {value:g}")
            raise InputError(f"{self.table.places[row]}: {fault}")
        unit_text = wishes.length_units[0] or columns.size_unit or self.form.units
        prior = _BIN_PRIOR if self.form in (MPV, SIZES) else _LIST_PRIOR if self.form is LENGTHS else _LENGTH_PRIOR
        lengths = {unit_text: 0.0} if unit_text else dict(prior)
        masses: dict[str, float] = {"kg": 0.0}
        weighed = columns.weight is not None and not columns.weight_is_density
        if weighed:
            mass_unit = wishes.masses or columns.weight_unit or self.form.masses
            masses = {mass_unit: 0.0} if mass_unit else dict(MASS_PRIOR)
        several = columns.quantity is not None and bool((columns.quantity[is_good] > 1).any())
        of_rows = [False]
        if weighed and columns.weight_is == "row":
            of_rows = [True]
        elif weighed and columns.weight_is == "" and several:
            of_rows = [False, True]
        choices = sorted(
            _Units(self._unit_cost(length, mass, rows, is_good) + length_cost + mass_cost, length, mass, rows)
            for length, length_cost in lengths.items()
            for mass, mass_cost in masses.items()
            for rows in of_rows
        )
        of_boxes, of_whole = (
            next((units for units in choices if units.of_rows == rows), None) for rows in (False, True)
        )
        if of_boxes is not None and of_whole is not None and of_whole.cost + ROW_LEAD < of_boxes.cost:
            name = columns.columns["weight"]
            raise InputError(
                f"{TWO_WAYS} {printable_name(name)} is of one box, or of all boxes of a row; say which "
                f"with --columns weight={name} or --columns 'total weight={name}'"
            )
        best = of_boxes or choices[0]
        close = (units for units in choices if units.of_rows == best.of_rows and units.cost < best.cost + TIE)
        if (other := next((units for units in close if units.length != best.length), None)) is not None:
            ways = (
                f"lengths in {UNIT_WORDS.get(unit, unit)} ({self._shown(unit, is_good)})"
                for unit in (best.length, other.length)
            )
            raise InputError(f"{TWO_WAYS} {', or '.join(ways)}; say which with --units")
        return best

    def _unit_cost(self, length: str, mass: str, of_rows: bool, good: NDArray[np.bool_]) -> float:
        columns, factor = self.columns, LENGTH_UNITS[length]
        size = columns.size[good] * factor
        cost = side_cost(float(np.exp(np.log(size).mean())))
        cost += 20.0 * (float(size.max()) > LARGEST_MM) + 20.0 * (float(size.min()) < SMALLEST_MM)
        container = self._container(next(iter(columns.boxes.containers), ""))
        if container is not None:
            cost += deck_cost(container[:2] * factor)
        if columns.weight is None or columns.weight_is_density:
            return cost
        kg = columns.weight[good] * MASS_UNITS[mass]
        if of_rows and columns.quantity is not None:
            with np.errstate(invalid="ignore", divide="ignore"):
                kg = kg / columns.quantity[good]
        with np.errstate(invalid="ignore", divide="ignore"):
            densities = kg / (size.prod(axis=1) / 1e9)
        densities = densities[(densities > 0) & (densities < _DENSEST_KG_M3)]
        if len(densities):
            cost += density_cost(float(np.median(densities)))
        return cost + _MIXED_UNITS_COST * ((length in ("in", "ft")) != (mass == "lb"))

    def _shown(self, unit: str, good: NDArray[np.bool_]) -> str:
        sides = np.median(self.columns.size[good], axis=0) * LENGTH_UNITS[unit]
        return f"boxes of {' × '.join(f'{side:.0f}' for side in sides)} mm"

    # Targets.

    def _container(self, part: str) -> FloatArray | None:
        """Length, width and height of a container in the file's unit; None if the file gives none."""
        containers = self.columns.boxes.containers
        sizes = containers.get(part) or containers.get("") or {}
        if len(sizes) < 2:
            return None
        upright = next((axis for axis in ("height", "z", "2", "depth") if axis in sizes), None)
        level = [value for axis, value in sizes.items() if axis != upright][:2]
        if len(level) < 2:
            return None
        return np.array([*level, math.nan if upright is None else sizes[upright]])

    def _target(self, name: str, row: int, unit: str) -> str:
        """The carrier of an order."""
        if self.reading.target:
            return target_named(self.reading.target)
        container = self._container(self.columns.boxes.parts[row])
        if container is None:
            return EURO
        level = container[:2] * LENGTH_UNITS[unit]
        for target_name, extent in TARGET_EXTENT_MM.items():
            if np.allclose(sorted(level), sorted(extent), rtol=0.005):
                return target_name
        low, high = _PALLET_MM
        if ((level >= low) & (level <= high)).all():
            return target_named(f"{level[0]:g}x{level[1]:g}")
        self.notes.append(f"the container, {level[0]:,.0f} × {level[1]:,.0f} mm, is no pallet; a Euro pallet is taken")
        return EURO

    # Quantities and sizes.

    def _counts(self, size: FloatArray, targets: Mapping[str, str], names: Sequence[str]) -> NDArray[np.int64]:
        """(n,) the number of boxes of each row.

        Raises:
            InputError: it is unclear whether a quantity counts the boxes of one layer or of all layers.
        """
        columns = self.columns
        if columns.quantity is None:
            return np.ones(columns.n_rows, np.int64)
        quantity = np.nan_to_num(columns.quantity)
        if columns.layers is None:
            return quantity.astype(np.int64)
        layers = np.nan_to_num(columns.layers, nan=1.0)
        per_layer = columns.per_layer
        if per_layer is None and (layers > 1).any():
            several = layers > 1
            areas = np.array([math.prod(target_extent_mm(targets[name])) for name in names])
            cover = quantity * size[:, 0] * size[:, 1] / areas
            with np.errstate(invalid="ignore"):
                if bool((cover[several] <= _FULL).all()):
                    name = columns.columns["quantity"]
                    raise InputError(
                        f"{TWO_WAYS} {printable_name(name)} counts the boxes of one layer, or of all layers; say which "
                        f"with --columns 'per layer={name}' or --columns quantity={name}"
                    )
            self.notes.append("the quantity in a row is the number of boxes in all its layers")
        elif per_layer:
            self.notes.append("the quantity in a row is the number of boxes in each of its layers")
        return (quantity * layers if per_layer else quantity).astype(np.int64)

    def _check_sizes(self, unit: str) -> None:
        """Add faults for sizes out of range."""
        limits = limits_in(SMALLEST_MM, LARGEST_MM, unit)
        size, names = self.columns.size, self.columns.size_names
        for name in names if len(names) == 3 else ():
            cells, decimal = self.table.column(name), self.table.decimal
            for row, text in thousands_faults(cells, decimal, unit, are_sizes=True).items():
                self.faults.setdefault(row, f"{name} {text}")
        with np.errstate(invalid="ignore"):
            is_bad = (size < limits[0]) | (size > limits[1])
        for row in np.flatnonzero(is_bad.any(axis=1)).tolist():
            axis = int(np.flatnonzero(is_bad[row])[0])
            fault = positive_fault(names[axis if len(names) == 3 else 0], float(size[row, axis]), *limits)
            if fault is not None:
                self.faults.setdefault(row, fault)

    # The following methods make the line that tells how a table of orders was read: units, columns, and numbers of
    # orders and boxes.

    def _has_own_names(self) -> bool:
        columns = self.columns
        roles = columns.columns
        is_own = (*columns.size_names, roles.get("weight")) == OWN_COLUMNS
        return is_own and {*roles.values()} <= _OWN_NAMES

    def _line(self, units: _Units, targets: Mapping[str, str], good: Sequence[tuple[str, Order]]) -> str:
        columns = self.columns
        if self.reading.for_episodes and self._has_own_names() and not columns.unread and not self.notes:
            return ""
        lengths = (
            units.length if columns.weight is None or columns.weight_is_density else f"{units.length}, {units.mass}"
        )
        names = [*columns.size_names, *(columns.columns[role] for role in _ROLES_IN_NOTES if role in columns.columns)]
        boxes = sum(len(order.items) for _, order in good)
        kinds = list(dict.fromkeys(targets.values()))
        parts = [
            f"{count_text(len(good), 'order')}, {count_text(boxes, 'box', 'boxes')}",
            lengths,
            f"columns {', '.join(map(printable_name, names))}",
            f"packed on {first_names(kinds, 3)}",
            *(["one box a row"] if columns.quantity is None and self.form.name not in _NUMBERED else []),
            *([f"not used: {first_names(columns.unread)}"] if columns.unread else []),
        ]
        return f"{self.source}: read as {self.form.name}; {'; '.join([*parts, *dict.fromkeys(self.notes)])}"


_OWN_NAMES: Final = {"weight_kg", "quantity", "order_id", "plan_id", "article", "item_id"}
_ROLES_IN_NOTES: Final = ("weight", "total weight", "density", "quantity", "per layer", "layers", "plan")
"""A line for the user tells how a table of orders was read. The line names the columns of the sizes first, and then the
columns with these roles."""
