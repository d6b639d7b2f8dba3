"""Blocks that rock, slide, are tilted, or are wrapped: values from mechanics and measurements, and petmjx's values.

The equations of motion are those of Housner 1963 ("The behavior of inverted pendulum structures during earthquakes",
Bulletin of the Seismological Society of America 53): a rigid block that rocks about its lower edges and does not slip.
Closed forms share no code with petmjx.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

import petmjx
from petmjx.runs.option_types import EngineName

Acceleration = Callable[[float], float]
"""Function that returns the acceleration of the ground, m/s², at a time, s."""

GRAVITY: Final = 9.81
"""Acceleration of gravity in simulations, m/s²."""
LEVEL_M_S2: Final = 9.80665
"""Acceleration of a profile at a level of 1 g, m/s²."""
STEP_S: Final = 1e-3
"""Step of the integration by Runge and Kutta's method of order 4, s. With half of this step, none of the levels in this
file changes."""
AT_REST_RAD_S: Final = 2e-3
"""A block that is slower than this after an impact counts as resting, rad/s. The top of a block of half a metre then
moves at 1 mm/s."""


MOST_TILT_RAD: Final = math.radians(petmjx.Thresholds().tilt_deg)
"""A box that tilts farther is lost, by petmjx's default threshold."""


class Row(NamedTuple):
    """One row of the gallery: a quantity with its unit, the value of its source, and petmjx's value."""

    quantity: str
    source: str
    expected: float
    value: float
    engine: str


class Motion(NamedTuple):
    """The computed motion of a block: its largest tilt, rad (infinite if it fell); the smallest coefficient of friction
    with which it does not slip; and the times of its impacts on the ground, s."""

    max_tilt_rad: float
    friction: float
    impacts_s: tuple[float, ...]

    @property
    def fell(self) -> bool:
        """Whether the block fell over."""
        return not math.isfinite(self.max_tilt_rad)

    @property
    def lost(self) -> bool:
        """Whether the block fell over, or tilted so far that petmjx calls it lost. (A squat block that is lost may
        still come back.)"""
        return self.max_tilt_rad > MOST_TILT_RAD


