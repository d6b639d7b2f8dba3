"""Packings judged by physics: placed exactly, and in worlds with errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from petmjx.api import score
from petmjx.packing.finalists import Finalist
from petmjx.packing.options import PhysicalOptions
from petmjx.plans.plan import Plan
from petmjx.plans.samples import as_placements
from petmjx.plans.validate import parse_plan
from petmjx.verdict import Verdict

SOURCE = "pack"
"""In place of a file's name."""


@dataclass(frozen=True)
class Judged:
    """A packing and what physics says of it.

    Attributes:
        plan: its plan.
        verdict: placed exactly.
        n_worlds: worlds with errors that have a verdict; ``n_standing``: those that stand.
    """

    finalist: Finalist
    plan: Plan
    verdict: Verdict
    n_worlds: int
    n_standing: int

    @property
    def stands(self) -> bool:
        """Whether it stands, placed exactly."""
        return self.verdict is Verdict.STABLE

    @property
    def share(self) -> float:
        """Share of the worlds with errors that stands; without such worlds 1 if it stands when placed exactly,
        else 0.
        """
        return self.n_standing / self.n_worlds if self.n_worlds else float(self.stands)

    def is_good(self, options: PhysicalOptions) -> bool:
        """Whether it stands as often as asked for."""
        return self.stands and self.share >= options.least_share


def judge(packings: Mapping[str, Finalist], options: PhysicalOptions, how: Mapping[str, Any]) -> dict[str, Judged]:
    """What physics says of packings, all in one run.

    Args:
        packings: plan id → packing.
        how: options of ``petmjx.score``.

    Raises:
        InputError: unusable options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    plans = {plan_id: plan_of(plan_id, finalist) for plan_id, finalist in packings.items()}
    sure = {"confidence": options.worlds} if options.worlds else {}
    worlds = score([*plans.values()], **{**how, **sure}).worlds
    exact = worlds[worlds["variant"] == 0].set_index("plan_id")["verdict"]
    known = worlds[(worlds["variant"] > 0) & (worlds["verdict"] != Verdict.INVALID.value)]
    count = known.groupby("plan_id").size()
    standing = known[known["verdict"] == Verdict.STABLE.value].groupby("plan_id").size()
    return {
        plan_id: Judged(
            packings[plan_id],
            plan,
            Verdict(exact[plan_id]),
            int(count.get(plan_id, 0)),
            int(standing.get(plan_id, 0)),
        )
        for plan_id, plan in plans.items()
    }


def plan_of(plan_id: str, finalist: Finalist) -> Plan:
    """A packing as a plan, as if it had been read from a file of ``petmjx samples``."""
    placements = as_placements(finalist.placed)
    return parse_plan(plan_id, SOURCE, placements, len(placements), {})


def choose(judged: Sequence[Judged], options: PhysicalOptions) -> Judged:
    """The one that is taken: of those that stand as often as asked for the one with most volume, then with most of what
    is maximised. If none does, the one that stands most often.

    Args:
        judged: at least one.
    """
    good = [each for each in judged if each.is_good(options)]
    if not good:
        return max(judged, key=lambda each: (each.stands, each.share, each.finalist.volume_m3))
    by_share = options.maximise == "share"
    return max(
        good, key=lambda each: (each.finalist.volume_m3, each.share if by_share else 0.0, each.finalist.utilisation)
    )
