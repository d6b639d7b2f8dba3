"""The options that decide when a pallet is quiet, and when it rests (``Quiet``).

Defaults, units, checks and descriptions are defined only here. docs/rules.md, section 5, has the exact rules, step by
step.
"""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, within

MOST_STEPS: Final = 100_000
"""Largest value of options that are numbers of steps. A larger value probably has a digit too many."""


class Quiet(CheckedRecord):
    """The conditions under which a pallet is quiet enough for the next box, and under which a simulated pallet is at
    rest.

    A pallet is quiet when all boxes have been slower than ``quiet_m_s`` for ``steps`` steps. The speed of a box is the
    speed of its fastest point. docs/rules.md, section 5, has the exact rules, step by step.

    With elliptic friction cones, there are two more conditions. First, each box must be slow or have slowed down.
    Second, no moving box may have become faster, because a box that begins to topple becomes faster. A box that
    violates one of these two conditions is said to creep, and delays the next box. Once a creeping box has dropped or
    tilted too far, it no longer delays the next box, because the outcome is then known.

    A box that moves back and forth without net motion is said to tremble. Trembling boxes never delay the next box.

    A simulated pallet is at rest if no point of any box moved faster than ``still_m_s`` in the last ``still_steps``
    steps of its rest window. The rest window is the time at the end over which forces at rest are averaged.
    """

    quiet_m_s: Annotated[float, within(0, 100)] = Field(
        0.01, gt=0, description="a box is quiet if the speed of its fastest point is below this, m/s"
    )
    slow_m_s: Annotated[float, within(0, 100)] = Field(
        0.001, ge=0, description="a box is slow if the speed of its fastest point is below this, m/s"
    )
    slowing: Annotated[float, within(0, 1000)] = Field(
        0.7,
        ge=0,
        description="a quiet box creeps if it is not slow, and its speed is still at least this share of the speed "
        "that it had when it became quiet",
    )
    steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        15, ge=1, description="number of steps for which all boxes must have been quiet before the next box is placed"
    )
    landing_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        50,
        ge=1,
        description="number of steps for which a box counts as landing after its placement; in these steps, no rest "
        "window begins, and accelerations do not count as signs of an explosion",
    )
    poll_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        5, ge=1, description="number of steps between two checks whether the pallet is quiet"
    )
    still_m_s: Annotated[float, within(0, 100)] = Field(
        0.0001, ge=0, description="a box counts as still if the speed of its fastest point is at most this, m/s"
    )
    still_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        50,
        ge=1,
        description="a simulated pallet is at rest if all boxes were still for this number of steps at the end of its "
        "world",
    )
    tremble_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        250,
        ge=1,
        description="length, in steps, of the windows into which a wait is divided; at the end of each window, petmjx "
        "searches for trembling boxes",
    )
    tremble_share: Annotated[float, within(0, 1)] = Field(
        0.25,
        ge=0,
        description="share of a path: a box trembles if, throughout a window of tremble_steps, its distance from where "
        "it was when the window began is at most this share of the path that it travels in the window",
    )

    @property
    def tremble_looks(self) -> int:
        """Number of checks, within ``tremble_steps`` steps, whether the pallet is quiet; rounded up."""
        return -(-self.tremble_steps // self.poll_steps)
