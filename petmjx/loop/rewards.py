"""The terms of the reward of an environment, by name. The weights of the terms are an option of the environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from petmjx.common.argument_checks import number_of
from petmjx.common.checked_records import hint, shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.loop.placement_results import PlacementResults


@dataclass(frozen=True, eq=False)
class Placement:
    """The inputs from which the terms of the reward are computed, for m boxes that were placed.

    Attributes:
        volume_mm3: (m,) volume of each placed box; ``mass_kg``: (m,) total mass of the boxes on each box's pallet.
        room_mm3: volume above the carriers of an episode up to ``max_height_mm``.
        higher_mm: (m,) increase of the pallet's height; ``max_height_mm``: largest allowed height of a box's top.
    """

    results: PlacementResults
    volume_mm3: FloatArray
    mass_kg: FloatArray
    room_mm3: float
    higher_mm: FloatArray
    max_height_mm: float


def _utilisation(placed: Placement) -> FloatArray:
    return placed.results.stable * (placed.volume_mm3 / placed.room_mm3)


def _margin(placed: Placement) -> FloatArray:
    return np.nan_to_num(placed.results.margin, nan=-1.0).clip(-1.0, 1.0)


def _load(placed: Placement) -> FloatArray:
    largest = np.nan_to_num(placed.results.top_force_n).max(axis=1, initial=0.0)
    return np.asarray(-largest / (STANDARD_GRAVITY * placed.mass_kg))


TERMS: Final[dict[str, tuple[str, Callable[[Placement], FloatArray]]]] = {
    "placed": ("1 if the pallet stands with the new box, else 0", lambda p: np.where(p.results.stable, 1.0, 0.0)),
    "utilisation": (
        "the box's volume as a share of the room over the carrier; 0 if the pallet does not stand",
        _utilisation,
    ),
    "fall": ("-1 where the pallet does not stand", lambda p: np.where(p.results.stable, 0.0, -1.0)),
    "margin": (
        "the pallet's margin (distance to the nearest threshold), from -1 to 1; -1 if the verdict is invalid",
        _margin,
    ),
    "load": ("minus the largest force on a box's top, as a share of the weight of all boxes", _load),
    "height": (
        "minus the increase of the pallet's height, as a share of the largest height",
        lambda p: -p.higher_mm / p.max_height_mm,
    ),
    "illegal": ("-1 for an action that the mask excludes", lambda p: np.zeros(len(p.results))),
}
"""Name of a term → description of the term, and the function that computes its values."""

USUAL_WEIGHTS: Final = {"utilisation": 10.0, "fall": 1.0, "illegal": 0.1}


def weights_of(rewards: Any) -> dict[str, float]:
    """The weights of the terms, by name. If ``rewards`` is None, the default weights are returned.

    Raises:
        InputError: a term is unknown, or a weight is not a number.
    """
    if rewards is None:
        return dict(USUAL_WEIGHTS)
    if not isinstance(rewards, Mapping):
        raise InputError(f"rewards must be a table of weights, {shown_value(rewards)}")
    for name in rewards:
        if name not in TERMS:
            raise InputError(f"rewards: unknown term {name!r}; {hint(str(name), TERMS)}")
    return {name: number_of(weight, f"rewards.{name}") for name, weight in rewards.items()}
