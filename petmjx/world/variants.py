"""Variants: how a world differs from its plan's nominal one.

A variant has two halves. What changes before or while boxes are placed (friction, mass, sizes, placement
errors) is its *placement*; what shakes the finished pallet (profile, strength, direction) is its *drive*.
Worlds of a plan with equal ``placement_key`` share one placement, whose settled state is forked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from petmjx.placing import Placing
from petmjx.units import FloatArray, mm_to_m
from petmjx.world.pairs import scaled_pairs
from petmjx.world.random import WorldKey
from petmjx.world.scene import Scene

MIN_SIZE_FRACTION = 0.1
"""Smallest size that can be drawn, as a fraction of the planned size: a box must keep a positive extent."""

LARGEST_SIZE_M = 7.0
"""Nor does any exceed this: boxes that wait for their turn hang 8 m apart."""

MIN_MASS_FRACTION = 0.1
"""Smallest mass that can be drawn, as a fraction of the nominal one: MuJoCo refuses bodies without mass."""

MIN_FRICTION_FRACTION = 0.1
"""Smallest friction that can be drawn, as a fraction of the nominal one: it must stay positive."""

STEP_TOLERANCE_M = 0.01
"""Of two boxes that overlap horizontally, one carries the other if its planned top is at most this far above the
other's planned bottom: the other one is then set down on it. A box that is higher counts as a wall beside it."""

_SAME_HEIGHT_M = 1e-9


class DistributionShape(StrEnum):
    """Family of a distribution."""

    FIXED = "fixed"
    NORMAL = "normal"
    UNIFORM = "uniform"