@dataclass(frozen=True)
class RockingBlock:
    """A rigid block on the ground, width_m × height_m in the plane of its motion.

    Attributes:
        kept: angular speed of the block after an impact, as a share of the angular speed before the impact; None for
            Housner's value, 1 − 1.5 sin² α.
    """

    width_m: float
    height_m: float
    kept: float | None = None

    @cached_property
    def slenderness_rad(self) -> float:
        """α, the tilt beyond which the block falls without a further push, rad."""
        return math.atan2(self.width_m, self.height_m)

    @cached_property
    def radius_m(self) -> float:
        """R, the distance from an edge to the centre, m."""
        return math.hypot(self.width_m, self.height_m) / 2

    @cached_property
    def rate_squared(self) -> float:
        """p² = 3 g / (4 R), 1/s²."""
        return 3 * GRAVITY / (4 * self.radius_m)

    @cached_property
    def speed_kept(self) -> float:
        """The angular speed after an impact, as a share of the angular speed before the impact."""
        return 1 - 1.5 * math.sin(self.slenderness_rad) ** 2 if self.kept is None else self.kept

    def rock(
        self, ground: Acceleration, seconds: float, quiet_from_s: float, start: Sequence[float] = (0, 0)
    ) -> Motion:
        """The motion of the block on a ground with the given acceleration. Tilts are positive towards +x.

        Args:
            seconds: length of the computation.
            quiet_from_s: time from which on the ground does not accelerate, so that a block at rest remains at rest.
            start: its tilt, rad, and angular speed, rad/s.
        """
        tilt, speed = map(float, start)
        side = math.copysign(1.0, tilt) if tilt else 0.0
        largest, friction, impacts = abs(tilt), 0.0, []
        step = 0
        while (time_s := step * STEP_S) < seconds:
            step += 1
            if side == 0.0:
                now = ground(time_s)
                if abs(now) <= GRAVITY * math.tan(self.slenderness_rad):
                    if time_s >= quiet_from_s:
                        break
                    continue
                side = -math.copysign(1.0, now)
            friction = max(friction, self._friction(tilt, speed, side, ground(time_s)))
            next_tilt, next_speed = self._step(tilt, speed, side, time_s, ground)
            if next_tilt * side < 0:
                share = tilt / (tilt - next_tilt)
                impacts.append(time_s + share * STEP_S)
                at_impact = speed + share * (next_speed - speed)
                next_speed, side = self.speed_kept * at_impact, -side
                next_tilt = next_speed * (1 - share) * STEP_S
                if abs(next_speed) < AT_REST_RAD_S:
                    next_tilt = next_speed = side = 0.0
            tilt, speed = next_tilt, next_speed
            largest = max(largest, abs(tilt))
            if largest > math.pi / 2:
                return Motion(math.inf, friction, tuple(impacts))
        return Motion(largest, friction, tuple(impacts))

    def _angular(self, tilt: float, side: float, ground_m_s2: float) -> float:
        """θ'' = −p² (sin(±α − θ) + a/g · cos(±α − θ))."""
        lean = self.slenderness_rad * side - tilt
        return -self.rate_squared * (math.sin(lean) + ground_m_s2 / GRAVITY * math.cos(lean))

    def _step(self, tilt: float, speed: float, side: float, time_s: float, ground: Acceleration) -> tuple[float, float]:
        half = STEP_S / 2
        before, between, after = (ground(time_s + part) for part in (0.0, half, STEP_S))
        first = self._angular(tilt, side, before)
        second = self._angular(tilt + half * speed, side, between)
        third = self._angular(tilt + half * (speed + half * first), side, between)
        fourth = self._angular(tilt + STEP_S * (speed + half * second), side, after)
        return (
            tilt + STEP_S * speed + STEP_S**2 / 6 * (first + second + third),
            speed + STEP_S / 6 * (first + 2 * second + 2 * third + fourth),
        )

    def _friction(self, tilt: float, speed: float, side: float, ground_m_s2: float) -> float:
        """The ratio of the horizontal to the vertical force at the edge. The ratio is the smallest coefficient of
        friction with which the block does not slip."""
        lean, turn = self.slenderness_rad * side - tilt, self._angular(tilt, side, ground_m_s2)
        across = self.radius_m * (math.cos(lean) * turn + math.sin(lean) * speed**2)
        upward = self.radius_m * (math.sin(lean) * turn - math.cos(lean) * speed**2)
        return abs(ground_m_s2 + across) / max(GRAVITY + upward, 1e-9)

    def energy_kept(self, before_rad: float, after_rad: float) -> float:
        """The share of the energy that remains after an impact, computed from the largest tilts before and after the
        impact (without a drive)."""
        rest = math.cos(self.slenderness_rad)
        before, after = (math.cos(self.slenderness_rad - tilt) - rest for tilt in (before_rad, after_rad))
        return after / before

    def late_deg(self, rate_deg_s: float, shift_m: float) -> float:
        """The angle by which a slow tilt goes on, from the moment when the block begins to tip until its centre is
        shifted by ``shift_m``, degrees.

        θ'' = p² (θ + ωt), so θ = ω / p · (sinh pt − pt).
        """
        p, rate = math.sqrt(self.rate_squared), math.radians(rate_deg_s)
        needed = shift_m / (self.radius_m * math.cos(self.slenderness_rad))
        low, high = 0.0, 60.0 / p
        for _ in range(60):
            middle = (low + high) / 2
            tipped = rate / p * (math.sinh(p * middle) - p * middle)
            low, high = (middle, high) if tipped < needed else (low, middle)
        return rate_deg_s * low


def trapezoid(level_g: float, ramp_s: float = 0.05, hold_s: float = 0.3) -> Acceleration:
    """The acceleration of EUMOS 40509's test: it grows to its level within 50 ms, stays there for 0.3 s, and falls to 0
    within 50 ms."""
    peak, end = level_g * LEVEL_M_S2, 2 * ramp_s + hold_s

    def ground(time_s: float) -> float:
        return peak * max(min(time_s / ramp_s, 1.0, (end - time_s) / ramp_s), 0.0)

    return ground


