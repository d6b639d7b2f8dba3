"""Scenes. A scene describes one world in SI units: its bodies, and their shapes, places, masses and friction.

A scene is made from a plan. In sweeps, a variant (a set of changes) is applied to the scene. Engines get scenes, never
plans. Only scenes assign numbers to bodies and shapes; all other code uses these numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, mm_to_m, round_to_micrometre
from petmjx.options.carriers import extent_m
from petmjx.options.physics import Triple
from petmjx.options.placing import EXACT, Placing
from petmjx.options.simulation import Simulation
from petmjx.options.walls import Side
from petmjx.options.wrap import Wrap
from petmjx.plans.plan import Plan
from petmjx.world.body_shapes import Body, Shapes
from petmjx.world.carrier_boards import body_of, floor_z_m, has_walls, pallet, with_walls
from petmjx.world.history import CARRIER
from petmjx.world.rotation import rotated_vectors
from petmjx.world.sheets_and_pallets import Pieces, pieces_of_sheets, with_pallets
from petmjx.world.surface_pairs import Pairs, find_surfaces

IDENTITY_QUAT = (1.0, 0.0, 0.0, 0.0)

UNWRAPPED: Final = Wrap()

AT_A_TIME: Final = 512
"""Number of plans whose scenes are slices of the same arrays. The arrays stay in memory as long as one of the scenes is
in use."""

OF_BOXES: Final = (
    "half_size",
    "mass",
    "target",
    "start_pos",
    "start_quat",
    "friction",
    "mass_center",
    "inertia_box",
    "surface",
    "approach",
    "stiffness",
    "soft",
)
"""Fields of a scene that have one row per box, unless they are None."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The world of one plan and one variant. Arrays are float64, with one row per box, in packing order.

    The place of a box is the place of its middle, even if its centre of mass is elsewhere.

    Attributes:
        half_size: (n, 3) half extents of the boxes, m.
        mass: (n,) masses of the boxes, kg.
        target: (n, 3) planned places of the boxes, m. A box's shift is measured from its planned place.
        start_pos: (n, 3) places at which the boxes are released, m. Without errors, these places equal ``target``.
        start_quat: (n, 4) orientations of the boxes at release, as quaternions (w, x, y, z).
        friction: (n, 3) sliding, torsional and rolling coefficients of the boxes.
        carrier: the carrier before gravity acts, with its top at z = 0.
        floor_friction: sliding, torsional and rolling coefficients of the floor.
        floor_z: height of the floor, m.
        mass_center: (n, 3) vectors from the boxes' middles to their centres of mass, along the boxes' axes, m. If
            ``mass_center`` is None, the centres of mass are in the middles.
        inertia_box: (n, 3) half extents of solid boxes that have the same inertia as the scene's boxes (see ``Body``),
            m. If ``inertia_box`` is None, the boxes are solid.
        surface: (n,) surface number of each box. If ``surface`` is None, every box has the number 0.
        pairs: the tables with values of contacts for pairs of surfaces, by name (petmjx/world/surface_pairs.py). Values
            without a table are the same for all pairs, as if no surface had a material.
        placing: how boxes are placed.
        approach: (n, 2) horizontal unit vectors along which carried boxes move to their places. If a row is 0, the
            box's direction follows from its neighbours. If ``approach`` is None, the directions of all boxes follow
            from their neighbours.
        stiffness: (n,) force on a box's top per compression of the box, N/m; inf if the box is rigid. If ``stiffness``
            is None, all boxes are rigid.
        soft: (n,) whether each box is a flex body of MuJoCo (petmjx/world/soft_boxes.py). If ``soft`` is None, no box
            is soft.
        wrap: the film around the pallet while the pallet is shaken (petmjx/world/film.py).
        pieces: shapes of the bodies that consist of several shapes: interlayer sheets, which carry load only above
            other bodies, and pallets among the boxes (petmjx/world/sheets_and_pallets.py).
    """

    half_size: NDArray[np.float64]
    mass: NDArray[np.float64]
    target: NDArray[np.float64]
    start_pos: NDArray[np.float64]
    start_quat: NDArray[np.float64]
    friction: NDArray[np.float64]
    carrier: Body
    floor_friction: Triple
    floor_z: float
    mass_center: NDArray[np.float64] | None = None
    inertia_box: NDArray[np.float64] | None = None
    surface: NDArray[np.intp] | None = None
    pairs: Pairs = field(default_factory=dict)
    placing: Placing = EXACT
    approach: NDArray[np.float64] | None = None
    stiffness: NDArray[np.float64] | None = None
    soft: NDArray[np.bool_] | None = None
    pieces: tuple[Pieces, ...] = ()
    wrap: Wrap = UNWRAPPED

    @property
    def n_boxes(self) -> int:
        return len(self.mass)

    def first(self, count: int) -> Scene:
        """The scene with only its first ``count`` boxes."""
        cut = {name: values[:count] for name in OF_BOXES if (values := getattr(self, name)) is not None}
        return replace(self, **cut, pieces=tuple(piece for piece in self.pieces if piece.box < count))

    def with_open_walls(self, sides: Collection[Side]) -> Scene:
        """The scene in which the carrier's walls on the given sides are open, like doors.

        Nothing else changes: open walls still contribute to the carrier's mass. So a simulation of one of the two
        scenes can continue from a state of the other.

        Raises:
            ValueError: the carrier has no wall on one of the sides.
        """
        return replace(self, carrier=self.carrier.without_walls(sides))

    @property
    def all_soft(self) -> Scene:
        """The scene in which all boxes are flex bodies (soft bodies of MuJoCo). Bodies of several shapes, such as
        sheets, stay rigid."""
        soft = np.ones(self.n_boxes, bool)
        soft[[piece.box for piece in self.pieces]] = False
        return replace(self, soft=soft)

    @cached_property
    def total_mass(self) -> float:
        """Mass of all boxes and the carrier, kg. The unit of force profiles is this mass × 9.81 m/s²."""
        return float(self.mass.sum() + self.carrier.mass)

    @cached_property
    def middle(self) -> NDArray[np.float64]:
        """(n, 3) vectors from the boxes' centres of mass to their middles, along the boxes' axes, m. The centre of mass
        is the origin of a box's frame."""
        return np.zeros_like(self.half_size) if self.mass_center is None else -self.mass_center

    def middles(self, frame: NDArray[np.float64], quat: NDArray[np.float64]) -> NDArray[np.float64]:
        """(…, k, 3) middles of the first k boxes, m, given their centres of mass and orientations."""
        if self.mass_center is None:
            return frame
        return frame + rotated_vectors(quat, self.middle[: frame.shape[-2]])

    def frames(self, middle: NDArray[np.float64], quat: NDArray[np.float64]) -> NDArray[np.float64]:
        """(…, k, 3) centres of mass of the first k boxes, m, given their middles and orientations."""
        if self.mass_center is None:
            return middle
        return middle - rotated_vectors(quat, self.middle[: middle.shape[-2]])

    def frame(self, box: int, middle: NDArray[np.float64], quat: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) centre of mass of one box, m, given the box's middle and orientation."""
        if self.mass_center is None:
            return middle
        origin: NDArray[np.float64] = middle - rotated_vectors(quat, self.middle[box])
        return origin

    @cached_property
    def shapes(self) -> Shapes:
        """The shapes of all bodies. A box has one shape. A sheet has one shape per piece, a pallet one per board."""
        carrier = self.carrier
        counts = np.ones(self.n_boxes, np.intp)
        for piece in self.pieces:
            counts[piece.box] = len(piece.half_size)
        body = np.repeat(np.arange(self.n_boxes), counts)
        half_size, pos = self.half_size[body], self.middle[body]
        for piece in self.pieces:
            half_size[body == piece.box] = piece.half_size
            pos[body == piece.box] += piece.pos
        return Shapes(
            body=np.concatenate([np.full(len(carrier.half_size), CARRIER), body]),
            half_size=np.concatenate([carrier.half_size, half_size]),
            pos=np.concatenate([carrier.shape_pos, pos]),
            friction=np.concatenate([carrier.friction, self.friction[body]]),
            surface=np.concatenate(
                [
                    np.zeros(len(carrier.half_size), np.intp) if carrier.surface is None else carrier.surface,
                    np.zeros(len(body), np.intp) if self.surface is None else self.surface[body],
                ]
            ),
        )

    @cached_property
    def inertia_boxes(self) -> NDArray[np.float64]:
        """(n + 1, 3) half extents of solid boxes with the inertia of the carrier and of each box (see ``Body``), m."""
        boxes = self.half_size if self.inertia_box is None else self.inertia_box
        return np.concatenate([self.carrier.inertia_box[None], boxes])


