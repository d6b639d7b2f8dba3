"""Finds the largest level of a profile (motion of the carrier) that a pallet survives, and how the pallet fails at a
larger level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from petmjx.common.text import alternatives
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict, failures
from petmjx.options.thresholds import FAILURES, Thresholds

DEFAULT_THRESHOLDS = Thresholds()

MODES: Mapping[Reason, str] = {failure.reason: failure.mode for failure in FAILURES}
"""Reason of an unstable world → its mode of failure, as in the column ``mode``."""

MODES_TEXT = alternatives(failure.mode for failure in reversed(FAILURES))
"""The modes of failure, in descriptions of columns."""


def failure_mode(outcome: Outcome, thresholds: Thresholds = DEFAULT_THRESHOLDS) -> str:
    """How the first box failed: the mode of the first of ``FAILURES`` that has happened to the box, such as "drop".

    If the box is within its thresholds again, the mode is "slide". A search reports the mode at the lowest level that
    fails. At a level just above the largest level that the pallet survives, the mode usually shows how the failure
    began. At a much larger level, a box that slides also falls, so the mode is usually "drop". For an invalid world,
    the mode is the reason why the world is invalid. For a stable world, the mode is "".
    """
    if outcome.verdict is not Verdict.UNSTABLE or outcome.culprit < 0:
        return MODES.get(outcome.reason, str(outcome.reason))
    happened = (reason for reason, failed in failures(outcome.boxes, thresholds) if failed[outcome.culprit])
    return MODES[next(happened, Reason.SHIFT)]


@dataclass(frozen=True)
class Probe:
    """The result of one test of a search, which is a simulation at one level. The row of the test in the table
    ``worlds`` has the same values, so that a search can be resumed.

    Attributes:
        culprit: number of the box that failed first, or −1 if no box failed.
        mode: the mode of failure (`failure_mode`).
        moving: whether boxes were still moving at the end of the simulation. If boxes were moving, a longer simulation
            may have another verdict.
        values: column → value, for the columns that the sweep adds to ``worlds``.
    """

    verdict: Verdict
    culprit: int = -1
    mode: str = ""
    moving: bool = False
    values: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        outcome: Outcome,
        thresholds: Thresholds = DEFAULT_THRESHOLDS,
        values: Mapping[str, Any] | None = None,
    ) -> Probe:
        """The result of a test, made from the outcome of its simulation."""
        moving = Flag.MOVING in outcome.flags
        return cls(outcome.verdict, outcome.culprit, failure_mode(outcome, thresholds), moving, values or {})

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> Probe:
        """The result of a test, made from its row in the table ``worlds``: column → value, where None stands for
        null."""
        culprit = -1 if row["culprit"] is None else int(row["culprit"])
        return cls(Verdict(row["verdict"]), culprit, row["mode"], bool(row["flags"] & Flag.MOVING), row)


class LevelSearch:
    """Finds the largest level that a pallet survives, for one placement, one profile and one direction.

    All searches of a sweep share one grid of levels. So the answer is wrong by at most one step of the grid, and the
    tested levels do not depend on the order in which simulations end. In each round, up to ``sections`` levels are
    tested at the same time, evenly spread between the largest level that the pallet survived and the smallest level at
    which it failed.

    The search assumes that a pallet that survives a level also survives all lower levels. The assumption can be wrong:
    a stronger push may press a box against its neighbour, so that the box jams. If a level above a failed level was
    survived, the answer is still the largest level below all failed levels, and ``monotone`` is False.

    Args:
        n_levels: number of levels of the grid. A level is represented by its index in the grid, in ascending order.
        at_rest: the result of the simulation without a profile. If the pallet does not stand in this simulation, the
            search ends at once, and no level is survived.
        sections: number of levels that are tested at the same time, ≥ 1. With 1, the search is plain bisection.
        from_zero: whether the lowest level is 0. If it is 0, a pallet that stands without a profile has survived it.

    Attributes:
        stands_at_rest: whether the pallet stood before any profile. If the pallet did not stand, no level is tested.
        survived: the largest survived level that is below all failed levels, or −1 if there is none.
        failed: the smallest level that failed; the number of levels if none failed; 0 if the pallet falls at rest.
        highest: the largest survived level, even if a smaller level failed.
        at_survived, at_failed: results of the tests at the levels ``survived`` and ``failed``; None if there was no
            test at the level.
        box, mode: number of the box that failed first at level ``failed`` or at rest, and its mode of failure. The
            number is −1 if no box failed.
    """

    def __init__(self, n_levels: int, at_rest: Probe, sections: int = 3, *, from_zero: bool = False) -> None:
        if n_levels < 1 or sections < 1:
            raise ValueError(f"n_levels and sections must be ≥ 1, got {n_levels} and {sections}")
        self.n_levels, self.sections = n_levels, sections
        self.stands_at_rest = at_rest.verdict is Verdict.STABLE
        self.survived = self.highest = 0 if self.stands_at_rest and from_zero else -1
        self.failed = n_levels if self.stands_at_rest else 0
        self.at_survived: Probe | None = None
        self.at_failed: Probe | None = None
        self.box, self.mode = (-1, "") if self.stands_at_rest else (at_rest.culprit, at_rest.mode)
        self.n_tests = self.n_invalid = self.n_moving = 0

    @property
    def monotone(self) -> bool:
        """Whether the pallet also failed at all tested levels above the smallest failed level."""
        return self.highest <= self.failed

    @property
    def largest_survived(self) -> int | None:
        """The largest survived level below all failed levels; None if there is no such level."""
        return self.survived if self.survived >= 0 else None

    @property
    def first_failed(self) -> int | None:
        """The smallest level that failed; None if no level failed, or if nothing was tested."""
        return self.failed if self.stands_at_rest and self.failed < self.n_levels else None

    def next_levels(self) -> list[int]:
        """The levels to test next, in ascending order. If the answer is known, the list is empty."""
        untested = self.failed - self.survived - 1
        count = min(self.sections, untested)
        steps = np.round(np.arange(1, count + 1) * (untested + 1) / (count + 1)).astype(np.int64)
        return [self.survived + step for step in steps.tolist()]

    def record(self, results: Mapping[int, Probe]) -> None:
        """Record the results of all tests that ``next_levels`` returned, as level → result.

        If a test is invalid, its level counts as failed, and the mode of failure is the reason why the test is invalid.
        """
        if sorted(results) != self.next_levels():
            raise ValueError(f"the levels {self.next_levels()} must have results, got {sorted(results)}")
        for level, result in sorted(results.items()):
            self.n_tests += 1
            self.n_invalid += result.verdict is Verdict.INVALID
            self.n_moving += result.moving
            if result.verdict is Verdict.STABLE:
                self.highest = max(self.highest, level)
                if level < self.failed:
                    self.survived, self.at_survived = level, result
            elif level < self.failed:
                self.failed, self.at_failed = level, result
                self.box, self.mode = result.culprit, result.mode
