"""What a search for repairs requests of an engine (the simulation of drafts), and what the search is sent in return
(the trials of these drafts).

This module imports nothing of engines or tables, so that the processes of searches start fast.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any, Final, NamedTuple, TypeVar

from petmjx.engines.verdict import Verdict
from petmjx.repairs.drafts import Draft

ERROR_WORLDS: Final = 8
"""Largest number of worlds with random errors in which a repair is judged."""


class TrialRequest(NamedTuple):
    """A draft to be simulated.

    Attributes:
        is_judged: whether the draft is only judged, that is, simulated once, until a box tilts by more than
            ``trials.JUDGED_TILT_DEG``. If False, the draft is scored.
        world: number of the world with random errors in which the draft is judged, from 1 to ``ERROR_WORLDS``. If 0,
            the draft is simulated without errors.
        as_score: whether a judged draft is simulated with the options of a score, so that its trial is attempt 1 of the
            score.
        judged: for a draft that was judged before and is now scored, the trial of that judgement; None if the draft was
            not judged before.
    """

    draft: Draft
    is_judged: bool
    world: int = 0
    judged: Trial | None = None
    as_score: bool = False


class Trial(NamedTuple):
    """The simulation of one draft.

    Attributes:
        verdict, reason: as in the table ``worlds``.
        culprit: number of the box that first crossed a limit; None if no box crossed one.
        fallen: numbers of all boxes that crossed a threshold.
        n_placed: number of boxes that were placed before the world ended.
        n_held: number of boxes that were placed before the first box crossed a limit; ``n_placed`` if no box crossed
            one, or if the draft was scored.
        margin: as in the table ``worlds``; NaN: no margin.
        is_score: whether a score on the same engine would give this verdict, so that the draft need not be simulated
            again. A trial with the options of a score (``TrialRequest.as_score``) counts as a score if no further
            attempt may follow. Any other judged trial counts as a score under three conditions: no further attempt may
            follow, the draft stands, and its boxes were at rest whenever a wait was over. (Under these conditions, the
            waits of the judged draft were as long as those of a score, unless a box was over a threshold at one sample
            and below it later.)
    """

    verdict: str
    reason: str
    culprit: int | None
    fallen: tuple[int, ...]
    n_placed: int
    n_held: int
    margin: float
    is_score: bool = False

    @property
    def stands(self) -> bool:
        """Whether the plan stands."""
        return self.verdict == Verdict.STABLE.value

    @property
    def progress(self) -> tuple[int, int]:
        """How far a plan gets: number of boxes placed before a box crossed a limit, and number of placed boxes that
        crossed no limit."""
        return self.n_held, self.n_placed - len(self.fallen)


class OutOfTime(Exception):
    """The time for the search is up, so the results found so far are final."""


class Together(NamedTuple):
    """Parts of a search that run side by side. The search goes on when all parts that run side by side have ended, and
    is sent the list of the parts' results."""

    parts: Sequence[Steps[Any]]


Result = TypeVar("Result")
Steps = Generator[list[TrialRequest] | Together, Any, Result]
"""A search, or a part of a search. A search yields requests and is sent the list of their trials; or it yields
``Together``."""


class TrialAnswer(NamedTuple):
    """The trials of all drafts of a batch of requests."""

    ticket: Any
    trials: list[Trial]
