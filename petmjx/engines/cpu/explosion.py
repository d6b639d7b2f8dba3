"""The rule that finds simulations that cannot be right (docs/rules.md, section 7), for one world of the C engine."""

from __future__ import annotations

from petmjx.engines.cpu.waits import NEVER


class Explosion:
    """Looks for large accelerations that last, without a sign that explains them.

    When light boxes land, or tipping boxes hit something, they reach 240 rad/s² for a few steps; one such sample is not
    an explosion. So samples right after a placement do not count. And one violent sample is not enough: the following
    ones, over at least as many steps as a box needs to land, must be violent too.

    Args:
        landing: steps that a box needs to land.
    """

    def __init__(self, landing: int) -> None:
        self._landing, self._fast_since = landing, NEVER

    def seen(self, step: int, placed_at: int, too_fast: bool) -> bool:
        """Whether the sample after a step says that the world explodes.

        Args:
            placed_at: the step after which the last box was placed; this one while a box is carried.
            too_fast: whether an acceleration is beyond its threshold and no sign has been seen.
        """
        if step - placed_at < self._landing:
            return False
        self._fast_since = min(self._fast_since, step) if too_fast else NEVER
        return too_fast and step - self._fast_since >= self._landing
