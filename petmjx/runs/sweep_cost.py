"""The cost of a sweep: the work of all its worlds (simulations), for estimates of time, and the limits for which
engines reserve memory before the first job.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from petmjx.common.units import seconds_to_steps
from petmjx.engines.cost_model import Work, rest_steps
from petmjx.engines.job_stream import JobBounds
from petmjx.options.placing import Way
from petmjx.options.simulation import Check, Schedule
from petmjx.plans.loose_boxes import statics_of
from petmjx.runs.sweep_worlds import PlacementGroup, SweepPlan
from petmjx.world.profiles.profile import Strength
from petmjx.world.variants import LegSpec

_TILTED: Final = 0.5
"""Expected share of the steps of a tilting profile that are simulated. The share is below 1, since many pallets slide
or topple before the end of the profile, and their worlds then end."""


def work_of(worlds: SweepPlan) -> Work:
    """The amount of work of all worlds of a sweep, for estimates of time."""
    sweep = worlds.sweep
    sim, profiles = sweep.simulation, list(sweep.profiles.values())
    drives = [
        profile.n_steps(sim.physics.timestep_s) * (_TILTED if profile.strength is Strength.ANGLE else 1)
        + rest_steps(sim, sim.rest_s)
        for profile in profiles
    ]
    if sim.total_time_factor is not None:
        drives = [worlds.drive_steps_left(plan) or 0 for plan in worlds.plans]
    nominal = int(sweep.nominal)
    filmed = float(sim.wrap.holds or "wrap_turns" in sweep.axes)
    if sweep.legs:
        legs = [leg for legs in worlds.ways.values() for leg in legs]
        drives = [_leg_steps(worlds, leg) + rest_steps(sim, sim.rest_s) for leg in legs]
        in_film = (steps for leg, steps in zip(legs, drives, strict=True) if leg.wrap_turns)
        filmed = max(filmed, sum(in_film) / max(sum(drives), 1.0))
    n_legs = len(drives) / len(worlds.ways) if sweep.legs else 1
    return Work(
        sim=sim,
        boxes=[plan.n_boxes for plan in worlds.plans],
        placements=worlds.all_placements,
        displaced=_displaced(worlds),
        carried=_carried(worlds),
        drives=round((worlds.n_variants - nominal) * n_legs) if sweep.has_drives else 0,
        drive_steps=sum(drives) / len(drives) if drives else 0.0,
        filmed=filmed,
        **statics_of(worlds.plans)._asdict(),
    )


def job_bounds(worlds: SweepPlan, groups: Collection[PlacementGroup]) -> JobBounds:
    """Limits for the jobs of some placements of a sweep, and of the drives and legs that follow these placements, such
    as the largest number of steps. With these limits, engines prepare themselves before the first job."""
    sweep = worlds.sweep
    sim, profiles = sweep.simulation, sweep.profiles.values()
    jobs = sum(max(len(group.variants), 1) for group in groups)
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
