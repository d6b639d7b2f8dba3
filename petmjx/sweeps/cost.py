"""How long a sweep may take, and on which engine it is expected to finish first."""

from __future__ import annotations

import numpy as np

from petmjx.engines.base import Engine
from petmjx.engines.choose import AUTO, H100, BreakEven, Choice, make_engine
from petmjx.machine import cpu_threads, why_no_warp
from petmjx.sweeps.grid import SweepPlan

GROWING_SHARE = 1 / 3
"""Cost of a step while boxes come one by one, as a share of that of the full pallet: the mean of k² over k = 1…n."""

STEP_OVERHEAD_S = 3e-5
"""Seconds a CPU thread takes for a step besides what grows with the square of the boxes."""

SHAKEN_FACTOR = 2.0
"""Cost of a drive's steps in those of a pallet at rest. One that slides takes up to five times as long a step, one that
falls ends sooner; measured on two plans of 16 and 20 boxes on the CPU."""

CPU_JAX_STEP_S = 1.1e-5
"""Seconds mjx-jax takes on a CPU for a step of one world, per box²: 57 steps/s with 40 boxes on two cores."""


def sweep_seconds(plan: SweepPlan, threads: int, costs: BreakEven = H100) -> dict[str, float]:
    """Expected seconds by engine. For ``mjx-jax`` those of a CPU."""
    profiles = list(plan.sweep.profiles.values())
    nominal = int(plan.sweep.nominal)
    drive_steps = float(np.mean([plan.drive_steps(profile) for profile in profiles])) if profiles else 0.0
    n_drives = plan.n_variants - nominal if profiles else 0
    n_placements = plan.n_placements + nominal
    boxes = np.array([each.n_boxes for each in plan.plans], dtype=float)
    placing = n_placements * np.array([plan.placement_steps(each) for each in plan.plans], dtype=float)
    driving = np.full(len(boxes), n_drives * drive_steps)
    box2_steps = float((boxes**2 * (GROWING_SHARE * placing + SHAKEN_FACTOR * driving)).sum())

    def device_s(worlds: float, steps: float) -> float:
        """A phase of many worlds: their steps on a full device, and the end of it, when few still run."""
        if not worlds:
            return 0.0
        lanes = (worlds + costs.tail_lanes) / costs.full_lanes
        return costs.gpu_step_s * lanes * steps

    total = len(boxes) * (n_placements + n_drives)
    mean_placing = float((GROWING_SHARE * boxes**2 * placing).sum()) / (len(boxes) * n_placements)
    mean_driving = SHAKEN_FACTOR * float((boxes**2).mean()) * drive_steps
    return {
        "mujoco": (costs.cpu_step_s * box2_steps + STEP_OVERHEAD_S * float((placing + driving).sum()))
        / min(threads, total),
        "mjx-jax": CPU_JAX_STEP_S * box2_steps,
        "mjx-warp": costs.gpu_start_s
        + device_s(len(boxes) * n_placements, mean_placing)
        + device_s(len(boxes) * n_drives, mean_driving),
    }


def sweep_engine(
    name: str, plan: SweepPlan, *, threads: int | None = None, lanes: int | None = None
) -> tuple[Engine, Choice]:
    """The engine for a sweep, built, and why it was taken. ``auto`` uses whichever of the options applies.

    Raises:
        InputError, EngineUnavailable: as :func:`petmjx.engines.choose.make_engine`.
    """
    if name != AUTO:
        return make_engine(name, threads=threads, lanes=lanes), Choice(name, "as asked for")
    count = threads or cpu_threads()
    seconds = sweep_seconds(plan, count)
    cpu_s, gpu_s = seconds["mujoco"], seconds["mjx-warp"]
    if cpu_s <= gpu_s:
        reason = f"about {cpu_s:.0f} s on {count} CPU threads, a GPU would need about {gpu_s:.0f} s"
        return make_engine("mujoco", threads=threads), Choice("mujoco", reason)
    if problem := why_no_warp():
        reason = f"mjx-warp would be faster but cannot run: {problem}"
        return make_engine("mujoco", threads=threads), Choice("mujoco", reason)
    reason = f"about {gpu_s:.0f} s, {count} CPU threads would need about {cpu_s:.0f} s"
    return make_engine("mjx-warp", lanes=lanes), Choice("mjx-warp", reason)
