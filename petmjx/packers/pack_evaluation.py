"""Packings judged by physics: placed exactly, and in worlds with errors."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Final

from petmjx.engines.verdict import Verdict
from petmjx.packers.pack_candidates import Finalist
from petmjx.packers.pack_options import PhysicalOptions
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.plan import Plan
from petmjx.plans.plan_validation import parse_plan

SOURCE = "pack"
"""In place of a file's name."""

FIRST_WORLDS: Final = 4
"""Worlds with errors that are simulated first. Of packings that fall too often most are found out by these."""


@dataclass(frozen=True)
class Evaluation:
    """A packing and what physics says of it.

    Attributes:
        plan: its plan.
        verdict: placed exactly.
        n_worlds: worlds with errors that have a verdict; ``n_standing``: those that stand.
        n_simulated: worlds that were simulated, the nominal one and invalid ones, too.
    """

    finalist: Finalist
    plan: Plan
    verdict: Verdict
    n_worlds: int
    n_standing: int
    n_simulated: int = 0

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


class Trial:
    """A packing while it is simulated: nominal world first, then those with errors.

    Attributes:
        plan: its plan.
        asked: worlds that were asked for.
        n_worlds, n_standing: as of ``Evaluation``, so far.
    """

    def __init__(self, plan_id: str, finalist: Finalist) -> None:
        self.finalist, self.plan = finalist, plan_of(plan_id, finalist)
        self.asked = self.n_worlds = self.n_standing = 0
        self._nominal: Verdict | None = None

    def ask(self, n_worlds: int) -> range:
        """The variants that are missing of the nominal world and so many with errors."""
        first, self.asked = self.asked, 1 + n_worlds
        return range(first, self.asked)

    def take(self, variant: int, verdict: Verdict) -> None:
        """What came of a world."""
        if variant == 0:
            self._nominal = verdict
        elif verdict is not Verdict.INVALID:
            self.n_worlds += 1
            self.n_standing += verdict is Verdict.STABLE

    def is_hopeless(self, options: PhysicalOptions) -> bool:
        """Whether it does not stand as often as asked for, whatever comes of the worlds that are missing."""
        fallen = self.n_worlds - self.n_standing
        most = (options.worlds - fallen) / options.worlds if options.worlds else 1.0
        return not self.judged.stands or most < options.least_share

    def is_whole(self, options: PhysicalOptions) -> bool:
        """Whether all its worlds were asked for."""
        return self.asked > options.worlds

    @property
    def judged(self) -> Evaluation:
        """What physics says of it, so far."""
        assert self._nominal is not None
        return Evaluation(self.finalist, self.plan, self._nominal, self.n_worlds, self.n_standing, self.asked)


Asks = list[tuple[Trial, range]]
"""Worlds that shall be simulated: packings, with variants of each."""


def order_evaluation(
    plan_id: str, found: Sequence[Finalist], options: PhysicalOptions, spare: Callable[[], bool] = lambda: False
) -> Generator[Asks, None, list[Evaluation]]:
    """Ask for the worlds that an order needs, and go on when they have verdicts; return the packings that were judged.

    Packings come one after the other, until one is good. Of each some worlds come first. Those that cannot be good any
    more are given up, unless none is good: then the packing that stands most often is taken, which takes all worlds of
    all of them.

    Args:
        found: the best packings first.
        spare: whether an engine has nothing better to do. Then worlds are asked for before it is known whether they
            are needed.
    """
    tried: list[Trial] = []
    by_share = options.maximise == "share"
    while len(tried) < len(found):
        hurries = spare()
        first = options.worlds if hurries else min(FIRST_WORLDS, options.worlds)
        left = found[len(tried) :]
        now = [Trial(plan_id, finalist) for finalist in (left if hurries or by_share else left[:1])]
        tried += now
        yield [(trial, trial.ask(first)) for trial in now]
        if rest := [trial for trial in now if first < options.worlds and not trial.is_hopeless(options)]:
            yield [(trial, trial.ask(options.worlds)) for trial in rest]
        if any(trial.is_whole(options) and trial.judged.is_good(options) for trial in tried):
            break
    else:
        if rest := [trial for trial in tried if not trial.is_whole(options)]:
            yield [(trial, trial.ask(options.worlds)) for trial in rest]
    return [trial.judged for trial in tried]


def decisive_evaluations(judged: Sequence[Evaluation], options: PhysicalOptions) -> Sequence[Evaluation]:
    """Those among which is chosen, however many more were simulated: up to the first good one, since the others are
    less dense; all of them if the share is maximised."""
    good = next((number for number, packing in enumerate(judged) if packing.is_good(options)), None)
    return judged if good is None or options.maximise == "share" else judged[: good + 1]


def plan_of(plan_id: str, finalist: Finalist) -> Plan:
    """A packing as a plan, as if it had been read from a file of ``petmjx samples``."""
    placements = as_placements(finalist.placed)
    return parse_plan(plan_id, SOURCE, placements, len(placements), {})


def choose(judged: Sequence[Evaluation], options: PhysicalOptions) -> Evaluation:
    """The one that is taken: of those that stand as often as asked for the one with most volume, then with most of what
    is maximised. If none does, the one that stands most often.

    Args:
        judged: at least one.
    """
    good = [packing for packing in judged if packing.is_good(options)]
    if not good:
        return max(judged, key=lambda packing: (packing.stands, packing.share, packing.finalist.volume_m3))
    by_share = options.maximise == "share"
    return max(
        good,
        key=lambda packing: (
            packing.finalist.volume_m3,
            packing.share if by_share else 0.0,
            packing.finalist.utilisation,
        ),
    )
