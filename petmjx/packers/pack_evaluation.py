"""Evaluates packings by simulation, both placed exactly and in worlds with errors."""

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
"""Source of packed plans in messages. Other plans have the name of a file instead."""

FIRST_WORLDS: Final = 4
"""Number of worlds with errors that are simulated first. This number suffices to refuse most packings that fall too
often."""


@dataclass(frozen=True)
class Evaluation:
    """A packing and the results of its simulations.

    Attributes:
        finalist: the packing.
        plan: the packing as a plan.
        verdict: the verdict of the nominal world, in which all boxes are placed exactly.
        n_worlds: number of worlds with errors that have a verdict.
        n_standing: number of worlds with errors in which the plan stands.
        n_simulated: number of simulated worlds, including the nominal one and invalid ones.
    """

    finalist: Finalist
    plan: Plan
    verdict: Verdict
    n_worlds: int
    n_standing: int
    n_simulated: int = 0

    @property
    def stands(self) -> bool:
        """Whether the plan stands when placed exactly."""
        return self.verdict is Verdict.STABLE

    @property
    def share(self) -> float:
        """Share of the worlds with errors in which the plan stands. Without worlds with errors, the share is 1 if the
        plan stands when placed exactly, else 0.
        """
        return self.n_standing / self.n_worlds if self.n_worlds else float(self.stands)

    def is_good(self, options: PhysicalOptions) -> bool:
        """Whether the plan stands as often as requested."""
        return self.stands and self.share >= options.least_share


class Trial:
    """A packing during its simulation: first the nominal world, then worlds with errors.

    Attributes:
        finalist: the packing.
        plan: the packing as a plan.
        asked: number of requested worlds.
        n_worlds, n_standing: as in ``Evaluation``, for the verdicts so far.
    """

    def __init__(self, plan_id: str, finalist: Finalist) -> None:
        self.finalist, self.plan = finalist, plan_of(plan_id, finalist)
        self.n_requested = self.n_worlds = self.n_standing = 0
        self._nominal: Verdict | None = None

    def ask(self, n_worlds: int) -> range:
        """Request the nominal world and ``n_worlds`` worlds with errors. Returns the variants not requested before."""
        first, self.n_requested = self.n_requested, 1 + n_worlds
        return range(first, self.n_requested)

    def take(self, variant: int, verdict: Verdict) -> None:
        """Record the verdict of a world."""
        if variant == 0:
            self._nominal = verdict
        elif verdict is not Verdict.INVALID:
            self.n_worlds += 1
            self.n_standing += verdict is Verdict.STABLE

    def is_hopeless(self, options: PhysicalOptions) -> bool:
        """Whether the packing can no longer be good, whatever the remaining verdicts are."""
        fallen = self.n_worlds - self.n_standing
        most = (options.worlds - fallen) / options.worlds if options.worlds else 1.0
        return not self.judged.stands or most < options.least_share

    def is_whole(self, options: PhysicalOptions) -> bool:
        """Whether all worlds of the packing have been requested."""
        return self.n_requested > options.worlds

    @property
    def judged(self) -> Evaluation:
        """The evaluation so far."""
        assert self._nominal is not None
        return Evaluation(self.finalist, self.plan, self._nominal, self.n_worlds, self.n_standing, self.n_requested)


Asks = list[tuple[Trial, range]]
"""Requested worlds: pairs of a packing and its variants."""


def order_evaluation(
    plan_id: str, finalists: Sequence[Finalist], options: PhysicalOptions, spare: Callable[[], bool] = lambda: False
) -> Generator[Asks, None, list[Evaluation]]:
    """Evaluate the packings of an order: yields requests for worlds, and returns the evaluations.

    The caller resumes the generator when all requested worlds have verdicts. Packings are evaluated one after the other
    until one is good. Each packing begins with a few worlds, and gets the remaining worlds only if it can still be
    good. If no packing is good, all worlds of all packings are requested, because then the packing that stands most
    often is chosen.

    Args:
        finalists: packings of the order, the best first.
        spare: function that tells whether the engine has spare capacity. If the engine has, worlds are requested before
            it is certain that they are needed.
    """
    tried: list[Trial] = []
    by_share = options.maximise == "share"
    while len(tried) < len(finalists):
        hurries = spare()
        first = options.worlds if hurries else min(FIRST_WORLDS, options.worlds)
        left = finalists[len(tried) :]
        now = [Trial(plan_id, finalist) for finalist in (left if hurries or by_share else left[:1])]
        tried += now
        yield [(trial, trial.ask(first)) for trial in now]
        if open_trials := [trial for trial in now if first < options.worlds and not trial.is_hopeless(options)]:
            yield [(trial, trial.ask(options.worlds)) for trial in open_trials]
        if any(trial.is_whole(options) and trial.judged.is_good(options) for trial in tried):
            break
    else:
        if open_trials := [trial for trial in tried if not trial.is_whole(options)]:
            yield [(trial, trial.ask(options.worlds)) for trial in open_trials]
    return [trial.judged for trial in tried]


def decisive_evaluations(judged: Sequence[Evaluation], options: PhysicalOptions) -> Sequence[Evaluation]:
    """The evaluations among which ``choose`` chooses. All later evaluations are dropped, so the choice does not depend
    on how many further packings were simulated.

    The evaluations end with the first good packing, since later ones are less dense. If the share is maximised, all
    evaluations count.
    """
    good = next((number for number, packing in enumerate(judged) if packing.is_good(options)), None)
    return judged if good is None or options.maximise == "share" else judged[: good + 1]


def plan_of(plan_id: str, finalist: Finalist) -> Plan:
    """A packing as a plan, the same as if it had been read from a file of ``petmjx samples``."""
    placements = as_placements(finalist.placed)
    return parse_plan(plan_id, SOURCE, placements, len(placements), {})


def choose(judged: Sequence[Evaluation], options: PhysicalOptions) -> Evaluation:
    """Choose a packing from its evaluations.

    Among good packings, the packing with the largest volume is chosen, and among equal volumes that with the largest
    value of ``options.maximise``. If no packing is good, the packing that stands most often is chosen.

    Args:
        judged: evaluations, at least one.
    """
    good_packings = [packing for packing in judged if packing.is_good(options)]
    if not good_packings:
        return max(judged, key=lambda packing: (packing.stands, packing.share, packing.finalist.volume_m3))
    by_share = options.maximise == "share"
    return max(
        good_packings,
        key=lambda packing: (
            packing.finalist.volume_m3,
            packing.share if by_share else 0.0,
            packing.finalist.utilisation,
        ),
    )
