"""Verdicts of a score for open pallets. The first attempt continues from their settled state if the engine gives the
same bits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from petmjx.engines.open_worlds import OpenWorlds
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

AT_ONCE = 4096
"""Most worlds that are finished side by side."""


class SettledEngine(Engine):
    """An engine that takes the first attempt at a plan from the open world that has the plan's boxes, and simulates all
    other attempts.

    On ``mjx-warp`` a world does not depend on how its boxes were put in. On ``mujoco`` waiting boxes are in a world's
    model, and affect the last digits. So for exact digits no attempt comes from open worlds there.

    Args:
        plans: open world → the plan with the same boxes.
        to_the_bit: whether outcomes must have the digits of a score.
    """

    def __init__(
        self,
        engine: Engine,
        open_worlds: OpenWorlds,
        plans: Mapping[int, Plan],
        sim: Simulation,
        *,
        to_the_bit: bool = True,
    ) -> None:
        self.name, self._engine, self._open, self._sim = engine.name, engine, open_worlds, sim
        self._worlds: dict[bytes, int] = {}
        if engine.name in ("mjx-warp", "mjx-warp-cpu") or not to_the_bit:
            self._worlds = {_key(Job(build_scene(plan, sim))): world for world, plan in plans.items()}

    @property
    def device(self) -> str:
        return self._engine.device

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """See ``Engine.run``."""
        world_by_job: dict[int, int] = {}
        if sim == self._sim:
            open_worlds = {index: self._worlds.get(_key(job)) for index, job in enumerate(jobs) if job.record is None}
            world_by_job = {index: world for index, world in open_worlds.items() if world is not None}
        numbers = list(world_by_job)
        for first in range(0, len(numbers), AT_ONCE):
            chunk_numbers = numbers[first : first + AT_ONCE]
            for outcome in self._open.finish([world_by_job[index] for index in chunk_numbers]):
                outcome.job = chunk_numbers[outcome.job]
                yield outcome
        other_jobs = [index for index in range(len(jobs)) if index not in world_by_job]
        if other_jobs:
            for outcome in self._engine.run([jobs[index] for index in other_jobs], sim, progress):
                outcome.job = other_jobs[outcome.job]
                yield outcome


def _key(job: Job) -> bytes:
    """A key that identifies the boxes of a pallet, among pallets of one carrier."""
    scene = job.scene
    return scene.mass.tobytes() + scene.half_size.tobytes() + scene.target.tobytes()
