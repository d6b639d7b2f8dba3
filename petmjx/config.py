"""Every option that results depend on (``Simulation``). How and where a run runs: petmjx/run_options.py.

Defaults, units, checks and descriptions are written only here. ``petmjx.score``, ``petmjx.sweep``, the command line
and the ``[simulation]`` table of sweep files are made from these records. ``run.json`` has their values.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, Field, computed_field, field_validator, model_validator

from petmjx.carrier import AnyCarrier, Carrier
from petmjx.checked import Checked, CliFlag, complaint, got, within
from petmjx.materials import FrictionPair
from petmjx.placing import Placing, Way
from petmjx.wrap import Wrap

# Limits of what is physical, or of any use. What lies beyond has the wrong unit or a digit too many, and would end as
# an infinity, in an endless run, or in tables for steps that no run has.
LONGEST_INTERVAL_S: Final = 40.0
LONGEST_S: Final = 600.0
"""Of any other time. With the shortest timestep and 512 boxes the steps of a run still fit 32 bits."""
SHORTEST_TIMESTEP_S: Final = 0.0001
MOST_STEPS: Final = 100_000
HIGHEST_FRICTION: Final = 100.0

SOFT_START_STEPS: Final = 100
"""Before time counts: so many steps without gravity, then as many with gravity × k / ``SOFT_START_STEPS``."""


class Check(StrEnum):
    """How boxes come to stand on the carrier."""

    ONE_BY_ONE = "one-by-one"
    STATIC = "static"


class Schedule(StrEnum):
    """When the next box is placed.

    What each one does is in the description of ``Simulation.schedule`` and, to the step, in docs/rules.md, section 5.
    """

    FIXED = "fixed"
    ADAPTIVE = "adaptive"


class Cone(StrEnum):
    """Friction cone of the contact model."""

    PYRAMIDAL = "pyramidal"
    ELLIPTIC = "elliptic"


class Solver(StrEnum):
    """Constraint solver. Which attempt takes which: petmjx/engines/retry.py."""

    NEWTON = "newton"
    CG = "cg"


class Attempts(StrEnum):
    """What the last attempt at a world is (petmjx/engines/retry.py)."""

    RIGID = "rigid"
    SOFT = "soft"


Triple = tuple[float, float, float]


def _no_negatives(values: Triple) -> Triple:
    if min(values) < 0:
        raise ValueError(f"must be ≥ 0, got {values}")
    if max(values) > HIGHEST_FRICTION:
        raise ValueError(f"must be from 0 to {HIGHEST_FRICTION:g}, got {values}")
    return values


def _impedances(values: Triple) -> Triple:
    if not (0 < values[0] < 1 and 0 < values[1] < 1 and values[2] > 0):
        raise ValueError(f"must be two impedances between 0 and 1 and a width > 0 m, got {values}")
    if values[2] > 1:
        raise ValueError(f"must have a width of at most 1 m, got {values}")
    return values


def _contact_times(values: tuple[float, float]) -> tuple[float, float]:
    # negative ones are a stiffness and a damping, and stand for themselves in MuJoCo
    if max(map(abs, values)) > 1e6:
        raise ValueError(f"must be from -1e+06 to 1e+06, got {values}")
    return values


Friction = Annotated[Triple, AfterValidator(_no_negatives)]
"""MuJoCo's sliding, torsional and rolling coefficients of a geom. Between two geoms the larger ones count."""

CUSTOM: Final = "custom"


