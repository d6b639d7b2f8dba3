"""Results of packing: of all orders (``Packed``), and of one order, with its chosen packing (``PackedOrder``)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.common.argument_checks import path_of
from petmjx.common.text import count_text
from petmjx.packers.finalists import Evaluation, Finalist, choose, decisive_evaluations
from petmjx.packers.left_out_items import FALLS, NO_PLACE, LeftOutItems, left_out_of
from petmjx.packers.physical_packer_options import PhysicalOptions
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.bedbpp_writer import Placement, write_plans
from petmjx.plans.file_formats import is_csv, is_parquet_name
from petmjx.plans.order import Order
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PathArgument
from petmjx.plans.plan_writer import save_plans
from petmjx.results.notebook_tables import ShownColumn, block_as_html, table_as_html
from petmjx.results.share_statistics import wilson_interval

SHOWN: Final = (
    ShownColumn("plan_id", "order"),
    ShownColumn("boxes", "boxes placed"),
    ShownColumn("left_out", "left out"),
    ShownColumn("utilisation", "utilisation", 3),
    ShownColumn("height_mm", "height mm"),
    ShownColumn("clearance_mm", "clearance mm"),
    ShownColumn("verdict", "placed exactly"),
    ShownColumn("share", "with errors %", 1, 100.0),
)
"""Columns of the table ``Packed.orders`` that notebooks show."""


@dataclass(frozen=True, eq=False)
class PackedOrder:
    """The chosen packing of an order, with the results of its simulations.

    Attributes:
        order_id: id of the order and of its plan.
        n_items: number of boxes in the order.
        taken: the chosen packing; None if there is no place for any box.
        tried: number of packings among which the packing was chosen (see ``decisive_evaluations``).
        n_simulated: number of simulated worlds of the order. This number may depend on other orders that are packed at
            the same time.
        good: whether the plan stands as often as requested.
        left_out: items that the packing leaves out; None if it leaves out no item.
        why: the reason why items are left out; "" if no item is left out.
    """

    order_id: str
    n_items: int
    taken: Evaluation | None
    tried: int
    n_simulated: int
    good: bool
    left_out: LeftOutItems | None
    why: str

    @classmethod
    def of(
        cls,
        order_id: str,
        order: Order,
        finalists: Sequence[Finalist],
        judged: Sequence[Evaluation],
        options: PhysicalOptions,
    ) -> PackedOrder:
        """Choose a packing of an order.

        Args:
            order_id: id of the order.
            order: the order.
            finalists: all packings of the order that the search found.
            judged: the evaluations of the simulated packings.
            options: options of the packer.
        """
        tried = decisive_evaluations(judged, options)
        packing = choose(tried, options) if tried else None
        left_out = left_out_of(order_id, order, packing.finalist.placed if packing else ())
        has_fuller = packing and max(finalist.volume_m3 for finalist in finalists) > packing.finalist.volume_m3
        why = "" if left_out is None else FALLS if has_fuller else NO_PLACE
        good = packing is not None and packing.is_good(options)
        simulated = sum(candidate.n_simulated for candidate in judged)
        return cls(order_id, len(order.items), packing, len(tried), simulated, good, left_out, why)

    @property
    def plan(self) -> Plan | None:
        """The chosen packing as a plan; None if there is no packing."""
        return self.taken.plan if self.taken else None

    @property
    def placements(self) -> list[Placement]:
        """The chosen packing in BED-BPP's format."""
        return as_placements(self.taken.finalist.placed) if self.taken else []

    def row(self) -> dict[str, Any]:
        """The row of this order in ``Packed.orders``: name of a column → value."""
        packing = self.taken
        n_worlds, n_standing = (packing.n_worlds, packing.n_standing) if packing else (0, 0)
        low, high = wilson_interval(n_standing, n_worlds)
        return {
            "plan_id": self.order_id,
            "order_boxes": self.n_items,
            "boxes": len(packing.finalist.placed) if packing else 0,
            "left_out": len(self.left_out.numbers) if self.left_out else 0,
            "utilisation": packing.finalist.utilisation if packing else np.nan,
            "height_mm": packing.finalist.height_mm if packing else np.nan,
            "clearance_mm": packing.finalist.clearance_mm if packing else np.nan,
            "verdict": packing.verdict.value if packing else "",
            "n_worlds": n_worlds,
            "n_standing": n_standing,
            "share": n_standing / n_worlds if n_worlds else np.nan,
            "low": float(low) if n_worlds else np.nan,
            "high": float(high) if n_worlds else np.nan,
            "tried": self.tried,
            "good": self.good,
            "why": self.why,
        }


@dataclass(frozen=True, eq=False)
class Packed:
    """The result of ``petmjx.pack``.

    Attributes:
        packed_orders: the result of each order, in the sequence of the input.
    """

    packed_orders: tuple[PackedOrder, ...]

    @property
    def each(self) -> tuple[PackedOrder, ...]:
        """The same as ``packed_orders``, under the name that this attribute had in version 0.2."""
        warnings.warn("Packed.each is now Packed.packed_orders", DeprecationWarning, stacklevel=2)
        return self.packed_orders

    @property
    def plans(self) -> list[Plan]:
        """The plans, for ``petmjx.score`` and ``petmjx.save_plans``. An order has no plan if there is no place for any
        of its boxes."""
        return [packed.plan for packed in self.packed_orders if packed.plan is not None]

    @property
    def orders(self) -> pd.DataFrame:
        """A table with one row for each order.

        The columns are

        - ``plan_id``: id of the order and of its plan.
        - ``order_boxes``: number of boxes in the order.
        - ``boxes``: number of placed boxes.
        - ``left_out``: number of boxes that are left out.
        - ``why``: the reason why boxes are left out.
        - ``utilisation``: volume of the placed boxes / (area of the target × height of the pile).
        - ``height_mm``: height of the pile, mm.
        - ``clearance_mm``: free space between neighbours, mm.
        - ``verdict``: the verdict if boxes are placed exactly.
        - ``n_worlds``: number of worlds with errors.
        - ``n_standing``: number of worlds with errors in which the plan stands.
        - ``share``: n_standing / n_worlds, with its Wilson 95 % interval ``low``, ``high``.
        - ``tried``: number of packings among which the packing was chosen.
        - ``good``: whether the plan stands as often as requested.
        """
        return pd.DataFrame([packed.row() for packed in self.packed_orders])

    def __repr__(self) -> str:
        orders = self.orders
        sure = f", {100 * orders['share'].mean():.1f} % of worlds with errors stand" if orders["n_worlds"].any() else ""
        return f"Packed({count_text(len(orders), 'order')}, utilisation {orders['utilisation'].mean():.3f}{sure})"

    def _repr_html_(self) -> str:
        """The display in a notebook: mean values, and a table with one row for each order."""
        return block_as_html([repr(self)], [table_as_html(self.orders, SHOWN, "orders")])

    def save(self, path: PathArgument) -> None:
        """Write the plans to a file. An existing file is replaced.

        The format is BED-BPP's JSON, or a table if the name ends in ``.csv`` or ``.parquet``. If the name ends in
        ``.gz``, the file is gzipped.

        Raises:
            InputError: there is no plan, or the file cannot be written.
        """
        file = path_of(path, "path")
        if is_csv(file) or is_parquet_name(file):
            save_plans(self.plans, file)
        else:
            write_plans(file, ((packed.order_id, packed.placements) for packed in self.packed_orders if packed.taken))
