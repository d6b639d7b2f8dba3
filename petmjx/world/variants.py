"""Variants: how a world differs from its plan's nominal world.

A variant has two halves. Its *placement* holds the changes that act while boxes are placed, or before (friction, mass,
sizes, placement errors). Its *drive* shakes the finished pallet (profile, strength, direction). Worlds of a plan with
the same ``placement_key`` share one placement: each starts from its settled state.

The scenes of many variants of a plan are made together (``apply_all``). Making a scene then takes a twentieth of a
millisecond. If scenes are made one by one, it takes ten times as long: as long as a GPU needs to simulate a small
world.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.options.placing import Placing, Way
from petmjx.options.walls import Side
from petmjx.world.body_shapes import Body
from petmjx.world.friction_pairs import scaled_pairs
from petmjx.world.random_streams import WorldKey, rngs
from petmjx.world.release_places import make_room
from petmjx.world.scene import Scene


class DistributionShape(StrEnum):
    """Family of distributions."""

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

    def draw(self, rngs: Iterable[np.random.Generator], shape: tuple[int, ...]) -> FloatArray:
        """(m, …) one sample from each of m generators; (1, …), without use of a generator, if nothing is random.

        Standard numbers are drawn and then scaled. So with the same generator, twice the spread gives each box twice
        the error, and levels of a sweep can be compared pair by pair.
        """
        if self.random and self.shape is DistributionShape.NORMAL:
            return self.centre + self.spread * np.array([rng.standard_normal(shape) for rng in rngs])
        if self.random and self.shape is DistributionShape.UNIFORM:
            return self.centre + self.spread * (2.0 * np.array([rng.random(shape) for rng in rngs]) - 1.0)
        return np.full((1, *shape), self.centre)

    def label(self) -> str:
        """The distribution as text in the results, for axes with distributions of several shapes."""
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
    """The changes that a variant makes while boxes are placed. Factors multiply; errors are drawn for each box.

    Attributes:
        box_friction_factor, carrier_friction_factor: factors on all three friction coefficients. MuJoCo uses the larger
            coefficient of two touching geoms, so a lower value on only one side changes little.
        mass_factor: factor on the mass of every box; the carrier's mass does not change.
        friction_rel: relative change of the friction of boxes and carrier, after the factors (0.1 = 10 % more). One
            error is drawn for the whole world, since all cartons are of the same board, on a day of the same humidity.
        mass_rel: relative change of each box's mass, after the factor.
        size_mm: change of each dimension of each box, mm.
        size_rel: relative change of each dimension (0.01 = 1 % larger).
        x_mm, y_mm, yaw_deg: placement error of each box.
        drop_height_mm: height of a box's release above its place; negative draws count as 0.
        placing_name: how boxes are placed, a value of ``petmjx.options.placing.Way``; None: as in the options.
        placing_height_mm, placing_side_mm, placing_speed_m_s, placing_force_n, tines_height_mm: replace the fields of
            ``petmjx.options.placing.Placing``; None: as in the options.
        wrap_turns: replaces the turns of film of ``petmjx.options.wrap.Wrap``; None: as in the options.
        shifts_from_release: True: shifts are measured from the place of release instead of from the plan.
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
    placing_name: str | None = None
    placing_height_mm: float | None = None
    placing_side_mm: float | None = None
    placing_speed_m_s: float | None = None
    placing_force_n: float | None = None
    tines_height_mm: float | None = None
    wrap_turns: float | None = None
    shifts_from_release: bool = False

    def placing(self, placing: Placing, *, errors: bool) -> Placing:
        """How boxes are placed if this change is applied to ``placing``. ``errors``: whether places or sizes have
        errors."""
        other = {
            "name": Way(self.placing_name) if self.placing_name is not None else None,
            "height_mm": self.placing_height_mm,
            "side_mm": self.placing_side_mm,
            "speed_m_s": self.placing_speed_m_s,
            "force_n": self.placing_force_n,
            "tines_mm": self.tines_height_mm,
        }
        changes = {name: value for name, value in other.items() if value is not None}
        chosen = placing.for_errors if errors else placing
        return chosen.changed(**changes) if changes else chosen

    @cached_property
    def random(self) -> bool:
        """Whether two replicates would differ in their placements."""
        values = (getattr(self, entry.name) for entry in fields(self))
        return any(isinstance(value, Distribution) and value.random for value in values)


