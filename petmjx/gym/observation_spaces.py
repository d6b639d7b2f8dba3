"""The spaces of observations: shapes and bounds of all values, and scales that map the values to the range from 0 to
1."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.gym.actions import PALLET, UPRIGHT
from petmjx.gym.environment_options import CANDIDATES, PalletizingOptions
from petmjx.loop.pallets import Pallets
from petmjx.plans.plan_fields import LARGEST_KG, LARGEST_MM

LOAD_N: Final = 500.0
BOX_KG: Final = 10.0
PALLET_KG: Final = 300.0
LEFT: Final = 20.0
"""Constants of the scales of observations. A scale x / (x + half) maps the value ``half`` to 0.5, and every positive
value to a number between 0 and 1. The constants are for orders of groceries (docs/loop.md): ``LOAD_N`` is a typical
load on a box, ``BOX_KG`` and ``PALLET_KG`` are typical masses of a box and of a pallet, and ``LEFT`` is a typical
number of remaining boxes."""

LARGEST_N: Final = 1e6
"""Largest force in observations, N: the weight of a pallet of 100 t. Every larger force is replaced by this value."""

_LENGTHS: Final = ("x", "y", "z", "length_x", "length_y", "height")

Observation = dict[str, NDArray[Any]]


class Space(NamedTuple):
    """The shape of a part of an observation, its smallest and its largest value, and its type."""

    shape: tuple[int, ...]
    low: Any
    high: Any
    kind: type[Any]


class ObservationSpaces:
    """The spaces and the scales of the observations of an environment.

    Args:
        cells: numbers of cells of the maps along x and y.
        n_actions: number of actions.
        features: names of the features of candidates.
    """

    def __init__(
        self,
        options: PalletizingOptions,
        pallets: Pallets,
        cells: tuple[int, int],
        n_actions: int,
        features: tuple[str, ...],
    ) -> None:
        self._options, self._features = options, features
        several = () if options.open_pallets == 1 else (options.open_pallets,)
        self._longest_mm = max(*pallets.extent_mm, options.max_height_mm)
        kg = pallets.most_boxes * LARGEST_KG
        spaces = {
            "height_map": Space((*several, *cells), 0.0, options.max_height_mm + 1.0, np.float32),
            "load_map": Space((*several, *cells), 0.0, LARGEST_N, np.float32),
            "boxes": Space((options.look_ahead, 4), 0.0, max(LARGEST_MM, LARGEST_KG), np.float32),
            "left": Space((1,), 0.0, 1e6, np.float32),
            "mass": Space((options.open_pallets,), 0.0, kg, np.float32),
            "carrier": Space((3,), 0.0, 20_000.0, np.float32),
            "action_mask": Space((n_actions,), 0, 1, np.int8),
        }
        if options.actions == CANDIDATES:
            length = 20_000.0
            most = dict.fromkeys(_LENGTHS, length) | {"mass": LARGEST_KG, "margin": 1.0, UPRIGHT: 2.0}
            most |= {
                "box": max(options.buffer - 1.0, 1.0),
                "turned": 1.0,
                "support": 1.01,
                PALLET: options.open_pallets - 1.0,
            }
            low = np.array([-1.0 if name == "margin" else 0.0 for name in features], np.float32)
            high = np.array([most[name] for name in features], np.float32)
            shape = (n_actions, len(features))
            spaces["candidates"] = Space(shape, np.tile(low, (n_actions, 1)), np.tile(high, (n_actions, 1)), np.float32)
        if options.scaled:
            spaces = {name: Space(space.shape, 0, 1, space.kind) for name, space in spaces.items()}
        self.spaces = spaces

    def scaled(self, observation: Observation) -> Observation:
        """The observations in the form that the environment returns: unscaled, or scaled to the range from 0 to 1,
        depending on its options."""
        if not self._options.scaled:
            return {**observation, "load_map": np.minimum(observation["load_map"], np.float32(LARGEST_N))}
        boxes = observation["boxes"]
        scaled = {
            "height_map": observation["height_map"] / self._longest_mm,
            "load_map": _saturated(observation["load_map"], LOAD_N),
            "boxes": np.concatenate([boxes[..., :3] / self._longest_mm, _saturated(boxes[..., 3:], BOX_KG)], axis=-1),
            "left": _saturated(observation["left"], LEFT),
            "mass": _saturated(observation["mass"], PALLET_KG),
            "carrier": observation["carrier"] / self._longest_mm,
        }
        if "candidates" in observation:
            scaled["candidates"] = self._candidates(observation["candidates"])
        clipped = {name: np.clip(values, 0.0, 1.0).astype(np.float32) for name, values in scaled.items()}
        return {name: clipped.get(name, values) for name, values in observation.items()}

    def _candidates(self, candidates: NDArray[np.float32]) -> NDArray[np.float32]:
        scaled = candidates.copy()
        for at, name in enumerate(self._features):
            values = scaled[..., at]
            if name in _LENGTHS:
                values /= self._longest_mm
            elif name == "mass":
                values[:] = _saturated(values, BOX_KG)
            elif name in ("box", PALLET):
                values /= max({"box": self._options.buffer, PALLET: self._options.open_pallets}[name] - 1, 1)
            elif name == UPRIGHT:
                values /= 2
        return scaled


def _saturated(values: NDArray[Any], half: float) -> NDArray[Any]:
    """Map values from [0, inf) to [0, 1), so that the value ``half`` is mapped to 0.5."""
    return np.asarray(values / (values + np.float32(half)))
