"""Verdicts on open pallets (pallets to which boxes can be added), as ``petmjx.score`` would give them. A score
simulates a plan, and may simulate the plan again with other settings (further attempts). The first attempt may continue
from the pallet's current state, instead of simulating all placements again, if the result is then the same to the last
bit."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass

from petmjx.engines.open_world_protocol import OpenWorlds
from petmjx.engines.protocol import Engine, Progress, says_at_hand
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

AT_ONCE = 4096
"""Largest number of open worlds that the engine simulates to their end in one call."""


class SettledEngine(Engine):
    """An engine for scores of open pallets. For the first attempt at a plan, the engine finishes the simulation of the
    open pallet that has the plan's boxes. All other attempts are simulated from the start.

    On the engine ``mjx-warp``, results do not depend on whether boxes were added later. On ``mujoco``, boxes that wait
    to be placed are part of the model, and their presence affects the last digits. So on ``mujoco``, open pallets are
    not used if results must be exact to the last digit.

    Args:
        to_the_bit: whether outcomes must be bit-identical to the outcomes of a score.
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
        """Register that an open world (an open pallet's simulation) has the boxes of this job, and is at rest."""
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
                if outcome is not None:  # None means that the engine has paused
                    outcome.job = other_jobs[outcome.job]
                yield outcome


@dataclass(frozen=True, eq=False)
class PalletWorld:
    """A pallet in its current state, for which a verdict is requested."""

    pallet: int
    name: str
    job: Job
    variant: int = 0


def pallet_scores(
    engine: SettledEngine, sim: Simulation, following: Callable[[], Sequence[PalletWorld]]
) -> Generator[tuple[int, Outcome]]:
    """Score pallets, including further attempts, while boxes are still put onto other pallets. Yields pairs of a
    pallet's number and its outcome, in any order.

    Args:
        following: function that returns the pallets to score next. The function is called after each outcome. The
            function may put boxes onto pallets that have been scored, and may return no pallets while others are still
            being scored. The generator ends when ``following`` returns no pallets and all pallets have been scored.
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
    """A key that identifies the boxes and places of a pallet. All pallets must have the same carrier."""
    scene = job.scene
    return scene.mass.tobytes() + scene.half_size.tobytes() + scene.target.tobytes()
