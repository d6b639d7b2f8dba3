"""The registry of packers by name (``PACKERS``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from petmjx.common.argument_checks import integer_of
from petmjx.common.checked_records import hint, shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.packers.balanced_packer import pack_balanced
from petmjx.packers.baseline_packer import PackRules, PlacedBox, pack_best
from petmjx.packers.item_stream import MOST_LOOK_AHEAD
from petmjx.packers.learned_packer import LEARNED, pack_learned
from petmjx.plans.order import Item

BASELINE: Final = "baseline"
BALANCED: Final = "balanced"


class Packer(Protocol):
    """A function that packs one order. The function returns the placed boxes in packing order. If boxes are placed in
    packing order, each box can be lowered to its place from above. Items for which there is no place are left out."""

    def __call__(
        self, items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules | None, rng: np.random.Generator
    ) -> list[PlacedBox]:
        """Place items on a target. The placed boxes refer to the same objects as ``items``.

        Args:
            items: the items of the order.
            extent_mm: length (along x) and width (along y) of the target, mm.
            rules: rules of the packer ``baseline``. If ``rules`` is None, the default rules are used.
            rng: random numbers for this order, which a packer may use.
        """


def _baseline(
    items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules | None, rng: np.random.Generator
) -> list[PlacedBox]:
    return pack_best(items, extent_mm, rules or PackRules(), rng)


def _balanced_packer(
    items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules | None, rng: np.random.Generator
) -> list[PlacedBox]:
    return pack_balanced(items, extent_mm)


def _learned_packer(
    items: Sequence[Item],
    extent_mm: tuple[float, float],
    rules: PackRules | None,
    rng: np.random.Generator,
    look_ahead: int = 1,
) -> list[PlacedBox]:
    return pack_learned(items, extent_mm, look_ahead)


PACKERS: Final[Mapping[str, Packer]] = MappingProxyType(
    {BASELINE: _baseline, BALANCED: _balanced_packer, LEARNED: _learned_packer}
)

LEFT_OUT_REASONS: Final[Mapping[str, str]] = MappingProxyType(
    {LEARNED: "when these boxes came, they had no place below 2 m at which they would be in balance and probably stand"}
)
"""Name of a packer → why it leaves boxes out. Packers that are not in this table leave out boxes for which there is no
place below 2 m."""


def packer_named(name: str, look_ahead: int | None = None) -> Packer:
    """The packer with the given name.

    Args:
        name: the name.
        look_ahead: number of boxes that the packer ``learned`` sees at a time. If ``look_ahead`` is None, the packer
            sees 1 box.

    Raises:
        InputError: no packer has this name, or ``look_ahead`` is given for another packer than ``learned``.
    """
    if not isinstance(name, str):
        raise InputError(f"packer must be text, {shown_value(name)}")
    if name not in PACKERS:
        raise InputError(f"unknown packer {printable_name(name)}; {hint(name, list(PACKERS))}")
    if look_ahead is None:
        return PACKERS[name]
    if name != LEARNED:
        raise InputError(f"look_ahead needs the packer '{LEARNED}'")
    return partial(_learned_packer, look_ahead=integer_of(look_ahead, "look_ahead", 1, MOST_LOOK_AHEAD))
