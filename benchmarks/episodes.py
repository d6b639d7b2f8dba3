"""Plays random episodes of the environments, and checks that each ends correctly and disturbs no other episode."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pandas as pd
from gymnasium import spaces
from numpy.typing import NDArray

from benchmarks.result_fields import Result, timed
from petmjx.engines.protocol import Engine
from petmjx.gym.vector_env import PalletizingVectorEnv

PALLETS: Final = 16
"""Number of pallets side by side."""

_ILLEGAL: Final = 0.05
"""Share of actions that are drawn from all actions, legal or not."""

_ALL_TERMS: Final = {
    "placed": 1,
    "utilisation": 10,
    "fall": 1,
    "margin": 1,
    "load": 1,
    "height": 1,
    "illegal": 0.1,
}

SETTINGS: Final[tuple[dict[str, Any], ...]] = (
    {"mask": "geometry"},
    {"mask": "support_50", "look_ahead": 4, "buffer": 2},
    {"mask": "support_75", "rewards": _ALL_TERMS},
    {"mask": "centre", "actions": "cells", "action_cell_mm": 200},
    {"mask": "geometry", "actions": "cells", "action_cell_mm": 200, "look_ahead": 2, "buffer": 2},
    {"mask": "physics", "n_candidates": 4, "scaled": True},
    {"mask": "sure", "look_ahead": 3, "buffer": 3, "open_pallets": 2, "scaled": True},
    {"mask": "support_75", "sides": "all", "errors": 1.0},
    {
        "mask": "geometry",
        "actions": "cells",
        "action_cell_mm": 400,
        "sides": "all",
        "open_pallets": 2,
        "curriculum": {"boxes": [1, 5], "sizes": [0, 1]},
        "level": 0.5,
    },
    {"mask": "loads", "n_candidates": 4, "most_illegal": 1},
    {"mask": "support_50", "carrier": "rollcontainer", "max_height_mm": 900},
    {"mask": "geometry", "most_boxes": 2},
)
"""Options of the environments among which the episodes are divided. Each is used with both ways of beginning anew."""


@dataclass
class _Seen:
    """Counts and faults of the episodes so far."""

    ended: int = 0
    placements: int = 0
    how: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)

    def fault(self, text: str, wrong: NDArray[np.bool_]) -> None:
        if wrong.any():
            self.faults[text] += int(wrong.sum())


def episodes(engine: Engine, count: int, seed: int) -> Result:
    """Play random episodes of orders of one to five boxes until this many have ended."""
    seen = _Seen()
    per_run = -(-count // (2 * len(SETTINGS)))
    with timed() as clock:
        for number, settings in enumerate(SETTINGS):
            for mode in ("NextStep", "SameStep"):
                _play(engine, settings, mode, min(per_run, count - seen.ended), seed + number, seen)
    return {
        "episodes": seen.ended,
        "placements": seen.placements,
        "settings": 2 * len(SETTINGS),
        "ends": dict(sorted(seen.how.items())),
        "faults": dict(seen.faults),
        "wall_s": clock.wall_s,
        "cpu_s": clock.cpu_s,
        "peak_rss_bytes": clock.peak_rss_bytes,
    }


def _play(engine: Engine, settings: dict[str, Any], mode: str, count: int, seed: int, seen: _Seen) -> None:
    rng = np.random.default_rng(seed)
    options = {"n_candidates": 8, "cell_mm": 100, "most_illegal": 3, **settings}
    env = PalletizingVectorEnv(PALLETS, mode, engine=engine, orders=_orders(rng), **options)
    observed, info = env.reset(seed=seed)
    over, before, goal = np.zeros(PALLETS, bool), np.zeros(PALLETS, int), seen.ended + count
    while seen.ended < goal:
        mask = observed["action_mask"]
        legal = np.argmax(rng.random(mask.shape) * (mask + 1e-9), axis=1)
        actions = np.where(rng.random(PALLETS) < _ILLEGAL, rng.integers(mask.shape[1], size=PALLETS), legal)
        allowed = mask[np.arange(PALLETS), actions] == 1
        seen.fault("an episode goes on without a legal action", ~over & ~mask.any(axis=1))
        began = over if mode == "NextStep" else np.zeros(PALLETS, bool)
        observed, reward, terminated, truncated, info = env.step(actions)
        over = terminated | truncated
        last = _last(info, over)
        _check(env, observed, reward, over, seen)
        grown = last["placed"] - np.where(began, 0, before)
        seen.fault("a step placed another number of boxes than one", grown != (allowed & ~began))
        fell = last["verdict"] != "stable"
        seen.fault("an episode goes on after a fall, or ended too early", fell & ~terminated)
        seen.fault("an episode ended twice", terminated & truncated)
        seen.placements += int(grown.sum())
        seen.ended += int(over.sum())
        seen.how.update(np.where(truncated, "illegal actions", np.where(fell, last["reason"], "packed"))[over].tolist())
        before = np.where(over & (mode == "SameStep"), 0, last["placed"])
    env.close()


def _last(info: dict[str, Any], over: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """The information on each episode; for an ended episode, the information at its end."""
    final = info.get("final_info")
    names = ("placed", "verdict", "reason")
    return {name: info[name] if final is None else np.where(over, final[name], info[name]) for name in names}


def _check(env: PalletizingVectorEnv, observed: Any, reward: Any, over: Any, seen: _Seen) -> None:
    assert isinstance(env.observation_space, spaces.Dict)
    outside = [name for name, space in env.observation_space.items() if not space.contains(observed[name])]
    for name in outside:
        seen.faults[f"{name} is outside of its space"] += 1
    seen.fault("a reward is no number", ~np.isfinite(reward))
    ended = env.episodes.pallets.ended.reshape(PALLETS, -1).any(axis=1)
    seen.fault("an episode goes on with a pallet that has ended", ~over & ended)


def _orders(rng: np.random.Generator) -> pd.DataFrame:
    """200 orders of one to five boxes of all shapes, some of which find no place, or are weak."""
    order_ids = np.repeat(np.arange(200), rng.integers(1, 6, size=200))
    sides = rng.integers(8, 85, size=(len(order_ids), 3)) * 10.0
    boxes = dict(zip(("length_mm", "width_mm", "height_mm"), sides.T, strict=True))
    mass, strength = rng.uniform(0.2, 30.0, len(order_ids)), rng.uniform(20.0, 300.0, len(order_ids))
    return pd.DataFrame({"order_id": order_ids, **boxes, "weight_kg": mass, "strength_n": strength})
