"""One world's physical description in SI units: places, sizes, masses, frictions.

A scene is made from a plan (and, in sweeps, changed by a variant). Engines see scenes, never plans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petmjx.config import CARRIER_EXTENT_M, Simulation, Triple
from petmjx.plans.plan import Plan
from petmjx.units import MM_PER_M, mm_to_m, round_to_micrometre

IDENTITY_QUAT = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """The world of one plan and one variant. Arrays are float64; box rows are in packing order.

    Attributes:
        half_size: (n, 3) box half extents, m.
        mass: (n,) kg.
        target: (n, 3) planned centres, m: what shifts are measured from.
        start_pos: (n, 3) centres at which boxes are released, m; the same as ``target`` in the nominal variant.
        start_quat: (n, 4) orientations (w, x, y, z) at release.
        box_friction, carrier_friction, floor_friction: sliding / torsional / rolling coefficients.
        carrier_half_size: (3,) m.
        carrier_pos: (3,) centre of the carrier before the soft start, m; its top is at z = 0.
        carrier_mass: kg.
        floor_z: m.
    """

    half_size: NDArray[np.float64]
    mass: NDArray[np.float64]
    target: NDArray[np.float64]
    start_pos: NDArray[np.float64]
    start_quat: NDArray[np.float64]
    box_friction: Triple
    carrier_friction: Triple
    floor_friction: Triple
    carrier_half_size: NDArray[np.float64]
    carrier_pos: NDArray[np.float64]
    carrier_mass: float
    floor_z: float

    @property
    def n_boxes(self) -> int:
        return len(self.mass)

    @property
    def total_mass(self) -> float:
        """Mass of boxes and carrier, kg; force profiles are scaled by it."""
        return float(self.mass.sum() + self.carrier_mass)


def build_scene(plan: Plan, sim: Simulation) -> Scene:
    """The nominal scene of a plan.

    Length and width are reduced by ``sim.size_reduction_mm``, and the height if boxes fall into their places; the
    front-left-bottom corner stays. Half sizes and centres are rounded half up to 1 µm, as the reference implementation
    writes them.
    """
    physics = sim.physics
    size = plan.size_mm - sim.size_reduction_mm * np.array([1.0, 1.0, float(physics.falls_into_place)])
    half_size = round_to_micrometre(mm_to_m(size / 2))
    target = round_to_micrometre(mm_to_m(plan.corner_mm + size / 2))
    carrier_half_size, carrier_pos = _carrier(plan, sim)
    return Scene(
        half_size=half_size,
        mass=plan.mass_kg.copy(),
        target=target,
        start_pos=target.copy(),
        start_quat=np.tile(np.array(IDENTITY_QUAT), (len(target), 1)),
        box_friction=physics.box_friction,
        carrier_friction=physics.carrier_friction,
        floor_friction=physics.floor_friction,
        carrier_half_size=carrier_half_size,
        carrier_pos=carrier_pos,
        carrier_mass=physics.carrier_mass_kg,
        floor_z=physics.floor_z_m,
    )


def _carrier(plan: Plan, sim: Simulation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3,) half extents and (3,) centre of the carrier, m: the plan's bounding box, or one of a fixed size whose
    front-left corner is the origin."""
    extent = CARRIER_EXTENT_M[sim.carrier]
    if extent is None:
        low_mm = plan.corner_mm[:, :2].min(axis=0)
        extent_mm = (plan.corner_mm + plan.size_mm)[:, :2].max(axis=0) - low_mm
        corner, size = low_mm / MM_PER_M, extent_mm / MM_PER_M
    else:
        corner, size = np.zeros(2), np.array(extent)
    half_height = sim.physics.carrier_half_height_m
    return np.array([*(size / 2), half_height]), np.array([*(corner + size / 2), -half_height])
