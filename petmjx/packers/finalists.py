"""Makes and evaluates the finalists of an order. A finalist is a packing that may be simulated, in a world in which
boxes are placed exactly, and in worlds with errors. The results of simulations decide which finalist is chosen."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from petmjx.common.units import MM_PER_M
from petmjx.engines.verdict import Verdict
from petmjx.engines.world_results import World
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.beam_search import search
from petmjx.packers.learned_packer import CLEARANCE_MM, pack_learned
from petmjx.packers.physical_packer_options import PhysicalOptions
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.order import Order, target_extent_mm
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan

SOURCE = "pack"
"""Text that messages show as the source of packed plans, which come from no file."""

FIRST_WORLDS: Final = 4
"""Number of worlds with errors that are simulated first. Most packings that fall too often can be refused after these
worlds."""


@dataclass(frozen=True)
class Finalist:
    """A packing of an order that may be simulated.

    Attributes:
        placed: boxes in packing order.
        clearance_mm: free space between neighbours, mm.
        volume_m3: volume of the boxes, m³.
        height_mm: height of the highest top, mm.
        utilisation: volume of the boxes / (area of the target × height of the highest top); BED-BPP's kpi_2.
    """

    placed: tuple[PlacedBox, ...]
    clearance_mm: float
    volume_m3: float
    height_mm: float
    utilisation: float


def finalists(order: Order, options: PhysicalOptions) -> list[Finalist]:
    """The best packing of an order for each value of ``options.clearances_mm`` (free space between boxes, mm). Packings
    are sorted by volume, then by utilisation, largest first.

    If each of these packings leaves boxes out, the best packing without free space is added. The list is empty if there
    is no place for any box.
    """
    searched = partial(search, order.items, target_extent_mm(order.target), width=options.width, branch=options.branch)
    packings = {clearance: searched(clearance) for clearance in options.clearances_mm}
    if 0.0 not in packings and all(len(packing.placed) < len(order.items) for packing in packings.values()):
        packings[0.0] = searched(0.0)
    candidates = [
        _finalist(order, packing.placed, clearance, packing.worth.volume_m3, packing.height_mm)
        for clearance, packing in packings.items()
        if packing.placed
    ]
    return sorted(candidates, key=lambda finalist: (finalist.volume_m3, finalist.utilisation), reverse=True)


def learned_finalists(order: Order, look_ahead: int) -> list[Finalist]:
    """A list with one packing, made by the packer ``learned``. The list is empty if there is no place for any box."""
    placed = pack_learned(order.items, target_extent_mm(order.target), look_ahead)
    if not placed:
        return []
    height = max(box.corner_mm[2] + box.item.height_mm for box in placed)
    return [_finalist(order, placed, CLEARANCE_MM, sum(box.item.volume_m3 for box in placed), height)]


def _finalist(
    order: Order, placed: Sequence[PlacedBox], clearance_mm: float, volume_m3: float, height_mm: float
) -> Finalist:
    length, width = target_extent_mm(order.target)
    utilisation = volume_m3 / (length * width * height_mm / MM_PER_M**3)
    return Finalist(tuple(placed), clearance_mm, volume_m3, height_mm, utilisation)


@dataclass(frozen=True)
class Evaluation:
    """A packing and the results of its simulations.

    Attributes:
        finalist: the packing.
        plan: the packing as a plan.
        verdict: the verdict of the nominal world, in which all boxes are placed exactly.
        n_worlds: number of worlds with errors that have a verdict.
        n_standing: number of worlds with errors in which the plan stands.
        n_simulated: number of simulated worlds, including the nominal world and worlds without a valid verdict.
    """

    finalist: Finalist
    plan: Plan
    verdict: Verdict
    n_worlds: int
    n_standing: int
    n_simulated: int = 0

    @property
    def stands(self) -> bool:
        """Whether the plan stands if its boxes are placed exactly."""
        return self.verdict is Verdict.STABLE

    @property
    def share(self) -> float:
        """Share of the worlds with errors in which the plan stands. If there are no worlds with errors, the share is 1
        if the plan stands in the nominal world, else 0."""
        return self.n_standing / self.n_worlds if self.n_worlds else float(self.stands)

    def is_good(self, options: PhysicalOptions) -> bool:
        """Whether the plan stands as often as requested."""
        return self.stands and self.share >= options.least_share


class Trial:
    """A packing that is being simulated: first its nominal world, then worlds with errors.

    Attributes:
        finalist: the packing.
        plan: the packing as a plan.
        n_requested: number of worlds requested so far.
        n_worlds: number of worlds with errors that have a verdict so far.
        n_standing: number of worlds with errors in which the plan stands so far.
        worlds: the worlds that were not requested yet, in the order of their variants; None before the first request.
    """

    def __init__(self, plan_id: str, finalist: Finalist) -> None:
        self.worlds: Iterator[World] | None = None
        self.finalist, self.plan = finalist, plan_of(plan_id, finalist)
        self.n_requested = self.n_worlds = self.n_standing = 0
        self._nominal: Verdict | None = None

    def ask(self, n_worlds: int) -> range:
        """Request the nominal world (variant 0) and ``n_worlds`` worlds with errors. Returns the variants that were not
        requested before."""
        first, self.n_requested = self.n_requested, 1 + n_worlds
        return range(first, self.n_requested)

    def take(self, variant: int, verdict: Verdict) -> None:
        """Record the verdict of one world."""
        if variant == 0:
            self._nominal = verdict
        elif verdict is not Verdict.INVALID:
            self.n_worlds += 1
            self.n_standing += verdict is Verdict.STABLE

    def is_hopeless(self, options: PhysicalOptions) -> bool:
        """Whether the packing can no longer stand as often as requested, whatever the remaining verdicts are."""
        fallen = self.n_worlds - self.n_standing
        most = (options.worlds - fallen) / options.worlds if options.worlds else 1.0
        return not self.judged.stands or most < options.least_share

    def is_whole(self, options: PhysicalOptions) -> bool:
        """Whether all worlds of the packing have been requested."""
        return self.n_requested > options.worlds

    @property
    def judged(self) -> Evaluation:
        """The packing with the verdicts of its worlds so far."""
        assert self._nominal is not None
        return Evaluation(self.finalist, self.plan, self._nominal, self.n_worlds, self.n_standing, self.n_requested)


Asks = list[tuple[Trial, range]]
"""Requested worlds: pairs of a packing and the variants to simulate."""


def order_evaluation(
    plan_id: str, finalists: Sequence[Finalist], options: PhysicalOptions, spare: Callable[[], bool] = lambda: False
) -> Generator[Asks, None, list[Evaluation]]:
    """Evaluate the packings of an order: a generator that yields requests for worlds, and returns the evaluations.

    The caller resumes the generator when all requested worlds have verdicts. Packings are evaluated one after another
    until one is good, that is, stands as often as requested. For each packing, a few worlds are simulated first. The
    remaining worlds are simulated only if the packing can still be good. If no packing is good, all worlds of all
    packings are simulated, since then the packing that stands most often is chosen.

    Args:
        plan_id: id of the order and of its plan.
        finalists: packings of the order, the best first.
        options: options of the packer.
        spare: function that returns whether the engine has spare capacity. With spare capacity, worlds are requested
            before it is certain that they are needed.
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
    """The evaluations among which ``choose`` chooses: all up to the evaluation of the first good packing. Packings are
    sorted by the volume of their boxes, largest first, so no later packing has a larger volume. If ``options.maximise``
    is ``share``, ``choose`` chooses among all evaluations.

    Because later evaluations are ignored, the choice does not depend on how many packings were simulated.
    """
    good = next((number for number, packing in enumerate(judged) if packing.is_good(options)), None)
    return judged if good is None or options.maximise == "share" else judged[: good + 1]


def plan_of(plan_id: str, finalist: Finalist) -> Plan:
    """A packing as a plan. The plan is the same as if it had been read from a file of ``petmjx samples``."""
    placements = as_placements(finalist.placed)
    return parse_plan(plan_id, placements, DecoderOptions(SOURCE))


def choose(judged: Sequence[Evaluation], options: PhysicalOptions) -> Evaluation:
    """Choose a packing from its evaluations.

    A packing is good if it stands as often as requested. Of the good packings, the packing with the largest volume of
    boxes is chosen. If several packings have this volume, the packing with the largest value of ``options.maximise`` is
    chosen. If no packing is good, the packing that stands most often is chosen.

    Args:
        judged: the evaluations of the packings; at least one.
        options: options of the packer.
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
