"""Finds the largest level of a profile (motion of the carrier) that a pallet survives, and how the pallet fails at a
larger level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from petmjx.common.text import alternatives
from petmjx.common.units import FloatArray
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


@dataclass
class SearchBracket:
    """What a search has found so far about one item, that is, about one combination of a placement, a profile and a
    direction.

    Attributes:
        stands_at_rest: whether the pallet stood before any profile. If the pallet did not stand, no level is tested.
        survived: index of the largest survived level that is below all failed levels, or −1 if there is none.
        failed: index of the smallest level that failed; the number of levels if none failed; 0 if the pallet falls at
            rest.
        highest: index of the largest survived level, even if a smaller level failed.
        box, mode: number of the box that failed first at level ``failed`` or at rest, and its mode of failure. The
            number is −1 if no box failed.
    """

    stands_at_rest: bool
    survived: int
    failed: int
    highest: int
    box: int = -1
    mode: str = ""
    n_tests: int = 0
    n_invalid: int = 0
    n_moving: int = 0

    @property
    def monotone(self) -> bool:
        """Whether the pallet also failed at all tested levels above the smallest failed level."""
        return self.highest <= self.failed


class Bisection:
    """Finds the largest level survived for many items together. An item is one combination of a placement, a profile
    and a direction.

    All items share one grid of levels. So the answer for an item is wrong by at most one step of the grid, and the
    tested levels do not depend on the order in which simulations end. In each round, up to ``sections`` levels of an
    item are tested at the same time, evenly spread between the largest level that the pallet survived and the smallest
    level at which it failed. The rounds of one item do not wait for the rounds of other items.

    The search assumes that a pallet that survives a level also survives all lower levels. The assumption can be wrong:
    a stronger push may press a box against its neighbour, so that the box jams. If a level above a failed level was
    survived, the answer is still the largest level below all failed levels, and ``monotone`` is False for the item.

    Args:
        levels: (n_levels,) levels in ascending order, in g or as a scale.
        at_rest: for each item, the result of the simulation without a profile. If the pallet does not stand in this
            simulation, the search for the item ends at once, and no level is survived. If ``levels[0]`` is 0, a pallet
            that stands without a profile has survived level 0.
        sections: number of levels of an item that are tested at the same time, ≥ 1. With 1, the search is plain
            bisection.

    Attributes:
        items: for each item, what the search has found so far.
    """

    def __init__(
        self,
        levels: ArrayLike,
        at_rest: Sequence[Probe],
        sections: int = 3,
    ) -> None:
        self.levels: FloatArray = np.asarray(levels, dtype=np.float64)
        if self.levels.ndim != 1 or len(self.levels) < 1 or np.any(np.diff(self.levels) <= 0):
            raise ValueError("levels must be a list of ascending numbers, with at least one number")
        if sections < 1:
            raise ValueError(f"sections must be ≥ 1, got {sections}")
        self.sections = sections
        self.items = [self._at_begin(world) for world in at_rest]

    def _at_begin(self, world: Probe) -> SearchBracket:
        if world.verdict is not Verdict.STABLE:
            return SearchBracket(False, -1, 0, -1, world.culprit, world.mode)
        survived = 0 if self.levels[0] == 0 else -1
        return SearchBracket(True, survived, len(self.levels), survived)

    def bounds(self, item: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Two tests, each as (item, index of the level): the test at the largest level survived, and the test at the
        smallest level that failed."""
        bracket = self.items[item]
        return (item, bracket.survived), (item, bracket.failed)

    def largest_survived(self, item: int) -> float | None:
        """The largest survived level below all failed levels, in g or as a scale; None if no level below all failed
        levels was survived."""
        survived = self.items[item].survived
        return float(self.levels[survived]) if survived >= 0 else None

    def first_failed(self, item: int) -> float | None:
        """The smallest level that failed, in g or as a scale; None if no level failed, or if nothing was tested."""
        bracket = self.items[item]
        return (
            float(self.levels[bracket.failed]) if bracket.stands_at_rest and bracket.failed < len(self.levels) else None
        )

    def next_tests(self, item: int) -> list[tuple[int, int]]:
        """The next tests of an item, as pairs (item, index of the level). If the answer for the item is known, the list
        is empty."""
        bracket = self.items[item]
        untested = bracket.failed - bracket.survived - 1
        count = min(self.sections, untested)
        steps = np.round(np.arange(1, count + 1) * (untested + 1) / (count + 1)).astype(np.int64)
        return [(item, bracket.survived + step) for step in steps.tolist()]

    def record(self, tests: Sequence[tuple[int, int]], worlds: Sequence[Probe]) -> None:
        """Record the results of tests. All tests that ``next_tests`` returned for an item must be recorded in one call,
        which may contain tests of several items.

        If a test is invalid, its level counts as failed, and the mode of failure is the reason why the test is invalid.
        """
        if len(tests) != len(worlds):
            raise ValueError("tests and worlds must have the same length, since each test has one world")
        survivors = []
        for (item, level), world in zip(tests, worlds, strict=True):
            bracket = self.items[item]
            bracket.n_tests += 1
            bracket.n_invalid += world.verdict is Verdict.INVALID
            bracket.n_moving += world.moving
            if world.verdict is Verdict.STABLE:
                survivors.append((bracket, level))
            elif level < bracket.failed:
                bracket.failed = level
                bracket.box, bracket.mode = world.culprit, world.mode
        # Levels that the pallet survived are recorded last: such a level must not raise the answer if it is above a
        # level at which the pallet failed.
        for bracket, level in survivors:
            bracket.highest = max(bracket.highest, level)
            if level < bracket.failed:
                bracket.survived = max(bracket.survived, level)
