"""What mjx-warp says of outcomes that are at hand."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator
from typing import Any

import numpy as np
import pytest
from support.outcomes import make_outcome

from petmjx.engines.base import Progress
from petmjx.engines.warp import rounds
from petmjx.engines.warp.rounds import Round, outcomes_of
from petmjx.options.config import Simulation
from petmjx.verdict import Outcome, Verdict

WAIT_S = 30


@pytest.mark.parametrize("ended", [[2, 0], [2, 0, 2], [2, 2, 0, 0]], ids=str)
def test_a_slice_in_which_no_world_has_ended_has_no_outcome_at_hand(
    ended: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """So many worlds end in slices that have gone through before the first outcome is made, and one in a slice that
    goes through after their last one."""
    gone_through, due, recorder = threading.Event(), threading.Event(), object()

    def slices() -> Generator[Round]:
        for number, count in enumerate(ended):
            yield Round(np.arange(count) + sum(ended[:number]), (), recorder, (), range(10))  # type: ignore[arg-type]
        gone_through.set()
        assert due.wait(WAIT_S)
        yield Round(np.array([sum(ended)]), (), recorder, (), range(10))  # type: ignore[arg-type]

    def made(rows: Any, *_: Any) -> Iterator[Outcome]:
        assert gone_through.wait(WAIT_S)
        yield from (make_outcome(1, Verdict.STABLE, job=row) for row in rows.tolist())

    monkeypatch.setattr(rounds, "outcomes", made)
    progress, at_hand = Progress(), list[int | None]()
    for outcome in outcomes_of(slices(), Simulation(), progress, waits=False):
        assert outcome.job == len(at_hand)
        at_hand.append(progress.at_hand)
        if len(at_hand) == sum(ended):
            due.set()
    assert at_hand == [*reversed(range(sum(ended))), 0]
    assert progress.at_hand is None, "nobody says so any more"
