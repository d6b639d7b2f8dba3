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
    """Answer each look in turn, with its outcomes, or with the line of an error."""
    looks, answers = own_pipes(NICE)
    while (look := next_of(looks)) is not None:
        try:
            found: list[Outcome] | str = looked_at(*look)
        except Exception as error:
            found = one_line(error)
        try:
            pickle.dump(found, answers)
            answers.flush()
        except BrokenPipeError:
            break
    os._exit(0)
