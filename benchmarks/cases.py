"""The list of all cases (measurements). To add a case, add an entry to the list. This module simulates nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from petmjx.common.errors import InputError
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Schedule, Simulation
from petmjx.plans.bundled import bundled_path

SEED = 0
"""Seed of the generated sample plans."""

STACK_PLAN = 33
"""Number of the sample plan of ``SEED`` from which stacks are cut. It is the first strictly packed plan with at least
64 boxes; it has 67. Larger stacks are made of bricks."""

MUJOCO = "mujoco"
PLAIN_LOOP = "plain-loop"
"""The name in the field ``engine`` in results of plain loops."""


class Way(StrEnum):
    """The code whose time is measured. ``files``: ``petmjx.score`` or ``petmjx.sweep``, from the file of plans to
    Parquet files. ``engine``: only an engine, from scenes to outcomes; an engine that compiles is run once before.
    ``loop-air``, ``loop-floor``: the plain loop on one thread; boxes that wait for their placement hang in the air,
    held by a force, or stand on the floor.
    """

    FILES = "files"
    ENGINE = "engine"
    LOOP_AIR = "loop-air"
    LOOP_FLOOR = "loop-floor"


@dataclass(frozen=True)
class Case:
    """One measurement."""

    name: str
    group: str  # Cases of a group can be run together, and have one table (``benchmarks.result_tables``).
    text: str  # Meaning of the measurement, in one line.
    way: Way = Way.FILES
    count: int = 2_000  # Number of plans; with ``boxes``, of copies (0: as many as fill the engine).
    source: str = ""  # File of plans; empty: generated samples of ``SEED``. ``--plans`` replaces the file.
    boxes: int = 0  # For ``Way.ENGINE``: number of boxes of the copied stack (``STACK_PLAN``, or bricks).
    longest_first: bool = False  # Whether plans with many boxes come first, so that all threads have work at the end.
    simulation: Mapping[str, Any] = field(default_factory=dict)  # Fields of ``petmjx.Simulation``.
    sweep: str = ""  # File of a sweep, or name of a ready-made one; empty: each plan is scored once.
    only: str = ""  # The engine of this case; empty: the engines of the call.
    threads: int | None = None  # Number of CPU threads of this case; None: the number of the call.

    @property
    def sim(self) -> Simulation:
        """The simulation options of the case, with defaults for all others."""
        return Simulation(**self.simulation)


_FULL_STACK = {"check": "static", "schedule": "fixed", "duration_s": 1.0, "early_stop": False}
"""All boxes stand from the start, and every world takes the same number of steps."""

_LOOPS = {Way.LOOP_AIR: "waiting boxes in the air", Way.LOOP_FLOOR: "waiting boxes on the floor"}
_SCHEDULES = tuple(schedule.value for schedule in Schedule)
_PLACEMENT_SEEDS = str(Path(__file__).parent / "sweeps" / "placement-seeds.toml")


def _w(name: str, text: str, **simulation: str) -> Case:
    """A case with workload W: the first 2,000 plans of ``petmjx samples``."""
    return Case(name, "W", f"workload W, {text}", simulation=simulation)


_DECLARED: tuple[Case, ...] = (
    *(
        Case(f"stacks-{n}", "stacks", f"full stack of {n} boxes, static: cost of a step", Way.ENGINE, 0, boxes=n,
             simulation=_FULL_STACK)
        for n in (8, 16, 24, 32, 40, 48, 64, 128, 250)
    ),
    _w("W-adaptive", "adaptive schedule"),
    _w("W-adaptive-reference", "adaptive, physics reference", physics="reference"),
    _w("W-fixed", "fixed schedule", schedule="fixed"),
    *(
        Case(f"scale-{n}", "scale", f"{n} plans, adaptive: time a plan", count=n)
        for n in (500, 1000, 2000, 4000, 8000, 10_003)
    ),
    Case("plain-loop", "plain", f"plain Python loop over plans of W, {_LOOPS[Way.LOOP_AIR]}", Way.LOOP_AIR,
         only=PLAIN_LOOP),
    Case("plain-loop-floor", "plain", f"plain Python loop over plans of W, {_LOOPS[Way.LOOP_FLOOR]}", Way.LOOP_FLOOR,
         only=PLAIN_LOOP),
    *(
        Case(f"one-plan-{physics}-{way}", "one-plan", f"one plan, plain loop, {text}, physics {physics}", way, 1,
             simulation={"physics": physics}, only=PLAIN_LOOP)
        for physics in PHYSICS
        for way, text in _LOOPS.items()
    ),
    *(
        Case(f"one-plan-{physics}-{schedule}", "one-plan", f"one plan, engine mujoco, {schedule}, physics {physics}",
             Way.ENGINE, 1, simulation={"physics": physics, "schedule": schedule}, only=MUJOCO, threads=1)
        for physics in PHYSICS
        for schedule in _SCHEDULES
    ),
    *(
        Case(f"threads-{n}", "threads", f"16 sample plans on engine mujoco, threads: {n}", count=16,
             longest_first=True, only=MUJOCO, threads=n)
        for n in (1, 2)
    ),
    Case("eumos-100", "sweeps", "100 plans × 64 EUMOS tests from settled states: worlds per second", count=100,
         sweep="eumos"),
    Case("eumos-16", "sweeps", "16 plans × 64 EUMOS tests: verdicts, with --oracle mujoco-adaptive", count=16,
         sweep="eumos"),
    Case("placement-seeds", "sweeps", "bundled plans × 32 random placements: how often each stands, with --oracle",
         count=26, source=str(bundled_path()), sweep=_PLACEMENT_SEEDS),
)  # fmt: skip

CASES: dict[str, Case] = {case.name: case for case in _DECLARED}

GROUPS: dict[str, tuple[Case, ...]] = {
    group: tuple(case for case in _DECLARED if case.group == group)
    for group in dict.fromkeys(case.group for case in _DECLARED)
}
"""Names that stand for several cases."""


def chosen_cases(names: Sequence[str]) -> list[Case]:
    """The cases with these names, or in the groups with these names. Each case is listed once, in the order of the
    names.

    Raises:
        InputError: there is no such case.
    """
    cases: dict[str, Case] = {}
    for name in names:
        if name not in CASES and name not in GROUPS:
            raise InputError(f"unknown case {name!r}; python -m benchmarks list shows all")
        cases.update((case.name, case) for case in GROUPS.get(name) or (CASES[name],))
    return list(cases.values())


def oracle_case(case: Case, schedule: Schedule) -> Case:
    """The case that the engine ``mujoco`` runs as the reference for ``case``. It is the same case except for the
    schedule."""
    if case.sim.schedule is schedule:
        return case
    oracle = replace(case, name=f"{case.name}/{schedule.value}", simulation={**case.simulation, "schedule": schedule})

    def is_wanted(other: Case) -> bool:
        alike = replace(oracle, name=other.name, text=other.text, simulation=other.simulation)
        return alike == other and oracle.sim == other.sim

    return next(filter(is_wanted, GROUPS[case.group]), oracle)
