"""Every option, said once: what results depend on (``Simulation``), how and where a run runs (``RunOptions``).

Defaults, units, checks and descriptions stand here alone. ``petmjx.score`` and ``petmjx.sweep``, the command line and
the ``[simulation]`` table of sweep files are made from these records, and they are written beside the results.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, Field, computed_field, field_validator, model_validator

from petmjx.checked import Checked, complaint, got, hint
from petmjx.errors import InputError

SOFT_START_STEPS: Final = 100
"""Steps without gravity, and again steps in which gravity grows by k/100, before time counts."""


@dataclass(frozen=True)
class Flag:
    """How a field is called on the command line.

    Attributes:
        metavar: what stands for its value in the help there.
        default: what the help says of a default that is None there.
    """

    name: str
    metavar: str = "NAME"
    short: str = ""
    default: str = ""


class Check(StrEnum):
    """How boxes come to stand on the carrier."""

    ONE_BY_ONE = "one-by-one"
    STATIC = "static"


class Schedule(StrEnum):
    """When the next box is placed.

    ``fixed``: at fixed times. ``adaptive``: as soon as the pallet is quiet and no box creeps. ``brisk``: as soon as it
    is quiet, creeping or not; with pyramidal cones, which creep by themselves, ``adaptive`` is the same.
    """

    FIXED = "fixed"
    ADAPTIVE = "adaptive"
    BRISK = "brisk"


class Cone(StrEnum):
    """Friction cone of the contact model."""

    PYRAMIDAL = "pyramidal"
    ELLIPTIC = "elliptic"


class Solver(StrEnum):
    """Constraint solver; the retry procedure goes through them in order."""

    NEWTON = "newton"
    CG = "cg"


class Carrier(StrEnum):
    """What the boxes stand on."""

    FOOTPRINT = "footprint"
    EURO_PALLET = "euro-pallet"
    ROLLCONTAINER = "rollcontainer"


CARRIER_EXTENT_M: dict[Carrier, tuple[float, float] | None] = {
    Carrier.FOOTPRINT: None,
    Carrier.EURO_PALLET: (1.2, 0.8),
    Carrier.ROLLCONTAINER: (0.8, 0.7),
}
"""x–y extent of each carrier in metres (BED-BPP's two targets); None: the plan's own bounding box."""

Triple = tuple[float, float, float]


def _no_negatives(values: Triple) -> Triple:
    if min(values) < 0:
        raise ValueError(f"must be ≥ 0, got {values}")
    return values


def _impedances(values: Triple) -> Triple:
    if not (0 < values[0] < 1 and 0 < values[1] < 1 and values[2] > 0):
        raise ValueError(f"must be two impedances between 0 and 1 and a width > 0 m, got {values}")
    return values


Friction = Annotated[Triple, AfterValidator(_no_negatives)]
"""MuJoCo's sliding, torsional and rolling coefficients of a geom; of two partners the larger ones count."""

CUSTOM: Final = "custom"


class Physics(Checked):
    """The contact world.

    Numbers are the reference implementation's (PET-Physics), but for the cone and the carrier's friction, which are the
    preset's. Boxes slide on boxes at 0.5 after the CTU Code (cardboard on cardboard, Annex 7, Appendix 2).

    Made from a preset's name ("pallet"), from a table that names one and changes some of its values
    (``{"name": "reference", "timestep_s": 0.001}``), or as ``Physics(timestep_s=0.001)``, which changes ``pallet``.
    """

    cone: Cone = Field(Cone.ELLIPTIC, description="friction cone")
    carrier_friction: Friction = Field((0.5, 0.005, 0.0001), description="friction of the carrier")
    box_friction: Friction = Field((0.5, 0.005, 0.0001), description="friction of boxes")
    floor_friction: Friction = Field((1.0, 0.005, 0.0001), description="friction of the floor")
    floor_z_m: float = Field(-0.144, lt=0, description="height of the floor: a pallet's height below z = 0")
    carrier_half_height_m: float = Field(0.072, gt=0, description="half the carrier's height")
    carrier_mass_kg: float = Field(25.0, gt=0, description="the carrier's mass")
    timestep_s: float = Field(0.002, gt=0, le=0.02, description="length of a step")
    gravity_m_s2: float = Field(9.81, gt=0, le=100, description="gravity, downwards")
    solref: tuple[float, float] = Field((0.02, 1.0), description="MuJoCo's time constant and damping ratio of contacts")
    solimp: Annotated[Triple, AfterValidator(_impedances)] = Field(
        (0.99, 0.99, 0.01), description="MuJoCo's impedances of contacts and their width, m"
    )

    @computed_field(description="the preset that these values are, or custom")  # type: ignore[prop-decorator]
    @property
    def name(self) -> str:
        """The preset that these values are, or "custom"."""
        return next((name for name, preset in PHYSICS.items() if preset == self), CUSTOM)

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, values: Any) -> Any:
        """A preset by name, or a preset with changes."""
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
PHYSICS["reference"] = Physics(cone=Cone.PYRAMIDAL, carrier_friction=(3.0, 0.005, 0.0001))
"""The presets. ``reference`` is PET-Physics; ``pallet`` has elliptic cones, which creep less, and the friction of
cardboard on a wooden pallet (CTU Code, Annex 7, Appendix 2)."""


