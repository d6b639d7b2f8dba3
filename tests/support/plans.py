"""Plans in memory, and scenes and worlds made from them. All tests write a box in the form of ``Box``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.body_shapes import Body
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scene

Triple = tuple[float, float, float]
Box = tuple[Triple, Triple, float]
"""Size in mm, front-left-bottom corner in mm, and mass in kg of a box."""

CARTON_MM = (400.0, 300.0, 200.0)


def stack(
    n: int = 2,
    overhang_mm: float = 0.0,
    *,
    size_mm: Triple = CARTON_MM,
    kg: float | Sequence[float] = 5.0,
    at_mm: tuple[float, float] = (0.0, 0.0),
) -> tuple[Box, ...]:
    """Boxes on top of one another, with every second box moved along x. If they overhang by half their length or more,
    they fall."""
    x, y = at_mm
    masses = [kg] * n if isinstance(kg, int | float) else kg
    return tuple((size_mm, (x + overhang_mm * (k % 2), y, size_mm[2] * k), masses[k]) for k in range(n))


def make_plan(plan_id: str = "00000001", boxes: int | Sequence[Box] = 3) -> Plan:
    """A plan of these boxes. If ``boxes`` is a number, a plan of this number of cartons on top of one another."""
    if isinstance(boxes, int):
        boxes = stack(boxes)
    n = len(boxes)
    return Plan(
        plan_id=plan_id,
        source="plans.json",
        size_mm=np.array([size for size, _, _ in boxes], float),
        corner_mm=np.array([corner for _, corner, _ in boxes], float),
        mass_kg=np.array([mass for _, _, mass in boxes], float),
        item_ids=tuple(f"item-{k}" for k in range(n)),
        articles=tuple(f"article-{k}" for k in range(n)),
        sequence=np.arange(1, n + 1),
    )


def heap(n: int = 40) -> tuple[Box, ...]:
    """Boxes of random sizes in uneven layers. The boxes fall a little, tip and slide."""
    rng = np.random.default_rng(3)
    boxes = []
    for k in range(n):
        layer, place = divmod(k, 12)
        x, y = divmod(place, 4)
        size = rng.integers(140, 260, 3)
        aside = rng.integers(0, 60, 2)
        corner = (280.0 * x + aside[0], 200.0 * y + aside[1], 265.0 * layer)
        boxes.append((tuple(map(float, size)), corner, rng.uniform(1, 10)))
    return tuple(boxes)


def make_scene(boxes: int | Sequence[Box], sim: Simulation | None = None) -> Scene:
    """The scene of these boxes, without changes."""
    return build_scene(make_plan(boxes=boxes), sim or Simulation())


def on_boards(scene: Scene) -> Scene:
    """The same boxes on two boards with a gap between them. Every second box is slippery, and heavier on one side."""
    carrier, n = scene.carrier, scene.n_boxes
    half, low = carrier.half_size[0] * [0.45, 1.0, 1.0], carrier.low
    high = carrier.high - 2 * half
    boards = Body.of_boards(
        np.array([low + half, high + half]),
        np.array([half, half]),
        np.full(2, carrier.mass / 2),
        np.array([(0.3, 0.005, 0.0001), (0.6, 0.005, 0.0001)]),
    )
    odd = (np.arange(n) % 2 == 1)[:, None]
    return replace(
        scene,
        carrier=boards,
        friction=scene.friction * np.where(odd, [0.4, 1.0, 1.0], 1.0),
        mass_center=np.where(odd, 0.3 * scene.half_size * [1.0, -1.0, 0.5], 0.0),
        inertia_box=scene.half_size * np.where(odd, 0.8, 1.0),
    )


def make_world(plan: Plan, sim: Simulation | None = None) -> World:
    """The world of a plan, without changes and without a drive (motion of the carrier)."""
    return World(plan, 0, Job(build_scene(plan, sim or Simulation())))


def falling() -> Scene:
    """Three boxes. More than half of the second box overhangs the first box. So the second box falls, and the third box
    falls with it."""
    return make_scene(stack(3, -200.0, size_mm=(300, 200, 150)))
