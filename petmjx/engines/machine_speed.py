"""The speed of this machine, for estimates. The constants of petmjx/engines/cost_model.py were measured on another
machine.

The speed is measured in CPU time of the thread, so that other programs on the machine have little effect. A measurement
delays the first step of a run by 0.3 s, so its result is kept for ten minutes in a file beside the compiled kernels.
"""

from __future__ import annotations

import functools
import hashlib
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from petmjx.common.atomic_write import atomic_write
from petmjx.common.compile_caches import cache_folder
from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.machine import cpu_name, package_versions
from petmjx.engines.cost_model import MEASURED, Costs
from petmjx.engines.expected_work import Work
from petmjx.engines.kernel_notes import CPU_KERNEL, are_noted
from petmjx.engines.subprocess.kernel_builds import are_kept
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

WORTH_S: Final = 1.0
"""Smallest expected time of a run for which the machine is measured, s. The measurement takes 0.1 to 0.3 s."""

KEPT_S: Final = 600.0
"""Time for which a measured value is kept, s. Other programs that begin or end change the speed of a processor a
little, so the value is not kept for longer."""

BOX_MM: Final = (400.0, 300.0, 200.0)
SIDE, LAYERS, ROUNDS = 3, 3, 2
"""To measure the machine, a block of boxes is simulated. The block has ``SIDE`` × ``SIDE`` boxes in each of ``LAYERS``
layers, and does not collapse. It is simulated ``ROUNDS`` times, and only the fastest time counts, since other work on
the machine may slow down a simulation."""

REFERENCE_S: Final = 0.04
"""CPU time for simulating the test block of boxes on the machine of ``MEASURED``, s."""

SLOWEST, FASTEST = 8.0, 0.125
"""Largest and smallest result of ``slowness``. A measured value beyond these bounds cannot be the speed of a machine;
the bound is used instead."""


def costs_here(work: Work, threads: int) -> Costs:
    """The costs of the engines on this machine. The machine's speed is measured only for runs of at least a second.

    Args:
        work: the work of the run.
        threads: number of CPU threads on which the run simulates worlds.
    """
    costs = with_kept_kernels(work)
    seconds = costs.seconds(work, threads)
    if min(seconds["mujoco"], seconds["mjx-warp-cpu"]) < WORTH_S:
        return costs
    return costs.slowed(slowness())


def with_kept_kernels(work: Work) -> Costs:
    """The costs ``MEASURED``, with less time for starting an engine whose kernels an earlier run on this machine has
    compiled. On a GPU, runs with film or compliant boxes need further kernels. petmjx does not note which of these
    kernels are compiled, so these runs get the full time."""
    costs = MEASURED
    if are_noted(CPU_KERNEL):
        costs = replace(costs, kernel_start_s=costs.kernel_load_s)
    if not np.any(work.filmed) and not work.compliant.any() and are_kept(work.sim):
        costs = replace(costs, gpu_start_s=costs.gpu_load_s)
    return costs


@functools.cache
def slowness() -> float:
    """Time that a CPU thread of this machine needs for a simulation, divided by the time of a thread of the machine on
    which the costs ``MEASURED`` were measured. The time is measured, unless a process of this user has measured it at
    most ``KEPT_S`` ago.
    """
    with suppress(OSError, ValueError, EngineUnavailable):
        file = _kept_file()
        age_s, kept = time.time() - file.stat().st_mtime, float(file.read_text())
        if 0.0 <= age_s < KEPT_S and FASTEST <= kept <= SLOWEST:
            return kept
    measured = float(np.clip(min(block_s() for _ in range(ROUNDS)) / REFERENCE_S, FASTEST, SLOWEST))
    with suppress(OSError, InputError, EngineUnavailable), atomic_write(_kept_file()) as file:
        file.write_text(repr(measured))
    return measured


def _kept_file() -> Path:
    """The file that keeps the measured value. Machines may share the folder, so the name depends on the processor, and
    on the versions of the packages that were measured."""
    digest = hashlib.sha256(repr((cpu_name(), sorted(package_versions().items()))).encode()).hexdigest()
    return cache_folder("warp") / f"slowness-{digest[:16]}"


def block_s() -> float:
    """CPU time that this thread needs to simulate the test block on C MuJoCo, s."""
    from petmjx.engines.mujoco.world_run import WorldRun  # MuJoCo takes 0.25 s to import

    sim = Simulation()
    job = Job(build_scene(block(), sim))
    begin_s = time.thread_time()
    WorldRun(0, job, sim, lambda: False).run()
    return time.thread_time() - begin_s


def block() -> Plan:
    """The plan of the test block: columns of boxes, side by side, placed layer by layer."""
    length, width, height = BOX_MM
    at = np.stack(np.meshgrid(np.arange(LAYERS), np.arange(SIDE), np.arange(SIDE), indexing="ij")).reshape(3, -1)
    places = [(x * length, y * width, z * height) for z, y, x in at.T.astype(float)]
    n_boxes = len(places)
    # Plan.from_boxes would load pandas, which takes a quarter of a second
    return Plan(
        plan_id="block",
        source="block",
        size_mm=np.tile(BOX_MM, (n_boxes, 1)),
        corner_mm=np.array(places),
        mass_kg=np.full(n_boxes, 5.0),
        item_ids=("",) * n_boxes,
        articles=("",) * n_boxes,
        sequence=np.arange(1, n_boxes + 1),
    )