def half_sine(level_g: float, duration_s: float) -> Acceleration:
    """The acceleration of a half-sine pulse."""

    def ground(time_s: float) -> float:
        return level_g * LEVEL_M_S2 * math.sin(math.pi * time_s / duration_s) if time_s < duration_s else 0.0

    return ground


EUMOS_S: Final = 0.4
"""Duration of EUMOS's pulse, s."""
SETTLES_S: Final = 30.0
"""Time for which the motion of a block is computed, s. After this time, all blocks of this file rest or have fallen."""


def slide_m(level_g: float, friction: float, step_s: float = 1e-4) -> float:
    """The distance that a block slides in EUMOS's test, by Coulomb's law, m."""
    ground, grip = trapezoid(level_g), friction * GRAVITY
    speed = way = time_s = 0.0
    while time_s < EUMOS_S or speed > 0:
        speed = max(speed + (ground(time_s) - grip) * step_s, 0.0)
        way += speed * step_s
        time_s += step_s
    return way


LEVEL_STEPS: Final = 100
"""Number of levels of a search per 1 g."""
THRESHOLD_M: Final = petmjx.Thresholds().shift_m


def slide_level_g(friction: float) -> float:
    """The largest level of EUMOS's test, in hundredths of 1 g, at which a block slides no farther than the
    threshold."""
    return _largest(lambda level: slide_m(level, friction) <= THRESHOLD_M)


def largest_level_g(block: RockingBlock, friction: float) -> float:
    """The largest level of EUMOS's test, in hundredths of 1 g, that a block survives.

    If a block rocks before it slides, and rocking never needs more than the available friction, the block does not
    slide. So the block is lost at Housner's level, even if a block that stands flat would slide too far at a smaller
    level. If the friction is equal to width / height, or larger by a few hundredths, a block slides and rocks at the
    same time, and the result is not exact.
    """
    slides = slide_level_g(friction)
    if friction <= math.tan(block.slenderness_rad):
        return slides
    rocks = _largest(lambda level: not block.rock(trapezoid(level), SETTLES_S, EUMOS_S).lost)
    needed = block.rock(trapezoid(rocks), SETTLES_S, EUMOS_S).friction
    return rocks if needed < friction else min(rocks, slides)


def _largest(survives: Callable[[float], bool], steps: int = LEVEL_STEPS) -> float:
    """The largest level up to 3 g that is survived, g. ``steps``: number of levels per 1 g."""
    low, high = 0, 3 * steps
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if survives(middle / steps) else (low, middle)
    return low / steps


# ---------------------------------------------------------------------- petmjx's values

SIDE_MM: Final = 300.0
DEPTH_MM: Final = 300.0
BOX_FRICTION: Final = 0.5
"""Friction of the physics ``pallet``. The values of the axis ``friction_factor`` are factors on this value."""
ROUGH: Final = 1.2
"""A friction at which no slender block slides."""


def block_plan(name: str, width_mm: float, heights_mm: Sequence[float]) -> petmjx.Plan:
    """A block, or a stack of boxes, in the middle of a Euro pallet; it rocks in the plane of x and z."""
    bottoms = np.cumsum([0.0, *heights_mm[:-1]])
    return petmjx.Plan.from_boxes(
        name,
        size_mm=[[width_mm, DEPTH_MM, height] for height in heights_mm],
        corner_mm=[[600.0 - width_mm / 2, 400.0 - DEPTH_MM / 2, float(bottom)] for bottom in bottoms],
        mass_kg=[10.0] * len(heights_mm),
    )


def swept(plans: Sequence[petmjx.Plan], engine: EngineName, sweep: str, **options: Any) -> petmjx.RunResults:
    """A sweep with these tables, on a Euro pallet."""
    text = f'name = "rocking"\n[simulation]\ncarrier = "euro-pallet"\n{sweep}'
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rocking.toml"
        file.write_text(text)
        return petmjx.sweep(file, plans, engine=engine, threads=1, **options)


