"""Variants: how a world differs from its plan's nominal (unchanged) world.

A variant has two halves. The *placement* of a variant consists of the changes that act while boxes are placed, or
before (friction, mass, sizes, placement errors). The *drive* of a variant is what shakes the finished pallet (profile,
strength, direction). Worlds of a plan with the same ``placement_key`` have the same placement. The placement that
several worlds have in common is simulated once, and each of these worlds starts from the settled state.

The scenes of many variants of a plan are made together (``apply_all``). Making scenes together takes 0.05 ms per scene.
Making scenes one by one would take ten times as long: as long as a GPU needs to simulate a small world.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.options.placing import Placing, Way
from petmjx.options.walls import Side
from petmjx.world.error_distributions import Distribution
from petmjx.world.random_streams import WorldKey, rngs
from petmjx.world.release_places import make_room
from petmjx.world.scene import Scene
from petmjx.world.surface_pairs import scaled_pairs

ZERO = Distribution()


@dataclass(frozen=True)
class PlacementChange:
    """The changes of a variant that act while boxes are placed, or before.

    For an attribute that is a ``Distribution``, a separate error is drawn for each box, except for ``friction_rel``.

    Attributes:
        box_friction_factor: factor on the three friction coefficients of boxes.
        carrier_friction_factor: factor on the three friction coefficients of the carrier. MuJoCo uses the larger
            coefficient of two touching geoms, so reducing only one of the two factors changes little.
        mass_factor: factor on the mass of every box. The carrier's mass does not change.
        friction_rel: relative change of the friction of boxes and carrier, in addition to ``box_friction_factor`` and
            ``carrier_friction_factor`` (0.1 = 10 % more). One error is drawn for the whole world, since all cartons of
            a pallet are of the same board and in air of the same humidity.
        mass_rel: relative change of a box's mass, in addition to ``mass_factor``.
        size_mm: change of each dimension of a box, mm.
        size_rel: relative change of each dimension of a box (0.01 = 1 % larger).
        x_mm, y_mm: errors of a box's place along x and y, mm.
        yaw_deg: error of a box's rotation about the vertical, degrees.
        drop_height_mm: height above its place at which a box is released, mm. Negative random heights count as 0.
        placing_name: how boxes are placed, a value of ``petmjx.options.placing.Way``. If ``placing_name`` is None, the
            option ``placing`` applies.
        placing_height_mm, placing_side_mm, placing_speed_m_s, placing_force_n, tines_height_mm: values that replace
            fields of ``petmjx.options.placing.Placing``. For a value of None, the option applies.
        wrap_turns: number of turns of film, which replaces the field ``turns`` of ``petmjx.options.wrap.Wrap``. If
            ``wrap_turns`` is None, the options apply.
        shifts_from_release: whether a box's shift is measured from its place of release, not from its planned place.
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
        """How boxes are placed if these changes are applied to ``placing``. ``errors`` is True if places or sizes of
        boxes have errors."""
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
        """Whether any change of the placement is random, so that repetitions of the placement differ."""
        values = (getattr(self, entry.name) for entry in fields(self))
        return any(isinstance(value, Distribution) and value.random for value in values)


SIZE_ERRORS: Final = frozenset({"size_mm", "size_rel"})
"""Fields of `PlacementChange` with errors of sizes."""
PLACE_AND_SIZE_ERRORS: Final = SIZE_ERRORS | {"x_mm", "y_mm", "yaw_deg"}
"""Fields of `PlacementChange` with errors of places or sizes. If a variant has such an error, a hand carries boxes to
their places, unless the options name another way of placing. Each of these fields also has a term in
``_farthest_m``."""

UNCHANGED = PlacementChange()

PlacementKey = tuple[PlacementChange, int]


@dataclass(frozen=True)
class DriveSpec:
    """What shakes the finished pallet: a profile, its scale or level, and its direction.

    Attributes:
        profile: name of the profile.
        scale: factor on the profile: its scale or level.
        direction_deg: angle by which the profile is rotated about the vertical, degrees.
        scale_to: if given, each world gets a random factor that is uniformly distributed between ``scale`` and
            ``scale_to``. If ``scale_to`` is None, the factor is ``scale``.
    """

    profile: str
    scale: float = 1.0
    direction_deg: float = 0.0
    scale_to: float | None = None