class Thresholds(Checked):
    """Where a plan stops being stable, and a simulation stops being believable (paper, section IV-C)."""

    shift_m: Annotated[float, Flag("--shift-limit-m", "M")] = Field(
        0.02, gt=0, description="unstable from a larger final displacement of a box in x, y or z, m"
    )
    shift_floor_m: float = Field(0.001, ge=0, description="components of a displacement below this count as 0, m")
    tilt_deg: Annotated[float, Flag("--tilt-limit-deg", "DEG")] = Field(
        20.0, gt=0, description="unstable from a larger angle between a box's z axis and the world's, degrees"
    )
    drop_hull_z_m: float = Field(-0.1, description="a box whose hull reaches below this has dropped, m")
    lin_acc_m_s2: float = Field(110.0, gt=0, description="explosion: linear acceleration before any sign, m/s²")
    ang_acc_rad_s2: float = Field(110.0, gt=0, description="explosion: angular acceleration before any sign, rad/s²")


class Quiet(Checked):
    """When a pallet is quiet enough for the next box.

    A box's pace is its linear or angular speed in units of its limit, whichever is larger. Pallets are looked at every
    ``poll_steps``. Quiet is a pallet, on either schedule, whose paces have all been below 1 for ``steps`` on end, and
    not before ``min_steps`` after a placement.

    On the adaptive schedule with elliptic cones each box must also be at rest at the end of those steps (its pace below
    ``rest_share``) or have slowed to ``slowing`` times its pace at their begin; otherwise the count begins anew. What
    neither comes to rest nor slows down creeps: over a fixed schedule's half minute 1 mm/s, a tenth of the limit, is
    more than a shift of 20 mm. It is given the whole interval, as the fixed schedule gives it. Once a box has crossed a
    threshold, where creep leads to is known, and it holds nothing up any more.
    """

    lin_vel_m_s: float = Field(0.01, gt=0, description="linear speed below which a box is quiet, m/s")
    ang_vel_rad_s: float = Field(0.05, gt=0, description="angular speed below which a box is quiet, rad/s")
    rest_share: float = Field(0.1, ge=0, description="pace below which a box is at rest")
    slowing: float = Field(0.5, ge=0, description="a faster box creeps unless it slows to this share of its pace")
    steps: int = Field(25, ge=1, description="steps for which all boxes must have been quiet")
    min_steps: int = Field(50, ge=1, description="steps after a placement before which no pallet is quiet")
    poll_steps: int = Field(5, ge=1, description="steps between two looks")


class Simulation(Checked):
    """Everything that the outcome of a world depends on besides its plan and its variant."""

    check: Annotated[Check, Flag("--check")] = Field(
        Check.ONE_BY_ONE,
        description="how boxes come to stand: one-by-one: box after box; static: all from the start",
    )
    schedule: Annotated[Schedule, Flag("--schedule")] = Field(
        Schedule.ADAPTIVE,
        description="when the next box is placed: adaptive: as soon as the pallet is quiet and nothing creeps; "
        "brisk: as soon as it is quiet, creeping or not; fixed: every interval",
    )
    physics: Annotated[Physics, Flag("--physics")] = Field(
        PHYSICS["pallet"],
        description="contact physics: pallet: elliptic friction cones, a wooden pallet; reference: as in PET-Physics",
    )
    carrier: Annotated[Carrier, Flag("--carrier")] = Field(
        Carrier.FOOTPRINT,
        description="what the boxes stand on: footprint: the plan's own extent; euro-pallet: 1200×800 mm; "
        "rollcontainer: 800×700 mm (x × y)",
    )
    size_reduction_mm: Annotated[float, Flag("--size-reduction-mm", "MM")] = Field(
        0.1, ge=0, description="each box dimension is reduced by this, so that neighbours do not start in contact, mm"
    )
    interval_s: Annotated[float, Flag("--interval", "S")] = Field(
        0.7, gt=0, description="time between two placements, s; the longest unless the schedule is fixed"
    )
    duration_s: Annotated[float, Flag("--duration", "S")] = Field(
        10.0, gt=0, description="length of the static check, s"
    )
    settle_s: Annotated[float, Flag("--settle", "S")] = Field(
        2.0, ge=0, description="rest between the last placement and a profile, s; the longest unless fixed"
    )
    rest_s: Annotated[float, Flag("--rest", "S")] = Field(
        1.0, ge=0, description="time to come to rest after a profile's last sample, s"
    )
    total_time_factor: float | None = Field(
        None,
        gt=1,
        description="fixed, one by one: the whole run as a multiple of the placement time, instead of rest_s",
    )
    sample_interval_s: Annotated[float, Flag("--sample-interval", "S")] = Field(
        0.2, gt=0, description="time between two samples of the metrics, s"
    )
    rest_window_s: float = Field(0.2, gt=0, description="rest_top_force_n is averaged over this at the end, s")
    early_stop: Annotated[bool, Flag("--early-stop/--no-early-stop")] = Field(
        True, description="stop a world once a box has dropped, instead of going on to the end of the schedule"
    )
    thresholds: Thresholds = Field(Thresholds(), description="where a plan stops being stable")
    quiet: Quiet = Field(Quiet(), description="when a pallet is quiet enough for the next box")
    solver: Annotated[Solver, Flag("--solver")] = Field(
        Solver.NEWTON, description="constraint solver of the first attempt"
    )
    solver_iterations: int | None = Field(
        None, gt=0, description="most solver iterations a step; none: the engine's own choice"
    )
    solver_tolerance: float | None = Field(
        None, gt=0, description="MuJoCo's opt.tolerance; none: the engine's own choice"
    )

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

    @property
    def waits_for_creep(self) -> bool:
        """Whether boxes that creep hold up the next one.

        Not with pyramidal cones: there everything creeps a little, and waiting for it brought next to nothing
        (docs/performance.md).
        """
        return self.schedule is Schedule.ADAPTIVE and self.physics.cone is Cone.ELLIPTIC


