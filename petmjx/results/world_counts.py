"""Counts of worlds for ``run.json``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from petmjx.common.text import count_text
from petmjx.engines.verdict import Flag, Reason, Verdict

NO_VERDICT: Final = "no verdict for"
"""The first words of the warning about worlds that reached the limit of iterations."""

COUNTED: Final = ("verdict", "reason", "attempt", "flags")
"""The columns of ``worlds`` whose values are counted."""


@dataclass(frozen=True)
class WorldCounts:
    """Numbers of worlds by verdict and reason, and of worlds that needed more than one attempt (simulation).

    If boxes still move at the end of a world, a longer simulation might have another verdict. ``moving`` is the number
    of stable worlds with moving boxes at the end. ``moving_by_shift`` is the number of worlds with moving boxes at the
    end that are unstable because of a shift. ``leans`` is the number of stable worlds in which a box leans or lies
    lower than planned.
    """

    verdicts: Counter[tuple[Verdict, Reason]] = field(default_factory=Counter)
    retried: int = 0
    moving: int = 0
    moving_by_shift: int = 0
    leans: int = 0

    @classmethod
    def of(cls, worlds: pa.Table) -> WorldCounts:
        """Count the rows of a table ``worlds`` by the values of the columns ``COUNTED``. A million rows take a tenth of
        a second."""
        groups = worlds.group_by(["verdict", "reason"]).aggregate([([], "count_all")]).to_pylist()

        def having(flag: Flag, column: str, value: str) -> int:
            bits = pc.bit_wise_and(worlds["flags"], pa.scalar(int(flag), pa.int32()))
            return pc.sum(pc.and_(pc.equal(worlds[column], value), pc.not_equal(bits, 0))).as_py() or 0

        return cls(
            Counter({(Verdict(row["verdict"]), Reason(row["reason"])): row["count_all"] for row in groups}),
            retried=pc.sum(pc.greater(worlds["attempt"], 1)).as_py() or 0,
            moving=having(Flag.MOVING, "verdict", Verdict.STABLE.value),
            moving_by_shift=having(Flag.MOVING, "reason", Reason.SHIFT.value),
            leans=having(Flag.LEANS, "verdict", Verdict.STABLE.value),
        )

    def __add__(self, other: WorldCounts) -> WorldCounts:
        return WorldCounts(*(getattr(self, entry.name) + getattr(other, entry.name) for entry in fields(self)))

    def iteration_limit_warning(self, limit: int | None) -> str | None:
        """The warning about worlds that have no verdict because they reached ``limit``, the largest number of solver
        iterations of a world; None if there are no such worlds."""
        count = self.verdicts[Verdict.INVALID, Reason.ITERATION_LIMIT]
        if not count:
            return None
        worlds = count_text(count, "world")
        shares = "shares leave out these worlds, and may be wrong"
        remedy = "a larger limit, or none, allows more iterations"
        return f"{NO_VERDICT} {worlds} with iteration_limit={limit}: {shares}; {remedy}"

    def as_json(self) -> dict[str, Any]:
        """The numbers as plain JSON values: all worlds by verdict, and worlds that are not stable also by reason."""
        by_reason: dict[str, dict[str, int]] = {Verdict.UNSTABLE.value: {}, Verdict.INVALID.value: {}}
        by_verdict = {verdict.value: 0 for verdict in Verdict}
        for (verdict, reason), count in sorted(self.verdicts.items()):
            by_verdict[verdict.value] += count
            if verdict is not Verdict.STABLE:
                by_reason[verdict.value][reason.value] = count
        return {
            "worlds": self.verdicts.total(),
            **by_verdict,
            "by_reason": by_reason,
            "moving": self.moving,
            "moving_by_shift": self.moving_by_shift,
            "leans": self.leans,
            "retried": self.retried,
        }
