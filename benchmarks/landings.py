"""Measures landings of a box that falls on another box: the depth, the bounce and the force, for several timesteps.

``python -m benchmarks.landings [ENGINE]`` prints the rows.
"""

from __future__ import annotations

import math
import sys
from functools import cache
from typing import Any, NamedTuple

import numpy as np

import petmjx
from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.options.physics import LANDING_S, RESTITUTION
from petmjx.options.quiet import Quiet

HEIGHTS_MM = (10.0, 50.0, 100.0, 300.0)
MOST_DEPTH_MM = (1.0, 3.0, 5.0, 9.0)
"""For each height of the fall, the largest accepted depth of a box below its place of rest, mm."""
TIMESTEPS_S = (0.002, 0.001, 0.0005)
ASKED = (0.0, 0.1, 0.3)
NEAR = 0.03
"""Largest accepted difference between measured and set restitution."""
CARDBOARD = (0.1, 0.3)
"""Usual range of the restitution of cardboard (petmjx.options.physics.RESTITUTION)."""


class Landed(NamedTuple):
    """The result of a landing: the largest depth of the box below its place of rest, mm; the restitution, from the
    height of the rebound; and the largest force on the box below, N."""

    depth_mm: float
    restitution: float
    peak_n: float


@cache
def landed(engine: str, height_mm: float, timestep_s: float, landing_s: float, restitution: float) -> Landed:
    """Simulate a box of 5 kg that falls on an equal box."""
    size, corner = [[400, 300, 200]] * 2, [[400, 250, 0], [400, 250, 200]]
    plan = petmjx.Plan.from_boxes("two", size_mm=size, corner_mm=corner, mass_kg=[5.0, 5.0])
    physics = {"timestep_s": timestep_s, "landing_s": landing_s, "restitution": restitution}
    placing: dict[str, Any] = {"name": "drop", "height_mm": height_mm}
    # with every timestep, the box below waits equally long; otherwise it might still rise after a landing
    quiet = {"steps": round(Quiet().steps * TIMESTEPS_S[0] / timestep_s)}
    story = petmjx.tell(
        "two",
        [plan],
        engine=engine,
        carrier="euro-pallet",
        placing=placing,
        physics=physics,
        quiet=quiet,
        interval_s=timestep_s,
    )
    height: FloatArray = story.history.pos[:, 1, 2]
    height = height[np.isfinite(height)]
    above = height - height[-1]
    touched = int(np.argmax(above < 0))
    rebound_m = max(float(above[touched:].max()), 0.0)
    fall_m_s = math.sqrt(2e-3 * STANDARD_GRAVITY * height_mm)
    return Landed(
        -1e3 * float(above[touched:].min()),
        math.sqrt(2 * STANDARD_GRAVITY * rebound_m) / fall_m_s,
        float(story.outcome.boxes.max_top_force_n[0]),
    )


def rows(engine: str) -> list[dict[str, Any]]:
    """Rows of the gallery: quantity, source, measured, petmjx, miss (0: within the measured range), engine."""

    def row(quantity: str, source: str, low: float, high: float, value: float) -> dict[str, Any]:
        miss = max(low - value, value - high, 0.0)
        fields = {"quantity": quantity, "source": source, "measured": f"{low:g} to {high:g}"}
        return fields | {"petmjx": round(value, 3), "miss": round(miss, 3), "engine": engine}

    made, step_s, depth = [], TIMESTEPS_S[0], "depth to which the box sinks"
    given, wanted = "petmjx's own limit for this depth", "restitution that was set"
    for height_mm, most_mm in zip(HEIGHTS_MM, MOST_DEPTH_MM, strict=True):
        usual = landed(engine, height_mm, step_s, LANDING_S, RESTITUTION)
        title = f"restitution in falls from {height_mm:g} mm, by default"
        made.append(row(title, "usual range of cardboard", *CARDBOARD, usual.restitution))
        made.append(row(f"{depth} in falls from {height_mm:g} mm, by default, mm", given, 0, most_mm, usual.depth_mm))
        for restitution in ASKED:
            landing = landed(engine, height_mm, step_s, LANDING_S, restitution)
            conditions = f"in falls from {height_mm:g} mm, with `restitution` {restitution:g}"
            made.append(row(f"{depth} {conditions}, mm", given, 0, most_mm, landing.depth_mm))
            low, high = restitution - NEAR, restitution + NEAR
            made.append(
                row(f"restitution of the simulated bounce {conditions}", wanted, low, high, landing.restitution)
            )
            bounces = [landed(engine, height_mm, s, LANDING_S, restitution).restitution for s in TIMESTEPS_S[1:]]
            worst = restitution + max((bounce - restitution for bounce in bounces), key=abs)
            at_worst = "restitution of the simulated bounce, at the timestep with the larger error (1 or 0.5 ms),"
            made.append(row(f"{at_worst} {conditions}", wanted, low, high, worst))
        for name, landing_s in (("by default", LANDING_S), ("with `landing_s` 0", 0.0)):
            peaks = [landed(engine, height_mm, timestep_s, landing_s, RESTITUTION).peak_n for timestep_s in TIMESTEPS_S]
            spread = max(peaks) / min(peaks) - 1
            falls = f"in falls from {height_mm:g} mm, {name}"
            quantity = f"relative spread of the peak force over three timesteps (largest / smallest − 1) {falls}"
            made.append(row(quantity, "no source", 0, 0.12, spread))
    return made


if __name__ == "__main__":
    for line in rows(sys.argv[1] if len(sys.argv) > 1 else "mujoco"):
        print("  ".join(str(value) for value in line.values()))