def rows(engine: EngineName = "mujoco") -> Iterator[Row]:
    """Yield all rows of this module, each as soon as it is simulated."""
    yield from free_rocking(engine)
    yield from overturning(engine)
    yield from overturning_limits(engine)
    yield from overturning(engine, FREE_BLOCKS[1:2], SHARP)
    yield from overturning_limits(engine, physics=SHARP)
    yield from tilting(engine)
    yield from eumos_levels(engine)
    yield from wrapped_levels(engine)


FREE_BLOCKS: Final = tuple(RockingBlock(width_m, 0.6) for width_m in (0.12, 0.15, 0.2, 0.3))
MEASURED_RESTITUTION: Final = {5: 0.95, 3: 0.97}
"""Slenderness → angular speed after an impact on concrete, as measured by ElGawady et al., divided by Housner's angular
speed."""
SHORTEST_TILT_RAD: Final = math.radians(0.5)
"""Smallest tilt of a swing that is compared, rad. In smaller swings, corners move by no more than the depth of
contacts."""


def free_rocking(engine: EngineName) -> Iterator[Row]:
    """Rows about a block that rocks after a pulse: the share of the energy that remains after each impact, and the
    duration of half a swing."""
    for block in FREE_BLOCKS:
        level = _rocking_level_g(block)
        width, height = 1000 * block.width_m, 1000 * block.height_m
        name = f"a block of {width:g} × {height:g} mm"
        axes = f'[axes]\nprofile = "eumos-40509"\nlevel = {level}\nfriction_factor = {ROUGH / BOX_FRICTION}\n'
        run = swept([block_plan("b", width, [height])], engine, axes, record="all", record_interval_s=0.002)
        assert run.histories is not None
        time_s, tilt = _free_swing(run.histories, run.worlds.iloc[0])
        peaks, crossings = _swings(time_s, tilt)
        kept = np.mean([block.energy_kept(*pair) for pair in pairwise(peaks)])
        kept_share = f"share of the energy that {name} keeps at an impact"
        yield Row(kept_share, "Housner 1963", block.speed_kept**2, float(kept), engine)
        swing_s = block.rock(lambda _: 0.0, 5.0, 0.0, start=(peaks[0], 0.0)).impacts_s
        yield Row(
            f"time between the first two impacts of {name} that rocks freely from {math.degrees(peaks[0]):.1f}°, s",
            "Housner 1963",
            swing_s[1] - swing_s[0],
            crossings[1] - crossings[0],
            engine,
        )
        slender = round(block.height_m / block.width_m)
        if slender in MEASURED_RESTITUTION:
            ratio = math.sqrt(kept) / block.speed_kept
            source = "measured on concrete, ElGawady et al."
            yield Row(
                f"angular speed of {name} after an impact, divided by the angular speed of Housner's block",
                source,
                MEASURED_RESTITUTION[slender],
                ratio,
                engine,
            )


def _rocking_level_g(block: RockingBlock) -> float:
    """A level of EUMOS's test that tilts a block by half of α."""
    low, high = math.tan(block.slenderness_rad), 3.0
    while high - low > 1e-4:
        middle = (low + high) / 2
        tilt = block.rock(trapezoid(middle), 2.0, EUMOS_S).max_tilt_rad
        low, high = (middle, high) if tilt < block.slenderness_rad / 2 else (low, middle)
    return round(low, 4)


def _free_swing(histories: pd.DataFrame, world: pd.Series) -> tuple[np.ndarray, np.ndarray]:
    """The times, s, and the tilts towards +x, rad, of all frames after the end of EUMOS's pulse."""
    begin_s = world.sim_time_s - world.n_steps * 0.002
    frames = histories[histories.time_s > begin_s + EUMOS_S]
    return frames.time_s.to_numpy(float), 2 * np.arctan2(frames.quat_y, frames.quat_w).to_numpy(float)


