"""Makes the finalists of an order. A finalist is a packing that may be simulated; the results of simulations decide
which finalist is chosen."""

from __future__ import annotations

from dataclasses import dataclass

from petmjx.common.units import MM_PER_M
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.beam_search import RankedPacking, search
from petmjx.packers.learned_packer import CLEARANCE_MM, pack_learned
from petmjx.packers.pack_options import PhysicalOptions
from petmjx.plans.order_generator import Order, target_extent_mm


@dataclass(frozen=True)
class Finalist:
    """A packing of an order that may be simulated.

    Attributes:
        placed: boxes in packing order.
        clearance_mm: free space between neighbours, mm.
        volume_m3: volume of the boxes, m³.
        height_mm: height of the highest top, mm.
        utilisation: volume of the boxes / (area of the target × height of the highest top); BED-BPP's kpi_2.
    """

    placed: tuple[PlacedBox, ...]
    clearance_mm: float
    volume_m3: float
    height_mm: float
    utilisation: float


def finalists(order: Order, options: PhysicalOptions) -> list[Finalist]:
    """For each free space between boxes in ``options.clearances_mm``, the best packing of an order. Packings are sorted
    by volume, then by utilisation, largest first.

    If all of these packings leave boxes out, the best packing without free space is added. The list is empty if there
    is no place for any box.
    """
    packings = {clearance: _search_result(order, clearance, options) for clearance in options.clearances_mm}
    if 0.0 not in packings and all(len(packing.placed) < len(order.items) for packing in packings.values()):
        packings[0.0] = _search_result(order, 0.0, options)
    candidates = [_finalist(order, clearance, packing) for clearance, packing in packings.items() if packing.placed]
    return sorted(candidates, key=lambda finalist: (finalist.volume_m3, finalist.utilisation), reverse=True)


def learned_finalists(order: Order, look_ahead: int) -> list[Finalist]:
    """A list with one packing, made by the packer ``learned``. The list is empty if there is no place for any box."""
    placed = pack_learned(order.items, target_extent_mm(order.target), look_ahead)
    if not placed:
        return []
    height = max(box.corner_mm[2] + box.item.height_mm for box in placed)
    volume = sum(box.item.volume_m3 for box in placed)
    return [Finalist(tuple(placed), CLEARANCE_MM, volume, height, _utilisation(order, volume, height))]


def _search_result(order: Order, clearance_mm: float, options: PhysicalOptions) -> RankedPacking:
    extent_mm = target_extent_mm(order.target)
    return search(order.items, extent_mm, clearance_mm, width=options.width, branch=options.branch)


def _finalist(order: Order, clearance_mm: float, packing: RankedPacking) -> Finalist:
    volume = packing.worth.volume_m3
    utilisation = _utilisation(order, volume, packing.height_mm)
    return Finalist(packing.placed, clearance_mm, volume, packing.height_mm, utilisation)


def _utilisation(order: Order, volume_m3: float, height_mm: float) -> float:
    length, width = target_extent_mm(order.target)
    return volume_m3 / (length * width * height_mm / MM_PER_M**3)
