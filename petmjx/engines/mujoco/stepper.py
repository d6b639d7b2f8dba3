"""Takes the steps of a world on C MuJoCo: many at a time, or one by one if the forces or the iterations of each step
are needed."""

from __future__ import annotations

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import RESTLESS_M_S, RISING_M_S2
from petmjx.engines.mujoco.landing import CALM_M_S2
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.mujoco.soft_boxes import SoftWorld
from petmjx.engines.mujoco.top_forces import top_force_inputs
from petmjx.engines.mujoco.world_timeout import Budget
from petmjx.options.simulation import Simulation

_RESTLESS_SQUARE = 0.5 * RESTLESS_M_S**2
"""If the sum of the squares of all velocities (m/s and rad/s) is at most this value, no point within 1 m of a box's
centre is faster than ``RESTLESS_M_S``."""


class Stepper:
    """Takes the steps of a world, as long as its time budget lasts.

    Args:
        sim: the options, which determine when the rules check whether the pallet is quiet. The largest forces on tops
            include the forces in the steps of these checks.
        budget: the time budget of the world. If ``budget`` is None, there is no limit.
        iteration_limit: largest number of solver iterations; None: no limit.

    Attributes:
        is_spent: whether the world has used up its iterations (``iteration_limit``).
    """

    def __init__(self, sim: Simulation, budget: Budget | None, iteration_limit: int | None) -> None:
        self._looks, self._poll_steps = sim.waits_for_rest, sim.quiet.poll_steps
        self._budget = budget
        self._placed, self._restless = 0, True
        self._iteration_limit, self._iterations, self.is_spent = iteration_limit, 0, False

    def restart_iterations(self) -> None:
        """Count the iterations of the solver from 0 on."""
        self._iterations, self.is_spent = 0, False

    def take(
        self, live: LiveWorld | SoftWorld, first: int, count: int, metrics: OracleMetrics | None, acts: bool
    ) -> int:
        """Take ``count`` steps. Returns the number of steps taken, which is smaller if the time is up or the iterations
        are used up.

        Args:
            first: number of the first step.
            metrics: object that records the forces on the tops of boxes; None if these forces are not needed.
            acts: whether a drive (motion of the carrier) acts. If a drive acts, the largest forces on the tops of boxes
                include the forces in every step.
        """
        number, end, budget = first, first + count, self._budget
        while number < end:
            if budget is not None and budget.is_spent(number - 1, live.n_placed):
                return number - first
            placed, self._placed = self._placed, live.n_placed
            if placed != live.n_placed or (number - 1) % self._poll_steps == 0:
                # ``_restless`` decides which steps count for the largest forces. It is updated every ``_poll_steps``
                # steps, not in every call. Otherwise, recording a world would change its results, since each recorded
                # frame ends a call.
                self._restless = placed != live.n_placed or not _is_calm(live)
            last = min(end, number + self._poll_steps - (number - 1) % self._poll_steps)
            counts = metrics if self._looks and live.n_placed and (acts or self._restless) else None
            if counts is None and self._iteration_limit is None and (budget is None or not budget.slow):
                live.step(last - number)
                number = last
                continue
            rising = live.data.qacc[2::6]
            while number < last:
                if budget is not None and budget.slow and budget.is_spent(number - 1, live.n_placed):
                    return number - first
                live.step(1)
                if counts is not None:
                    self._look(live, number, rising, acts, counts)
                number += 1
                if self._iteration_limit is not None:
                    self._iterations += sum(live.data.solver_niter.tolist())
                    self.is_spent = self._iterations >= self._iteration_limit
                    if self.is_spent:
                        return number - first
        return count

    def _look(
        self, live: LiveWorld | SoftWorld, number: int, rising: FloatArray, acts: bool, metrics: OracleMetrics
    ) -> None:
        """Record the forces on the tops of boxes in this step, if the step counts for the largest forces. All steps of
        a drive and of a soft world count. Other steps count if the rules check whether the pallet is quiet, or if a
        body is accelerated upwards by more than ``RISING_M_S2``. (The caller leaves out the steps of calm worlds, see
        ``_is_calm``.) ``rising``: upward accelerations of bodies, m/s²."""
        if isinstance(live, SoftWorld):
            metrics.add_forces(live.top_forces()[: live.n_free])
        elif acts or number % self._poll_steps == 0 or np.maximum.reduce(rising) > RISING_M_S2:
            metrics.add_step(top_force_inputs(live.data, live.geom_bodies, live.n_free))


def _is_calm(live: LiveWorld | SoftWorld) -> bool:
    """Whether no box is fast (``_RESTLESS_SQUARE``), and all accelerations are so small (``CALM_M_S2``) that no box
    becomes fast before the next check whether the pallet is quiet."""
    speed, acceleration = live.data.qvel, live.data.qacc
    return bool(speed.dot(speed) <= _RESTLESS_SQUARE and acceleration.dot(acceleration) <= CALM_M_S2**2)