def _swings(time_s: np.ndarray, tilt: np.ndarray) -> tuple[list[float], list[float]]:
    """The largest tilts of those swings that are large enough, rad, and the times of the impacts with which these
    swings begin, s. The first swing may have begun in the pulse."""
    impacts = np.flatnonzero(np.diff(np.sign(tilt)))
    peaks = [float(np.abs(part).max()) for part in np.split(tilt, impacts + 1)]
    count = next((k for k, peak in enumerate(peaks) if peak < SHORTEST_TILT_RAD), len(peaks))
    return peaks[:count], [float(time_s[k]) for k in impacts[: max(count, 2)]]


PULSES_S: Final = (0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)
OVER_TAN: Final = (1.1, 1.3, 1.5, 1.8, 2.1, 2.4, 2.8, 3.2, 3.7, 4.3, 5.0, 6.0)
"""Peaks of pulses, divided by the acceleration g tan α at which rocking begins. ``PULSES_S`` are the durations of the
pulses."""


SHARP: Final = "solimp = [0.1, 0.999, 0.00002]"
"""Contacts that reach their stiffness within 0.02 mm instead of 0.1 mm, as a line of a sweep's table of physics. With
these contacts, a block's edges are nearly the hard edges of Housner's block."""


def _contacts(physics: str) -> str:
    """The note of a row whose contacts are not the default contacts."""
    return f", with `{physics}`" if physics else ""


def overturning(
    engine: EngineName, blocks: Sequence[RockingBlock] = (FREE_BLOCKS[1], FREE_BLOCKS[3]), physics: str = ""
) -> Iterator[Row]:
    """Rows with the number of half-sine pulses, of 8 × 12, that have the same outcome for a block as in Housner's
    equations.

    Args:
        physics: a line of a sweep's table of physics.
    """
    for block in blocks:
        width, height = 1000 * block.width_m, 1000 * block.height_m
        levels = [round(math.tan(block.slenderness_rad) * over, 3) for over in OVER_TAN]
        friction = max(ROUGH, 2 * levels[-1])
        tables = "".join(
            f'[profiles.p{k}]\nkind = "half-sine"\nduration_ms = {1e3 * s}\n' for k, s in enumerate(PULSES_S)
        )
        names = [f"p{k}" for k in range(len(PULSES_S))]
        contacts = f"[simulation.physics]\n{physics}\n"
        axes = f"[axes]\nprofile = {names}\nlevel = {levels}\nfriction_factor = {friction / BOX_FRICTION}\n"
        worlds = swept([block_plan("b", width, [height])], engine, contacts + axes + tables).worlds
        verdicts = worlds.set_index(["profile", worlds.level_g.round(3)]).verdict
        same = 0
        for (k, pulse_s), level in product(enumerate(PULSES_S), levels):
            lost = block.rock(half_sine(level, pulse_s), SETTLES_S, pulse_s).lost
            same += lost == (verdicts[f"p{k}", level] != "stable")
        quantity = "number of half-sine pulses (of 96) with the same outcome for petmjx's and Housner's block of "
        quantity += f"{width:g} × {height:g} mm{_contacts(physics)}"
        yield Row(quantity, "Housner 1963, integrated", 96, same, engine)


LIMITS_S: Final = (0.15, 0.2, 0.3, 0.4)
"""Durations of the pulses whose largest survived peaks are searched, s."""
LIMIT_STEPS: Final = 1000
"""Number of levels of these searches per 1 g."""


@cache
def pulse_limit_g(block: RockingBlock, pulse_s: float) -> float:
    """The largest peak of a half-sine pulse that a block survives, by Housner's equations, in thousandths of 1 g."""
    return _largest(lambda level: not block.rock(half_sine(level, pulse_s), SETTLES_S, pulse_s).fell, LIMIT_STEPS)


