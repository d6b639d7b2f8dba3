"""How long a world on C MuJoCo waits for its next event (docs/rules.md, sections 4 and 5).

For the MJX engines, the tables in petmjx/engines/mjx/timetable.py and the rules in petmjx/engines/mjx/rules.py do the
same.
"""

from __future__ import annotations

from petmjx.common.units import seconds_to_steps
from petmjx.engines.step_clock import Clock
from petmjx.options.simulation import Check, Schedule, Simulation

NEVER = 2**62
"""A step number that no world reaches."""


class Waits:
    """The wait for the next event: the next placement, the drive (motion of the carrier), or the rest window at the
    end.

    Attributes:
        settles: True if a drive follows the placement, or if the settled state is kept.
        since: the step after which the wait begins.
        last_placement: the step after which the last box was placed.
        drive_end: the last step of the drive, if boxes do not come to rest earlier; None before the drive begins.
    """

    def __init__(self, sim: Simulation, clock: Clock, settles: bool) -> None:
        self._sim, self._clock, self.settles = sim, clock, settles
        self._dt = sim.physics.timestep_s
        self._static = sim.check is Check.STATIC
        self._adaptive = sim.schedule is not Schedule.FIXED
        self.since = self.last_placement = 0
        self.drive_end: int | None = None
        self._boxes, self._all_placed = 0, False
        self._patient, self._latest, self._latest_if_failed = False, NEVER, NEVER

    @property
    def adapts(self) -> bool:
        """Whether the next event comes as soon as the pallet is quiet. With the fixed schedule, the result is True only
        if the world was still moving at its end and got more time."""
        return self._adaptive or self.since > self.last_placement

    @property
    def rests_first(self) -> bool:
        """Whether a rest window comes before the drive. At the end of the window, the world may get more time."""
        return self._adaptive and self._sim.waits_for_rest

    @property
    def _is_plain_static(self) -> bool:
        """Whether the simulation is a static check without a drive. The option ``duration_s`` is the length of a static
        check without a drive.
        """
        return self._static and not self.settles

    def begin(self, step: int, n_boxes: int, all_placed: bool, restless: bool) -> None:
        """Start to wait for the next event, after the step ``step``.

        Args:
            n_boxes: number of boxes of the plan.
            all_placed: whether all boxes are placed.
            restless: whether this wait must be short, because an earlier wait ended while boxes were moving, and this
                wait is not the world's last.
        """
        self.since, self._boxes, self._all_placed = step, n_boxes, all_placed
        self._patient = self._sim.waits_for_rest and self.adapts and not self._is_plain_static
        self._latest_if_failed = NEVER
        self._latest = self.longest_wait if self._patient and not restless else self._latest_after(step)

    def lasts_longer(self, step: int) -> bool:
        """Whether this wait would continue after ``step`` if it were the last wait of the world. (After a wait that
        ended while boxes were moving, all waits are short, except the last wait of the world.)"""
        return self._patient and step < self.longest_wait

    def deadline(self, sign_step: int | None) -> int:
        """The latest step at which the next event can happen. When a box has failed, a long wait is useless. The long
        wait then becomes a short wait that begins at the first sign of failure.

        Args:
            sign_step: step of the first sign of failure; None if no box has failed.
        """
        if self.in_drive:
            return NEVER
        if sign_step is None or not self._patient:
            return self._latest
        if self._latest_if_failed == NEVER:
            self._latest_if_failed = self._latest_after(max(self.since, sign_step))
        return self._latest_if_failed

    def _latest_after(self, since: int) -> int:
        """The latest end of a short wait, as a step number. The wait began after the step ``since``, and the next event
        comes when the wait ends.

        With the fixed schedule, a drive starts at the same time as in the reference implementation. The start of the
        drive is counted from the nominal time of the last placement. (The real placement is a few steps later, since
        times are rounded to steps.)
        """
        sim = self._sim
        if self._all_placed and self.settles and self.drive_end is None:
            fixed_s = 0.0 if self._static else self._boxes * sim.interval_s
            placed_s = self._clock.time_s(since) if self._adaptive else fixed_s
            return seconds_to_steps(placed_s + sim.settle_s, self._dt)
        if self._is_plain_static:
            return self.static_end
        return self._later(since, sim.interval_s)

    @property
    def in_drive(self) -> bool:
        """Whether the world now waits for quiet after the last sample of a drive. A wait for quiet after a drive ends
        before ``drive_end``.
        """
        return self.drive_end is not None and self.since < self.drive_end

    def last_end(self, step: int) -> int:
        """The last step of a world whose boxes are not at rest after ``step``. ``NEVER`` if unknown."""
        return self.drive_end if self.drive_end is not None and step < self.drive_end else NEVER

    @property
    def longest_wait(self) -> int:
        """The last step of a world that keeps moving: ``longest_wait_s`` after its last placement or, if it has a
        drive, after the end of the drive."""
        return self._later(self.last_placement if self.drive_end is None else self.drive_end, self._sim.longest_wait_s)

    def may_go_on(self, step: int) -> bool:
        """Whether a world whose boxes still move at its end, after ``step``, gets more time."""
        if not self._sim.waits_for_rest or self._sim.total_time_factor is not None:
            return False
        return step < (self.static_end if self._is_plain_static else self.longest_wait)

    def _later(self, since: int, wait_s: float) -> int:
        """The step at which a wait is over. After a drive, the length of a wait is counted in steps, like the length of
        the drive.
        """
        if self.drive_end is not None:
            return since + seconds_to_steps(wait_s, self._dt)
        return self._clock.first_after(since, wait_s)

    @property
    def static_end(self) -> int:
        """The last step of a static check without a drive."""
        return seconds_to_steps(self._sim.duration_s, self._dt)

    def end_of_fixed(self, n_boxes: int) -> int:
        """The last step of a world with the fixed schedule and without a drive. The value is ``NEVER`` if this step is
        not known in advance.
        """
        if self._adaptive or self.settles:
            return NEVER
        if self._static:
            return self.static_end
        return seconds_to_steps((n_boxes + 1) * self._sim.interval_s, self._dt)