@dataclass(frozen=True)
class Distribution:
    """The distribution of one error, in the unit of its axis.

    ``fixed``: always ``centre``; ``normal``: mean ``centre`` and standard deviation ``spread``;
    ``uniform``: from ``centre − spread`` to ``centre + spread``.
    """

    shape: DistributionShape = DistributionShape.FIXED
    centre: float = 0.0
    spread: float = 0.0

    @property
    def random(self) -> bool:
        return self.shape is not DistributionShape.FIXED and self.spread > 0

    @property
    def zero(self) -> bool:
        return self.centre == 0 and not self.random

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Samples. Standard numbers are drawn and then scaled. So with the same generator, twice the spread gives each
        box twice the error, and levels of a sweep can be compared pair by pair."""
        if self.shape is DistributionShape.NORMAL:
            return self.centre + self.spread * rng.standard_normal(shape)
        if self.shape is DistributionShape.UNIFORM:
            return self.centre + self.spread * (2.0 * rng.random(shape) - 1.0)
        return np.full(shape, self.centre)

    def label(self) -> str:
        """Its text in the results, if the axis has distributions of several shapes."""
        if self.zero:
            return "0"
        if self.shape is DistributionShape.FIXED:
            return f"fixed({self.centre:g})"
        if self.shape is DistributionShape.NORMAL:
            return f"normal({self.centre:g}, {self.spread:g})"
        return f"uniform({self.centre - self.spread:g}, {self.centre + self.spread:g})"


ZERO = Distribution()


@dataclass(frozen=True)
class PlacementChange:
    """What is different while boxes are placed. Factors multiply; errors are drawn for each box.

    Attributes:
        box_friction_factor, carrier_friction_factor: on all three friction coefficients. MuJoCo takes the
            larger coefficient of two touching geoms, so a lower value on one side alone changes little.
        mass_factor: on the mass of every box; the carrier's mass does not change.
        friction_rel: relative change of the friction of boxes and carrier, on top of the factors (0.1 = 10 % more). One
            draw for the whole world: all cartons are of one board, on a day of one humidity.
        mass_rel: relative change of each box's mass, on top of the factor.
        size_mm: added to each dimension of each box, mm.
        size_rel: relative change of each dimension (0.01 = 1 % larger).
        x_mm, y_mm, yaw_deg: placement error of each box.
        drop_height_mm: height above its place at which a box is released; negative draws count as 0.
        placing_height_mm, placing_side_mm, placing_speed_m_s, placing_force_n, tines_height_mm: instead of those of
            ``petmjx.placing.Placing``; None: those.
        wrap_turns: of film, instead of those of ``petmjx.wrap.Wrap``; None: those.
        shifts_from_release: shifts are measured from where a box was released instead of from the plan.
    """

    box_friction_factor: float = 1.0
    carrier_friction_factor: float = 1.0
    mass_factor: float = 1.0
    friction_rel: Distribution = ZERO
    mass_rel: Distribution = ZERO
    size_mm: Distribution = ZERO
    size_rel: Distribution = ZERO
    x_mm: Distribution = ZERO
    y_mm: Distribution = ZERO
    yaw_deg: Distribution = ZERO
    drop_height_mm: Distribution = ZERO
    placing_height_mm: float | None = None
    placing_side_mm: float | None = None
    placing_speed_m_s: float | None = None
    placing_force_n: float | None = None
    tines_height_mm: float | None = None
    wrap_turns: float | None = None
    shifts_from_release: bool = False

    def placing(self, placing: Placing, *, errors: bool) -> Placing:
        """How boxes are placed that would be placed so; ``errors``: their places or sizes have errors."""
        other = {
            "height_mm": self.placing_height_mm,
            "side_mm": self.placing_side_mm,
            "speed_m_s": self.placing_speed_m_s,
            "force_n": self.placing_force_n,
            "tines_mm": self.tines_height_mm,
        }
        given = {name: value for name, value in other.items() if value is not None}
        chosen = placing.for_errors if errors else placing
        return chosen.changed(**given) if given else chosen

    @property
    def random(self) -> bool:
        """Whether two replicates differ."""
        values = (getattr(self, entry.name) for entry in fields(self))
        return any(isinstance(value, Distribution) and value.random for value in values)


UNCHANGED = PlacementChange()

PlacementKey = tuple[PlacementChange, int]


@dataclass(frozen=True)
class DriveSpec:
    """What shakes the finished pallet: the name of a profile, its scale or level, and its direction."""

    profile: str
    scale: float = 1.0
    direction_deg: float = 0.0


@dataclass(frozen=True)
class Variant:
    """One set of changes to a plan's nominal world.

    Attributes:
        index: ``variant`` in the results; 0 is the nominal world.
        placement, drive: the two halves. Without a drive the world ends when the placement is at rest.
        replicate: which repetition; random numbers depend on (seed, plan id, replicate) alone.
        parameters: result column → value.
    """

    index: int
    placement: PlacementChange = UNCHANGED
    drive: DriveSpec | None = None
    replicate: int = 0
    parameters: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)

    @property
    def placement_key(self) -> PlacementKey:
        """Equal for variants of one plan that share a placement. Replicates share it, unless something random acts
        while boxes are placed."""
        return (self.placement, self.replicate if self.placement.random else 0)


def apply(scene: Scene, plan_id: str, variant: Variant, seed: int, *, standing: int = 0) -> Scene:
    """The scene of a plan under a variant's placement change; its drive is not used here.

    When sizes change, boxes keep their horizontal centres, so neighbours that became larger overlap sideways and push
    each other apart. Boxes are set down on the actual tops of those below. Placement errors in x, y and yaw change
    ``start_pos`` and ``start_quat``; a box whose new place is over a slightly higher neighbour is released above it. No
    box starts inside another one vertically. ``target``, from which shifts are measured, stays at the planned x and y;
    its z is the height at which the box really stands, so that a tolerance in height is no shift. With errors of places
    or sizes boxes are placed as for errors (``Placing.for_errors``).

    Args:
        standing: so many first boxes stand already: they keep their sizes, places and masses.

    Returns:
        The same object where nothing changes.
    """
    change = variant.placement
    if change == UNCHANGED:
        return scene
    key = WorldKey(seed, plan_id, variant.replicate)
    n_boxes = scene.n_boxes
    half_size = _changed_half_size(scene, change, key)
    if standing:
        half_size = np.concatenate([scene.half_size[:standing], half_size[standing:]])
    start_pos = scene.start_pos.copy()
    start_pos[:, 0] += mm_to_m(change.x_mm.draw(key.rng("x"), (n_boxes,)))
    start_pos[:, 1] += mm_to_m(change.y_mm.draw(key.rng("y"), (n_boxes,)))
    yaw = np.radians(change.yaw_deg.draw(key.rng("yaw"), (n_boxes,)))
    start_pos[:standing], yaw[:standing] = scene.start_pos[:standing], 0.0
    target = scene.target.copy()
    moved = (change.size_mm, change.size_rel, change.x_mm, change.y_mm, change.yaw_deg)
    has_errors = not all(error.zero for error in moved)
    if has_errors:
        start_pos[standing:, 2] = _set_down(scene, half_size, start_pos, yaw)[standing:]
        target[standing:, 2] = start_pos[standing:, 2]
    if change.shifts_from_release:
        target = start_pos.copy()
    drop_height_mm = change.drop_height_mm.draw(key.rng("drop"), (n_boxes,))
    start_pos[:, 2] += mm_to_m(np.maximum(drop_height_mm, 0.0))
    mass_share = 1.0 + change.mass_rel.draw(key.rng("mass-rel"), (n_boxes,))
    mass = scene.mass * change.mass_factor * np.maximum(mass_share, MIN_MASS_FRACTION)
    mass[:standing] = scene.mass[:standing]
    (friction_share,) = 1.0 + change.friction_rel.draw(key.rng("friction-rel"), (1,))
    friction = max(float(friction_share), MIN_FRICTION_FRACTION)
    of_boxes, of_carrier = change.box_friction_factor * friction, change.carrier_friction_factor * friction
    return replace(
        scene,
        half_size=half_size,
        mass=mass,
        target=target,
        start_pos=start_pos,
        start_quat=_turned(scene.start_quat, yaw),
        placing=change.placing(scene.placing, errors=has_errors),
        wrap=scene.wrap if change.wrap_turns is None else scene.wrap.changed(turns=change.wrap_turns),
        friction=scene.friction * of_boxes,
        carrier=replace(scene.carrier, friction=scene.carrier.friction * of_carrier),
        pair_friction=scaled_pairs(scene.pair_friction, scene.carrier.surface, of_boxes, of_carrier),
    )


def _changed_half_size(scene: Scene, change: PlacementChange, key: WorldKey) -> FloatArray:
    shape = (scene.n_boxes, 3)
    size = 2.0 * scene.half_size
    factor = 1.0 + change.size_rel.draw(key.rng("size-rel"), shape)
    changed = size * factor + mm_to_m(change.size_mm.draw(key.rng("size"), shape))
    if change.size_mm.zero and change.size_rel.zero:
        return scene.half_size
    half: FloatArray = np.clip(changed, MIN_SIZE_FRACTION * size, LARGEST_SIZE_M) / 2.0
    return half


def _turned(quat: FloatArray, yaw: FloatArray) -> FloatArray:
    """Orientations (w, x, y, z) turned about the world's z axis, which is the product q_z(yaw) · q."""
    cos, sin = np.cos(yaw / 2), np.sin(yaw / 2)
    w, x, y, z = quat.T
    return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=1)


