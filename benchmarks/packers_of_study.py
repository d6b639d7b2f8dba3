"""The packers of the study, by name. Some see the whole order, others see only the next boxes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.common.parallel_map import ordered_results
from petmjx.packers.balanced_packer import PREFERENCE_SETS
from petmjx.packers.baseline_packer import PackRules, PlacedBox, pack
from petmjx.packers.item_stream import ItemStream, by_taste, pack_stream
from petmjx.packers.learned_candidates import FourSidedStream, lowest_first
from petmjx.packers.learned_packer import CLEARANCE_MM as LEARNED_CLEARANCE_MM
from petmjx.packers.learned_packer import Policy, pack_learned
from petmjx.packers.pack import pack_each
from petmjx.packers.packer_registry import BALANCED, BASELINE, packer_named
from petmjx.packers.packing_state import Packing
from petmjx.plans.order import TARGET_EXTENT_MM, Item, Order

CLEARANCE_MM: Final = 6.0
LOOK_AHEAD: Final = 5

PHYSICAL: Final = "physical"
ONLINE: Final = "learned, online"
LOWEST: Final = "lowest first on all sides, online"

Placements = Sequence[PlacedBox]
Numbered = tuple[str, Order]


def _named(order: Order, *, name: str) -> Placements:
    return packer_named(name)(order.items, TARGET_EXTENT_MM[order.target], None, np.random.default_rng(0))


def _apart(order: Order) -> Placements:
    """The packer ``balanced`` with free space between boxes. This packer shows the effect of the clearances of the
    packer ``physical`` alone."""
    best: Placements = ()
    for preferences in PREFERENCE_SETS:
        packing = Packing(order.items, TARGET_EXTENT_MM[order.target], preferences, CLEARANCE_MM)
        packing.fill()
        best = max(best, packing.placed, key=len)
        if len(best) == len(order.items):
            break
    return best


def _baseline_online(order: Order) -> Placements:
    rng = np.random.default_rng(0)
    return pack(order.items, TARGET_EXTENT_MM[order.target], PackRules(), rng, as_they_come=True)


def _balanced_online(order: Order, *, clearance_mm: float = 0.0, look_ahead: int = 1) -> Placements:
    return pack_stream(ItemStream(order.items, TARGET_EXTENT_MM[order.target], clearance_mm, look_ahead), by_taste)


def _lowest_online(order: Order) -> Placements:
    """A simple rule that chooses among the same candidates as ``learned``. This packer shows the effect of the
    candidates without learning."""
    stream = FourSidedStream(order.items, TARGET_EXTENT_MM[order.target], LEARNED_CLEARANCE_MM)
    return pack_stream(stream, lowest_first)


def _learned(order: Order, *, look_ahead: int, policy: Policy | None = None) -> Placements:
    return pack_learned(order.items, TARGET_EXTENT_MM[order.target], look_ahead, policy)


def packers(policy: Policy | None = None) -> dict[str, Callable[[Order], Placements]]:
    """Name → packer, for all packers except ``physical``, which needs an engine.

    Args:
        policy: of ``learned``; None: the published one.
    """
    apart, ahead = f"{CLEARANCE_MM:g} mm apart", f"{LOOK_AHEAD} seen"
    return {
        BASELINE: partial(_named, name=BASELINE),
        BALANCED: partial(_named, name=BALANCED),
        f"balanced, {apart}": _apart,
        "baseline, online": _baseline_online,
        "balanced, online": _balanced_online,
        f"balanced, {apart}, online": partial(_balanced_online, clearance_mm=CLEARANCE_MM),
        LOWEST: _lowest_online,
        ONLINE: partial(_learned, look_ahead=1, policy=policy),
        f"balanced, {apart}, {ahead}": partial(_balanced_online, clearance_mm=CLEARANCE_MM, look_ahead=LOOK_AHEAD),
        f"learned, {ahead}": partial(_learned, look_ahead=LOOK_AHEAD, policy=policy),
    }


RULES_ONLINE: Final = ("baseline, online", "balanced, online", f"balanced, {CLEARANCE_MM:g} mm apart, online", LOWEST)
"""The packers that ``learned`` should beat."""


class Packings(dict[str, Placements]):
    """Order id → packed boxes. ``cpu_s``: CPU time per order, s."""

    cpu_s: float = float("nan")


def packed(
    orders: Sequence[Numbered], by: Mapping[str, Callable[[Order], Placements]], workers: int
) -> dict[str, Packings]:
    """All orders packed by each packer."""
    packings_by_packer: dict[str, Packings] = {name: Packings() for name in by}
    seconds = dict.fromkeys(by, 0.0)
    answers = ordered_results(partial(_timed, by=by), orders, workers, alone=64, chunk=8)
    for (order_id, _), answer in zip(orders, answers, strict=True):
        for name, (placed, cpu_s) in answer.items():
            packings_by_packer[name][order_id] = placed
            seconds[name] += cpu_s
    for name, packings in packings_by_packer.items():
        packings.cpu_s = seconds[name] / max(len(orders), 1)
    return packings_by_packer


def packed_already(path: Path) -> Packings:
    """The packings of another packer, read from a file of plans in BED-BPP's JSON."""
    packings = Packings()
    for order_id, placements in json.loads(path.read_text(encoding="utf-8")).items():
        boxes = []
        for placement in placements:
            x, y, z = map(float, placement["flb_coordinates"])
            boxes.append(PlacedBox(_item(placement["item"]), placement["orientation"], (x, y, z)))
        packings[order_id] = boxes
    return packings


def _item(given: Mapping[str, Any]) -> Item:
    names = (given["article"], given["id"], given["product_group"])
    return Item(*names, *(float(given[name]) for name in ("length/mm", "width/mm", "height/mm", "weight/kg")))


def packed_physically(orders: Sequence[Numbered], workers: int, how: Mapping[str, Any]) -> Packings:
    """The orders packed by ``physical``, whose CPU time is that of all threads of this process."""
    begin, packings = time.process_time(), Packings()
    packed_orders: Iterator[Any] = pack_each(iter(orders), workers=workers, **how)
    for packing in packed_orders:
        packings[packing.order_id] = packing.taken.finalist.placed if packing.taken else ()
    packings.cpu_s = (time.process_time() - begin) / len(orders) if workers == 1 else float("nan")
    return packings


def _timed(numbered: Numbered, by: Mapping[str, Callable[[Order], Placements]]) -> dict[str, tuple[Placements, float]]:
    answer = {}
    for name, packs in by.items():
        begin = time.process_time()
        answer[name] = (packs(numbered[1]), time.process_time() - begin)
    return answer