UNCHANGED = PlacementChange()

PlacementKey = tuple[PlacementChange, int]


@dataclass(frozen=True)
class DriveSpec:
    """The drive of the finished pallet: the name of a profile, its scale or level, and its direction.

    Attributes:
        scale_to: for each world, one scale is drawn uniformly between ``scale`` and this value; None: the scale is
            always ``scale``.
    """

    profile: str
    scale: float = 1.0
    direction_deg: float = 0.0
    scale_to: float | None = None


@dataclass(frozen=True)
class LegSpec:
    """A leg of a chain: the drives that shake the pallet on a part of its journey.

    Attributes:
        drives: drives in order, with a pause of ``pause_s`` between two drives. Without drives, the pallet rests for
            ``pause_s``.
        wrap_turns: turns of film around the pallet during the leg; None: as in the options.
        open_walls: walls of the carrier that are open during the leg, in addition to those open by the options.
    """

    name: str
    drives: tuple[DriveSpec, ...]
    pause_s: float = 0.0
    wrap_turns: float | None = None
    open_walls: tuple[Side, ...] = ()


@dataclass(frozen=True)
class Variant:
    """One set of changes to a plan's nominal world.

    Attributes:
        index: column ``variant`` in the results; 0 is the nominal world.
        placement, drive: the two halves of the variant. A world without a drive ends when the placement is at rest.
        replicate: number of the repetition; random numbers depend only on (seed, plan id, replicate).
        parameters: result column → value.
        legs: legs of a chain, instead of a drive. Each leg begins with the boxes where the previous leg left them.
    """

    index: int
    placement: PlacementChange = UNCHANGED
    drive: DriveSpec | None = None
    replicate: int = 0
    parameters: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)
    legs: tuple[LegSpec, ...] = ()

    @property
    def placement_key(self) -> PlacementKey:
        """A key that is equal for all variants of a plan that share a placement. Replicates share a placement unless
        something random happens while boxes are placed."""
        return (self.placement, self.replicate if self.placement.random else 0)


MIN_SIZE_FRACTION = 0.1
"""Smallest size that can be drawn, as a share of the planned size: every extent of a box must stay positive."""

LARGEST_SIZE_M = 7.0
"""Largest size that can be drawn, m. The limit is needed since boxes that are not yet placed hang 8 m apart."""

MIN_MASS_FRACTION = 0.1
"""Smallest mass that can be drawn, as a share of the nominal mass: MuJoCo refuses bodies without mass."""

MIN_FRICTION_FRACTION = 0.1
"""Smallest friction that can be drawn, as a share of the nominal friction: it must stay positive."""

STEP_TOLERANCE_M = 0.01
"""A lower box carries an upper box that overlaps it horizontally if the planned top of the lower box is at most this
far above the planned bottom of the upper one, m. The upper box is then set down on the lower one. If the top is higher,
the lower box counts as a wall beside the upper one."""

MOST_SPREADS: Final = 5.0
"""Largest error that is assumed, in standard deviations from the mean. One normal error in 2 million is larger."""

_SAME_HEIGHT_M = 1e-9

AT_A_TIME: Final = 256
"""Number of worlds that are made together. With 43 boxes per world, the largest arrays take 8 MB."""


def apply(scene: Scene, plan_id: str, variant: Variant, seed: int, *, standing: int = 0) -> Scene:
    """The scene of a plan after a variant's placement change. The variant's drive is not used.

    When sizes change, boxes keep their horizontal centres, so neighbours that became larger overlap sideways. A hand
    then moves each box to a place with room. If boxes are placed ``exact``, they appear at the nearest places without
    overlaps (petmjx.world.release_places). Boxes are set down on the actual tops of the boxes below.

    Placement errors in x, y and yaw change ``start_pos`` and ``start_quat``. A box that is moved over a slightly higher
    neighbour is released above it. No box starts inside another one vertically. Shifts are measured from ``target``,
    which keeps the planned x and y. The z of ``target`` is the height at which the box really stands, so that a
    tolerance in height does not count as a shift. If places or sizes have errors, boxes are placed as
    ``Placing.for_errors`` states.

    Args:
        standing: number of boxes, from the first on, that already stand. These boxes keep their sizes, places and
            masses.

    Returns:
        ``scene`` itself if nothing changes.
    """
    return next(apply_all(scene, plan_id, (variant,), seed, standing=standing))