class Physics(Checked):
    """Contacts, carrier, floor, gravity and timestep.

    The numbers are those of the reference implementation (PET-Physics), except those in which the presets differ: the
    cone, the carrier's friction, the five of contacts (solref, solreffriction, solimp, impratio, skin_m), and whether
    boxes fall into their places. Friction of 0.5 between boxes: CTU Code, Annex 7, Appendix 2 (cardboard on cardboard).

    Made from a preset's name ("pallet"), from a table that names a preset and changes some of its values
    (``{"name": "reference", "timestep_s": 0.001}``), or as ``Physics(timestep_s=0.001)``, which changes ``pallet``.
    """

    cone: Cone = Field(Cone.ELLIPTIC, description="friction cone")
    carrier_friction: Friction = Field((0.5, 0.005, 0.0001), description="friction of the carrier")
    box_friction: Friction = Field((0.5, 0.005, 0.0001), description="friction of boxes")
    floor_friction: Friction = Field((1.0, 0.005, 0.0001), description="friction of the floor")
    floor_z_m: Annotated[float, within(-20, 0)] = Field(
        -0.144, lt=0, description="height of the floor: a pallet's height below z = 0"
    )
    carrier_half_height_m: Annotated[float, within(0.001, 10)] = Field(
        0.072, gt=0, description="half the carrier's height"
    )
    carrier_mass_kg: Annotated[float, within(0.001, 100_000)] = Field(25.0, gt=0, description="the carrier's mass")
    timestep_s: Annotated[float, within(SHORTEST_TIMESTEP_S, 0.02)] = Field(0.002, gt=0, description="length of a step")
    gravity_m_s2: Annotated[float, within(0.001, 100)] = Field(9.81, gt=0, description="gravity, downwards")
    solref: Annotated[tuple[float, float], AfterValidator(_contact_times)] = Field(
        (0.02, 1.25), description="MuJoCo's time constant and damping ratio of contacts"
    )
    solreffriction: Annotated[tuple[float, float], AfterValidator(_contact_times)] = Field(
        (0.004, 1.0),
        description="MuJoCo's solref of friction, with elliptic cones; 0, 0: that of contacts",
    )
    solimp: Annotated[Triple, AfterValidator(_impedances)] = Field(
        (0.1, 0.999, 0.0001), description="MuJoCo's impedances of contacts and their width, m"
    )
    impratio: Annotated[float, within(1, 10_000)] = Field(
        100.0, description="MuJoCo's impratio: how much stiffer friction is than pressure, with elliptic cones"
    )
    skin_m: Annotated[float, within(0, 0.001)] = Field(
        0.0001,
        description="by how much boxes are enlarged on each side for the collider, which then prefers faces to "
        "edges, m; the carrier is enlarged by twice that; contacts of faces still begin where the boxes "
        "themselves touch",
    )
    falls_into_place: bool = Field(
        False,
        description="whether boxes are released above their place, by size_reduction_mm at least, and fall into it; "
        "else they are released as they will rest",
    )

    @property
    def carrier_skin_m(self) -> float:
        """By how much the carrier is larger for the collider, m: more than boxes, so that the faces of those that stand
        flush with its edge end within its face, and the collider finds their corners (docs/validation.md)."""
        return 2 * self.skin_m

    @property
    def has_own_friction(self) -> bool:
        """Whether friction has a time constant of its own. Only the friction of elliptic cones can have one."""
        return self.cone is Cone.ELLIPTIC and any(self.solreffriction)

    @computed_field(description="name of the preset that has these values, or custom")  # type: ignore[prop-decorator]  # pydantic's own way
    @property
    def name(self) -> str:
        """The preset that has exactly these values, or "custom"."""
        return next((name for name, preset in PHYSICS.items() if preset == self), CUSTOM)

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, values: Any) -> Any:
        """Accept a preset's name, or a table that changes a preset."""
        if values == CUSTOM:  # without a table it says nothing
            raise ValueError(f"must be {' or '.join(PHYSICS)}, or a table of values, {got(values)}")
        if isinstance(values, str):
            values = {"name": values}
        if not isinstance(values, Mapping) or "name" not in values:
            return values
        changes = dict(values)
        name = changes.pop("name")
        if name not in (*PHYSICS, CUSTOM):
            raise ValueError(f"must be {' or '.join(PHYSICS)}, or a table of values, {got(name)}")
        preset = {} if name == CUSTOM else PHYSICS[name].model_dump(exclude={"name"})
        return preset | changes


PHYSICS: dict[str, Physics] = {}
PHYSICS["pallet"] = Physics()
PHYSICS["reference"] = Physics(
    cone=Cone.PYRAMIDAL,
    carrier_friction=(3.0, 0.005, 0.0001),
    solref=(0.02, 1.0),
    solreffriction=(0.0, 0.0),
    solimp=(0.99, 0.99, 0.01),
    impratio=1.0,
    skin_m=0.0,
    falls_into_place=True,
)
"""The presets. ``reference`` is PET-Physics. ``pallet`` has contacts in which pallets rest (docs/validation.md):
elliptic cones, an impedance that rises from 0.1 to 0.999 within 0.1 mm, friction that gives way 250 times less than
with MuJoCo's own values; and the friction of cardboard on a wooden pallet (CTU Code, Annex 7, Appendix 2)."""


class Thresholds(Checked):
    """Limits beyond which a plan is unstable, and a simulation invalid (PET-Physics paper, section IV-C)."""

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


