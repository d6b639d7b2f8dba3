"""How a world takes its steps on C MuJoCo: many at a time, or one by one where forces are looked at after each."""

from __future__ import annotations

import time

import numpy as np

from petmjx.engines.cpu.forces import pressed
from petmjx.engines.cpu.live import LiveWorld
from petmjx.engines.cpu.running import OracleMetrics
from petmjx.engines.cpu.soft import SoftWorld
from petmjx.metrics.spec import RESTLESS_M_S, RISING_M_S2
from petmjx.options.config import Simulation

_RESTLESS_SQUARE = 0.5 * RESTLESS_M_S**2
"""A pallet whose squares of speeds, m/s and rad/s, add up to no more has no point within 1 m of its box's centre that
is faster than ``RESTLESS_M_S``."""

_CALM_SQUARE = 0.5**2
"""The same of accelerations, m/s² and rad/s²: in five steps, the time between two looks for quiet, a box becomes faster
by at most 5 mm/s."""


class Stepper:
    """Takes a world's steps, as many as its time allows.

    Args:
        sim: says which steps count between samples, beside those in which a box lands: looks for quiet.
        timeout_s: seconds that the world may take; None: as many as it needs.
    """

    def __init__(self, sim: Simulation, timeout_s: float | None) -> None:
        self._looks, self._poll_steps = sim.waits_for_rest, sim.quiet.poll_steps
        self._give_up_at = time.monotonic() + timeout_s if timeout_s is not None else None
        self._placed = 0

    def take(
        self, live: LiveWorld | SoftWorld, first: int, count: int, metrics: OracleMetrics | None, acts: bool
    ) -> int:
        """Take steps; returns how many: fewer where the time is up before.

        Args:
            first: the number of the first of them.
            metrics: take in forces of steps.
            acts: a drive does, so that the forces of all steps may be larger than those before.
        """
        counts = metrics if self._looks and live.n_placed and (acts or self._is_restless(live)) else None
        if self._give_up_at is None and counts is None:
            live.step(count)
            return count
        data, step = live.data, live.step
        rising, largest, poll_steps = data.qacc[2::6], np.maximum.reduce, self._poll_steps
        for number in range(first, first + count):
            if self._give_up_at is not None and time.monotonic() > self._give_up_at:
                return number - first
            step(1)
            if counts is None:
                continue
            if isinstance(live, SoftWorld):
                counts.add_forces(live.top_forces()[: live.n_free])
            elif acts or number % poll_steps == 0 or largest(rising) > RISING_M_S2:
                counts.add_step(pressed(data, live.geom_bodies, live.n_free))
        return count

    def _is_restless(self, live: LiveWorld | SoftWorld) -> bool:
        """Whether a box may be fast, or become fast, before the next look for quiet."""
        placed, self._placed = self._placed, live.n_placed
        speed, acceleration = live.data.qvel, live.data.qacc
        calm = speed.dot(speed) <= _RESTLESS_SQUARE and acceleration.dot(acceleration) <= _CALM_SQUARE
        return placed != live.n_placed or not calm
