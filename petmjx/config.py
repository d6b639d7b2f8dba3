"""What a run does, in frozen, validated records that are written beside the results.

Every number of the world model is here, with its unit in the name and its source in the docstring.
"""

from __future__ import annotations

from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


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


class Physics(_Frozen):
    """The contact world. Friction triples are MuJoCo's sliding / torsional / rolling coefficients.

    Numbers are the reference implementation's (PET-Physics); boxes slide on boxes at 0.5 after the CTU
    Code (cardboard on cardboard). ``floor_z_m`` is minus a pallet's height.
    """

    name: str
    cone: Cone
    carrier_friction: Triple
    box_friction: Triple = (0.5, 0.005, 0.0001)
    floor_friction: Triple = (1.0, 0.005, 0.0001)
    floor_z_m: float = -0.144
    carrier_half_height_m: float = 0.072
    carrier_mass_kg: float = 25.0
    timestep_s: float = 0.002
    gravity_m_s2: float = 9.81
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: Triple = (0.99, 0.99, 0.01)


PHYSICS: dict[str, Physics] = {
    "pallet": Physics(name="pallet", cone=Cone.ELLIPTIC, carrier_friction=(0.5, 0.005, 0.0001)),
    "reference": Physics(name="reference", cone=Cone.PYRAMIDAL, carrier_friction=(3.0, 0.005, 0.0001)),
}
"""The presets. ``reference`` is PET-Physics; ``pallet`` has elliptic cones, which do not creep, and the
friction of cardboard on a wooden pallet (CTU Code, Annex 7, Appendix 2)."""


class Thresholds(_Frozen):
    """Where a plan stops being stable, and a simulation stops being believable (paper, section IV-C)."""

    shift_m: float = Field(0.02, gt=0, description="largest final |x|, |y| or |z| displacement of a box")
    shift_floor_m: float = Field(0.001, ge=0, description="components below this count as 0")
    tilt_deg: float = Field(20.0, gt=0, description="largest angle between a box's z axis and the world's")
    drop_hull_z_m: float = Field(-0.1, description="a box whose hull reaches below this has dropped")
    lin_acc_m_s2: float = Field(110.0, gt=0, description="explosion: linear acceleration before any sign")
    ang_acc_rad_s2: float = Field(110.0, gt=0, description="explosion: angular acceleration before any sign")


class Quiet(_Frozen):
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

    lin_vel_m_s: float = 0.01
    ang_vel_rad_s: float = 0.05
    rest_share: float = Field(0.1, ge=0, description="pace below which a box is at rest")
    slowing: float = Field(0.5, ge=0, description="a faster box creeps unless it slows to this share of its pace")
    steps: int = 25
    min_steps: int = 50
    poll_steps: int = 5


class SimConfig(_Frozen):
    """Everything the outcome of a world depends on besides its scene."""

    physics: Physics = PHYSICS["pallet"]
    check: Check = Check.ONE_BY_ONE
    schedule: Schedule = Schedule.ADAPTIVE
    interval_s: float = Field(0.7, gt=0, description="time between two placements; at most, unless fixed")
    duration_s: float = Field(10.0, gt=0, description="length of the static check")
    sample_interval_s: float = Field(0.2, gt=0, description="time between two samples of the metrics")
    rest_window_s: float = Field(0.2, gt=0, description="rest_top_force_n is averaged over this at the end")
    early_stop: bool = Field(True, description="stop a world once a box has dropped")
    thresholds: Thresholds = Thresholds()
    quiet: Quiet = Quiet()
    solver: Solver = Solver.NEWTON
    solver_iterations: int | None = Field(
        None, gt=0, description="most iterations a step; None: the engine's own choice"
    )
    solver_tolerance: float | None = Field(
        None, gt=0, description="MuJoCo's opt.tolerance; None: the engine's own choice"
    )
    settle_s: float = Field(2.0, ge=0, description="rest between the last placement and a force profile")

    @property
    def waits_for_creep(self) -> bool:
        """Whether boxes that creep hold up the next one.

        Not with pyramidal cones: there everything creeps a little, and waiting for it brought next to nothing
        (benchmarks/README.md).
        """
        return self.schedule is Schedule.ADAPTIVE and self.physics.cone is Cone.ELLIPTIC


SOFT_START_STEPS = 100
"""Steps without gravity, and again steps in which gravity grows by k/100, before time counts."""
