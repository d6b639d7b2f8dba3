"""The packers by name. Each takes the items of one order and gives placements in packing order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from petmjx.checked import got, hint
from petmjx.errors import InputError
from petmjx.plans.samples.balanced import pack_balanced
from petmjx.plans.samples.orders import Item
from petmjx.plans.samples.packer import PackRules, Placed, pack_best
from petmjx.text import shown

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


PACKERS: Final[Mapping[str, Packer]] = MappingProxyType({BASELINE: _baseline, BALANCED: _balanced})


def packer_named(name: str) -> Packer:
    """The packer of that name.

    Raises:
        InputError: there is none.
    """
    if not isinstance(name, str):
        raise InputError(f"packer must be text, {got(name)}")
    if name not in PACKERS:
        raise InputError(f"unknown packer {shown(name)}; {hint(name, list(PACKERS))}")
    return PACKERS[name]
