"""The number of outcomes that mjx-warp reports as at hand, which need no further time slice of the device."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.outcomes import make_outcome

from petmjx.engines.mjx.readback import Readback
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.engines.warp import time_slices
from petmjx.engines.warp.time_slices import SliceResult, outcomes_of
from petmjx.options.simulation import Simulation

WAIT_S = 30


def round_of(rows: NDArray[np.int64]) -> SliceResult:
    """The result of a time slice in which these rows have ended, with one batch for every two rows."""
    picked: Any = [SimpleNamespace(rows=rows[first : first + 2]) for first in range(0, len(rows), 2)]
    recorder: Any = None
    return SliceResult(picked, recorder, (), range(10))


@pytest.mark.parametrize("ended", [[2, 0], [2, 0, 2], [2, 2, 0, 0]], ids=str)
def test_a_slice_in_which_no_world_has_ended_has_no_outcome_at_hand(
    ended: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``ended``: number of worlds that end in each slice. All these slices end before the first outcome is made. One
    more world ends in a later slice, which ends after the last of these outcomes is made."""
    gone_through, due = threading.Event(), threading.Event()

    def slices() -> Generator[SliceResult]:
        for number, count in enumerate(ended):
            yield round_of(np.arange(count) + sum(ended[:number]))
        gone_through.set()
        assert due.wait(WAIT_S)
        yield round_of(np.array([sum(ended)]))

    def made(picked: Sequence[Readback], *_: Any) -> Iterator[Outcome]:
        assert gone_through.wait(WAIT_S)
        rows = [row for batch in picked for row in batch.rows.tolist()]
        yield from (make_outcome(1, Verdict.STABLE, job=row) for row in rows)

    monkeypatch.setattr(time_slices, "outcomes", made)
    progress, at_hand = Progress(), list[int | None]()
    for outcome in outcomes_of(slices(), Simulation(), progress, waits=False):
        assert outcome.job == len(at_hand)
        at_hand.append(progress.at_hand)
        if len(at_hand) == sum(ended):
            due.set()
    assert at_hand == [*reversed(range(sum(ended))), 0]
    assert progress.at_hand is None, "nobody says so any more"