def overturning_limits(
    engine: EngineName, pulses_s: Sequence[float] = LIMITS_S, physics: str = "", within: float = 0.03
) -> Iterator[Row]:
    """Rows with the largest peaks of half-sine pulses that a block survives, in thousandths of 1 g.

    Args:
        physics: a line of a sweep's table of physics.
        within: largest distance of the simulated levels from Housner's limit, as a share of this limit.
    """
    block = FREE_BLOCKS[1]
    width, height = 1000 * block.width_m, 1000 * block.height_m
    for pulse_s in pulses_s:
        expected = pulse_limit_g(block, pulse_s)
        lower, upper = (1 - within) * expected, (1 + within) * expected
        tables = (
            f"[simulation.physics]\n{physics}\n"
            f'[axes]\nprofile = "pulse"\ndirection = "+x"\nfriction_factor = {ROUGH / BOX_FRICTION}\n'
            f'[profiles.pulse]\nkind = "half-sine"\nduration_ms = {1e3 * pulse_s}\n'
            f"[search]\nlower = {lower:.3f}\nupper = {upper:.3f}\ntolerance = {1 / LIMIT_STEPS}\n"
        )
        summary = swept([block_plan("b", width, [height])], engine, tables).summary
        assert summary is not None
        quantity = f"largest half-sine pulse of {pulse_s:g} s that a block of {width:g} × {height:g} mm survives, g"
        quantity += _contacts(physics)
        yield Row(quantity, "Housner 1963, integrated", expected, float(summary.largest_level_g.iloc[0]), engine)


TILT_RATES: Final = {"tilt": 5.0, "tilt-quasi-static": 0.5}
"""Profile → its rate, degrees/s."""


TILTED_BLOCKS: Final = (RockingBlock(0.15, 0.9), RockingBlock(0.2, 0.6), RockingBlock(0.2, 0.4))


def tilting(
    engine: EngineName,
    frictions: Sequence[float] = (0.3, 0.5, 0.7),
    blocks: Sequence[RockingBlock] = TILTED_BLOCKS,
) -> Iterator[Row]:
    """Rows with the angles at which boxes on a tilted carrier fail, and the delay of the failure, compared with closed
    forms."""
    shift_mm = 1000 * THRESHOLD_M
    for profile, rate in TILT_RATES.items():
        for friction in frictions:
            angle = math.degrees(math.atan(friction))
            failed = _fail_angle_deg(block_plan("b", 500.0, [100.0]), profile, friction, engine)
            name = f"a box with friction {friction:g} slides in the profile `{profile}`"
            yield Row(f"angle at which {name}, °", "atan(friction)", angle, failed, engine)
            late = slide_late_deg(math.radians(angle), rate)
            slid = f"a box with friction {friction:g} has slid by {shift_mm:g} mm in the profile `{profile}`"
            quantity = f"further tilt of the carrier, beyond atan(friction), until {slid}, °"
            yield Row(quantity, "Coulomb", late, failed - angle, engine)
        for block in blocks:
            width, height = 1000 * block.width_m, 1000 * block.height_m
            angle = math.degrees(block.slenderness_rad)
            failed = _fail_angle_deg(block_plan("b", width, [height]), profile, ROUGH, engine)
            block_name = f"a block of {width:g} × {height:g} mm"
            name = f"{block_name} topples in the profile `{profile}`"
            yield Row(f"angle at which {name}, °", "atan(width / height)", angle, failed, engine)
            late = block.late_deg(rate, THRESHOLD_M)
            moved = f"the centre of {block_name} has moved by {shift_mm:g} mm in the profile `{profile}`"
            yield Row(
                f"further tilt of the carrier, beyond atan(width / height), until {moved}, °",
                "Housner 1963, linear",
                late,
                failed - angle,
                engine,
            )


def slide_late_deg(angle_rad: float, rate_deg_s: float) -> float:
    """The angle by which a tilt goes on, from the moment when a box begins to slide until it has slid by the threshold,
    degrees. The acceleration of the box grows by g ω / cos θ each second, so the box slides by g ω t³ / (6 cos θ)."""
    return rate_deg_s * math.cbrt(6 * THRESHOLD_M * math.cos(angle_rad) / (GRAVITY * math.radians(rate_deg_s)))