def build_scene(plan: Plan, sim: Simulation) -> Scene:
    """The scene of a plan, without errors of places or sizes.

    Length and width of the boxes are reduced by ``sim.size_reduction_mm``. If boxes fall into their places, the heights
    of the boxes are reduced by this value, too. The front-left-bottom corner of a box does not move. Half sizes and
    centres are rounded half up to 1 µm, as in the reference implementation.
    """
    stiffness = _stiffness(plan) if sim.physics.has_own_friction else None
    carrier, surfaces = carrier_of(plan, sim), find_surfaces(plan, sim)
    boxes = _of_boxes(plan.size_mm, plan.corner_mm, plan.mass_kg.copy(), sim)
    mass_center = None if plan.mass_center_mm is None else mm_to_m(plan.mass_center_mm)
    pallets, mass_center, inertia_box = with_pallets(plan, boxes["half_size"], mass_center)
    sheets = pieces_of_sheets(plan.sheets, boxes["target"], boxes["half_size"], carrier) if plan.kinds else ()
    return Scene(
        **boxes,
        **_of_all(sim),
        carrier=carrier if surfaces is None else replace(carrier, surface=surfaces.of_boards),
        mass_center=mass_center,
        inertia_box=inertia_box,
        surface=None if surfaces is None else surfaces.of_boxes,
        pairs={} if surfaces is None else surfaces.pairs,
        approach=_directions(plan),
        stiffness=stiffness,
        soft=np.isfinite(stiffness) & ~plan.sheets if sim.soft and stiffness is not None else None,
        pieces=(*sheets, *pallets),
    )


