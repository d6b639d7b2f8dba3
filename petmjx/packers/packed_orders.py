"""Results of packing (``PackedOrder``): the chosen packing of an order, and its statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from petmjx.packers.finalists import Evaluation, Finalist, choose, decisive_evaluations
from petmjx.packers.left_out_items import LeftOutItems, left_out_of, why_left_out
from petmjx.packers.pack_options import PhysicalOptions
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.bedbpp_writer import Placement
from petmjx.plans.order import Order
from petmjx.plans.plan import Plan
from petmjx.results.share_statistics import wilson_interval


@dataclass(frozen=True, eq=False)
class PackedOrder:
    """The chosen packing of an order, with the results of its simulations.

    Attributes:
        order_id: id of the order and of its plan.
        n_items: number of boxes in the order.
        taken: the chosen packing; None if there is no place for any box.
        tried: number of packings among which the packing was chosen: all packings up to the first good one.
        n_simulated: number of simulated worlds, which may depend on other orders.
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
        chosen_m3 = packing.finalist.volume_m3 if packing else None
        why = "" if left_out is None else why_left_out(chosen_m3, (finalist.volume_m3 for finalist in finalists))
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