@dataclass(frozen=True)
class LegSpec:
    """A leg of a chain: a part of the pallet's journey, such as a transport by lorry.

    Attributes:
        name: name of the leg.
        drives: what shakes the pallet, in order, with a pause of ``pause_s`` between two drives. If there are no
            drives, the pallet rests for ``pause_s``.
        pause_s: duration of a pause, s.
        wrap_turns: turns of film around the pallet during the leg. If ``wrap_turns`` is None, the options apply.
        open_walls: walls of the carrier that are open during the leg, in addition to the walls that the options open.
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
        index: number of the variant, in the column ``variant`` of results; 0 is the nominal world.
        placement, drive: the two halves of the variant. A world without a drive ends when the boxes are at rest.
        replicate: number of the repetition. Random numbers depend only on the seed, the plan id and this number.
        parameters: column of the results → value in this column.
        legs: the legs of a chain, which replace the drive. A leg begins with the boxes where the previous leg left
            them.
    """

    index: int
    placement: PlacementChange = UNCHANGED
    drive: DriveSpec | None = None
    replicate: int = 0
    parameters: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)
    legs: tuple[LegSpec, ...] = ()

    @property
    def placement_key(self) -> PlacementKey:
        """A key that is equal for all variants of a plan with the same placement. Repetitions have the same placement
        unless something in the placement is random."""
        return (self.placement, self.replicate if self.placement.random else 0)


MIN_SIZE_FRACTION = 0.1
"""Smallest random extent of a box, as a share of its planned extent. Extents must stay positive."""

LARGEST_SIZE_WITH_ERRORS_M = 7.0
"""Largest extent of a box with errors of its size, m. (In a plan, extents are at most
``petmjx.plans.plan_fields.LARGEST_MM``.) Boxes that are not yet placed hang 8 m apart, so larger boxes might touch."""

MIN_MASS_FRACTION = 0.1
"""Smallest random mass of a box, as a share of its mass without errors. MuJoCo refuses bodies without mass."""

MIN_FRICTION_FRACTION = 0.1
"""Smallest random friction coefficient, as a share of the coefficient without errors. Coefficients must stay
positive."""

STEP_TOLERANCE_M = 0.01
"""Box A counts as below box B if, in the plan, A's top is above B's bottom by at most this length, m. So if A and B
overlap seen from above, B is set down on A. If the top of A is still higher, A counts as standing beside B."""

MOST_SPREADS: Final = 5.0
"""``_farthest_m`` assumes that no random error differs from its mean by more than this number of standard deviations.
One normal error in 2 million differs by more."""

_SAME_HEIGHT_M = 1e-9

AT_A_TIME: Final = 256
"""Number of worlds whose scenes are made together. With 43 boxes per world, the largest arrays take 8 MB."""


def apply(scene: Scene, plan_id: str, variant: Variant, seed: int, *, standing: int = 0) -> Scene:
    """The scene of a plan with the changes in a variant's placement. The variant's drive is not used.

    When sizes change, boxes keep their horizontal centres, so neighbours that became larger overlap sideways. During
    the simulation, the hand moves each box to a place with room. With the way of placing ``exact``, there is no hand:
    boxes appear at the nearest places without overlaps (petmjx.world.release_places). Boxes are set down on the actual
    tops of the boxes below.

    Errors along x, along y and in yaw change ``start_pos`` and ``start_quat``. If an error moves a box over a slightly
    higher neighbour, the box is released above that neighbour. Shifts are measured from ``target``, which keeps the
    planned x and y. The z of ``target`` becomes the height at which the box really stands, so that errors of heights do
    not count as shifts. If places or sizes have errors, boxes are placed as ``Placing.for_errors`` states.

    Args:
        scene: the scene without changes.
        plan_id: id of the plan, which the random numbers depend on.
        variant: the variant.
        seed: seed of the random numbers.
        standing: number of boxes, from the first on, that already stand. Boxes that already stand keep their sizes,
            places and masses. A further change of single boxes must leave the first ``standing`` rows alone, too. Only
            friction changes for all boxes, since a world has one factor.

    Returns:
        The changed scene, or ``scene`` itself if nothing changes.
    """
    return next(apply_all(scene, plan_id, (variant,), seed, standing=standing))


