"""A packing plan in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import array_of, list_of, text_of
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.common.units import PLAN_UNITS
from petmjx.options.run_options import Anchor
from petmjx.plans.input_conventions import InputConventions
from petmjx.plans.plan_fields import KINDS, PALLET_KINDS, SHEET, SPARSE, joined_names, pallet_fault


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Plan:
    """One packing plan. Rows are placements in packing order, counted from 0. Lengths are in millimetres.

    Attributes:
        plan_id: the plan's key in its file.
        source: name of its file, for messages.
        size_mm: (n, 3) extents of the boxes along x, y, z as placed, that is, after they were turned.
        corner_mm: (n, 3) front-left-bottom corners; z = 0 is the top of the carrier.
        mass_kg: (n,) masses, kg.
        item_ids, articles: n names each.
        sequence: (n,) running number of each item within the customer's order.
        orientation: (n,) 0 if the item's length lies along x, 1 if it lies along y. None: unknown, so the extents along
            x and y are assumed to be the item's length and width.
        product_groups: n names, "" for an item without a group; empty if no item has a group.
        materials: n names of materials, which determine friction (petmjx.options.materials); "": unknown for this box;
            empty: unknown for all boxes.
        mass_center_mm: (n, 3) centres of mass relative to the middles of the boxes, along x, y and z; None: they are
            all in the middles.
        approach_deg: (n,) horizontal direction in which each box moves to its place, in degrees from +x towards +y;
            NaN: this box may move in any direction; None: all boxes may. The direction is used when boxes are carried
            (``petmjx.options.placing``).
        stiffness_n_mm: (n,) stiffness of the box in a press: force on its top divided by the compression, N/mm; NaN:
            the box is rigid; None: all boxes are rigid.
        strength_n: (n,) load that the box can bear on its top, N; NaN: unknown for this box; None: unknown for all
            boxes.
        kinds: for each of the n items "box", "sheet" (an interlayer sheet) or the name of a pallet, such as "epal-1";
            empty: all are boxes.
    """

    plan_id: str
    source: str
    size_mm: NDArray[np.float64]
    corner_mm: NDArray[np.float64]
    mass_kg: NDArray[np.float64]
    item_ids: tuple[str, ...]
    articles: tuple[str, ...]
    sequence: NDArray[np.int64]
    orientation: NDArray[np.int64] | None = None
    product_groups: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()
    mass_center_mm: NDArray[np.float64] | None = None
    approach_deg: NDArray[np.float64] | None = None
    stiffness_n_mm: NDArray[np.float64] | None = None
    strength_n: NDArray[np.float64] | None = None
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Convert lists to arrays, and refuse values that no engine could use.

        Errors name the field. The errors of ``from_boxes`` also name the box.

        Raises:
            InputError: a field has a wrong type or length, or a number is not finite or not positive.
        """
        text_of(self.plan_id, "plan_id")
        text_of(self.source, "source")
        fields: dict[str, Any] = {
            "size_mm": array_of(self.size_mm, "size_mm", (3,)),
            "corner_mm": array_of(self.corner_mm, "corner_mm", (3,)),
            "mass_kg": array_of(self.mass_kg, "mass_kg", ()),
            **{name: tuple(list_of(getattr(self, name), name, str, "text")) for name in ("item_ids", "articles")},
            "sequence": _whole_numbers(self.sequence, "sequence"),
        }
        if self.orientation is not None:
            fields["orientation"] = _whole_numbers(self.orientation, "orientation")
            if not ((fields["orientation"] == 0) | (fields["orientation"] == 1)).all():
                raise InputError("orientation must be 0 or 1 for each box")
        for name, known in SPARSE.items():
            if (values := getattr(self, name)) is not None:
                fields[name] = array_of(values, name, (), may_lack=True)
                if ((fields[name] < known.low) | (fields[name] > known.high)).any():
                    raise InputError(f"{name} must be from {known.low:g} to {known.high:g}")
        names = {
            name: tuple(list_of(getattr(self, name), name, str, "text"))
            for name in ("kinds", "product_groups", "materials")
        }
        kinds = names["kinds"]
        if not set(kinds) <= {"", *KINDS}:
            raise InputError(f"kinds must be {joined_names(KINDS, 'or')} for each box")
        fields |= {name: values for name, values in names.items() if values}
        if self.mass_center_mm is not None:
            fields["mass_center_mm"] = array_of(self.mass_center_mm, "mass_center_mm", (3,))
        n_boxes = len(fields["mass_kg"])
        if not n_boxes:
            raise InputError("mass_kg must have a value for each box, got none")
        for name, values in fields.items():
            if len(values) != n_boxes:
                raise InputError(f"{name} must have {count_text(n_boxes, 'value')}, as mass_kg has, got {len(values)}")
            object.__setattr__(self, name, values)
        for name in ("size_mm", "mass_kg"):
            if not fields[name].min() > 0:
                raise InputError(f"{name} must be > 0, got {fields[name].min():g}")
        if self.mass_center_mm is not None and not (2 * np.abs(self.mass_center_mm) < self.size_mm).all():
            raise InputError("mass_center_mm must be inside the boxes, less than half of size_mm from their middles")
        for box, name in enumerate(kinds):
            if (fault := pallet_fault(name, self.size_mm[box])) is not None:
                raise InputError(f"box {box}: {fault}")
        object.__setattr__(self, "product_groups", names["product_groups"])
        object.__setattr__(self, "materials", names["materials"])
        object.__setattr__(self, "kinds", kinds if set(kinds) - {"", KINDS[0]} else ())

    @classmethod
    def from_boxes(
        cls,
        plan_id: str,
        boxes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None = None,
        *,
        size_mm: Any = None,
        corner_mm: Any = None,
        mass_kg: Any = None,
        units: str = PLAN_UNITS,
        anchor: Anchor = "corner",
        **columns: Any,
    ) -> Plan:
        """Make a plan from plain values, with the same checks as for files.

        ``Plan.from_boxes("tower", size_mm=[[400, 300, 200]] * 2, corner_mm=[[0, 0, 0], [0, 0, 200]], mass_kg=[6, 6])``

        Args:
            plan_id: 1 to 1,000 characters.
            boxes: a dictionary for each box, in packing order; or one dictionary with a list of n values for each
                field; or a data frame. The fields are the columns of tables: ``length_mm``, ``width_mm``,
                ``height_mm``, ``weight_kg``, ``x_mm``, ``y_mm``, ``z_mm``, and optionally ``article``, ``item_id``,
                ``product_group``, ``orientation``, ``order_sequence``, ``approach_deg``, ``material``,
                ``com_length_mm``, ``com_width_mm``, ``com_height_mm``, ``stiffness_n_mm``, ``strength_n`` and ``kind``.
                The field ``sequence`` gives a packing order that differs from the order of the boxes.
            size_mm: (n, 3) extents along x, y, z as placed, mm, as in ``Plan.size_mm``, instead of lengths, widths and
                heights. With ``size_mm``, an ``orientation`` only records how the boxes were turned, since the extents
                already include the turn.
            corner_mm: (n, 3) front-left-bottom corners, mm, instead of x, y and z; z = 0 is the top of the carrier.
            mass_kg: (n,) masses, kg, instead of weights.
            units: unit of all these lengths (mm, cm, dm, m, in or ft) and unit of all masses (kg, g, lb or t), such as
                "cm,g".
            anchor: the point of a box that the coordinates describe, as in ``load_plans``.
            columns: further fields as lists of n values.

        Raises:
            InputError: a field is missing, unknown or unusable. The message names the box and the field.
        """
        from petmjx.plans.plan_builder import fields_from_boxes  # imported here, since it loads Arrow

        arrays = {"size_mm": size_mm, "corner_mm": corner_mm, "mass_kg": mass_kg}
        return cls(**fields_from_boxes(plan_id, boxes, arrays, columns, InputConventions.checked(units, anchor)))

    @classmethod
    def of_units(
        cls,
        plan_id: str,
        loads: Sequence[Plan],
        corner_mm: Any,
        *,
        pallet: str = "epal-1",
        pallet_kg: float | None = None,
        material: str = "",
    ) -> Plan:
        """Make one plan from several loaded pallets, which are side by side on a carrier or stacked. Pallets are placed
        one after another, each followed by its load.

        ``Plan.of_units("two", [plan, plan], [(0, 0, 0), (0, 0, 1344)])`` stacks a second pallet on a load of 1,200 mm.

        Args:
            loads: for each pallet, the plan of its load. In the plan of a load, z = 0 is the pallet's top, and the
                origin is the pallet's corner.
            corner_mm: (u, 3) front-left-bottom corner of each pallet, mm.
            pallet: the kind of the pallets, such as "epal-1" (docs/carriers.md#load-units).
            pallet_kg: mass of each pallet, kg. None: the mass of the carrier with the name ``pallet``.
            material: material of the pallets, for friction that depends on materials; "": unknown.

        Raises:
            InputError: an argument is unusable.
        """
        from petmjx.plans.plan_builder import fields_of_units  # imported here, since it loads Arrow

        loads = list_of(loads, "loads", Plan, "Plan objects")
        return cls(**fields_of_units(plan_id, loads, corner_mm, pallet, pallet_kg, material))

    @property
    def n_boxes(self) -> int:
        return len(self.mass_kg)

    @property
    def sheets(self) -> NDArray[np.bool_]:
        """(n,) whether each item is an interlayer sheet."""
        return np.array([name == SHEET for name in self.kinds] or [False] * self.n_boxes, bool)

    @property
    def pallets(self) -> dict[int, str]:
        """The items that are pallets: number of the item → its kind."""
        return {box: name for box, name in enumerate(self.kinds) if name in PALLET_KINDS}

    @property
    def turned(self) -> NDArray[np.bool_]:
        """(n,) whether each item's length lies along y."""
        return np.zeros(self.n_boxes, dtype=bool) if self.orientation is None else self.orientation == 1

    @property
    def item_com_mm(self) -> NDArray[np.float64]:
        """(n, 3) centres of mass relative to the items' middles, along their length, width and height."""
        if self.mass_center_mm is None:
            return np.zeros((self.n_boxes, 3))
        along = self.mass_center_mm[:, [1, 0, 2]] * (1.0, -1.0, 1.0)
        return np.where(self.turned[:, None], along, self.mass_center_mm) + 0.0  # + 0.0 turns -0.0 into 0.0

    @property
    def item_size_mm(self) -> NDArray[np.float64]:
        """(n, 3) length, width and height of the items, before they are turned."""
        return np.where(self.turned[:, None], self.size_mm[:, [1, 0, 2]], self.size_mm)

    def __repr__(self) -> str:
        return f"Plan({printable_name(self.plan_id)!r}, {count_text(self.n_boxes, 'box', 'boxes')})"


def _whole_numbers(values: Any, name: str) -> NDArray[np.int64]:
    """(n,) whole numbers as int64. Raises InputError if some are not whole."""
    if isinstance(values, np.ndarray) and values.dtype == np.int64 and values.ndim == 1:
        return values
    array = array_of(values, name, ())
    if (array % 1).any():
        raise InputError(f"{name} must be whole numbers")
    return np.asarray(values).astype(np.int64)
