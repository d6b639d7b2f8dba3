"""Forces on the tops of boxes in small piles: petmjx's ``rest_top_force_n`` against other simulators and statics.

If each box has one support, statics alone determines the forces on all boxes, and all simulators must agree. If a box
has several supports, balance does not determine how they share its load, and simulators differ by the stiffness of
their contacts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

import petmjx
from benchmarks.referees.box_by_box import stand
from benchmarks.referees.referee import Referee
from petmjx.common.units import FloatArray
from petmjx.options.simulation import Check, Simulation
from petmjx.plans.plan import Plan
from petmjx.world.scene import Scene, build_scene
from petmjx.world.supports import bearing_of

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Pile:
    """A pile: its boxes as (size, mm; front-left-bottom corner, mm; mass, kg)."""

    name: str
    boxes: tuple[tuple[Triple, Triple, float], ...]

    @property
    def plan(self) -> Plan:
        size, corner, mass = zip(*self.boxes, strict=True)
        return Plan.from_boxes(self.name, size_mm=size, corner_mm=corner, mass_kg=mass)


_CARTON: Final = (400.0, 300.0, 200.0)
_LEG: Final = (100.0, 100.0, 200.0)
_PLANK: Final = (800.0, 200.0, 50.0)
_PLATE: Final = (600.0, 600.0, 50.0)
_BRICK: Final = (300.0, 150.0, 100.0)

PILES: Final = (
    Pile("tower", tuple((_CARTON, (0.0, 0.0, 200.0 * k), 5.0 + k) for k in range(5))),
    Pile("leaning tower", tuple((_CARTON, (60.0 * k, 40.0 * k, 200.0 * k), 5.0 + k) for k in range(4))),
    Pile(
        "balance",
        (
            (_CARTON, (200.0, 0.0, 0.0), 4.0),
            (_PLANK, (0.0, 50.0, 200.0), 3.0),
            (_LEG, (0.0, 100.0, 250.0), 3.0),
            (_LEG, (700.0, 100.0, 250.0), 4.0),
        ),
    ),
    Pile(
        "bridge, load off its middle",
        (
            ((200.0, 200.0, 200.0), (0.0, 0.0, 0.0), 4.0),
            ((200.0, 200.0, 200.0), (600.0, 0.0, 0.0), 4.0),
            (_PLANK, (0.0, 0.0, 200.0), 3.0),
            (_LEG, (200.0, 50.0, 250.0), 10.0),
        ),
    ),
    Pile(
        "plank on three columns",
        (
            *((_LEG, (350.0 * k, 50.0, 0.0), 2.0) for k in range(3)),
            (_PLANK, (0.0, 0.0, 200.0), 3.0),
            (_LEG, (350.0, 50.0, 250.0), 10.0),
        ),
    ),
    Pile(
        "plate on four legs, load off its middle",
        (
            *((_LEG, (500.0 * x, 500.0 * y, 0.0), 2.0) for x in range(2) for y in range(2)),
            (_PLATE, (0.0, 0.0, 200.0), 5.0),
            (_LEG, (350.0, 300.0, 250.0), 10.0),
        ),
    ),
    Pile(
        "wall of bricks",
        (
            *((_BRICK, (301.0 * k, 0.0, 0.0), 4.0) for k in range(3)),
            *((_BRICK, (150.0 + 301.0 * k, 0.0, 100.0), 4.0) for k in range(2)),
            (_BRICK, (301.0, 0.0, 200.0), 4.0),
        ),
    ),
)


def by_statics(scene: Scene, gravity_m_s2: float) -> FloatArray | None:
    """(n,) forces on the tops of boxes, N, by statics. None if a box has several supports, because balance then does
    not determine the forces."""
    bearing = bearing_of(scene)
    if (np.bincount(bearing.upper, minlength=scene.n_boxes) != 1).any():
        return None
    force: FloatArray = gravity_m_s2 * (bearing.loads(scene.n_boxes)[:, 0] - scene.mass)
    return force


def forces(pile: Pile, referees: Mapping[str, Referee], sim: Simulation) -> dict[str, FloatArray]:
    """Source → (n,) forces on the tops of boxes at rest, N. Sources are ``petmjx``, each referee in which the boxes
    come to rest, and ``statics`` if balance determines the forces.

    Raises:
        RuntimeError: the pile does not stand in petmjx.
    """
    scene = build_scene(pile.plan, sim)
    results = petmjx.score([pile.plan], engine="mujoco", check=sim.check.value)
    if results.worlds["verdict"].iloc[0] != "stable":
        raise RuntimeError(f"{pile.name}: {results.worlds['verdict'].iloc[0]}")
    forces_by_name = {"petmjx": results.boxes["rest_top_force_n"].to_numpy(dtype=float)}
    if (exact := by_statics(scene, sim.physics.gravity_m_s2)) is not None:
        forces_by_name["statics"] = exact
    for name, referee in referees.items():
        world = referee.world(scene, sim.physics, fine=True)
        outcome = stand(world, scene, sim)
        world.close()
        if not outcome.moving:
            forces_by_name[name] = outcome.boxes.rest_top_force_n
    return forces_by_name


def differences(referees: Mapping[str, Referee]) -> Iterator[dict[str, Any]]:
    """Yield the fields of a result for each pile and check: all forces, N, and the largest difference between petmjx's
    force and another source's, as a share of the largest force of the pile."""
    for pile in PILES:
        for check in Check:
            forces_by_name = forces(pile, referees, Simulation(check=check))
            ours = forces_by_name["petmjx"]
            yield {
                "pile": pile.name,
                "check": check.value,
                "determinate": "statics" in forces_by_name,
                "force_n": {who: values.tolist() for who, values in forces_by_name.items()},
                "differs": {
                    who: float(np.abs(v - ours).max() / ours.max())
                    for who, v in forces_by_name.items()
                    if v is not ours
                },
            }