def apply_all(
    scene: Scene, plan_id: str, variants: Iterable[Variant], seed: int, *, standing: int = 0
) -> Iterator[Scene]:
    """The scene of each variant, bit-identical to the result of :func:`apply` for this variant alone."""
    for change, group in itertools.groupby(variants, key=lambda variant: variant.placement):
        while batch := list(itertools.islice(group, AT_A_TIME)):
            if change == UNCHANGED:
                yield from (scene for _ in batch)
            else:
                keys = [WorldKey(seed, plan_id, variant.replicate) for variant in batch]
                yield from _changed_scenes(scene, change, keys, standing)


def _changed_scenes(scene: Scene, change: PlacementChange, keys: Sequence[WorldKey], standing: int) -> Iterator[Scene]:
    """The scenes of worlds that differ only in their random numbers. Each key identifies a world.

    In this function, each array has one row per world, or a single row if all worlds are equal.
    """
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
    has_errors = not all(getattr(change, name).zero for name in PLACE_AND_SIZE_ERRORS)
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
    of_worlds = (slippery, half_size, mass, target, start_pos, start_quat)
    # equal worlds share the same objects, so that pickles and tables contain these objects only once
    columns = (values if len(values) > 1 else itertools.repeat(values[0]) for values in of_worlds)
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
    """The scene with its friction coefficients multiplied by the factors of ``change`` and by ``factor``."""
    of_boxes, of_carrier = change.box_friction_factor * factor, change.carrier_friction_factor * factor
    if of_boxes == 1 and of_carrier == 1:
        return scene
    return replace(
        scene,
        friction=scene.friction * of_boxes,
        carrier=replace(scene.carrier, friction=scene.carrier.friction * of_carrier),
        pairs=scaled_pairs(scene.pairs, scene.carrier.surface, of_boxes, of_carrier),
    )


def _changed_half_size(scene: Scene, relative: FloatArray, more_mm: FloatArray) -> FloatArray:
    size = 2.0 * scene.half_size
    changed = size * (1.0 + relative) + mm_to_m(more_mm)
    half: FloatArray = np.clip(changed, MIN_SIZE_FRACTION * size, LARGEST_SIZE_WITH_ERRORS_M) / 2.0
    return half


def _yawed_orientations(quat: FloatArray, yaw: FloatArray) -> FloatArray:
    """(m, n, 4) quaternions (w, x, y, z) of boxes after a rotation by ``yaw``, rad, about the world's z axis."""
    cos, sin = np.cos(yaw / 2), np.sin(yaw / 2)
    w, x, y, z = quat.T
    return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


def _footprint_half(half_size: FloatArray, yaw: FloatArray) -> FloatArray:
    """(m, n, 2) half extents along x and y, m, of the rectangle around each box, seen from above, after a rotation."""
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    x, y = half_size[..., 0], half_size[..., 1]
    return np.stack([cos * x + sin * y, sin * x + cos * y], axis=-1)