def apply_all(
    scene: Scene, plan_id: str, variants: Iterable[Variant], seed: int, *, standing: int = 0
) -> Iterator[Scene]:
    """The scene of each variant, bit-identical to the result of :func:`apply`, whatever the other variants are."""
    for change, group in itertools.groupby(variants, key=lambda variant: variant.placement):
        for batch in _variant_batches(group):
            if change == UNCHANGED:
                yield from (scene for _ in batch)
            else:
                keys = [WorldKey(seed, plan_id, variant.replicate) for variant in batch]
                yield from _changed_scenes(scene, change, keys, standing)


def _variant_batches(variants: Iterable[Variant]) -> Iterator[tuple[Variant, ...]]:
    source = iter(variants)
    while batch := tuple(itertools.islice(source, AT_A_TIME)):
        yield batch


def _changed_scenes(scene: Scene, change: PlacementChange, keys: Sequence[WorldKey], standing: int) -> Iterator[Scene]:
    """The scenes of worlds that differ only in their random numbers. Each array has one row per world, or one row for
    all worlds."""
    n = scene.n_boxes

    def drawn(error: Distribution, purpose: str, *shape: int) -> FloatArray:
        return error.draw(rngs(keys, purpose), shape)

    half_size = scene.half_size[None]
    if not (change.size_mm.zero and change.size_rel.zero):
        half_size = _changed_half_size(
            scene, drawn(change.size_rel, "size-rel", n, 3), drawn(change.size_mm, "size", n, 3)
        )
        half_size[:, :standing] = scene.half_size[:standing]
    x, y, yaw = (drawn(getattr(change, name), name.partition("_")[0], n) for name in ("x_mm", "y_mm", "yaw_deg"))
    yaw = np.radians(yaw)
    moved = (change.size_mm, change.size_rel, change.x_mm, change.y_mm, change.yaw_deg)
    has_errors = not all(error.zero for error in moved)
    placing = change.placing(scene.placing, errors=has_errors)
    worlds = max(len(half_size), len(x), len(y), len(yaw))
    start_pos = np.repeat(scene.start_pos[None], worlds, axis=0)
    start_pos[..., 0] += mm_to_m(x)
    start_pos[..., 1] += mm_to_m(y)
    start_pos[:, :standing], yaw[:, :standing] = scene.start_pos[:standing], 0.0
    target = scene.target[None]
    if has_errors:
        if placing.name is Way.EXACT:
            start_pos[..., :2] = _with_room(scene, change, half_size, start_pos, yaw, standing)
        target = np.repeat(target, worlds, axis=0)
        start_pos[:, standing:, 2] = _set_down(scene, half_size, start_pos, yaw)[:, standing:]
        target[:, standing:, 2] = start_pos[:, standing:, 2]
    if change.shifts_from_release:
        target = start_pos.copy()
    drop_m = mm_to_m(np.maximum(drawn(change.drop_height_mm, "drop", n), 0.0))
    if len(drop_m) > len(start_pos):
        start_pos = np.repeat(start_pos, len(drop_m), axis=0)
    start_pos[..., 2] += drop_m
    mass_share = 1.0 + drawn(change.mass_rel, "mass-rel", n)
    mass = scene.mass * change.mass_factor * np.maximum(mass_share, MIN_MASS_FRACTION)
    mass[:, :standing] = scene.mass[:standing]
    friction_share = 1.0 + drawn(change.friction_rel, "friction-rel", 1)[:, 0]
    friction = np.maximum(friction_share, MIN_FRICTION_FRACTION)
    start_quat = _yawed_orientations(scene.start_quat, yaw)
    wrap = scene.wrap if change.wrap_turns is None else scene.wrap.changed(turns=change.wrap_turns)
    slippery = [_with_friction(scene, change, float(factor)) for factor in friction]
    fields = (slippery, half_size, mass, target, start_pos, start_quat)
    # worlds that do not differ share one object, so that pickles and tables hold it only once
    columns = (values if len(values) > 1 else itertools.repeat(values[0]) for values in fields)
    for _, base, half, kg, planned, place, turn in zip(keys, *columns, strict=False):
        yield replace(
            base,
            half_size=half,
            mass=kg,
            target=planned,
            start_pos=place,
            start_quat=turn,
            placing=placing,
            wrap=wrap,
        )


