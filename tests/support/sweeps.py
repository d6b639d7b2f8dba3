"""Small sweeps, and an engine that records its jobs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from support.command_line import write
from support.plans import make_plan, stack

QUICK = """
[simulation]
settle_s = 0.4
rest_s = 0.5
early_stop = false
"""


def leaning(plan_id: str, n: int = 2, overhang_mm: float = 0.0) -> Plan:
    """A plan of cartons on top of one another, with every second carton moved along x."""
    return make_plan(plan_id, stack(n, overhang_mm))


def write_sweep(folder: Path, text: str) -> Path:
    return write(folder / "x.toml", text)


class Recorder(MujocoEngine):
    """The engine ``mujoco``, which also records the jobs and options that it gets."""

    def __init__(self, threads: int | None = None) -> None:
        super().__init__(threads)
        self.batches: list[tuple[list[Job], Simulation]] = []

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        jobs = list(jobs)
        self.batches.append((jobs, sim))
        return super().run(jobs, sim, progress)


EUMOS_GRID = """
[axes]
profile = "eumos-40509"
direction = ["+x", "-x", "+y", "-y"]
level = { from = 0.05, to = 0.8, step = 0.05 }
"""
