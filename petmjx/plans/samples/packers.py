"""The packers by name. Each takes the items of one order and gives placements in packing order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from petmjx.basics.arguments import whole_of
from petmjx.basics.checked import got, hint
from petmjx.basics.errors import InputError
from petmjx.basics.text import shown
from petmjx.plans.samples.balanced import pack_balanced
from petmjx.plans.samples.online.learned import LEARNED, pack_learned
from petmjx.plans.samples.online.stream import MOST_LOOK_AHEAD
from petmjx.plans.samples.orders import Item
from petmjx.plans.samples.packer import PackRules, Placed, pack_best

BASELINE: Final = "baseline"
BALANCED: Final = "balanced"


class Packer(Protocol):
    """Packs one order: items with a place, from below upwards, each let down from above. The others are left out."""

    def __call__(
        self, items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules | None, rng: np.random.Generator
    ) -> list[Placed]:
        """Place items on a target of ``extent_mm`` (x, y), as objects of ``items``.

        Args:
            rules: of the packer ``baseline``; None: its own.
            rng: the random numbers of this order. A packer may leave them alone.
        """


def _baseline(
    items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules | None, rng: np.random.Generator
) -> list[Placed]:
    return pack_best(items, extent_mm, rules or PackRules(), rng)


def _balanced(
    items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules | None, rng: np.random.Generator
) -> list[Placed]:
    return pack_balanced(items, extent_mm)


def _learned(
    items: Sequence[Item],
    extent_mm: tuple[float, float],
    rules: PackRules | None,
    rng: np.random.Generator,
    look_ahead: int = 1,
) -> list[Placed]:
    return pack_learned(items, extent_mm, look_ahead)


PACKERS: Final[Mapping[str, Packer]] = MappingProxyType({BASELINE: _baseline, BALANCED: _balanced, LEARNED: _learned})

WHY: Final[Mapping[str, str]] = MappingProxyType(
    {LEARNED: "when they came, no place below 2 m was in balance and likely to stand"}
)
"""Packers that leave boxes out for reasons of their own."""


def packer_named(name: str, look_ahead: int | None = None) -> Packer:
    """The packer of that name.

    Args:
        look_ahead: of the packer ``learned``: how many of the next boxes it sees; None: 1.

    Raises:
        InputError: there is none, or it has no look-ahead.
    """
    if not isinstance(name, str):
        raise InputError(f"packer must be text, {got(name)}")
    if name not in PACKERS:
        raise InputError(f"unknown packer {shown(name)}; {hint(name, list(PACKERS))}")
    if look_ahead is None:
        return PACKERS[name]
    if name != LEARNED:
        raise InputError(f"look_ahead needs the packer {LEARNED}")
    return partial(_learned, look_ahead=whole_of(look_ahead, "look_ahead", 1, MOST_LOOK_AHEAD))
