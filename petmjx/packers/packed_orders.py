"""What a packer made of an order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from petmjx.packers.pack_candidates import Finalist
from petmjx.packers.pack_evaluation import Evaluation, choose, decisive_evaluations
from petmjx.packers.pack_options import PhysicalOptions
from petmjx.packers.sample_plans import LeftOutItems, as_placements, left_out_of
from petmjx.plans.json_writer import Placement
from petmjx.plans.order_generator import Order
from petmjx.plans.plan import Plan
from petmjx.results.shares import wilson_interval

NO_PLACE = "no packing has room for more"
FALLS = "packings with more boxes do not stand often enough"


@dataclass(frozen=True, eq=False)
class PackedOrder:
    """An order's packing, with what physics says of it.

    Attributes:
        order_id: the order's, and the plan's.
        n_items: boxes of the order.
        taken: the packing; None where no box has a place.
        tried: how many packings were simulated before one was good.
        n_simulated: worlds that were simulated. It may depend on other orders.
        good: whether it stands as often as asked for.
        left_out: what it leaves out; None: nothing. ``why``: the reason, or "".
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
        found: Sequence[Finalist],
        judged: Sequence[Evaluation],
        options: PhysicalOptions,
    ) -> PackedOrder:
        """The packing that is taken of those that were found and judged."""
        tried = decisive_evaluations(judged, options)
        packing = choose(tried, options) if tried else None
        left_out = left_out_of(order_id, order, packing.finalist.placed if packing else ())
        fuller = packing is not None and max(finalist.volume_m3 for finalist in found) > packing.finalist.volume_m3
        why = "" if left_out is None else FALLS if fuller else NO_PLACE
        good = packing is not None and packing.is_good(options)
        simulated = sum(candidate.n_simulated for candidate in judged)
        return cls(order_id, len(order.items), packing, len(tried), simulated, good, left_out, why)

    @property
    def plan(self) -> Plan | None:
        """The packing as a plan."""
        return self.taken.plan if self.taken else None

    @property
    def placements(self) -> list[Placement]:
        """The packing as BED-BPP writes it."""
        return as_placements(self.taken.finalist.placed) if self.taken else []

    def row(self) -> dict[str, Any]:
        """Column → value, as in ``Packed.orders``."""
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
