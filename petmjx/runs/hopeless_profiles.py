"""Hopeless profiles: motions of the carrier under which every unsecured load slides farther than the shift threshold,
whatever the plan.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.options.simulation import Simulation
from petmjx.runs.chain_legs import legs_with
from petmjx.runs.sweep_file import Sweep
from petmjx.world.carrier_boards import carrier_friction, has_walls
from petmjx.world.contact_laws import friction_share, kinetic_share
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.job import ACCELERATION
from petmjx.world.profiles.accelerations import Tilt
from petmjx.world.variants import MIN_FRICTION_FRACTION

RANGE_POINTS = 9
"""Number of values that are checked on an axis with a continuous range. The values are evenly spread over the range."""
LARGEST_SD = 4.0
"""Errors with a normal distribution are checked up to this number of standard deviations above the mean. One random
error in 30,000 is larger."""


def slide_m(
    acceleration: FloatArray,
    friction: float,
    gravity_m_s2: float,
    timestep_s: float,
    enough_m: float = math.inf,
    kinetic: float = 1.0,
) -> float:
    """How far a block slides on a moving carrier, m: its largest distance from its first position on the carrier.

    The model is Coulomb's friction. The block stays in place while the horizontal acceleration of the carrier is at
    most friction × (gravity + vertical acceleration). At a larger acceleration, the block slides, and friction
    decelerates it by friction × (gravity + vertical acceleration), or, if the block slides fast, by ``kinetic`` times
    this value. If the acceleration is constant within each step and always along the same line, the result is exact,
    except for steps in which the block stops or its friction changes.

    A whole load slides about as far as the block, or farther. If a load touches only the carrier's top, the horizontal
    force on the load is limited to friction × the vertical force, as on the block. So the centre of mass of the load
    moves as far as the block or farther, and so does at least one box.

    Args:
        acceleration: (n_steps, 3) acceleration of the carrier, m/s².
        enough_m: the computation stops when the block has slid farther than this, m.
        kinetic: friction of a fast-sliding block as a share of the friction at rest (petmjx/world/contact_laws.py).
    """
    grip = friction * np.maximum(gravity_m_s2 + acceleration[:, 2], 0.0)
    slips = np.flatnonzero(np.hypot(acceleration[:, 0], acceleration[:, 1]) > grip)
    vx = vy = x = y = farthest = 0.0
    step = 0
    while farthest <= enough_m:
        if vx == vy == 0.0:  # skip to the next step in which the block slips
            next_slip = int(np.searchsorted(slips, step))
            if next_slip == len(slips):
                break
            step = int(slips[next_slip])
        if step == len(acceleration):  # the profile is over and the carrier is at rest, so friction brakes the block
            speed, brake = math.hypot(vx, vy), friction * kinetic * gravity_m_s2
            if brake == 0:
                return math.inf
            stop_s = speed / (2 * brake)
            return max(farthest, math.hypot(x + vx * stop_s, y + vy * stop_s))
        brake_m_s2 = float(grip[step] * friction_share(np.array(math.hypot(vx, vy)), kinetic))
        pushed_x, pushed_y = (v - float(a) * timestep_s for v, a in zip((vx, vy), acceleration[step, :2], strict=True))
        speed = math.hypot(pushed_x, pushed_y)
        remaining_share = max(1.0 - brake_m_s2 * timestep_s / speed, 0.0) if speed > 0 else 0.0
        x += (vx + pushed_x * remaining_share) / 2 * timestep_s
        y += (vy + pushed_y * remaining_share) / 2 * timestep_s
        vx, vy = pushed_x * remaining_share, pushed_y * remaining_share
        farthest = max(farthest, math.hypot(x, y))
        step += 1
    return farthest


def hopeless_profiles(sweep: Sweep) -> list[str]:
    """One line for each hopeless profile: a profile that makes every unsecured load slide farther than the shift
    threshold.

    If the sweep has several strengths of a profile, the line names the smallest strength with which every load slides
    too far. Whether a profile is hopeless depends only on accelerations, which are the same for all plans. A sweep that
    searches for the strength at which loads fail (``sweep.search``) gets no lines, since the result of the search is
    this strength. With ``total_time_factor``, there are no lines either, since a simulation may end before the load has
    slid farther than the threshold.
    """
    sim, axes = sweep.simulation, sweep.axes
    if sweep.search is not None or sim.total_time_factor is not None:
        return []
    if has_walls(sim):
        return []  # walls may hold every load, so no profile is hopeless
    turns = sweep.axes.get("wrap_turns")
    least = sim.wrap.turns if turns is None else min(float(str(value)) for value in turns.values or (turns.low,))
    if least > 0:
        return []  # film secures every load, so no profile is hopeless

    def values(name: str) -> list[float]:
        """The values of an axis of factors, in ascending order; [1] if the sweep does not have this axis."""
        if name not in axes:
            return [1.0]
        factors = axes[name].values or np.linspace(axes[name].low, axes[name].high, RANGE_POINTS).tolist()
        return sorted(value for value in factors if isinstance(value, float))

    common_factors = values("friction_factor")
    box, carrier = (values(f"{side}_friction_factor") for side in ("box", "carrier"))
    # of the friction coefficients of two touching geoms, MuJoCo uses the larger one
    friction = common_factors[-1] * max(sim.physics.box_friction[0] * box[-1], carrier_friction(sim) * carrier[-1])
    errors = _friction_errors(sweep)
    friction *= max(1.0 + max(map(_largest, errors), default=0.0), MIN_FRICTION_FRACTION)
    varies = any(len(factors) > 1 for factors in (common_factors, box, carrier, errors)) or any(
        error.random for error in errors
    )
    up_to = "up to " if varies else ""
    lines = []
    shaken = [(name, profile, values(profile.strength)) for name, profile in sweep.profiles.items()]
    if sweep.legs:
        legs = legs_with(sweep.legs, None, sweep.own_profiles)
        bare = ((leg.name, drive) for leg in legs for drive in leg.drives if not leg.wrap_turns)
        shaken = [(f"leg {leg}: {drive.profile}", sweep.profiles[drive.profile], [drive.scale]) for leg, drive in bare]
    for name, profile, strengths in shaken:
        if profile.kind != ACCELERATION or profile.random:
            continue
        unit = profile.excitation(sim.physics.timestep_s).samples
        first = _first_hopeless(unit, strengths, friction, sim)
        if first == len(strengths):
            continue
        peak_g = strengths[first] * float(np.hypot(unit[:, 0], unit[:, 1]).max()) / STANDARD_GRAVITY
        peak = f"{profile.max_deg:g}°" if isinstance(profile, Tilt) else f"{peak_g:.3g} g"
        since = f" from {profile.strength} {strengths[first]:g} on" if len(strengths) > 1 else ""
        reason = f"with friction {up_to}{friction:.3g} no unsecured load stays in place"
        lines.append(f"{name} reaches {peak}{since}: {reason}")
    return lines


def _friction_errors(sweep: Sweep) -> list[Distribution]:
    axis = sweep.axes.get("friction_tolerance_rel")
    return [value for value in axis.values if isinstance(value, Distribution)] if axis else []


def _largest(error: Distribution) -> float:
    """The largest value of an error. For a normal distribution, this is the centre plus ``LARGEST_SD`` standard
    deviations."""
    return error.centre + (LARGEST_SD if error.shape is DistributionShape.NORMAL else 1.0) * error.spread


def _first_hopeless(unit: FloatArray, strengths: Sequence[float], friction: float, sim: Simulation) -> int:
    """Index of the smallest strength that makes a block slide farther than the shift threshold. If no strength does,
    the result is the number of strengths. ``strengths`` must be in ascending order.

    The search assumes that a block that slides too far with one strength also does so with all larger strengths.
    """
    physics, limit_m = sim.physics, sim.thresholds.shift_m

    def slides(strength: float) -> bool:
        way = slide_m(
            strength * unit, friction, physics.gravity_m_s2, physics.timestep_s, limit_m, kinetic_share(physics)
        )
        return way > limit_m

    return bisect_left(strengths, True, key=slides)
