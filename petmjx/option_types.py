"""The options of ``petmjx.score`` and ``petmjx.sweep`` for type checkers: their names, and what each takes.

Written by ``make options`` (tools/option_types.py) from the records in petmjx/config.py and petmjx/run_options.py,
which check the values and say what they mean. Do not edit.
"""

from __future__ import annotations

from os import PathLike
from typing import Literal, TypedDict

from petmjx.config import Carrier, Check, Cone, Physics, Quiet, Schedule, Solver, Thresholds
from petmjx.engines.base import Simulates

EngineName = Literal[
    "auto",
    "mujoco",
    "mjx-jax",
    "mjx-warp",
]
PhysicsName = Literal[
    "pallet",
    "reference",
]
CarrierName = Literal[
    "footprint",
    "euro-pallet",
    "rollcontainer",
    "epal-1",
    "gma-48x40",
    "pet-eur",
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
SolverName = Literal[
    "newton",
    "cg",
]


class PhysicsTable(TypedDict, total=False):
    """Fields of ``petmjx.Physics`` that change."""

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
    skin_m: float
    falls_into_place: bool


class ThresholdsTable(TypedDict, total=False):
    """Fields of ``petmjx.Thresholds`` that change."""

    shift_m: float
    shift_floor_m: float
    tilt_deg: float
    drop_hull_z_m: float
    lin_acc_m_s2: float
    ang_acc_rad_s2: float


class QuietTable(TypedDict, total=False):
    """Fields of ``petmjx.Quiet`` that change."""

    quiet_m_s: float
    slow_m_s: float
    slowing: float
    steps: int
    min_steps: int
    poll_steps: int
    still_m_s: float
    still_steps: int


class SimulationOptions(TypedDict, total=False):
    """Fields of ``petmjx.config.Simulation``."""

    check: Check | CheckName
    schedule: Schedule | ScheduleName
    physics: Physics | PhysicsTable | PhysicsName
    carrier: Carrier | CarrierName
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
    thresholds: Thresholds | ThresholdsTable
    quiet: Quiet | QuietTable
    solver: Solver | SolverName
    solver_iterations: int | None
    solver_tolerance: float | None


class ConfidenceOptions(TypedDict, total=False):
    """Fields of ``petmjx.run_options.Confidence``."""

    confidence: int | None
    errors: str | PathLike[str] | None


class RunOptionsGiven(TypedDict, total=False):
    """Fields of ``petmjx.run_options.RunOptions``."""

    engine: EngineName | Simulates
    threads: int | None
    lanes: int | None
    world_timeout_s: float | None
    workers: int | str | None
    ray: str | None
    limit: int | None
    units: str
    anchor: Literal["corner", "centre", "base-centre", "far-corner"]
    record: str | tuple[str, ...] | list[str] | None
    record_interval_s: float
    record_details: bool
    force_intervals: bool
    orders: str | PathLike[str] | None
    strict: bool
    allow_large: bool
    out: str | PathLike[str] | None
    overwrite: bool
    resume: bool
    shard: str | None


class ScoreOptions(SimulationOptions, ConfidenceOptions, RunOptionsGiven, total=False):
    """The options of ``petmjx.score``."""


class SweepOptions(SimulationOptions, RunOptionsGiven, total=False):
    """The options of ``petmjx.sweep``."""
