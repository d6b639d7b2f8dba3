"""The part of a run that is being collected."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

from petmjx.results.counts import COUNTED, WorldCounts
from petmjx.results.parts import Part


@dataclass
class Pending:
    """The part that is being collected, and what was written before it."""

    part: Part
    counts: WorldCounts = field(default_factory=WorldCounts)
    since_s: float = 0.0
    """When its first world came (monotonic clock). Time before that, such as for compiling, does not count."""

    def following(self) -> Pending:
        """The next part, once this one is written."""
        counts = replace(self.counts, verdicts=Counter(self.counts.verdicts))
        cells = [row.cells for row in self.part.rows]
        counts.add(*([cell[name] for cell in cells] for name in COUNTED))
        return Pending(Part(self.part.number + 1), counts)
