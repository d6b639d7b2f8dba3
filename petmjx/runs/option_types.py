"""The options of ``petmjx.score`` and ``petmjx.sweep`` for type checkers: their names and types.

Written by ``make options`` (tools/option_types.py) from the records in petmjx/options. These records check the values
of options and state their meanings. Do not edit.
"""

from __future__ import annotations

from os import PathLike
from typing import Literal, TypedDict

from petmjx.engines.protocol import MinimalEngine
from petmjx.options.carriers import Board, Carrier, OwnCarrier
from petmjx.options.materials import FrictionPair, LandingPair
from petmjx.options.physics import Cone, Physics
from petmjx.options.placing import Placing, Way
from petmjx.options.quiet import Quiet
from petmjx.options.simulation import Attempts, Check, Schedule, Solver
from petmjx.options.thresholds import Thresholds
from petmjx.options.walls import Side, Walls
from petmjx.options.wrap import Wrap

EngineName = Literal[
    "auto",
    "mujoco",
    "mjx-jax",
    "mjx-warp",
    "mjx-warp-cpu",
]
PhysicsName = Literal[
    "pallet",
    "reference",
]
AnchorName = Literal[
    "corner",
    "centre",
    "base-centre",
    "far-corner",
    "top-centre",
    "corner-x",
    "corner-y",
    "corner-xy",
    "corner-z",
    "corner-xz",
    "corner-yz",
]
AttemptsName = Literal[
    "rigid",
    "soft",
]
CarrierName = Literal[
    "footprint",
    "euro-pallet",
    "rollcontainer",
    "epal-1",
    "gma-48x40",
    "pet-eur",
    "rollcontainer-grid",
    "rollcontainer-2",
    "rollcontainer-3",
    "rollcontainer-4",
    "gitterbox",
    "container-20ft",
    "trailer",
]
CheckName = Literal[
    "one-by-one",
    "static",
]
ConeName = Literal[
    "pyramidal",
    "elliptic",
]
ScheduleName = Literal[
    "fixed",
    "adaptive",
]
SideName = Literal[
    "left",
    "right",
    "front",
    "back",
]
SolverName = Literal[
    "newton",
    "cg",
]
WayName = Literal[
    "auto",
    "exact",
    "drop",
    "hand",
    "tines",
]


class PhysicsTable(TypedDict, total=False):
    """Fields of ``petmjx.options.physics.Physics``."""

    name: PhysicsName | Literal["custom"]
    cone: Cone | ConeName
    carrier_friction: tuple[float, float, float] | list[float]
    box_friction: tuple[float, float, float] | list[float]
    floor_friction: tuple[float, float, float] | list[float]
    floor_z_m: float
    carrier_half_height_m: float
    carrier_mass_kg: float
    timestep_s: float
    gravity_m_s2: float
    solref: tuple[float, float] | list[float]
    solreffriction: tuple[float, float] | list[float]
    solimp: tuple[float, float, float] | list[float]
    impratio: float
    slip_correction: bool
    kinetic_friction_share: float
    landing_s: float
    restitution: float
    skin_m: float
    falls_into_place: bool


class ThresholdsTable(TypedDict, total=False):
    """Fields of ``petmjx.options.thresholds.Thresholds``."""

    shift_m: float
    shift_floor_m: float
    tilt_deg: float
    drop_hull_z_m: float
    lin_acc_m_s2: float
    ang_acc_rad_s2: float


class QuietTable(TypedDict, total=False):
    """Fields of ``petmjx.options.quiet.Quiet``."""

    quiet_m_s: float
    slow_m_s: float
    slowing: float
    steps: int
    landing_steps: int
    poll_steps: int
    still_m_s: float
    still_steps: int
    tremble_steps: int
    tremble_share: float


class PlacingTable(TypedDict, total=False):
    """Fields of ``petmjx.options.placing.Placing``."""

    name: Way | WayName
    height_mm: float
    side_mm: float
    speed_m_s: float
    force_n: float
    tines_mm: float


class WrapTable(TypedDict, total=False):
    """Fields of ``petmjx.options.wrap.Wrap``."""

    turns: float
    force_n: float
    film_mm: float
    friction: float
    hat_n: float