def _overlap_mask(centre: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
    """(…, n, n) whether two boxes overlap, seen from above."""

    along: list[NDArray[np.bool_]] = []
    for axis in range(2):
        place, reach = centre[..., axis], half[..., axis]
        apart = np.abs(place[..., :, None] - place[..., None, :])
        along.append(apart < reach[..., :, None] + reach[..., None, :])
    return along[0] & along[1]


def _with_room(
    scene: Scene, change: PlacementChange, half_size: FloatArray, start_pos: FloatArray, yaw: FloatArray, standing: int
) -> FloatArray:
    """(m, n, 2) horizontal places of boxes, m, after overlapping boxes were moved apart. The carrier's walls are
    additional boxes that do not move."""
    carrier, n, target = scene.carrier, scene.n_boxes, scene.target
    sides, walls = carrier.walls, slice(carrier.n_boards, None)
    middle, half = (carrier.pos + carrier.shape_pos)[walls], carrier.half_size[walls]
    above, gap = _lower(scene), carrier.room.gaps(target, scene.half_size, 0.0)
    is_near = np.isfinite(gap[:, [int(side.is_far) for side in sides], [side.axis for side in sides]])
    is_neighbour = np.zeros((n + len(sides),) * 2, bool)
    is_neighbour[:n, :n], is_neighbour[:n, n:], is_neighbour[n:, :n] = ~(above | above.T), is_near, is_near.T

    def joined(of_boxes: FloatArray, of_walls: FloatArray) -> FloatArray:
        repeated = np.broadcast_to(of_walls, (*of_boxes.shape[: of_boxes.ndim - of_walls.ndim], *of_walls.shape))
        return np.concatenate([of_boxes, repeated], axis=of_boxes.ndim - of_walls.ndim)

    moved = make_room(
        joined(start_pos[..., :2], middle[:, :2]),
        joined(half_size, half),
        joined(yaw, np.zeros(len(sides))),
        joined(target[:, :2], middle[:, :2]),
        joined(scene.half_size, half),
        is_neighbour,
        np.concatenate([np.arange(n) >= standing, np.zeros(len(sides), bool)]),
        _farthest_m(scene, change),
    )
    return moved[:, :n]


def _farthest_m(scene: Scene, change: PlacementChange) -> float:
    """Largest planned gap, m, across which two boxes may touch because of errors of their places and sizes."""
    x, y, size, share, yaw = (
        abs(error.centre) + MOST_SPREADS * error.spread
        for error in (change.x_mm, change.y_mm, change.size_mm, change.size_rel, change.yaw_deg)
    )
    half = float(np.hypot(scene.half_size[:, 0], scene.half_size[:, 1]).max(initial=0.0))
    return 2.0 * ((math.hypot(x, y) + size / 2.0) / MM_PER_M + half * (share + min(math.radians(yaw), 1.0)))


def _lower(scene: Scene) -> NDArray[np.bool_]:
    """(n, n) whether the box of the row could be set down on the box of the column, according to their planned
    heights."""
    planned_bottom = scene.target[:, 2] - scene.half_size[:, 2]
    planned_top = scene.target[:, 2] + scene.half_size[:, 2]
    rank = np.argsort(np.argsort(planned_bottom, kind="stable"))
    lower: NDArray[np.bool_] = (planned_top <= planned_bottom[:, None] + STEP_TOLERANCE_M) & (rank < rank[:, None])
    return lower


def _set_down(scene: Scene, half_size: FloatArray, start_pos: FloatArray, yaw: FloatArray) -> FloatArray:
    """(m, n) heights of the boxes' middles, m, after boxes are set down on the actual tops of the boxes below.

    Boxes are set down from the bottom up. Box A is below box B under two conditions: A's planned top is not above B's
    planned bottom (with a tolerance of ``STEP_TOLERANCE_M``), and the two overlap, seen from above, at their planned or
    actual places. The planned gap between a box and the highest box below is kept. For a box that stands on another box
    in the plan, the planned gap is 0, or 0.1 mm if heights are reduced (``build_scene``). The planned gap is larger for
    a box that floats in the plan. If the two boxes overlap vertically in the plan, they do not overlap afterwards.
    """
    planned_bottom = scene.target[:, 2] - scene.half_size[:, 2]
    planned_top = scene.target[:, 2] + scene.half_size[:, 2]
    lower = _lower(scene)
    supports = lower & _overlap_mask(scene.target[:, :2], scene.half_size[:, :2])
    below = supports | (lower & _overlap_mask(start_pos[..., :2], _footprint_half(half_size, yaw)))
    # if a box overlaps no lower box in the plan, seen from above, it stands on the carrier or floats above it
    support_top = np.where(supports, planned_top, -math.inf).max(axis=1, initial=-math.inf)
    stands = supports.any(axis=1)
    gap = np.where(stands, np.maximum(planned_bottom - support_top, 0.0), 0.0)
    least_bottom = np.where(stands, -math.inf, planned_bottom)
    half_z = np.broadcast_to(half_size[..., 2], start_pos.shape[:2])
    centre_z = planned_bottom + half_z
    bears: NDArray[np.bool_] = np.any(below, axis=0)
    left: NDArray[np.bool_] = np.any(bears, axis=1)
    while left.any():  # each pass sets down the boxes whose lower boxes are all set down
        boxes = np.flatnonzero(left & ~np.any(bears & left, axis=1))
        left[boxes] = False
        actual_top = np.where(below[:, boxes], (centre_z + half_z)[:, None], -math.inf).max(axis=2)
        bottom = np.maximum(actual_top + gap[boxes], least_bottom[boxes])
        lifted = (np.abs(bottom - planned_bottom[boxes]) > _SAME_HEIGHT_M) & np.isfinite(actual_top)
        centre_z[:, boxes] = np.where(lifted, bottom + half_z[:, boxes], centre_z[:, boxes])
    return centre_z