def _with_friction(scene: Scene, change: PlacementChange, factor: float) -> Scene:
    """The scene with the friction changed by ``change`` and then multiplied by ``factor``."""
    of_boxes, of_carrier = change.box_friction_factor * factor, change.carrier_friction_factor * factor
    if of_boxes == 1 and of_carrier == 1:
        return scene
    return replace(
        scene,
        friction=scene.friction * of_boxes,
        carrier=replace(scene.carrier, friction=scene.carrier.friction * of_carrier),
        pair_friction=scaled_pairs(scene.pair_friction, scene.carrier.surface, of_boxes, of_carrier),
    )


def _changed_half_size(scene: Scene, relative: FloatArray, more_mm: FloatArray) -> FloatArray:
    size = 2.0 * scene.half_size
    changed = size * (1.0 + relative) + mm_to_m(more_mm)
    half: FloatArray = np.clip(changed, MIN_SIZE_FRACTION * size, LARGEST_SIZE_M) / 2.0
    return half


def _yawed_orientations(quat: FloatArray, yaw: FloatArray) -> FloatArray:
    """(m, n, 4) orientations (w, x, y, z), rotated about the world's z axis: the product q_z(yaw) · q."""
    cos, sin = np.cos(yaw / 2), np.sin(yaw / 2)
    w, x, y, z = quat.T
    return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


def _footprint_half(half_size: FloatArray, yaw: FloatArray) -> FloatArray:
    """(m, n, 2) half extents of the axis-aligned rectangle around each rotated footprint."""
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    x, y = half_size[..., 0], half_size[..., 1]
    return np.stack([cos * x + sin * y, sin * x + cos * y], axis=-1)