AUTO: Final = "auto"


def _share(text: str | None) -> str | None:
    """I/N with 1 ≤ I ≤ N."""
    if text is None:
        return None
    found = re.fullmatch(r"0*(\d{1,9})/0*(\d{1,9})", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise ValueError(f"must be I/N with 1 ≤ I ≤ N, such as 3/16, {got(text)}")
    return f"{found[1]}/{found[2]}"


class RunOptions(Checked):
    """How and where a run runs: none of it changes the outcome of a world."""

    engine: Annotated[Any, Flag("--engine")] = Field(
        AUTO,
        description="what steps worlds: mujoco: C MuJoCo on CPU threads; mjx-jax, mjx-warp: MJX in batches; auto: "
        "mjx-warp where it runs and is expected to finish first, else mujoco; in Python also an engine of your own",
    )
    threads: Annotated[int | None, Flag("--threads", "N")] = Field(
        None, ge=1, description="CPU threads of the engine mujoco; by default all that this process may use"
    )
    lanes: Annotated[int | None, Flag("--lanes", "N")] = Field(
        None, ge=1, description="worlds at once of the MJX engines; by default chosen from the device's memory"
    )
    limit: Annotated[int | None, Flag("--limit", "N")] = Field(None, ge=1, description="take only this many plans")
    strict: Annotated[bool, Flag("--strict")] = Field(
        False, description="stop at the first unusable plan instead of skipping it"
    )
    allow_large: Annotated[bool, Flag("--yes", short="-y")] = Field(
        False, description="run sweeps of more than a million worlds too"
    )
    out: Annotated[Path | None, Flag("--out", "DIR", "-o", default="petmjx-results/DATE-TIME")] = Field(
        None,
        description="folder for the results; in Python by default a temporary one that goes with what is returned",
    )
    overwrite: Annotated[bool, Flag("--overwrite")] = Field(
        False, description="replace the results that the folder holds"
    )
    resume: Annotated[bool, Flag("--resume")] = Field(
        False,
        description="go on with the run that the folder holds: simulate what is missing of it; begin if it holds none",
    )
    shard: Annotated[str | None, AfterValidator(_share), Flag("--shard", "I/N")] = Field(
        None, description="take only the I-th of N shares of the plans, I from 1; petmjx merge joins the results"
    )

    @model_validator(mode="after")
    def _folder_is_named(self) -> Self:
        if self.resume and self.out is None:
            raise complaint("needs out: which run is to go on?", "resume")
        if self.resume and self.overwrite:
            raise complaint("contradicts overwrite: drop one of them", "resume")
        return self

    def takes(self, plan_id: str) -> bool:
        """Whether a plan is in this run's shard. That depends on its id alone, so that all its worlds stay together."""
        if self.shard is None:
            return True
        share, shares = (int(number) for number in self.shard.split("/"))
        digest = hashlib.blake2b(plan_id.encode("utf-8", "backslashreplace"), digest_size=8).digest()
        return int.from_bytes(digest, "big") % shares == share - 1


def sorted_options(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options by name, as fields of ``Simulation`` and fields of ``RunOptions``.

    Raises:
        InputError: no such option; the line names the one that was probably meant.
    """
    ours: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
    records: tuple[type[Checked], ...] = (Simulation, RunOptions)
    for name, value in options.items():
        home = next((i for i, record in enumerate(records) if name in record.model_fields), None)
        if home is None:
            known = [field for record in records for field in record.model_fields]
            raise InputError(f"unknown option {name}; {hint(name, known)}")
        ours[home][name] = value
    return ours
