"""Small plans that stand, slide, tip and collapse, and their outcomes, computed once for all tests of a session."""

from __future__ import annotations

import functools

import jax

from petmjx.engines.mjx.engine import MjxJaxEngine
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.packers.handmade_plans import HANDMADE
from petmjx.world.job import Job
from petmjx.world.scene import Scene
from support.plans import Box, make_scene, stack
from support.plans import make_plan as make_plan

LANES = 4
MOST_BOXES = 4
"""A step costs as lanes × boxes² on a CPU: all pairs of boxes may touch."""

MORE: dict[str, tuple[Box, ...]] = {
    "uneven pile": (
        ((400, 300, 200), (0, 0, 0), 9.0),
        ((300, 300, 200), (400, 0, 0), 4.0),
        ((500, 200, 120), (100, 50, 200), 6.0),
        ((150, 150, 180), (150, 60, 320), 1.5),
    ),
    "brickwork": (
        ((300, 200, 150), (0, 0, 0), 5.0),
        ((300, 200, 150), (300, 0, 0), 5.0),
        ((300, 200, 150), (150, 0, 150), 5.0),
        ((300, 200, 150), (150, 0, 300), 5.0),
    ),
    "stack of 4": stack(4, kg=6.0),
    "corner overhang of 30 %": (((400, 400, 200), (0, 0, 0), 8.0), ((400, 400, 200), (120, 120, 200), 5.0)),
    "falls 60 mm flat": (((400, 300, 200), (0, 0, 0), 6.0), ((300, 200, 150), (50, 50, 260), 3.0)),
    "two wings on a post": (
        ((200, 200, 200), (200, 0, 0), 5.0),
        ((200, 200, 100), (40, 0, 200), 4.0),  # with 20 mm less, rounding decides whether it drops or leans
        ((200, 200, 100), (400, 0, 200), 4.0),
    ),
    "light under heavy": (((300, 300, 100), (0, 0, 0), 0.5), ((300, 300, 250), (0, 0, 100), 20.0)),
    "corner overhang of 70 %": (((400, 400, 200), (0, 0, 0), 8.0), ((400, 400, 200), (280, 280, 200), 5.0)),
}


def _placed(entry: dict[str, object]) -> Box:
    item, corner = entry["item"], entry["flb_coordinates"]
    assert isinstance(item, dict)
    assert isinstance(corner, list)
    return (item["length/mm"], item["width/mm"], item["height/mm"]), tuple(corner), item["weight/kg"]


def boxes_by_plan() -> dict[str, tuple[Box, ...]]:
    """Plan id → boxes: the hand-made sample plans with few boxes, followed by ``MORE``."""
    small = {p.plan_id: tuple(map(_placed, p.placements)) for p in HANDMADE if len(p.placements) <= MOST_BOXES}
    return small | MORE


@functools.cache
def scenes(physics: str = "pallet") -> dict[str, Scene]:
    sim = Simulation(physics=physics)
    return {name: make_scene(boxes, sim) for name, boxes in boxes_by_plan().items()}


def simulate(engine: Engine, some: dict[str, Scene], sim: Simulation) -> dict[str, Outcome]:
    """Name → outcome."""
    names = list(some)
    with jax.numpy_rank_promotion("allow"):  # MJX broadcasts as NumPy does
        return {names[o.job]: o for o in engine.run([Job(scene) for scene in some.values()], sim)}


@functools.cache
def jax_engine() -> MjxJaxEngine:
    """The one engine of the session: its programs take ten seconds to compile."""
    return MjxJaxEngine(LANES)


BRISK = Simulation(interval_s=0.1, rest_window_s=0.1)
"""Options with which the worlds end in two thirds of the steps that they take with the usual ones."""


@functools.cache
def jax_outcomes() -> dict[str, Outcome]:
    """The outcomes of mjx-jax, simulated in several batches."""
    return simulate(jax_engine(), scenes(), BRISK)


@functools.cache
def exact_outcomes() -> dict[str, Outcome]:
    return simulate(MujocoEngine(2), scenes(), BRISK)


def run_one(job: Job, sim: Simulation) -> Outcome:
    """The outcome of one world on C MuJoCo."""
    (outcome,) = MujocoEngine(1).run([job], sim)
    return outcome