def _fail_angle_deg(plan: petmjx.Plan, profile: str, friction: float, engine: EngineName) -> float:
    axes = f'[axes]\nprofile = "{profile}"\nfriction_factor = {friction / BOX_FRICTION}\n'
    return float(swept([plan], engine, axes).worlds.fail_angle_deg.iloc[0])


STACKS: Final = (1, 2, 3, 4, 5)
FRICTIONS: Final = (0.3, 0.5, 0.7, 0.9, 1.2)


def eumos_levels(
    engine: EngineName, stacks: Sequence[int] = STACKS, frictions: Sequence[float] = FRICTIONS
) -> Iterator[Row]:
    """The largest level of EUMOS's test that a box of 300 × 300 × 250 mm and stacks of it survive, to 0.01 g.

    A stack rocks as one block, since its boxes press on each other's whole faces.
    """
    plans = [block_plan(f"{n}", SIDE_MM, [250.0] * n) for n in stacks]
    factors = [friction / BOX_FRICTION for friction in frictions]
    axes = f'[axes]\nprofile = "eumos-40509"\ndirection = "+x"\nfriction_factor = {factors}\n'
    search = "[search]\nlower = 0.2\nupper = 1.4\ntolerance = 0.01\n"
    summary = swept(plans, engine, axes + search).summary
    assert summary is not None
    for answer in summary.to_dict("records"):
        n, friction = int(answer["plan_id"]), round(answer["friction_factor"] * BOX_FRICTION, 3)
        expected = largest_level_g(RockingBlock(SIDE_MM / 1000, 0.25 * n), friction)
        quantity = f"largest level of EUMOS's test that stacks of {n} boxes with friction {friction:g} survive, g"
        yield Row(quantity, "Coulomb's law, or Housner's block (1963)", expected, answer["largest_level_g"], engine)


TURNS: Final = (2, 3, 4)
TURN_N: Final = 20.0
FILM_FRICTION: Final = 0.4
FILM_M: Final = 0.5
"""Tension of a turn, N, friction on film, and width of the film, m: values for a closed form, which are not
measured."""


def wrapped_levels(engine: EngineName) -> Iterator[Row]:
    """The largest level of EUMOS's test that a wrapped box of 10 kg survives, to 0.01 g.

    Each turn adds its tension (Sensors 2025, 25(22), 6883). At a corner, film pulls along two sides, so each of the
    four sides is pressed with 2 T, where T is the tension of as much film as the box is high. This pressure times the
    friction of film holds the box in addition to its own friction.
    """
    mass_kg, height_m = 10.0, 0.2
    plan = petmjx.Plan.from_boxes("w", size_mm=[[400, 300, 200]], corner_mm=[[400, 250, 0]], mass_kg=[mass_kg])
    film = f"wrap = {{ force_n = {TURN_N}, friction = {FILM_FRICTION}, film_mm = {1000 * FILM_M} }}\n"
    axes = f'[axes]\nprofile = "eumos-40509"\ndirection = "+x"\nwrap_turns = {list(TURNS)}\n'
    search = "[search]\nlower = 0.3\nupper = 2.0\ntolerance = 0.01\n"
    summary = swept([plan], engine, film + axes + search).summary
    assert summary is not None
    for answer in summary.to_dict("records"):
        turns = answer["wrap_turns"]
        hold_n = FILM_FRICTION * 4 * 2 * turns * TURN_N * height_m / FILM_M
        expected = slide_level_g(BOX_FRICTION + hold_n / (mass_kg * GRAVITY))
        film = f"{turns:g} turns of film of {TURN_N:g} N"
        quantity = f"largest level of EUMOS's test that a box of 10 kg survives in {film}, g"
        source = "Coulomb's law, with tension of film as in Sensors 2025, 25(22), 6883"
        yield Row(quantity, source, expected, answer["largest_level_g"], engine)


if __name__ == "__main__":
    print(pd.DataFrame(rows()).to_string(index=False))
