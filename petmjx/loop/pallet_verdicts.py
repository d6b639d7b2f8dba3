"""Verdicts of a score for open pallets. If the engine gives bit-identical results, the first attempt continues from a
pallet's settled state."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass

from petmjx.engines.attempt_stream import score_worlds
from petmjx.engines.open_worlds import OpenWorlds
from petmjx.engines.protocol import Engine, Progress, says_at_hand
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

AT_ONCE = 4096
"""Largest number of worlds that are finished side by side."""


class SettledEngine(Engine):
    """An engine for pallets that are open. It takes the first attempt at a plan from the open world that has the plan's
    boxes, and simulates all other attempts.

    On ``mjx-warp``, a world's results do not depend on how its boxes were put in. On ``mujoco``, waiting boxes are part
    of a world's model and affect the last digits. So on ``mujoco``, no attempt comes from open worlds if digits must be
    exact.

    Args:
        to_the_bit: whether outcomes must be bit-identical to those of a score.
    """

    def __init__(self, engine: Engine, open_worlds: OpenWorlds, sim: Simulation, *, to_the_bit: bool = True) -> None:
        self.name, self._engine, self._open, self._sim = engine.name, engine, open_worlds, sim
        self._same_bits = engine.name in ("mjx-warp", "mjx-warp-cpu") or not to_the_bit
        self._worlds: dict[bytes, int] = {}
        self._keys: dict[int, bytes] = {}

    @property
    def device(self) -> str:
        return self._engine.device

    def settle(self, job: Job, world: int) -> None:
        """Register an open world: it has the boxes of this job, and has settled."""
        if self._same_bits:
            earlier = self._keys.pop(world, None)
            if earlier is not None and self._worlds.get(earlier) == world:
                del self._worlds[earlier]
            self._keys[world] = key = _key(job)
            self._worlds[key] = world

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """See ``Engine.run``."""
        progress = progress or Progress()
        world_by_job: dict[int, int] = {}
        if sim == self._sim:
            open_worlds = {index: self._worlds.get(_key(job)) for index, job in enumerate(jobs) if job.record is None}
            world_by_job = {index: world for index, world in open_worlds.items() if world is not None}
        numbers = list(world_by_job)
        for first in range(0, len(numbers), AT_ONCE):
            chunk_numbers = numbers[first : first + AT_ONCE]
            outcomes = self._open.finish([world_by_job[index] for index in chunk_numbers])
            for at_hand, outcome in zip(range(len(outcomes) - 1, -1, -1), outcomes, strict=True):
                outcome.job, progress.at_hand = chunk_numbers[outcome.job], at_hand
                yield outcome
        progress.at_hand = None
        other_jobs = [index for index in range(len(jobs)) if index not in world_by_job]
        if other_jobs:
            for outcome in self._engine.run([jobs[index] for index in other_jobs], sim, progress):
                if outcome is not None:  # None: a pause of the engine
                    outcome.job = other_jobs[outcome.job]
                yield outcome


@dataclass(frozen=True, eq=False)
class PalletWorld:
    """A pallet in its current state, for which a score is requested."""

    pallet: int
    name: str
    job: Job
    variant: int = 0


def pallet_scores(
    engine: SettledEngine, sim: Simulation, following: Callable[[], Sequence[PalletWorld]]
) -> Generator[tuple[int, Outcome]]:
    """Score pallets, further attempts included, while others are still being built: (pallet, outcome), in any order.

    Args:
        following: function that returns the pallets to score next; it may return none while some still have no score.
            ``following`` is called after each outcome, and may put boxes onto pallets that have their score. The
            generator ends once ``following`` returns none and all pallets have their score.
    """
    progress = Progress()

    def settled() -> Sequence[PalletWorld]:
        worlds = following()
        for world in worlds:
            engine.settle(world.job, world.pallet)
        return worlds

    for result in score_worlds((), sim, engine, progress=progress, following=settled):
        yield result.world.pallet, result.outcome


def _key(job: Job) -> bytes:
    """A key that identifies the boxes of a pallet, among pallets with the same carrier."""
    scene = job.scene
    return scene.mass.tobytes() + scene.half_size.tobytes() + scene.target.tobytes()
