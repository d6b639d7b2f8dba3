"""The cost of a sweep: the work of all its worlds (simulations), for estimates of time, and the limits for which
engines reserve memory before the first job.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.expected_work import STEADY_G, Work, rest_steps
from petmjx.engines.job_stream import JobBounds
from petmjx.options.placing import Way
from petmjx.options.simulation import Check, Schedule
from petmjx.plans.plan_workload import MOST_LOOKED_AT, statics_of, tipping_g
from petmjx.runs.sweep_worlds import PlacementGroup, SweepPlan
from petmjx.world.carrier_boards import has_walls
from petmjx.world.profiles.profile import Profile
from petmjx.world.supports import deck_mm
from petmjx.world.variants import LegSpec

_HELD_BY_OTHERS: Final = 2.0
"""``tipping_g`` is the acceleration at which a column of boxes that nothing holds tips over, as a multiple of 9.81
m/s². In a load, boxes beside one another hold each other up, so the load falls at about ``_HELD_BY_OTHERS`` ×
``tipping_g``. In EUMOS's profile, loads of 20 to 60 boxes with a ``tipping_g`` of 0.12 g began to fall at 0.25 g, and
loads with a ``tipping_g`` of 0.3 g at 0.6 g."""

_FALL_STEPS: Final = 250
"""Number of steps of a drive between the moment at which a load begins to fall and the moment at which a box is lost.
With EUMOS's profile of 0.1 to 1.6 g, drives took 270 to 320 steps on average, and with EN 12195-1's profile, drives of
two plans of about 50 boxes took 400 steps."""

_GENTLE_IN_SEARCHES: Final = 0.5
"""Expected share of the tested levels of a search that are below the largest level that a pallet survives."""

_CREEPING_BOXES, _MOST_CREEPING = 40, 3.0
"""A search tests levels near the largest level that a pallet survives. At these levels, boxes may creep for a long
time, and the more boxes there are, the more often one of them creeps. So in a search, a drive of n boxes is expected to
take 1 + n / ``_CREEPING_BOXES`` times as many steps as a drive after which the pallet is soon quiet. The factor is at
most ``_MOST_CREEPING``. In searches of EUMOS's levels, this factor was 1.1 for plans of 10 boxes, 1.7 to 3.3 for sets
of plans of about 40 boxes, and 3.4 for a plan of 238 boxes."""

_FALLING_POWER: Final = 8
"""If a leg of a chain has n times the acceleration ``tipping_g`` of a plan (n > 1), the pallet is expected to stand
after the leg with the probability (1 / n) to this power. Four plans of 21 to 54 boxes were simulated in 48 worlds of
two chains. After a leg with a conveyor of up to 0.3 g, the pallet stood in 5 of these worlds; the expected number with
this power is 11."""


def work_of(worlds: SweepPlan) -> Work:
    """The amount of work of all worlds of a sweep, for estimates of time."""
    sweep = worlds.sweep
    sim, search = sweep.simulation, sweep.search
    drives = [_drive_steps(worlds, profile) for profile in sweep.profiles.values()]
    if search is not None:
        mean_boxes = sum(plan.n_boxes for plan in worlds.plans) / max(len(worlds.plans), 1)
        creeping = min(1 + mean_boxes / _CREEPING_BOXES, _MOST_CREEPING)
        drives = [creeping * steps for steps in drives]
    if sim.total_time_factor is not None:
        drives = [worlds.drive_steps_left(plan) or 0 for plan in worlds.plans]
    nominal = int(sweep.nominal)
    filmed: float | list[float] = float(sim.wrap.holds or "wrap_turns" in sweep.axes)
    gentle: float | list[float] = _gentle_share(worlds)
    driven_share: list[float] = []
    if sweep.legs:
        legs = [leg for legs in worlds.ways.values() for leg in legs]
        drives = [_leg_steps(worlds, leg) + rest_steps(sim, sim.rest_s) for leg in legs]
        expected = _leg_shares(worlds)
        driven_share, gentle = expected.simulated.tolist(), expected.gentle.tolist()
        filmed = 1.0 if sim.wrap.holds else expected.filmed.tolist()
    n_legs = len(drives) / len(worlds.ways) if sweep.legs else 1
    return Work(
        sim=sim,
        boxes=[plan.n_boxes for plan in worlds.plans],
        placements=worlds.all_placements,
        displaced=_displaced(worlds),
        carried=_carried(worlds),
        drives=round((worlds.n_variants - nominal) * n_legs) if sweep.has_drives else 0,
        drive_steps=sum(drives) / len(drives) if drives else 0.0,
        rounds=round(n_legs) if search is None else search.rounds(len(sweep.search_levels)),
        filmed=filmed,
        gentle=gentle,
        driven_share=driven_share,
        **statics_of(worlds.plans, partial(deck_mm, sim=sim))._asdict(),
    )


def job_bounds(worlds: SweepPlan, groups: Collection[PlacementGroup]) -> JobBounds:
    """Limits, such as the largest number of steps, for the jobs of some placements of a sweep, and for the jobs of the
    drives and legs that follow these placements. With these limits, engines prepare themselves before the first job."""
    sweep = worlds.sweep
    sim, profiles = sweep.simulation, sweep.profiles.values()
    jobs = sum(map(worlds.most_forks, groups))
    box_counts = {group.plan.n_boxes for group in groups}
    if sweep.legs:
        legs = {leg for legs in worlds.ways.values() for leg in legs}
        drawn = any(worlds.is_drawn(drive) for leg in legs for drive in leg.drives)
        wraps = sim.wrap.holds or any(leg.wrap_turns for leg in legs)
        most_steps = max(_leg_steps(worlds, leg) for leg in legs)
        return JobBounds(jobs, box_counts, most_steps, None if drawn else len(legs), wraps)
    drive_steps = max((profile.n_steps(sim.physics.timestep_s) for profile in profiles), default=0)
    if sim.total_time_factor is not None:
        drive_steps = min(drive_steps, max(worlds.drive_steps_left(group.plan) or 0 for group in groups))
    # with the fixed schedule, a profile of forces begins at a different time in each plan, so its samples differ
    # between plans
    drawn = any(profile.random for profile in profiles) or sim.schedule is Schedule.FIXED
    wraps = sim.wrap.holds or "wrap_turns" in sweep.axes
    return JobBounds(jobs, box_counts, drive_steps, None if drawn else len(profiles), wraps)


def _leg_steps(worlds: SweepPlan, leg: LegSpec) -> int:
    """Number of steps of a leg, which is the number of steps of all its drives and of the pauses between the
    drives."""
    timestep_s = worlds.sweep.simulation.physics.timestep_s
    pauses = (len(leg.drives) - 1 if leg.drives else 1) * seconds_to_steps(leg.pause_s, timestep_s)
    return pauses + sum(worlds.sweep.profiles[drive.profile].n_steps(timestep_s) for drive in leg.drives)


def _drive_steps(worlds: SweepPlan, profile: Profile) -> float:
    """Expected number of steps of a drive, as the mean over the strengths of a profile and the plans. Loads that
    nothing holds are expected to slide or fall when the acceleration reaches a limit, and their drives then end."""
    sweep = worlds.sweep
    sim = sweep.simulation
    full = profile.n_steps(sim.physics.timestep_s) + rest_steps(sim, sim.rest_s)
    holds = sim.wrap.holds or "wrap_turns" in sweep.axes or has_walls(sim)
    if holds or profile.random or sweep.search is not None or not sim.early_stop or not worlds.plans:
        return full
    some = worlds.plans[:: -(-len(worlds.plans) // MOST_LOOKED_AT)]
    tipping = _HELD_BY_OTHERS * np.array([tipping_g(plan) for plan in some])
    falls_g = np.minimum(tipping, sim.physics.box_friction[0])
    reached_g = profile.excitation(sim.physics.timestep_s).reached_g
    begins = np.array([np.searchsorted(abs(strength) * reached_g, falls_g) for strength in _strengths(worlds, profile)])
    return float(np.where(begins < len(reached_g), np.minimum(begins + _FALL_STEPS, full), full).mean())


class _ShakenLeg(NamedTuple):
    """A leg, as far as it matters for costs.

    Attributes:
        peak_g: the largest horizontal acceleration that the leg may have, in units of 9.81 m/s². Random profiles are
            left out.
        is_gentle: whether ``peak_g`` is at most ``STEADY_G``. Vibrations are never gentle.
    """

    steps: int
    peak_g: float
    is_filmed: bool
    is_gentle: bool

    @classmethod
    def of(cls, worlds: SweepPlan, leg: LegSpec) -> _ShakenLeg:
        peaks_g, vibrates = [0.0], False
        for drive in leg.drives:
            profile, scale = worlds.sweep.profiles[drive.profile], max(abs(drive.scale), abs(drive.scale_to or 0.0))
            vibrates |= profile.random
            if not profile.random:
                peaks_g.append(scale * _unit_peak_g(worlds, profile))
        peak_g = max(peaks_g)
        return cls(_leg_steps(worlds, leg), peak_g, bool(leg.wrap_turns), peak_g <= STEADY_G and not vibrates)


class _LegShares(NamedTuple):
    """Expected shares of the steps of all legs of a plan, for each of n plans.

    Attributes:
        simulated: (n,) share of the steps of all legs that are simulated.
        filmed, gentle: (n,) share of the simulated steps in which film holds the pallet, and share of the simulated
            steps that belong to gentle legs (``_ShakenLeg``).
    """

    simulated: FloatArray
    filmed: FloatArray
    gentle: FloatArray


def _leg_shares(worlds: SweepPlan) -> _LegShares:
    """The expected shares of the steps of all legs, for each plan. After a leg whose acceleration exceeds
    ``tipping_g``, a pallet without film or walls has probably fallen. The next legs are then not simulated."""
    holds = worlds.sweep.simulation.wrap.holds or has_walls(worlds.sweep.simulation)
    tips_g, total = np.array([tipping_g(plan) for plan in worlds.plans]), 0
    simulated, filmed, gentle = np.zeros((3, len(tips_g)))
    shaken = {leg: _ShakenLeg.of(worlds, leg) for legs in worlds.ways.values() for leg in legs}
    for legs in worlds.ways.values():
        stands = np.ones(len(tips_g))
        for leg in map(shaken.__getitem__, legs):
            total += leg.steps
            simulated += stands * leg.steps
            filmed += stands * leg.steps * leg.is_filmed
            gentle += stands * leg.steps * leg.is_gentle
            if leg.peak_g > 0.0 and not (holds or leg.is_filmed):
                stands *= np.minimum(tips_g / leg.peak_g, 1.0) ** _FALLING_POWER
    of_simulated = np.maximum(simulated, 1.0)
    return _LegShares(simulated / max(total, 1), filmed / of_simulated, gentle / of_simulated)


def _gentle_share(worlds: SweepPlan) -> float:
    """For a sweep without legs, the expected share of the drives whose acceleration is at most ``STEADY_G``. The share
    of a search is ``_GENTLE_IN_SEARCHES``, since a search tests levels on both sides of the largest level that a pallet
    survives."""
    sweep = worlds.sweep
    if sweep.search is not None:
        return _GENTLE_IN_SEARCHES
    gentle = [
        not profile.random and abs(strength) * _unit_peak_g(worlds, profile) <= STEADY_G
        for profile in sweep.profiles.values()
        for strength in _strengths(worlds, profile)
    ]
    return sum(gentle) / max(len(gentle), 1)


def _strengths(worlds: SweepPlan, profile: Profile) -> list[float]:
    """The factors on a profile in a sweep; for an axis with a continuous range, its two ends."""
    axis = worlds.sweep.axes.get(profile.strength)
    if axis is None:
        return [1.0]
    return [axis.low, axis.high] if axis.continuous else [value for value in axis.values if isinstance(value, float)]


def _unit_peak_g(worlds: SweepPlan, profile: Profile) -> float:
    """The largest horizontal acceleration of a profile at scale 1, in units of 9.81 m/s²."""
    return profile.excitation(worlds.sweep.simulation.physics.timestep_s).peak_g


def _displaced(worlds: SweepPlan) -> int:
    """Number of placements per plan in which boxes appear at places with errors and the schedule waits until the pallet
    is quiet."""
    sim, with_errors = worlds.sweep.simulation, _with_errors(worlds)
    waits = sim.check is Check.ONE_BY_ONE and sim.schedule is Schedule.ADAPTIVE
    if "placing" in worlds.sweep.axes:
        return with_errors - min(_carried(worlds), with_errors)
    return with_errors if waits and not sim.may_carry else 0


def _carried(worlds: SweepPlan) -> int:
    """Number of placements per plan in which boxes are carried to their places. Placements without errors are counted
    only if the sweep has an axis ``placing``."""
    if not worlds.sweep.simulation.may_carry:
        return 0
    if "placing" in worlds.sweep.axes:
        ways = worlds.sweep.axes["placing"].values
        return worlds.n_placements * sum(Way(str(way)) in (Way.HAND, Way.TINES) for way in ways) // len(ways)
    return _with_errors(worlds)


def _with_errors(worlds: SweepPlan) -> int:
    """Number of placements per plan in which places or sizes have random errors."""
    return worlds.n_random_placements if worlds.has_errors else 0
