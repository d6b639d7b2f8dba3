"""Which engine to use: the user's, or for ``auto`` the one that is expected to finish first."""

from __future__ import annotations

import contextlib
import importlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from petmjx.config import Check, Schedule, SimConfig
from petmjx.engines.base import Engine
from petmjx.errors import EngineUnavailable, InputError
from petmjx.machine import cpu_threads, why_no_warp
from petmjx.units import seconds_to_steps

AUTO = "auto"

ENGINES: dict[str, tuple[str, str]] = {
    "mujoco": ("petmjx.engines.cpu.engine", "MujocoEngine"),
    "mjx-jax": ("petmjx.engines.batch.mjx_jax", "MjxJaxEngine"),
    "mjx-warp": ("petmjx.engines.warp.engine", "MjxWarpEngine"),
}
"""Engine name → module and class. A module is imported only when its engine is asked for."""


@dataclass(frozen=True)
class Choice:
    """An engine's name and, in one line, why it was taken."""

    name: str
    reason: str


@dataclass(frozen=True)
class BreakEven:
    """What the two fast engines cost, as far as choosing between them needs it.

    The cost of a step grows about with the square of the boxes that are placed, on both.

    Attributes:
        cpu_step_s: seconds one CPU thread takes for a step of one world, per box².
        gpu_step_s: seconds a device takes for a step of ``full_lanes`` worlds, per box².
        full_lanes: worlds that fill the device.
        tail_lanes: what the end of a run costs, in worlds: its last ones run on a device that is all but idle.
        gpu_start_s: start-up of the device engine, programs compiled anew.
        adaptive_share, brisk_share: cost of a schedule as a share of the fixed one's, collapsing plans included.
    """

    cpu_step_s: float = 2.4e-7
    gpu_step_s: float = 2.4e-6
    full_lanes: int = 2048
    tail_lanes: int = 3300
    gpu_start_s: float = 25.0
    adaptive_share: float = 0.4
    brisk_share: float = 0.34

    def seconds(self, n_boxes: Sequence[int], sim: SimConfig, threads: int) -> tuple[float, float]:
        """Expected seconds for one world per entry of ``n_boxes``: on CPU threads, and on the device."""
        if not len(n_boxes):
            return 0.0, self.gpu_start_s
        boxes = np.asarray(n_boxes, dtype=float)
        timestep = sim.physics.timestep_s
        if sim.check is Check.STATIC:
            box2_steps = boxes**2 * seconds_to_steps(sim.duration_s, timestep)
        else:
            # boxes come one by one: the mean of k² over k = 1…n is about n²/3
            box2_steps = boxes**2 / 3 * (boxes + 1) * seconds_to_steps(sim.interval_s, timestep)
        shares = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: self.adaptive_share, Schedule.BRISK: self.brisk_share}
        box2_steps = box2_steps * shares[sim.schedule]
        lanes = (len(boxes) + self.tail_lanes) / self.full_lanes
        cpu_s = self.cpu_step_s * float(box2_steps.sum()) / threads
        return cpu_s, self.gpu_start_s + self.gpu_step_s * float(box2_steps.mean()) * lanes


H100 = BreakEven()
"""Fitted to generated plans with 43 boxes on average, adaptive, on one H100 and 16 threads (benchmarks/README.md).
Measured there: mjx-warp compiles for 22 s (7 s with programs kept from an earlier run) and runs 18 s for 500 plans,
24 s for 2,000, 41 s for 4,000 and 63 s for 8,000; mujoco scores 13.8 plans/s. So a GPU pays from about 650 such plans
on. Other sizes and other devices have not been fitted."""


def choose_engine(
    n_boxes: Sequence[int], sim: SimConfig, *, threads: int | None = None, costs: BreakEven = H100
) -> Choice:
    """The engine ``auto`` stands for.

    Args:
        n_boxes: boxes of each world that is to be simulated.
        sim: what is simulated; its check and schedule decide how many steps there are.
        threads: CPU threads the ``mujoco`` engine would use; None: all.
        costs: the break-even's parameters.
    """
    threads = threads or cpu_threads()
    cpu_s, gpu_s = costs.seconds(n_boxes, sim, threads)
    if cpu_s <= gpu_s:
        return Choice("mujoco", f"about {cpu_s:.0f} s on {threads} CPU threads, a GPU would need about {gpu_s:.0f} s")
    if problem := why_no_warp():
        return Choice("mujoco", f"mjx-warp would be faster but cannot run: {problem}")
    return Choice("mjx-warp", f"about {gpu_s:.0f} s, {threads} CPU threads would need about {cpu_s:.0f} s")


def resolve_engine(
    name: str, n_boxes: Sequence[int], sim: SimConfig, *, threads: int | None = None, lanes: int | None = None
) -> tuple[Engine, Choice]:
    """The engine for a run, built, and why it was taken. ``auto`` uses whichever of the options applies.

    Raises:
        InputError, EngineUnavailable: as ``make_engine``.
    """
    if name != AUTO:
        return make_engine(name, threads=threads, lanes=lanes), Choice(name, "as asked for")
    choice = choose_engine(n_boxes, sim, threads=threads)
    if choice.name == "mujoco":
        return make_engine(choice.name, threads=threads), choice
    return make_engine(choice.name, lanes=lanes), choice


def make_engine(name: str, *, threads: int | None = None, lanes: int | None = None) -> Engine:
    """Build an engine by name.

    Args:
        threads: CPU threads of ``mujoco``; None: all.
        lanes: worlds at once of the MJX engines; None: chosen from the device's memory.

    Raises:
        InputError: no such engine, or an option that it does not have.
        EngineUnavailable: it cannot run here; the text says why.
    """
    if name not in ENGINES:
        raise InputError(f"unknown engine {name!r}; there are {', '.join(ENGINES)} and {AUTO}")
    options: dict[str, Any] = {}
    if name == "mujoco":
        if lanes is not None:
            raise InputError("lanes belong to the MJX engines; the engine mujoco has threads")
        options["threads"] = threads
    else:
        if threads is not None:
            raise InputError(f"threads belong to the engine mujoco; the engine {name} has lanes")
        options["lanes"] = lanes
    module_name, class_name = ENGINES[name]
    try:
        # mujoco.mjx prints to standard output where Warp is not installed; that belongs to results
        with contextlib.redirect_stdout(io.StringIO()):
            module = importlib.import_module(module_name)
    except ImportError as error:
        raise EngineUnavailable(f"engine {name} cannot run here: {error}") from error
    engine: Engine = getattr(module, class_name)(**options)
    return engine