def carrier_of(plan: Plan, sim: Simulation) -> Body:
    """The carrier of a plan, with its walls but without surface numbers."""
    boards = pallet(sim.carrier)
    if boards is not None:
        return with_walls(body_of(boards, sim.physics), sim)
    return with_walls(next(_slabs(plan.corner_mm, plan.size_mm, np.array([0]), sim)), sim)


def build_scenes(plans: Iterable[Plan], sim: Simulation) -> Iterator[Scene]:
    """The scene of each plan, in order, as from ``build_scene``. Many plans are computed together; the scenes are
    bit-identical to the scenes of ``build_scene``."""
    slabs, source = _is_slab(sim), iter(plans)
    while batch := list(islice(source, AT_A_TIME)):
        alike = [plan for plan in batch if slabs and _is_plain(plan)]
        size, corner, mass = (
            np.concatenate([getattr(plan, name) for plan in alike] or [np.empty(0)])
            for name in ("size_mm", "corner_mm", "mass_kg")
        )
        together = plain_scenes(size, corner, mass, [plan.n_boxes for plan in alike], sim) if alike else iter(())
        for plan in batch:
            yield next(together) if slabs and _is_plain(plan) else build_scene(plan, sim)


def has_plain_scene(plan: Plan, sim: Simulation) -> bool:
    """Whether ``plain_scenes``, the fast way, can make the scene of a plan."""
    return _is_slab(sim) and _is_plain(plan)


def _is_slab(sim: Simulation) -> bool:
    """Whether the carrier is a slab without walls."""
    return pallet(sim.carrier) is None and not has_walls(sim)


def _is_plain(plan: Plan) -> bool:
    """Whether a plan gives only the sizes, places and masses of its boxes, and no other properties of them."""
    more = plan.mass_center_mm, plan.approach_deg, plan.stiffness_n_mm
    return not plan.kinds and not plan.materials and all(array is None for array in more)


def plain_scenes(
    size: NDArray[np.float64],
    corner: NDArray[np.float64],
    mass: NDArray[np.float64],
    counts: Sequence[int],
    sim: Simulation,
) -> Iterator[Scene]:
    """The scene of each plan, for plans for which ``has_plain_scene`` is True.

    Args:
        size, corner: (n, 3) extents and corners of the boxes of all plans, plan after plan, mm.
        mass: (n,) masses of these boxes, kg.
        counts: number of boxes of each plan.
    """
    ends = np.cumsum(counts)
    boxes, of_all = _of_boxes(size, corner, mass, sim), _of_all(sim)
    carriers, begin = _slabs(corner, size, np.array([0, *ends[:-1]]), sim), 0
    for end, carrier in zip(ends.tolist(), carriers, strict=True):
        rows, begin = slice(begin, end), end
        yield Scene(**{name: values[rows] for name, values in boxes.items()}, **of_all, carrier=carrier)