def _footprint_half(half_size: FloatArray, yaw: FloatArray) -> FloatArray:
    """(n, 2) half extents of the axis-aligned rectangle around each turned footprint."""
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    x, y = half_size[:, 0], half_size[:, 1]
    return np.stack([cos * x + sin * y, sin * x + cos * y], axis=1)


def _overlapping(centre: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
    """(n, n) which footprints overlap."""
    along = np.abs(centre[:, None] - centre) < half[:, None] + half
    overlaps: NDArray[np.bool_] = along[..., 0] & along[..., 1]
    return overlaps


def _set_down(scene: Scene, half_size: FloatArray, start_pos: FloatArray, yaw: FloatArray) -> FloatArray:
    """(n,) heights of centres when each box is set down on the actual tops of those below it.

    Boxes are taken from the bottom up. A box is below another one if its planned top is not above the other's planned
    bottom (with a tolerance of `STEP_TOLERANCE_M`) and their footprints overlap, as planned or as placed. The planned
    gap to the highest box below stays (0.1 mm from the size reduction; more for a box that floats in the plan). A
    planned penetration does not stay.
    """
    planned_bottom = scene.target[:, 2] - scene.half_size[:, 2]
    planned_top = scene.target[:, 2] + scene.half_size[:, 2]
    order = np.argsort(planned_bottom, kind="stable")
    rank = np.argsort(order)
    lower = (planned_top <= planned_bottom[:, None] + STEP_TOLERANCE_M) & (rank < rank[:, None])
    supports = lower & _overlapping(scene.target[:, :2], scene.half_size[:, :2])
    below: NDArray[np.bool_] = supports | (lower & _overlapping(start_pos[:, :2], _footprint_half(half_size, yaw)))
    # A box that overlaps no other in the plan stands on the carrier, or floats above it.
    support_top = np.where(supports, planned_top, -math.inf).max(axis=1, initial=-math.inf)
    stands = supports.any(axis=1)
    gap = np.where(stands, np.maximum(planned_bottom - support_top, 0.0), 0.0)
    least_bottom = np.where(stands, -math.inf, planned_bottom)
    centre_z = planned_bottom + half_size[:, 2]
    for box in order[np.any(below[order], axis=1)]:
        actual_top = (centre_z + half_size[:, 2])[below[box]].max()
        bottom = max(actual_top + gap[box], least_bottom[box])
        if abs(bottom - planned_bottom[box]) > _SAME_HEIGHT_M:
            centre_z[box] = bottom + half_size[box, 2]
    return centre_z
