"""The rule for quiet (docs/rules.md, section 5), for one world of the C engine. Its twin: ``Rules.count_quiet``."""

from __future__ import annotations

import numpy as np

from petmjx.config import Simulation
from petmjx.metrics import motion_np
from petmjx.units import FloatArray


class QuietRule:
    """Counts the looks at a pallet and says whether it is quiet. Its numbers: ``petmjx.config.Quiet``.

    The caller looks every ``poll_steps``, and makes sure that ``min_steps`` have passed since the last placement.
    """

    def __init__(self, sim: Simulation) -> None:
        self._rule = sim.quiet
        self._waits_for_creep = sim.waits_for_creep
        self._steps = 0
        self._first_pace: FloatArray = np.zeros(0)

    def restart(self) -> None:
        """A box was placed: the count starts again."""
        self._steps = 0

    def is_quiet(self, velocity: FloatArray, sign_seen: bool) -> bool:
        """One look.

        Args:
            velocity: (k, 6) of the placed boxes, linear in m/s and angular in rad/s.
            sign_seen: whether a box has crossed a threshold; then creep is not waited for.
        """
        rule = self._rule
        pace = motion_np.pace(velocity, rule)
        if not (pace < 1).all():
            self._steps = 0
            return False
        if self._steps == 0:
            self._first_pace = pace
        self._steps += rule.poll_steps
        if self._steps < rule.steps:
            return False
        if not self._waits_for_creep or sign_seen:
            return True
        creeps = not (pace < np.maximum(rule.rest_share, rule.slowing * self._first_pace)).all()
        if creeps:
            self._steps, self._first_pace = rule.poll_steps, pace
        return not creeps
