"""What is measured, as data. Nothing here simulates."""

from __future__ import annotations

from dataclasses import dataclass

from petmjx.config import PHYSICS, Check, Schedule, Simulation
from petmjx.errors import InputError

SEED = 0
"""Seed of the sample plans that the workload consists of."""

WORKLOAD_PLANS = 2_000
STACK_BOXES = (8, 16, 24, 32, 40, 48, 64)
SCALE_PLANS = (500, 1_000, 2_000, 4_000, 8_000)

STACK_PLAN = 33
"""Sample plan of ``SEED``, packed strictly, that the stacks are cut from: the first with at least 64 boxes (67)."""


@dataclass(frozen=True)
class StackCase:
    """Copies of one full stack, all boxes standing from the start: what a step costs at a size.

    Attributes:
        boxes: the first so many boxes of ``STACK_PLAN``.
        duration_s: simulated time after the soft start; the same for every world.
    """

    name: str
    text: str
    boxes: int
    duration_s: float = 1.0

    @property
    def sim(self) -> Simulation:
        """Static check of fixed length; nothing ends a world early."""
        return Simulation(check=Check.STATIC, schedule=Schedule.FIXED, duration_s=self.duration_s, early_stop=False)


@dataclass(frozen=True)
class WorkloadCase:
    """The first plans of the samples, one by one, from file to Parquet, as ``petmjx score`` does it."""

    name: str
    text: str
    schedule: Schedule
    physics: str = "pallet"
    plans: int = WORKLOAD_PLANS

    @property
    def sim(self) -> Simulation:
        """The configuration of ``petmjx score`` with this schedule and physics."""
        return Simulation(physics=PHYSICS[self.physics], schedule=self.schedule)


@dataclass(frozen=True)
class PlainLoopCase:
    """The loop one would write first: one thread, one ``mj_step`` a step from Python, fixed schedule.

    Attributes:
        parked_on_floor: boxes that wait stand on the floor, as in the reference implementation; otherwise they hang
            in the air, held by a force (cheaper).
        max_seconds: no further plan is begun after this.
    """

    name: str
    text: str
    parked_on_floor: bool
    physics: str = "pallet"
    plans: int = WORKLOAD_PLANS
    max_seconds: float = 60.0


Case = StackCase | WorkloadCase | PlainLoopCase

_DECLARED: tuple[Case, ...] = (
    *(StackCase(f"stacks-{n}", f"full stack of {n} boxes, static: steps per second", n) for n in STACK_BOXES),
    WorkloadCase("W-adaptive", "workload W, adaptive schedule", Schedule.ADAPTIVE),
    WorkloadCase("W-brisk", "workload W, brisk schedule: creep holds nothing up", Schedule.BRISK),
    WorkloadCase("W-adaptive-reference", "workload W, adaptive, physics reference", Schedule.ADAPTIVE, "reference"),
    WorkloadCase("W-fixed", "workload W, fixed schedule", Schedule.FIXED),
    WorkloadCase("W-fixed-reference", "workload W, fixed, physics reference (an oracle)", Schedule.FIXED, "reference"),
    *(
        WorkloadCase(f"scale-{n}", f"{n} plans, adaptive: time per plan", Schedule.ADAPTIVE, plans=n)
        for n in SCALE_PLANS
    ),
    PlainLoopCase("plain-loop", "plain Python loop, waiting boxes in the air", parked_on_floor=False),
    PlainLoopCase("plain-loop-floor", "plain Python loop, waiting boxes on the floor", parked_on_floor=True),
)

CASES: dict[str, Case] = {case.name: case for case in _DECLARED}

GROUPS: dict[str, tuple[str, ...]] = {
    "stacks": tuple(case.name for case in _DECLARED if isinstance(case, StackCase)),
    "W": ("W-adaptive", "W-brisk", "W-adaptive-reference", "W-fixed"),
    "scale": tuple(case.name for case in _DECLARED if case.name.startswith("scale-")),
    "plain": ("plain-loop", "plain-loop-floor"),
}
"""Names that stand for several cases."""


def chosen_cases(names: list[str]) -> list[Case]:
    """Cases by name or group, each once, in the order in which they were named.

    Raises:
        InputError: no such case.
    """
    found: dict[str, Case] = {}
    for name in names:
        if name not in CASES and name not in GROUPS:
            raise InputError(f"unknown case {name!r}; python -m benchmarks --list shows all")
        found.update((member, CASES[member]) for member in GROUPS.get(name, (name,)))
    return list(found.values())


def oracle_case(case: WorkloadCase, schedule: Schedule) -> WorkloadCase:
    """The workload whose results on engine ``mujoco`` are the yardstick: same physics and plans, this schedule."""
    if case.schedule is schedule:
        return case
    for other in _DECLARED:
        if isinstance(other, WorkloadCase) and (other.schedule, other.physics, other.plans) == (
            schedule,
            case.physics,
            WORKLOAD_PLANS,
        ):
            return other
    raise InputError(f"no case with schedule {schedule.value} and physics {case.physics}")
