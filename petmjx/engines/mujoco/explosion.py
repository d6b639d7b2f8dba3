"""The rule that detects explosions (simulations that have become numerically unstable) in a world on C MuJoCo
(docs/rules.md, section 7).

The class ``Rules`` in petmjx/engines/mjx/rules.py has the same rule in JAX.
"""

from __future__ import annotations

from petmjx.engines.mujoco.timetable import NEVER


class Explosion:
    """Detects simulations that cannot be right: accelerations stay large for some time, and no failed box causes them.

    When light boxes land, or tipping boxes hit something, accelerations reach 240 rad/s² for a few steps. So an
    explosion is detected only if accelerations are large in all samples for at least the time that a box needs to land.
    Samples right after a placement are no evidence of an explosion. But if accelerations are small in such a sample,
    the large accelerations before it have ended: one box has landed, and another may land later.

    Args:
        landing: number of steps that a box needs to land.
    """

    def __init__(self, landing: int) -> None:
        self._landing, self._fast_since = landing, NEVER

    def seen(self, step: int, placed_at: int, too_fast: bool) -> bool:
        """Whether the world has exploded, decided after the sample at ``step``.

        Args:
            placed_at: the step after which the last box was placed; while a hand carries a box, the current step.
            too_fast: whether an acceleration is above its threshold although no box has crossed a threshold of failure.
        """
        if not too_fast:
            self._fast_since = NEVER
        if not too_fast or step - placed_at < self._landing:
            return False
        self._fast_since = min(self._fast_since, step)
        return step - self._fast_since >= self._landing