class Quiet(Checked):
    """When a pallet is quiet enough for the next box, and when a world rests.

    The rules, to the step: docs/rules.md, section 5. In short: a pallet is quiet when all boxes were slower than
    ``quiet_m_s`` for ``steps`` steps. A box is as fast as its fastest point.

    With elliptic cones each box must also be slow or have slowed down then, and one that moves must not have become
    faster, as a box does that begins to topple. A box for which this does not hold creeps. Once a box has crossed a
    threshold, the result of the creep is known, so it is not waited for.

    A world rests if no point of any box moved faster than ``still_m_s`` in the last ``still_steps`` of its rest window.
    """

    quiet_m_s: Annotated[float, within(0, 100)] = Field(
        0.01, gt=0, description="speed of a box's fastest point below which it is quiet, m/s"
    )
    slow_m_s: Annotated[float, within(0, 100)] = Field(
        0.001, ge=0, description="speed of a box's fastest point below which it is slow, m/s"
    )
    slowing: Annotated[float, within(0, 1000)] = Field(
        0.5, ge=0, description="a box that is not slow creeps unless it slows to this share of its speed"
    )
    steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        25, ge=1, description="steps for which all boxes must have been quiet"
    )
    min_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        50, ge=1, description="steps after a placement before which no pallet is quiet"
    )
    poll_steps: Annotated[int, within(1, MOST_STEPS)] = Field(5, ge=1, description="steps between two checks")
    still_m_s: Annotated[float, within(0, 100)] = Field(
        0.0001, ge=0, description="speed of a box's fastest point up to which it is still, m/s"
    )
    still_steps: Annotated[int, within(1, MOST_STEPS)] = Field(
        50, ge=1, description="steps before a world's end for which all boxes must have been still"
    )


class Simulation(Checked):
    """Everything that the outcome of a world depends on, except its plan and its variant."""

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
        "(PET-Physics's), rollcontainer-grid, or your own, FILE.toml",
    )
    friction_pairs: tuple[FrictionPair, ...] = Field(
        (),
        max_length=100,
        description="friction between materials of boxes and boards, beside the table that petmjx has: tables with "
        "between, a list of two materials, and friction",
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
        1.0, ge=0, description="time to come to rest after a profile's last sample, s"
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
        True, description="stop a world once a box has dropped, instead of going on to the end of the schedule"
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
        description="soft: simulate worlds once more with all boxes as flex bodies that are invalid after all other "
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
        if value == "brisk":  # of petmjx 0.1
            raise ValueError(
                "must be 'fixed' or 'adaptive': 'brisk' was removed, since adaptive now takes as few steps"
            )
        return value

    @field_validator("friction_pairs")
    @classmethod
    def _each_pair_once(cls, value: tuple[FrictionPair, ...]) -> tuple[FrictionPair, ...]:
        keys = [pair.key for pair in value]
        for at, key in enumerate(keys):
            if key in keys[:at]:
                raise complaint(f"is about the same materials as friction_pairs[{keys.index(key)}]", at)
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
    def _placed_one_by_one(self) -> Self:
        way = self.placing.name
        if not self.placing.appears and self.check is Check.STATIC:
            raise complaint(
                f"{way} needs check one-by-one: in a static check all boxes stand from the start", "placing"
            )
        if self.placing.carries and self.schedule is Schedule.FIXED:
            raise complaint(
                f"{way} needs schedule adaptive: a fixed one does not wait until a box is let go", "placing"
            )
        return self

    @model_validator(mode="after")
    def _soft_boxes_appear(self) -> Self:
        for name, asked in (("soft", self.soft), ("attempts", self.attempts is Attempts.SOFT)):
            if asked and self.placing.name not in (Way.AUTO, Way.EXACT):
                raise complaint(
                    f"needs placing exact: soft boxes appear at their places, got {self.placing.name}", name
                )
        return self

    @property
    def has_soft(self) -> bool:
        """Whether boxes may be flex bodies."""
        return self.soft or self.attempts is Attempts.SOFT

    @property
    def may_carry(self) -> bool:
        """Whether a hand may place boxes. Where nobody has chosen one, not in physics in which boxes fall
        into their places, nor where nobody waits for a hand."""
        if self.placing.name is not Way.AUTO:
            return self.placing.carries
        waits = self.check is Check.ONE_BY_ONE and self.schedule is Schedule.ADAPTIVE
        return waits and not self.physics.falls_into_place

    @property
    def waits_for_rest(self) -> bool:
        """Whether what follows waits for boxes that creep: the next box (schedule adaptive), a profile, and the end.

        Not with pyramidal cones: there every box creeps a little (docs/performance.md).
        """
        return self.physics.cone is Cone.ELLIPTIC