class WallsTable(TypedDict, total=False):
    """Fields of ``petmjx.options.walls.Walls``."""

    sides: tuple[Side | SideName, ...] | list[Side | SideName] | None
    open: tuple[Side | SideName, ...] | list[Side | SideName]
    height_mm: float | None
    gap_mm: float | None
    thickness_mm: float | None
    mass_kg_m2: float | None
    friction: float | None
    material: str | None


class OwnCarrierTable(TypedDict, total=False):
    """Fields of ``petmjx.options.carriers.OwnCarrier``."""

    name: str
    mass_kg: float | None
    friction: float | None
    material: str
    walls: Walls | WallsTable | tuple[Side | SideName, ...] | list[Side | SideName] | str
    boards: tuple[Board | BoardTable, ...] | list[Board | BoardTable]


class BoardTable(TypedDict, total=False):
    """Fields of ``petmjx.options.carriers.Board``."""

    name: str
    corner_mm: tuple[float, float, float] | list[float]
    size_mm: tuple[float, float, float] | list[float]
    mass_kg: float | None
    friction: float | None
    material: str


class FrictionPairTable(TypedDict, total=False):
    """Fields of ``petmjx.options.materials.FrictionPair``."""

    between: tuple[str, str] | list[str]
    friction: float
    kinetic: float | None


class LandingPairTable(TypedDict, total=False):
    """Fields of ``petmjx.options.materials.LandingPair``."""

    between: tuple[str, str] | list[str]
    restitution: float | None
    landing_s: float | None


class SimulationOptions(TypedDict, total=False):
    """Fields of ``petmjx.options.simulation.Simulation``."""

    check: Check | CheckName
    schedule: Schedule | ScheduleName
    physics: Physics | PhysicsTable | PhysicsName
    carrier: Carrier | CarrierName | OwnCarrier | OwnCarrierTable | str | PathLike[str]
    walls: Walls | WallsTable | tuple[Side | SideName, ...] | list[Side | SideName] | str
    friction_pairs: tuple[FrictionPair | FrictionPairTable, ...] | list[FrictionPair | FrictionPairTable]
    landing_pairs: tuple[LandingPair | LandingPairTable, ...] | list[LandingPair | LandingPairTable]
    size_reduction_mm: float
    interval_s: float
    longest_wait_s: float
    duration_s: float
    settle_s: float
    rest_s: float
    total_time_factor: float | None
    sample_interval_s: float
    rest_window_s: float
    early_stop: bool
    check_timestep: bool
    soft: bool
    attempts: Attempts | AttemptsName
    placing: Placing | PlacingTable | Way | WayName
    wrap: Wrap | WrapTable
    thresholds: Thresholds | ThresholdsTable
    quiet: Quiet | QuietTable
    solver: Solver | SolverName
    solver_iterations: int | None
    iteration_limit: int | None
    solver_tolerance: float | None


class ConfidenceOptions(TypedDict, total=False):
    """Fields of ``petmjx.options.confidence.Confidence``."""

    confidence: int | None
    errors: str | PathLike[str] | None
    exact_too: bool


class TransportOptions(TypedDict, total=False):
    """Fields of ``petmjx.options.transport.Transport``."""

    chain: str | PathLike[str] | None


class RunOptionsGiven(TypedDict, total=False):
    """Fields of ``petmjx.options.run_options.RunOptions``."""

    engine: EngineName | MinimalEngine
    threads: int | None
    lanes: int | None
    world_timeout_s: float | None
    workers: int | str | None
    ray: str | None
    limit: int | None
    units: str | None
    anchor: AnchorName | None
    up: Literal["x", "y", "z"] | None
    sizes: Literal["placed", "item"] | None
    columns: dict[str, str] | str | None
    density: float | None
    items: str | PathLike[str] | None
    reading: str | PathLike[str] | None
    articles: str | PathLike[str] | None
    record: str | tuple[str, ...] | list[str] | None
    record_interval_s: float
    record_details: bool
    force_intervals: bool
    keep: Literal["all", "worlds"]
    orders: str | PathLike[str] | None
    strict: bool
    allow_large: bool
    out: str | PathLike[str] | None
    overwrite: bool
    resume: bool
    shard: str | None


class ScoreOptions(SimulationOptions, ConfidenceOptions, TransportOptions, RunOptionsGiven, total=False):
    """The options of ``petmjx.score``."""


class SweepOptions(SimulationOptions, RunOptionsGiven, total=False):
    """The options of ``petmjx.sweep``."""
