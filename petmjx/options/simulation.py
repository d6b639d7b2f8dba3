"""The options of a simulation (``Simulation``): all options that affect its results.

petmjx/options/run_options.py has the options for how and where a run is computed. Defaults, units, checks and
descriptions are defined only here. The arguments of ``petmjx.score`` and ``petmjx.sweep``, the options of the command
line and the ``[simulation]`` table of sweep files are generated from the records of petmjx/options. ``run.json``
stores the values of the options.
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
from petmjx.options.quiet import MOST_STEPS, Quiet
from petmjx.options.thresholds import Thresholds
from petmjx.options.walls import Walls
from petmjx.options.wrap import Wrap

# Limits of options. A value above its limit probably has the wrong unit or a digit too many. With too large a value,
# numbers would become infinite, a run would not end, or tables would be too long to be useful.
LONGEST_INTERVAL_S: Final = 40.0
LONGEST_S: Final = 600.0
"""Largest values of options that are times, s. ``LONGEST_INTERVAL_S`` is the limit of ``interval_s`` and
``longest_wait_s``, because a simulation may wait this long for each box; ``LONGEST_S`` is the limit of all other times.
With ``LONGEST_INTERVAL_S``, the number of steps of a simulation fits into 32 bits, even with the shortest timestep and
512 boxes."""
MOST_ITERATIONS: Final = 1_000_000_000
"""Largest ``iteration_limit``. An attempt with a smaller timestep multiplies the limit, but never beyond this value,
because counts of iterations must fit into 32 bits."""

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
    petmjx/engines/attempt_settings.py chooses the solver of each attempt."""

    NEWTON = "newton"
    CG = "cg"


class Attempts(StrEnum):
    """Whether boxes are rigid or soft in the last attempt at a simulation (petmjx/engines/attempt_settings.py)."""

    RIGID = "rigid"
    SOFT = "soft"