def _overlap_mask(centre: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
    """(…, n, n) whether the footprints of two boxes overlap."""

    along: list[NDArray[np.bool_]] = []
    for axis in range(2):
        place, reach = centre[..., axis], half[..., axis]
        apart = np.abs(place[..., :, None] - place[..., None, :])
        along.append(apart < reach[..., :, None] + reach[..., None, :])
    return along[0] & along[1]


def _with_room(
    scene: Scene, change: PlacementChange, half_size: FloatArray, start_pos: FloatArray, yaw: FloatArray, standing: int
) -> FloatArray:
    """(m, n, 2) horizontal places of boxes, moved apart until none overlap."""
    above = _lower(scene)
    beside = ~(above | above.T)
    movable = np.arange(scene.n_boxes) >= standing
    reach_m = _farthest_m(scene, change)
    places = start_pos[..., :2], half_size, yaw
    planned = scene.target[:, :2], scene.half_size
    if not scene.carrier.walls:
        return make_room(*places, *planned, beside, movable, reach_m)
    return _with_walls(scene.carrier, scene.target, places, planned, beside, movable, reach_m)


def _with_walls(
    carrier: Body,
    target: FloatArray,
    places: tuple[FloatArray, FloatArray, FloatArray],
    planned: tuple[FloatArray, FloatArray],
    beside: NDArray[np.bool_],
    movable: NDArray[np.bool_],
    reach_m: float,
) -> FloatArray:
    """``make_room``, with the carrier's walls as additional boxes that do not move."""
    walls, n, sides = slice(carrier.n_boards, None), len(target), carrier.walls
    middle, half = (carrier.pos + carrier.shape_pos)[walls], carrier.half_size[walls]
    gap = carrier.room.gaps(target, planned[1], 0.0)
    is_near = np.array([np.isfinite(gap[:, int(side.is_far), side.axis]) for side in sides]).T
    is_neighbour = np.zeros((n + len(sides),) * 2, bool)
    is_neighbour[:n, :n], is_neighbour[:n, n:], is_neighbour[n:, :n] = beside, is_near, is_near.T

    def joined(of_boxes: FloatArray, of_walls: FloatArray) -> FloatArray:
        repeated = np.broadcast_to(of_walls, (*of_boxes.shape[: of_boxes.ndim - of_walls.ndim], *of_walls.shape))
        return np.concatenate([of_boxes, repeated], axis=of_boxes.ndim - of_walls.ndim)

    moved = make_room(
        joined(places[0], middle[:, :2]),
        joined(places[1], half),
        joined(places[2], np.zeros(len(sides))),
        joined(planned[0], middle[:, :2]),
        joined(planned[1], half),
        is_neighbour,
        np.append(movable, [False] * len(sides)),
        reach_m,
    )
    return moved[:, :n]


def _farthest_m(scene: Scene, change: PlacementChange) -> float:
    """Largest planned distance at which two boxes may still touch because of their errors, m."""
    x, y, size, share, yaw = (
        abs(error.centre) + MOST_SPREADS * error.spread
        for error in (change.x_mm, change.y_mm, change.size_mm, change.size_rel, change.yaw_deg)
    )
    half = float(np.hypot(scene.half_size[:, 0], scene.half_size[:, 1]).max(initial=0.0))
    return 2.0 * ((math.hypot(x, y) + size / 2.0) / MM_PER_M + half * (share + min(math.radians(yaw), 1.0)))


def _lower(scene: Scene) -> NDArray[np.bool_]:
    """(n, n) whether the row's box could be set down on the column's box, by their planned heights."""
    planned_bottom = scene.target[:, 2] - scene.half_size[:, 2]
    planned_top = scene.target[:, 2] + scene.half_size[:, 2]
    rank = np.argsort(np.argsort(planned_bottom, kind="stable"))
    lower: NDArray[np.bool_] = (planned_top <= planned_bottom[:, None] + STEP_TOLERANCE_M) & (rank < rank[:, None])
    return lower


def _set_down(scene: Scene, half_size: FloatArray, start_pos: FloatArray, yaw: FloatArray) -> FloatArray:
    """(m, n) heights of the centres of boxes after they are set down on the actual tops of the boxes below, m.

    Boxes are processed from the bottom up. A box is below another one if two conditions hold: its planned top is not
    above the other's planned bottom (with a tolerance of `STEP_TOLERANCE_M`), and their footprints overlap, as planned
    or as placed. The planned gap to the highest box below is kept (0.1 mm from the size reduction; more for a box that
    floats in the plan). A planned penetration is not kept.
    """
    planned_bottom = scene.target[:, 2] - scene.half_size[:, 2]
    planned_top = scene.target[:, 2] + scene.half_size[:, 2]
    lower = _lower(scene)
    supports = lower & _overlap_mask(scene.target[:, :2], scene.half_size[:, :2])
    below = supports | (lower & _overlap_mask(start_pos[..., :2], _footprint_half(half_size, yaw)))
    # A box with no lower box under it in the plan (seen from above, it overlaps none) stands on the carrier or floats
    # above it.
    support_top = np.where(supports, planned_top, -math.inf).max(axis=1, initial=-math.inf)
    stands = supports.any(axis=1)
    gap = np.where(stands, np.maximum(planned_bottom - support_top, 0.0), 0.0)
    least_bottom = np.where(stands, -math.inf, planned_bottom)
    half_z = np.broadcast_to(half_size[..., 2], start_pos.shape[:2])
    centre_z = planned_bottom + half_z
    bears: NDArray[np.bool_] = np.any(below, axis=0)
    left: NDArray[np.bool_] = np.any(bears, axis=1)
    while left.any():  # each pass takes all boxes whose boxes below are in place
        boxes = np.flatnonzero(left & ~np.any(bears & left, axis=1))
        left[boxes] = False
        actual_top = np.where(below[:, boxes], (centre_z + half_z)[:, None], -math.inf).max(axis=2)
        bottom = np.maximum(actual_top + gap[boxes], least_bottom[boxes])
        lifted = (np.abs(bottom - planned_bottom[boxes]) > _SAME_HEIGHT_M) & np.isfinite(actual_top)
        centre_z[:, boxes] = np.where(lifted, bottom + half_z[:, boxes], centre_z[:, boxes])
    return centre_z
