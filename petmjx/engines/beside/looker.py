"""What runs in a process that looks at outcomes. It needs neither JAX nor Warp, and ends with the run."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from typing import Final

from petmjx.basics.text import one_line
from petmjx.engines.beside.child import next_of, own_pipes
from petmjx.engines.looked_at import looked_at
from petmjx.options.config import Simulation
from petmjx.verdict import Outcome
from petmjx.world.job import Job

NICE: Final = 5

Look = tuple[Sequence[Outcome], Sequence[Job], Simulation]
"""The arguments of ``looked_at``."""


def main() -> None:
    """Answer each look in turn, with its outcomes without their boxes, or with the line of an error."""
    looks, answers = own_pipes(NICE)
    while (look := next_of(looks)) is not None:
        answer: list[Outcome] | str
        try:
            answer = looked_at(*look)
            for outcome in answer:
                del outcome.boxes  # the run has them, and would need most of its time for an answer to read them
        except Exception as error:
            answer = one_line(error)
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except BrokenPipeError:
            break
    os._exit(0)
