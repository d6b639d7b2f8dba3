"""Random piles, scaled in all lengths together with the thresholds that are lengths: which verdicts change.

Under gravity, a pile twice as large falls in the same way, √2 times as slowly. Only petmjx's own constants do not
scale: the timestep, the springs of contacts, 0.1 mm of size, speeds that count as quiet. If these constants decide a
verdict, a flag must show it.

    python -m benchmarks.scaled_piles --seed 20261128 --piles 500
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

import petmjx
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Flag
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan import Plan
from petmjx.runs.option_types import EngineName

FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors of all lengths. 1 is the drawn pile."""

SAYS_WHY = Flag.MOVING | Flag.KNIFE_EDGE | Flag.SINKING | Flag.TIMESTEP
"""Flags that mark verdicts which small differences may have decided."""

FLOOR_MM = (600.0, 400.0)
SIDES_MM = (100, 400)
MASSES_KG = (0.5, 12.0)
BOXES = (3, 8)
FLAT_SHARE = 0.7
"""Share of boxes that are as high as the first box, so that other boxes lie on several supports."""

PLACES = 10
CAREFUL_SHARE = 0.9
"""Share of boxes for which ``PLACES`` places are tried. With these two values, about half of all piles stand."""


@dataclass(frozen=True, eq=False)
class Pile:
    """Boxes in packing order. ``size`` and ``corner``: (n, 3), mm; ``mass``: (n,), kg."""

    size: FloatArray
    corner: FloatArray
    mass: FloatArray

    def plan(self, name: str, factor: float) -> Plan:
        """The pile as a plan, with all lengths multiplied by a factor. Masses do not change."""
        return Plan.from_boxes(name, size_mm=factor * self.size, corner_mm=factor * self.corner, mass_kg=self.mass)


def pile(rng: np.random.Generator) -> Pile:
    """A random pile. Each box is let down from above, at a random place over a rectangle of the floor. For most boxes,
    some places are tried, and the place with the largest supported share of the base is taken."""
    n = int(rng.integers(BOXES[0], BOXES[1] + 1))
    size = rng.integers(SIDES_MM[0], SIDES_MM[1] + 1, (n, 3)).astype(float)
    size[rng.random(n) < FLAT_SHARE, 2] = size[0, 2]
    corner = np.zeros((n, 3))
    for box in range(n):
        chosen = -1.0
        for _ in range(PLACES if rng.random() < CAREFUL_SHARE else 1):
            low = np.floor(rng.random(2) * (np.array(FLOOR_MM) - size[box, :2]))
            z, share = _let_down(low, size[box], corner[:box], size[:box])
            if share > chosen:
                chosen, corner[box] = share, (*low, z)
    lightest, heaviest = np.log(MASSES_KG)
    return Pile(size, corner, np.exp(rng.uniform(lightest, heaviest, n)).round(3))


def _let_down(low: FloatArray, size: FloatArray, corners: FloatArray, sizes: FloatArray) -> tuple[float, float]:
    """The height at which a box comes to rest on k other boxes, mm, and the supported share of its base."""
    common = np.minimum(low + size[:2], corners[:, :2] + sizes[:, :2]) - np.maximum(low, corners[:, :2])
    area = np.maximum(common, 0.0).prod(axis=1)
    tops = corners[:, 2] + sizes[:, 2]
    z = float(tops[area > 0].max(initial=0.0))
    return z, 1.0 if z == 0 else float(area[tops == z].sum() / size[:2].prod())


def thresholds(factor: float) -> Thresholds:
    """The default thresholds, with the thresholds that are lengths multiplied by a factor."""
    usual = Thresholds()
    lengths = ("shift_m", "shift_floor_m", "drop_hull_z_m")
    return usual.model_copy(update={name: factor * getattr(usual, name) for name in lengths})


def scaled(seed: int, piles: int, engine: EngineName, factors: Sequence[float] = FACTORS) -> pd.DataFrame:
    """The worlds of all piles in all sizes: one row per pile and factor, with the columns of ``worlds`` and ``factor``.

    Args:
        seed: of the piles.
        factors: of all lengths.
    """
    rng = np.random.default_rng(seed)
    drawn = [pile(rng) for _ in range(piles)]
    width = len(str(piles - 1))
    frames = []
    for factor in factors:
        plans = [pile.plan(f"pile-{number:0{width}}", factor) for number, pile in enumerate(drawn)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = petmjx.score(plans, engine=engine, threads=1, thresholds=thresholds(factor), keep="worlds")
        frames.append(run.worlds.assign(factor=factor))
    return pd.concat(frames, ignore_index=True)


def changes(worlds: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame, bool]]:
    """Yield the piles whose verdicts differ between sizes: the id, the worlds, and whether one of these worlds has a
    flag for doubtful verdicts."""
    for plan_id, rows in worlds.groupby("plan_id", observed=True):
        if rows["verdict"].nunique() > 1:
            yield str(plan_id), rows, bool((rows["flags"] & int(SAYS_WHY)).any())


def main() -> None:
    """Print which verdicts change."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--piles", type=int, default=500)
    parser.add_argument("--engine", default="mujoco")
    options = parser.parse_args()
    begin = time.perf_counter()
    worlds = scaled(options.seed, options.piles, options.engine)
    for plan_id, rows, flagged in changes(worlds):
        print(plan_id, "flagged" if flagged else "WITHOUT A FLAG")
        print(rows[["factor", "verdict", "reason", "margin", "plan_edge_m", "rest_edge_m", "flags"]].to_string())
    counts = Counter(flagged for _, _, flagged in changes(worlds))
    verdicts = worlds.loc[worlds["factor"] == 1.0, "verdict"].value_counts().to_dict()
    print(
        f"{options.piles} piles (seed {options.seed}, {options.engine}), as drawn {verdicts}: verdicts of "
        f"{counts.total()} change between {FACTORS[0]} and {FACTORS[-1]}, of {counts[False]} without a flag "
        f"({time.perf_counter() - begin:.0f} s)"
    )


if __name__ == "__main__":
    main()
