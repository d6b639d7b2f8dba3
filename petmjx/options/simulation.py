"""The options of a simulation (``Simulation``): all options that affect its results.

petmjx/options/run_options.py has the options for how and where a run is computed. Defaults, units, checks and
descriptions are defined only here. The arguments of ``petmjx.score`` and ``petmjx.sweep``, the options of the command
line and the ``[simulation]`` table of sweep files are generated from these records. ``run.json`` stores the values of
the options.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, Final, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, complaint, within
from petmjx.options.carriers import AnyCarrier, Carrier, walls_of
from petmjx.options.materials import FrictionPair, LandingPair
from petmjx.options.physics import PHYSICS, Cone, Physics
from petmjx.options.placing import Placing, Way
from petmjx.options.walls import Walls
from petmjx.options.wrap import Wrap

# Limits of options. A value above its limit probably has the wrong unit or a digit too many. With too large a value,
# numbers would become infinite, a run would not end, or tables would be too long to be useful.
LONGEST_INTERVAL_S: Final = 40.0
LONGEST_S: Final = 600.0
"""Largest value of options that are times, s. ``LONGEST_INTERVAL_S`` limits ``interval_s`` and ``longest_wait_s``. With
``LONGEST_INTERVAL_S`` as the limit, the number of steps of a simulation fits into 32 bits, even with the shortest
timestep and 512 boxes."""
MOST_STEPS: Final = 100_000

SOFT_START_STEPS: Final = 100
"""Number of steps in each half of the soft start, which precedes a simulation's time 0. In the first half, there is no
gravity. In the second half, gravity increases: in step k it is gravity × k / ``SOFT_START_STEPS``."""


class Check(StrEnum):
    """Whether boxes are placed one by one, or all boxes are in place from the start."""

    ONE_BY_ONE = "one-by-one"
    STATIC = "static"


class Schedule(StrEnum):
    """The rule for when the next box is placed.

    ``Simulation.schedule`` describes each schedule; docs/rules.md, section 5, has the exact rules, step by step.
    """

    FIXED = "fixed"
    ADAPTIVE = "adaptive"


class Solver(StrEnum):
    """MuJoCo's constraint solver. A simulation that fails is repeated in further attempts with other settings;
    petmjx/engines/attempts.py chooses the solver of each attempt."""

    NEWTON = "newton"
    CG = "cg"


class Attempts(StrEnum):
    """Whether boxes are rigid or soft in the last attempt at a simulation (petmjx/engines/attempts.py)."""

    RIGID = "rigid"
    SOFT = "soft"


class Thresholds(CheckedRecord):
    """The thresholds above which a plan counts as unstable, or a simulation as invalid (PET-Physics paper, section
    IV-C)."""

    shift_m: Annotated[float, within(0, 100), CliFlag("--shift-limit-m", "M")] = Field(
        0.02, gt=0, description="a plan is unstable if a box ends further than this from its place in x, y or z, m"
    )
    shift_floor_m: Annotated[float, within(0, 100)] = Field(
        0.001, ge=0, description="components of a displacement below this count as 0, m"
    )
    tilt_deg: Annotated[float, within(0, 360), CliFlag("--tilt-limit-deg", "DEG")] = Field(
        20.0,
        gt=0,
        description="a plan is unstable if the angle between a box's z axis and the world's exceeds this, degrees",
    )
    drop_hull_z_m: Annotated[float, within(-100, 100)] = Field(
        -0.1, description="a box whose hull reaches below this has dropped, m"
    )
    lin_acc_m_s2: Annotated[float, within(0, 1e9)] = Field(
        110.0, gt=0, description="a larger linear acceleration before the first sign is an explosion, m/s²"
    )
    ang_acc_rad_s2: Annotated[float, within(0, 1e9)] = Field(
        110.0, gt=0, description="a larger angular acceleration before the first sign is an explosion, rad/s²"
    )


class Quiet(CheckedRecord):
    """The conditions under which a pallet is quiet enough for the next box, and under which a simulated pallet is at
    rest.

    A pallet is quiet when all boxes have been slower than ``quiet_m_s`` for ``steps`` steps. The speed of a box is the
    speed of its fastest point. docs/rules.md, section 5, has the exact rules, step by step.

    With elliptic friction cones, there are two more conditions. First, each box must be slow or have slowed down.
    Second, no moving box may have become faster, because a box that begins to topple becomes faster. A box that
    violates one of these two conditions is said to creep, and delays the next box. Once a creeping box has dropped or
    tilted too far, it no longer delays the next box, because the outcome is then known.

    A box that moves back and forth without net motion is said to tremble. Trembling boxes never delay the next box.

    A simulated pallet is at rest if no point of any box moved faster than ``still_m_s`` in the last ``still_steps``
    steps of its rest window (the time at the end over which forces at rest are averaged).
    """

    quiet_m_s: Annotated[float, within(0, 100)] = Field(
        0.01, gt=0, description="speed of a box's fastest point below which it is quiet, m/s"
    )
    slow_m_s: Annotated[float, within(0, 100)] = Field(
        0.001, ge=0, description="speed of a box's fastest point below which it is slow, m/s"
    )
    slowing: Annotated[float, within(0, 1000)] = Field(
        0.7, ge=0, description="a box that is not slow creeps unless it slows to this share of its speed"
    )
    steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        15, ge=1, description="steps for which all boxes must have been quiet"
    )
    landing_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        50, ge=1, description="steps in which a box lands: no rest window, and no explosion, begins before"
    )
    poll_steps: Annotated[int, within(1, MOST_STEPS)] = Field(5, ge=1, description="steps between two checks")
    still_m_s: Annotated[float, within(0, 100)] = Field(
        0.0001, ge=0, description="speed of a box's fastest point up to which it is still, m/s"
    )
    still_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        50, ge=1, description="steps before a world's end for which all boxes must have been still"
    )
    tremble_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        250,
        ge=1,
        description="length of the windows of a wait, in steps; at the end of each, trembling boxes are looked for",
    )
    tremble_share: Annotated[float, within(0, 1)] = Field(
        0.25, ge=0, description="a box trembles that gets no further away than this share of the way that it goes"
    )

    @property
    def tremble_looks(self) -> int:
        """How often the simulation checks, within ``tremble_steps`` steps, whether the pallet is quiet; rounded up."""
        return -(-self.tremble_steps // self.poll_steps)


class Simulation(CheckedRecord):
    """All options on which the result of a simulation depends, besides the plan and random errors."""

    check: Annotated[Check, CliFlag("--check")] = Field(
        Check.ONE_BY_ONE,
        description="how boxes come to stand: one-by-one: box after box; static: all from the start",
    )
    schedule: Annotated[Schedule, CliFlag("--schedule")] = Field(
        Schedule.ADAPTIVE,
        description="when the next box is placed: adaptive: as soon as the pallet is quiet and nothing creeps; "
        "fixed: every interval",
    )
    physics: Annotated[Physics, CliFlag("--physics")] = Field(
        PHYSICS["pallet"],
        description="contact physics: pallet: pallets rest, the carrier is of wood; reference: as in PET-Physics",
    )
    carrier: Annotated[AnyCarrier, CliFlag("--carrier", "NAME|FILE")] = Field(
        Carrier.FOOTPRINT,
        description="what the boxes stand on: footprint: the plan's bounding box; euro-pallet: 1200×800 mm; "
        "rollcontainer: 800×700 mm (x × y); made of boards with gaps: epal-1 (EN 13698-1), gma-48x40, pet-eur "
        "(PET-Physics's), rollcontainer-grid, or your own, FILE.toml; with walls: rollcontainer-2, -3, -4, gitterbox, "
        "container-20ft, trailer",
    )
    walls: Walls = Field(Walls(), description="walls around the carrier's top")
    friction_pairs: tuple[FrictionPair, ...] = Field(
        (),
        max_length=100,
        description="friction between materials of boxes and boards, in addition to petmjx's own table: tables with "
        "between (a list of two materials) and friction",
    )
    landing_pairs: tuple[LandingPair, ...] = Field(
        (),
        max_length=100,
        description="landings between materials of boxes and boards, in addition to petmjx's own table: tables with "
        "between (a list of two materials), and restitution, landing_s or both",
    )
    size_reduction_mm: Annotated[float, within(0, 1000), CliFlag("--size-reduction-mm", "MM")] = Field(
        0.1, ge=0, description="boxes are made smaller by this along x and y, so that neighbours start apart, mm"
    )
    interval_s: Annotated[float, within(0, LONGEST_INTERVAL_S), CliFlag("--interval", "S")] = Field(
        0.7, gt=0, description="time between two placements, s; adaptive: the longest wait once a box has failed"
    )
    longest_wait_s: Annotated[float, within(0, LONGEST_INTERVAL_S), CliFlag("--longest-wait", "S")] = Field(
        10.0,
        ge=0,
        description="longest wait for a pallet to come to rest before a world ends and, with schedule adaptive, "
        "before the next box, s. A world that still moves then has the flag moving",
    )
    duration_s: Annotated[float, within(0, LONGEST_S), CliFlag("--duration", "S")] = Field(
        10.0, gt=0, description="length of the static check, s"
    )
    settle_s: Annotated[float, within(0, LONGEST_S), CliFlag("--settle", "S")] = Field(
        2.0,
        ge=0,
        description="pause between the last placement and a profile, s; adaptive: only for pallets that have failed",
    )
    rest_s: Annotated[float, within(0, LONGEST_S), CliFlag("--rest", "S")] = Field(
        1.0,
        ge=0,
        description="time to come to rest after a profile's last sample, s; adaptive: less where it is quiet sooner",
    )
    total_time_factor: Annotated[float | None, within(1, 10)] = Field(
        None,
        gt=1,
        description="fixed, one by one: length of the whole run in multiples of the placement time, instead of rest_s",
    )
    sample_interval_s: Annotated[float, within(0, LONGEST_S), CliFlag("--sample-interval", "S")] = Field(
        0.2, gt=0, description="time between two samples of the metrics, s"
    )
    rest_window_s: Annotated[float, within(0, LONGEST_S)] = Field(
        0.2, gt=0, description="rest_top_force_n is averaged over this at the end, s"
    )
    early_stop: Annotated[bool, CliFlag("--early-stop/--no-early-stop")] = Field(
        True,
        description="stop a world once a box has dropped, or with random errors or in a drive is lost, instead of "
        "going on to the end of the schedule",
    )
    check_timestep: Annotated[bool, CliFlag("--check-timestep")] = Field(
        False,
        description="simulate worlds with a margin below a half again at half the timestep, and name those that change "
        "(flag timestep)",
    )
    soft: Annotated[bool, CliFlag("--soft")] = Field(
        False,
        description="simulate boxes that have a stiffness as flex bodies of MuJoCo, which bend and twist, instead of "
        "by a contact law; on mujoco alone, and up to a hundred times as slow",
    )
    attempts: Annotated[Attempts, CliFlag("--attempts")] = Field(
        Attempts.RIGID,
        description="soft: once more simulate, with all boxes as flex bodies, worlds that are invalid after all other "
        "attempts, or whose verdict soft contacts may have decided; rigid: do not",
    )
    placing: Placing = Field(Placing(), description="how a box is placed")
    wrap: Wrap = Field(Wrap(), description="stretch film around a pallet that is shaken")
    thresholds: Thresholds = Field(Thresholds(), description="thresholds beyond which a plan is unstable")
    quiet: Quiet = Field(Quiet(), description="when a pallet is quiet enough for the next box")
    solver: Annotated[Solver, CliFlag("--solver")] = Field(
        Solver.NEWTON, description="constraint solver of the first attempt"
    )
    solver_iterations: Annotated[int | None, within(1, MOST_STEPS)] = Field(
        None, gt=0, description="solver iterations per step, at most; none: the engine's own choice"
    )
    solver_tolerance: Annotated[float | None, within(0, 1)] = Field(
        None, gt=0, description="MuJoCo's opt.tolerance; none: the engine's own choice"
    )

    @field_validator("schedule", mode="before")
    @classmethod
    def _no_brisk(cls, value: Any) -> Any:
        if value == "brisk":  # petmjx 0.1 had the schedule ``brisk``
            raise ValueError(
                "must be 'fixed' or 'adaptive': 'brisk' was removed, since adaptive now takes as few steps"
            )
        return value

    @field_validator("friction_pairs", "landing_pairs")
    @classmethod
    def _each_pair_once(
        cls, value: tuple[FrictionPair | LandingPair, ...], info: ValidationInfo
    ) -> tuple[FrictionPair | LandingPair, ...]:
        keys = [pair.key for pair in value]
        for at, key in enumerate(keys):
            if key in keys[:at]:
                raise complaint(f"is about the same materials as {info.field_name}[{keys.index(key)}]", at)
        return value

    @field_validator("interval_s", "duration_s", "sample_interval_s", "rest_window_s")
    @classmethod
    def _at_least_a_step(cls, value: float, info: Any) -> float:
        physics = info.data.get("physics")
        if isinstance(physics, Physics) and value < physics.timestep_s:
            raise ValueError(f"must be at least the timestep of {physics.timestep_s:g} s, got {value:g}")
        return value

    @model_validator(mode="after")
    def _whole_run(self) -> Self:
        if self.total_time_factor is not None:
            if self.check is not Check.ONE_BY_ONE or self.schedule is not Schedule.FIXED:
                raise complaint("needs check one-by-one and schedule fixed", "total_time_factor")
            if self.rest_s != type(self).model_fields["rest_s"].default:
                raise complaint("contradicts total_time_factor: drop one of them", "rest_s")
        return self

    @model_validator(mode="after")
    def _opens_walls(self) -> Self:
        walls_of(self.carrier, self.walls).check_open()
        return self

    @model_validator(mode="after")
    def _placed_one_by_one(self) -> Self:
        way = self.placing.name
        if not self.placing.appears and self.check is Check.STATIC:
            raise complaint(
                f"{way} needs check='one-by-one': in a static check, all boxes are in place from the start", "placing"
            )
        if self.placing.carries and self.schedule is Schedule.FIXED:
            raise complaint(
                f"{way} needs schedule adaptive: the fixed schedule does not wait until a box is let go", "placing"
            )
        return self

    @model_validator(mode="after")
    def _soft_boxes_appear(self) -> Self:
        for name, is_on in (("soft", self.soft), ("attempts", self.attempts is Attempts.SOFT)):
            if is_on and self.placing.name not in (Way.AUTO, Way.EXACT):
                raise complaint(
                    f"needs placing exact: soft boxes appear at their places, got {self.placing.name}", name
                )
        return self

    @property
    def has_soft(self) -> bool:
        """Whether boxes may be simulated as flex bodies (MuJoCo's deformable bodies)."""
        return self.soft or self.attempts is Attempts.SOFT

    @property
    def may_carry(self) -> bool:
        """Whether boxes may be carried to their places by a simulated hand or by tines.

        If the user has chosen a way of placing, boxes may be carried only if this way is ``hand`` or ``tines``. With
        ``auto``, a hand may carry boxes, unless boxes fall into their places or the schedule does not wait for a hand.
        """
        if self.placing.name is not Way.AUTO:
            return self.placing.carries
        waits = self.check is Check.ONE_BY_ONE and self.schedule is Schedule.ADAPTIVE
        return waits and not self.physics.falls_into_place

    @property
    def waits_for_rest(self) -> bool:
        """Whether creeping boxes (see ``Quiet``) delay the next box (schedule adaptive), the start of a profile (a
        shaking of the carrier) and the end of the simulation.

        With pyramidal friction cones, creeping boxes never delay anything, because with these cones every box creeps a
        little (benchmarks/notebook/performance.md).
        """
        return self.physics.cone is Cone.ELLIPTIC