def _of_boxes(
    size_mm: NDArray[np.float64], corner_mm: NDArray[np.float64], mass_kg: NDArray[np.float64], sim: Simulation
) -> dict[str, Any]:
    """The fields of scenes with one row per box, for the boxes of one or several plans."""
    half_size, target = half_size_and_target(size_mm, corner_mm, sim)
    return {
        "half_size": half_size,
        "mass": mass_kg,
        "target": target,
        "start_pos": target.copy(),
        "start_quat": np.tile(np.array(IDENTITY_QUAT), (len(target), 1)),
        "friction": np.tile(sim.physics.box_friction, (len(target), 1)),
    }


def _of_all(sim: Simulation) -> dict[str, Any]:
    """The fields of scenes that are the same for all plans."""
    return {
        "floor_friction": sim.physics.floor_friction,
        "floor_z": floor_z_m(sim),
        "placing": sim.placing if sim.may_carry or not sim.placing.appears else EXACT,
        "wrap": sim.wrap,
    }


def _slabs(
    corner_mm: NDArray[np.float64], size_mm: NDArray[np.float64], begins: NDArray[np.intp], sim: Simulation
) -> Iterator[Body]:
    """The carriers of plans, if the carrier is a slab, that is, a single box.

    A slab is as long and wide as the plan's bounding box, or has a fixed size with its front-left corner at the origin.

    Args:
        corner_mm, size_mm: (n, 3) corners and extents of the boxes of all plans, plan after plan.
        begins: (p,) row of the first box of each plan.
    """
    physics = sim.physics
    for place, half_size in zip(*slab_places(corner_mm, size_mm, begins, sim), strict=True):
        yield Body.solid(place, half_size, physics.carrier_mass_kg, physics.carrier_friction)


def slab_places(
    corner_mm: NDArray[np.float64], size_mm: NDArray[np.float64], begins: NDArray[np.intp], sim: Simulation
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p, 3) middles and (p, 3) half extents of the carriers of plans, m, if the carrier is a slab.

    Args:
        corner_mm, size_mm, begins: as for ``_slabs``.
    """
    extent, n = extent_m(sim.carrier), len(begins)
    if extent is None:
        low_mm = np.minimum.reduceat(corner_mm[:, :2], begins)
        extent_mm = np.maximum.reduceat((corner_mm + size_mm)[:, :2], begins) - low_mm
        corner, size = low_mm / MM_PER_M, extent_mm / MM_PER_M
    else:
        corner, size = np.zeros((n, 2)), np.tile(np.array(extent), (n, 1))
    thick = np.full((n, 1), sim.physics.carrier_half_height_m)
    return np.hstack([corner + size / 2, -thick]), np.hstack([size / 2, thick])


def half_size_and_target(
    size_mm: NDArray[np.float64], corner_mm: NDArray[np.float64], sim: Simulation
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, 3) half extents and (n, 3) planned middles of boxes, m, given (n, 3) extents and (n, 3) corners, mm."""
    size = size_mm - sim.size_reduction_mm * np.array([1.0, 1.0, float(sim.physics.falls_into_place)])
    return round_to_micrometre(mm_to_m(size / 2)), round_to_micrometre(mm_to_m(corner_mm + size / 2))


def _stiffness(plan: Plan) -> NDArray[np.float64] | None:
    """(n,) stiffness of each box, N/m; inf if the plan gives no stiffness for the box. The result is None if the plan
    gives no stiffness at all."""
    if plan.stiffness_n_mm is None:
        return None
    return np.where(np.isnan(plan.stiffness_n_mm), np.inf, plan.stiffness_n_mm * MM_PER_M)


def _directions(plan: Plan) -> NDArray[np.float64] | None:
    """(n, 2) unit vectors of the horizontal directions in which the plan lets boxes approach their places. A row is 0
    if the plan gives no direction for the box. The result is None if the plan gives no directions."""
    if plan.approach_deg is None:
        return None
    angle = np.radians(plan.approach_deg)
    return np.asarray(np.nan_to_num(np.stack([np.cos(angle), np.sin(angle)], axis=1)))