class Simulation(CheckedRecord):
    """All options on which the result of a simulation depends, besides the plan and random errors."""

    check: Annotated[Check, CliFlag("--check")] = Field(
        Check.ONE_BY_ONE,
        description="how boxes come to stand: one-by-one: they are placed one after another; static: all boxes stand "
        "from the start",
    )
    schedule: Annotated[Schedule, CliFlag("--schedule")] = Field(
        Schedule.ADAPTIVE,
        description="when the next box is placed: adaptive: as soon as the pallet is quiet and no box creeps; fixed: "
        "at equal intervals",
    )
    physics: Annotated[Physics, CliFlag("--physics")] = Field(
        PHYSICS["pallet"],
        description="physics of contacts: pallet: stacks of boxes come to rest, and the carrier is of wood; reference: "
        "as in PET-Physics",
    )
    carrier: Annotated[AnyCarrier, CliFlag("--carrier", "NAME|FILE")] = Field(
        Carrier.FOOTPRINT,
        description="what the boxes stand on: footprint: the plan's bounding box; "
        f"{', '.join(list(Carrier)[1:])}: slabs, or bodies of boards, some with walls (docs/carriers.md has their "
        "sizes); or your own carrier, FILE.toml",
    )
    walls: Walls = Field(Walls(), description="walls around the carrier's top")
    friction_pairs: tuple[FrictionPair, ...] = Field(
        (),
        max_length=100,
        description="coefficients of friction for pairs of materials (boxes and boards), in addition to petmjx's own; "
        "each entry has two keys: 'between', a list of two materials, and 'friction'",
    )
    landing_pairs: tuple[LandingPair, ...] = Field(
        (),
        max_length=100,
        description="values for pairs of materials, in addition to petmjx's own: how boxes bounce and stop when they "
        "land; each entry has the key 'between', a list of two materials, and at least one of "
        f"{', '.join(repr(name) for name in LandingPair.model_fields if name != 'between')}",
    )
    size_reduction_mm: Annotated[float, within(0, 1000), CliFlag("--size-reduction-mm", "MM")] = Field(
        0.1,
        ge=0,
        description="length by which boxes are made smaller along x and y, so that neighbours do not touch at the "
        "start, mm",
    )
    interval_s: Annotated[float, within(0, LONGEST_INTERVAL_S), CliFlag("--interval", "S")] = Field(
        0.7,
        gt=0,
        description="time between two placements, s; with schedule=adaptive: longest wait for the next placement once "
        "a box has failed",
    )
    longest_wait_s: Annotated[float, within(0, LONGEST_INTERVAL_S), CliFlag("--longest-wait", "S")] = Field(
        10.0,
        ge=0,
        description="longest wait for a pallet to come to rest, s: before a world ends and, with schedule=adaptive, "
        "before the next box is placed. A world that still moves after this wait has the flag 'moving'",
    )
    duration_s: Annotated[float, within(0, LONGEST_S), CliFlag("--duration", "S")] = Field(
        10.0,
        gt=0,
        description="length of the static check, s; with schedule=adaptive: largest length of the static check",
    )
    settle_s: Annotated[float, within(0, LONGEST_S), CliFlag("--settle", "S")] = Field(
        2.0,
        ge=0,
        description="pause between the last placement and a profile (a motion of the carrier), s; with "
        "schedule=adaptive, only pallets that have failed have this pause",
    )
    rest_s: Annotated[float, within(0, LONGEST_S), CliFlag("--rest", "S")] = Field(
        1.0,
        ge=0,
        description="time to come to rest after the last sample of a profile (a motion of the carrier), s; with "
        "schedule=adaptive: less if the pallet is quiet sooner",
    )
    total_time_factor: Annotated[float | None, within(1, 10)] = Field(
        None,
        gt=1,
        description="only with schedule=fixed and check=one-by-one: length of the whole simulation, as a multiple of "
        "the time in which boxes are placed; replaces rest_s",
    )
    sample_interval_s: Annotated[float, within(0, LONGEST_S), CliFlag("--sample-interval", "S")] = Field(
        0.2, gt=0, description="time between two samples of the metrics, s"
    )
    rest_window_s: Annotated[float, within(0, LONGEST_S)] = Field(
        0.2,
        gt=0,
        description="length of the window at the end of a world over which forces at rest (rest_top_force_n) are "
        "averaged, s",
    )
    early_stop: Annotated[bool, CliFlag("--early-stop/--no-early-stop")] = Field(
        True,
        description="end a world as soon as a box has dropped, instead of simulating it to the end of the schedule; "
        "worlds with random errors, and worlds that are shaken, also end as soon as a box is lost (tilted too far)",
    )
    check_timestep: Annotated[bool, CliFlag("--check-timestep")] = Field(
        False,
        description="simulate again, at half the timestep, the worlds whose margin is between -0.5 and 0.5, and report "
        "the worlds whose verdict then changes (flag 'timestep')",
    )
    soft: Annotated[bool, CliFlag("--soft")] = Field(
        False,
        description="simulate boxes that have a stiffness as flex bodies of MuJoCo, which bend and twist; otherwise, a "
        "contact law makes these boxes soft; engine mujoco only; up to a hundred times slower",
    )
    attempts: Annotated[Attempts, CliFlag("--attempts")] = Field(
        Attempts.RIGID,
        description="attempts to simulate a world: soft: a world gets one more attempt, with all boxes as flex bodies, "
        "if it is invalid after all other attempts, or if soft contacts may have decided its verdict; rigid: no "
        "world gets this attempt",
    )
    placing: Placing = Field(Placing(), description="how a box is placed")
    wrap: Wrap = Field(Wrap(), description="stretch film around a pallet that is shaken")
    thresholds: Thresholds = Field(Thresholds(), description="thresholds beyond which a plan is unstable")
    quiet: Quiet = Field(Quiet(), description="conditions under which a pallet is quiet enough for the next box")
    solver: Annotated[Solver, CliFlag("--solver")] = Field(
        Solver.NEWTON, description="constraint solver of the first attempt"
    )
    solver_iterations: Annotated[int | None, within(1, MOST_STEPS)] = Field(
        None, gt=0, description="largest number of solver iterations per step; none: the engine's own choice"
    )
    iteration_limit: Annotated[int | None, within(1, MOST_ITERATIONS), CliFlag("--iteration-limit", "N")] = Field(
        None,
        gt=0,
        description="largest number of solver iterations of a world; with a profile (a motion of the carrier), the "
        "placement and the profile may each take this number. A world that reaches this number ends, "
        "and has a verdict only if a box has dropped or tilted too far; none: no limit",
    )
    solver_tolerance: Annotated[float | None, within(0, 1)] = Field(
        None, gt=0, description="MuJoCo's opt.tolerance; none: the engine's own choice"
    )

    @field_validator("schedule", mode="before")
    @classmethod
    def _no_brisk(cls, value: Any) -> Any:
        if value == "brisk":  # petmjx 0.1 had the schedule ``brisk``
            raise ValueError(
                "must be 'fixed' or 'adaptive': 'brisk' was removed, since 'adaptive' now takes as few steps"
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
                raise complaint("needs check='one-by-one' and schedule='fixed'", "total_time_factor")
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
                f"{way} needs schedule='adaptive': the fixed schedule does not wait until a box is let go", "placing"
            )
        return self

    @model_validator(mode="after")
    def _soft_boxes_appear(self) -> Self:
        for name, is_on in (("soft", self.soft), ("attempts", self.attempts is Attempts.SOFT)):
            if is_on and self.placing.name not in (Way.AUTO, Way.EXACT):
                raise complaint(
                    f"needs placing='exact': soft boxes appear at their places, got {self.placing.name}", name
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
        ``auto``, a hand may carry boxes if ``check`` is ``one-by-one``, the schedule is ``adaptive``, and boxes do not
        fall into their places.
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
