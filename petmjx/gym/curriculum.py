"""Curricula: each episode has a level of difficulty from 0 to 1, on which its order (the list of boxes to pack) and its
errors depend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from petmjx.common.argument_checks import number_of
from petmjx.common.checked_records import hint, shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.gym.environment_options import MOST_ERRORS, PalletizingOptions
from petmjx.loop.episode_orders import Boxes

_LIMITS: Final = {"boxes": (1.0, 100_000.0), "sizes": (0.0, 1.0), "errors": (0.0, MOST_ERRORS)}

Range = tuple[float, float]


@dataclass(frozen=True)
class Curriculum:
    """Properties of episodes, each as a pair of values: one for level 0 and one for level 1. Between level 0 and level
    1, each value changes linearly.

    Attributes:
        boxes: largest number of boxes of an order. If an order has more boxes than this number, the last boxes are
            left out. If ``boxes`` is None, no boxes are left out.
        sizes: how much the boxes of an order differ. With the value 0, all boxes have the mean size and mass of the
            order's boxes; with the value 1, all boxes have their own size and mass.
        errors: size of the random placement errors, as in the option ``errors``.
    """

    boxes: Range | None = None
    sizes: Range = (1.0, 1.0)
    errors: Range = (0.0, 0.0)

    @classmethod
    def of(cls, options: PalletizingOptions) -> Self:
        """The curriculum that the options of an environment define. Without a curriculum, episodes are the same at all
        levels.

        Raises:
            InputError: an entry is unknown, or is not a pair of numbers within the allowed range.
        """
        entries = {} if options.curriculum is None else options.curriculum
        if not isinstance(entries, Mapping):
            raise InputError(f"curriculum must be a table, {shown_value(entries)}")
        ranges: dict[str, Any] = {"errors": (options.errors, options.errors)}
        for name, ends in entries.items():
            if name not in _LIMITS:
                raise InputError(f"curriculum: unknown entry {name!r}; {hint(str(name), _LIMITS)}")
            if not isinstance(ends, list | tuple) or len(ends) != 2:
                raise InputError(f"curriculum.{name} must be two numbers, for the levels 0 and 1, {shown_value(ends)}")
            ranges[name] = tuple(number_of(end, f"curriculum.{name}", *_LIMITS[name]) for end in ends)
        return cls(**ranges)

    def order(self, boxes: Boxes, level: float) -> Boxes:
        """The boxes of an order as they are packed in an episode of level ``level``."""
        whole = boxes
        if self.boxes is not None:
            boxes = boxes.take(slice(round(_between(self.boxes, level))))
        share = _between(self.sizes, level)
        if share == 1.0:
            return boxes
        size, mass = whole.size_mm.mean(axis=0), whole.mass_kg.mean()
        return Boxes(
            size + share * (boxes.size_mm - size),
            mass + share * (boxes.mass_kg - mass),
            boxes.strength_n,
            boxes.upright,
        )

    def error_strength(self, level: FloatArray) -> FloatArray:
        """(m,) size of the placement errors at each of m levels, as in the option ``errors``."""
        low, high = self.errors
        return np.asarray(low + level * (high - low), np.float64)


def level_of(options: object, n: int, *others: str) -> FloatArray | None:
    """(n,) the levels that the options of ``reset`` set for n environments; None if the options set no level.

    Args:
        others: names of the other options that ``reset`` of the environment has.

    Raises:
        InputError: the options are not a dict, an option does not exist, or the number of levels is neither 1 nor n.
    """
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise InputError(f"options must be a dict, {shown_value(options)}")
    names = ("level", *others)
    if unknown := [name for name in options if name not in names]:
        raise InputError(f"options: unknown option {unknown[0]!r}; an environment has {' and '.join(names)}")
    if options.get("level") is None:
        return None
    try:
        return np.broadcast_to(np.asarray(options["level"], np.float64), (n,))
    except (TypeError, ValueError):
        for_many = "" if n == 1 else f", or {n} of them"
        raise InputError(
            f"options: level must be a number from 0 to 1{for_many}, {shown_value(options['level'])}"
        ) from None


def _between(ends: Range, level: float) -> float:
    return ends[0] + level * (ends[1] - ends[0])
