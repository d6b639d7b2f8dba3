"""An engine without physics, which yields outcomes at once, in this process or in workers. With this engine, the time
of a run is that of the host's work on worlds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.protocol import Progress, says_at_hand
from petmjx.engines.remote import worker_pool
from petmjx.engines.remote.ray_actor import Worker
from petmjx.engines.user_engine import UserEngine
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

FALL_EVERY = 10
INVALID_EVERY = 500
"""Of ``FALL_EVERY`` worlds, one falls. Of ``INVALID_EVERY`` worlds, one is invalid at the first attempt and stands at
the second."""


class Instant:
    """An engine that simulates nothing: in most outcomes, boxes stand at their planned places. Like other engines, it
    begins with the largest world.

    Args:
        repeats: whether some worlds are invalid at the first attempt.
    """

    name = "instant"

    def __init__(self, *, repeats: bool = True) -> None:
        self._repeats = repeats

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        progress = progress or Progress()
        again, rng = sim.solver_tolerance is not None, np.random.default_rng(len(jobs))
        sizes = np.array([job.scene.n_boxes for job in jobs])
        for left, k in zip(reversed(range(len(jobs))), np.argsort(-sizes, kind="stable").tolist(), strict=True):
            progress.at_hand = left
            pos = jobs[k].scene.target
            moved = 1e-4 * rng.standard_normal(pos.shape)
            if k % INVALID_EVERY == 1 and self._repeats and not again:
                yield _outcome(k, pos, moved, Verdict.INVALID, Reason.EXPLOSION, Flag.EXPLOSION)
            elif k % FALL_EVERY == 3:
                moved[-1, 0] = 0.05
                yield _outcome(k, pos, moved, Verdict.UNSTABLE, Reason.SHIFT, Flag.EARLY_STOP)
            else:
                yield _outcome(k, pos, moved, Verdict.STABLE, Reason.NONE, Flag.NONE)


IN_WORKERS = "mjx-warp-cpu"
"""Name of the engine that a run must request so that its workers answer at once."""


def instant_workers() -> dict[str, Any]:
    """Name in the module ``worker_pool`` → its value with which workers answer at once, and get jobs as if they had a
    GPU."""
    return {"Worker": InstantWorker, "LEAST": {IN_WORKERS: worker_pool.LEAST["mjx-warp"]}}


@contextmanager
def answering_in_workers() -> Iterator[None]:
    """A context in which workers that this process starts answer at once."""
    instant = instant_workers()
    before = {name: vars(worker_pool)[name] for name in instant}
    vars(worker_pool).update(instant)
    try:
        yield
    finally:
        vars(worker_pool).update(before)


class InstantWorker(Worker):
    """A worker that starts its engine like any worker, and then replaces it by an engine that answers at once. No world
    needs a further attempt, because C MuJoCo would make it."""

    def hello(self) -> bytes:
        greeting = super().hello()
        self._built = Future()
        self._built.set_result(UserEngine(Instant(repeats=False), None))
        return greeting


def _outcome(job: int, pos: FloatArray, moved: FloatArray, verdict: Verdict, reason: Reason, flags: Flag) -> Outcome:
    n, falls = len(pos), verdict is Verdict.UNSTABLE
    return Outcome(
        job=job,
        verdict=verdict,
        reason=reason,
        culprit=n - 1 if falls else -1,
        first_sign_s=1.0 + abs(moved[0, 0]) if falls else float("nan"),
        n_boxes=n,
        n_placed=n,
        sim_time_s=2.0,
        n_steps=1000 + int(1e6 * abs(moved[0, 1])),
        flags=flags,
        boxes=BoxMetrics(
            **_still(n)
            | {
                "pos": pos,
                "shift_m": moved,
                "max_tilt_deg": 1e3 * np.abs(moved[:, 0]),
                "max_top_force_n": 1e5 * abs(moved[:, 1]),
            }
        ),
        n_at_sign=n if falls else 0,
    )


@cache
def _still(n: int) -> dict[str, Any]:
    """Metrics of n boxes that stand still, by name. No code changes these arrays."""
    zero, upright = np.zeros(n), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return vars(BoxMetrics.measured(n, max_lin_acc=zero, max_ang_acc=zero, rest_top_force_n=zero, quat=upright))
