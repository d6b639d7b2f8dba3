"""Decides clear cases of placements without a simulation: boxes that stand beyond doubt, and boxes that fall beyond
doubt.

The bearing of a box is the convex hull of its contacts with the boxes below it; for a box on the carrier, the bearing
is the whole carrier. Loads are passed from box to box by the pressure plane of ``petmjx.packers.pile_balance`` (a
pressure that is a linear function of x and y). Rigid boxes stand if any forces exist that balance them. This is the
safe theorem of statics (Livesley 1978, "Limit analysis of structures formed from rigid blocks", International Journal
for Numerical Methods in Engineering 12, 1853–1871). So if the boxes of a pallet rest at their planned places,
a new box stands beyond doubt under two conditions. First, the weight of the new box, and the loads of all boxes that
carry it, must act well inside the boxes' bearings. Second, no other load on the pallet may be near the edge of a
bearing.

A box falls beyond doubt if its weight acts well outside its bearing, and no body is near enough to catch the box before
it has turned too far. Neighbours could hold the falling box only by friction. The friction at the neighbours is
limited, because the only force that presses the box against its neighbours is the friction under the box. If boxes of
the pallet have moved, they are treated as larger by the distance that they have moved. All other placements are
undecided.

Decisions without a simulation are valid for rigid boxes and for usual thresholds of verdicts (see ``decidable``). The
required distances are chosen so that simulations agree with the decisions; ``python -m benchmarks loop bounds``
compares both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.engines.mujoco.box_motion import shift, tilt_deg
from petmjx.engines.open_world_protocol import Snapshots
from petmjx.loop.box_tables import BoxTable
from petmjx.loop.placement_arguments import Placements
from petmjx.options.carriers import Carrier
from petmjx.options.physics import Cone
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import FAILURES, MOTION_REASONS, Thresholds
from petmjx.packers.pile_balance import MARGIN_M, MARGIN_SHARE, TOUCH_MM, pressure_moments
from petmjx.world.carrier_boards import has_walls
from petmjx.world.growing_scenes import widened_table
from petmjx.world.release_places import NOTHING

OPEN: Final = 0
STANDS: Final = 1
FALLS: Final = -1

KNIFE_SHARE: Final = 0.25
"""If a placement changes the load of a box, this load must act inside the edges of the box's bearing, at a certain
distance from them (``_least_margin``). For all other loads, ``KNIFE_SHARE`` times this distance is enough. If a load
acts nearer to the edge than required, the box may seem to rest while it already begins to turn."""

MOST_LOAD: Final = 100.0
"""A new box stands beyond doubt only if each box that carries it bears at most this load, as a multiple of the carrying
box's own mass. Contacts are soft: a box sinks by about 0.003 mm × load / own mass (docs/rules.md, section 8), which is
0.3 mm for a load of 100 times its own mass."""

MOST_SLENDER: Final = 8.0
"""A new box stands beyond doubt only if the height of its top above the carrier is at most this multiple of a side: the
shortest horizontal side of the new box and of all boxes that carry it. Because contacts are soft, a high pile leans
more than a low one."""

HANGING_SHARE: Final = 0.05
"""The weight of a falling box must act outside the box's bearing (the hull of its contacts), at a distance of at least
this share of the box's shorter side. A box whose weight acts so far outside turns within a second, so the simulation
does not take it for a box at rest."""

HANGING_MM: Final = 10.0
"""The weight of a falling box must act outside the box's bearing (the hull of its contacts), at a distance of at least
this length, mm. The required distance is ``HANGING_MM``, or the distance that ``HANGING_SHARE`` gives, if that is
larger."""

TURN_DEG: Final = 25.0
GONE_MM: Final = 30.0
"""A box is lost if, before a body catches it, it turns by ``TURN_DEG``, or its middle moves down and sideways by
``GONE_MM``. The weight of a lost box acts farther beyond the edge than at the beginning, so the box does not come back.
``TURN_DEG`` exceeds the largest allowed tilt threshold by a quarter, and ``GONE_MM`` exceeds the largest allowed shift
threshold by a half."""

NEAR_MM: Final = 2.0
"""Two boxes with a planned gap of up to this width may touch, because boxes of a pallet at rest can be up to 1 mm off
their planned places."""

CALM_DEG: Final = 0.5
"""Largest tilt of a box that counts as resting at its planned place, degrees. At a tilt of 0.5°, the two sides of a box
that is 350 mm wide differ by 3 mm in height."""

HOLDING: Final = 1.1
"""The friction with which boxes on one side hold a turning box is at most μ² times the weight of the turning box. A box
falls beyond doubt only if even ``HOLDING`` times this friction could not hold it."""

SAME_WAY: Final = 1e-6
"""Two directions count as equal if the cosine of the angle between them differs from 1 by less than this value."""

MOST_BEARERS: Final = 4
"""A placement can be decided only if the new box rests on at most this number of boxes."""

MOST_CORNERS: Final = 4 * MOST_BEARERS

ROUNDING_MM2: Final = 1e-4
"""Tolerance of a cross product of two lengths. If the cross product says that a corner is beyond an edge by less than
this value, the corner counts as being on the edge."""

_AT_ONCE: Final = 512
"""Number of placements that are decided at a time. The tables for 512 placements fit into the cache of a CPU core."""

_USUAL: Final = frozenset({Carrier.EURO_PALLET, Carrier.ROLLCONTAINER})
"""Carriers that are simulated as one piece. Carriers of boards are excluded, because single boards can tip."""


def decidable(sim: Simulation) -> bool:
    """Whether decisions of this module are valid for simulations with the options ``sim``. The options must specify
    rigid boxes that appear at their places, and a carrier of one piece without walls. Contacts must be as stiff as in
    the preset ``pallet`` or stiffer, and thresholds must be near the default thresholds. Boxes may fail only by
    motions."""
    limits, physics = sim.thresholds, sim.physics
    return (
        sim.carrier in _USUAL
        and not has_walls(sim)
        and sim.placing.appears
        and not physics.falls_into_place
        and physics.cone is Cone.ELLIPTIC
        and physics.solref[0] <= 0.02
        and physics.gravity_m_s2 >= 1.0
        and 0.01 <= limits.shift_m <= 0.02
        and limits.shift_floor_m <= 0.001
        and 10.0 <= limits.tilt_deg <= 20.0
        and sim.size_reduction_mm <= 1.0
        and all(failure.reason in MOTION_REASONS for failure in FAILURES)
    )


def boxes_apart_mm(snapshots: Snapshots, thresholds: Thresholds) -> FloatArray:
    """(m, k) upper bound for the distance of any corner of each box from its planned position, mm. The distance is 0 if
    the box rests at its planned place, that is, if its shift is below the smallest shift that counts and its tilt was
    always below ``CALM_DEG``."""
    with np.errstate(invalid="ignore"):  # values after the last box of a pallet are NaN
        m, k = snapshots.max_tilt_deg.shape
        tilted = np.fmax(snapshots.max_tilt_deg, tilt_deg(snapshots.quat.reshape(-1, 4)).reshape(m, k))
        shifted = shift(snapshots.pos, snapshots.target, thresholds.shift_floor_m)
        rests = (shifted == 0).all(axis=2) & (tilted < CALM_DEG)
        offset = np.linalg.norm(snapshots.pos - snapshots.target, axis=2)
        turn = np.sqrt(np.clip(1.0 - snapshots.quat[..., 0] ** 2, 0.0, 1.0))  # sine of half the angle
        apart = (offset + 2 * turn * np.linalg.norm(snapshots.half_size, axis=2)) * MM_PER_M + NEAR_MM
    return np.where(rests | np.isnan(apart), 0.0, apart)


class Bounds:
    """The data with which placements on n pallets are decided without a simulation, updated box by box.

    Args:
        stock: the boxes on the pallets.
        friction: the coefficient of friction between boxes.
    """

    def __init__(self, stock: BoxTable, friction: float) -> None:
        n = len(stock.count)
        self._stock, self._friction = stock, friction
        # for each pallet, the number of its boxes that the tables below have rows for
        self._boxes: NDArray[np.int64] = np.zeros(n, np.int64)
        # Each table below has the shape (n, k, …), with k rows for the boxes of each pallet. At first, k is 1, because
        # few pallets need more rows.
        self._bearers: NDArray[np.int64] = np.full((n, 1, MOST_BEARERS), NOTHING)
        self._shares: FloatArray = np.zeros((n, 1, MOST_BEARERS, 3, 3))
        self._edges: FloatArray = np.zeros((n, 1, MOST_CORNERS, 3))  # in the form of ``_Rests.edges``
        # (n, k) the load of each box must act at least this far inside the edges of the area on which the box lies, mm
        self._least: FloatArray = np.zeros((n, 1))

    def cut(self, pallets: NDArray[np.int64], count: NDArray[np.int64]) -> None:
        """Keep only the first ``count`` boxes of each given pallet."""
        self._boxes[pallets] = np.minimum(self._boxes[pallets], count)

    def of(self, request: Placements, margin: FloatArray, apart_mm: FloatArray) -> NDArray[np.int8]:
        """(m,) the decision about each placement: ``STANDS``, ``FALLS`` or ``OPEN``.

        Args:
            margin: (n,) margins of stability of the pallets; negative for pallets that are not at rest.
            apart_mm: (n, k) distance of each box from its planned place, as computed by ``boxes_apart_mm``.
        """
        pallets, of = np.unique(request.pallet, return_inverse=True)
        self._update(pallets)
        loads, apart = self._loads(pallets), apart_mm[pallets]
        decided = np.full(len(request), OPEN, np.int8)
        for some in np.array_split(np.arange(len(request)), -(-len(request) // _AT_ONCE) or 1):
            boxes = request.take(some)
            rests = _Rests.of(self._stock, boxes, self._stock.count[boxes.pallet])
            moved = apart[of[some], : rests.here.shape[1]]
            decided[some[rests.falls(boxes, moved, self._friction)]] = FALLS
            decided[some[self._stand(rests, boxes, loads[of[some]]) & (moved == 0).all(axis=1)]] = STANDS
        return np.where(margin[request.pallet] >= 0, decided, OPEN).astype(np.int8)

    def _update(self, pallets: NDArray[np.int64]) -> None:
        """Add those boxes of the given pallets that are missing in the tables."""
        stock, most = self._stock, self._stock.mass_kg.shape[1]
        self._bearers = widened_table(self._bearers, most, NOTHING)
        for name in ("_shares", "_edges", "_least"):
            setattr(self, name, widened_table(getattr(self, name), most))
        while len(rows := pallets[self._boxes[pallets] < stock.count[pallets]]):
            at = self._boxes[rows]
            box = stock.box(rows, at)
            rests = _Rests.of(stock, box, at)
            self._bearers[rows, at], self._shares[rows, at] = rests.bearers, rests.shares
            self._edges[rows, at], self._least[rows, at] = rests.edges, _least_margin(box)
            self._boxes[rows] += 1

    def _loads(self, pallets: NDArray[np.int64]) -> FloatArray:
        """(m, k, 3) load of each box of the pallets, including the box's own weight, as (mass, mass × x, mass × y) in
        kg and kg·mm."""
        stock = self._stock
        k = int(stock.count[pallets].max(initial=0))
        middle = stock.corner_mm[pallets, :k, :2] + stock.size_mm[pallets, :k, :2] / 2
        mass = stock.mass_kg[pallets, :k, None]
        return self._passed_down(pallets, np.nan_to_num(mass * np.concatenate([np.ones_like(mass), middle], axis=2)))

    def _passed_down(self, pallets: NDArray[np.int64], loads: FloatArray) -> FloatArray:
        """(m, k, 3) the load on each box: its given load, plus the parts of the loads of higher boxes that reach this
        box. A box rests only on boxes placed earlier, so the loads are passed on from the last box to the first."""
        loads = loads.copy()
        for number in range(loads.shape[1] - 1, 0, -1):
            row = np.flatnonzero(loads[:, number, 0] > 0)
            _pass_on(
                loads, row, self._bearers[pallets[row], number], self._shares[pallets[row], number], loads[row, number]
            )
        return loads

    def _stand(self, rests: _Rests, request: Placements, loads: FloatArray) -> NDArray[np.bool_]:
        """(m,) whether each new box stands beyond doubt.

        Args:
            loads: (m, k, 3) loads of the boxes that are already on the pallets.
        """
        m, k = loads.shape[:2]
        pallets, middle = request.pallet, request.corner_mm[:, :2] + request.size_mm[:, :2] / 2
        least = _least_margin(request)
        stands = rests.rests & (_margin(rests.edges, middle) >= least)
        load = request.mass_kg[:, None] * np.concatenate([np.ones((m, 1)), middle], axis=1)
        added_load: FloatArray = np.zeros((m, k, 3))
        row = np.flatnonzero(stands)
        _pass_on(added_load, row, rests.bearers[row], rests.shares[row], load[row])
        added_load = self._passed_down(pallets, added_load)
        bears = added_load[..., 0] > 0
        after = loads + added_load
        in_table = np.arange(k) < self._stock.count[pallets, None]
        with np.errstate(invalid="ignore", divide="ignore"):  # columns beyond a pallet's boxes hold NaN
            margin = _margin(self._edges[pallets, :k], after[..., 1:] / after[..., :1])
        enough = np.where(bears, 1.0, KNIFE_SHARE) * self._least[pallets, :k]
        stands = stands & (~in_table | (margin >= enough)).all(axis=1)
        light = after[..., 0] > MOST_LOAD * np.nan_to_num(self._stock.mass_kg[pallets, :k], nan=1.0)
        stands &= ~(bears & light).any(axis=1)
        sides = self._stock.size_mm[pallets, :k, :2].min(axis=2)
        narrow = np.where(bears, sides, np.inf).min(axis=1, initial=np.inf)
        narrow = np.minimum(narrow, request.size_mm[:, :2].min(axis=1))
        low: NDArray[np.bool_] = request.corner_mm[:, 2] + request.size_mm[:, 2] <= MOST_SLENDER * narrow
        return np.asarray(stands & low)


def _least_margin(boxes: Placements) -> FloatArray:
    """(m,) smallest distance, mm, at which the load of each box must act inside the edges of the box's bearing (the
    hull of its contacts)."""
    return np.asarray(np.minimum(MARGIN_M * MM_PER_M, MARGIN_SHARE * boxes.size_mm[:, :2].min(axis=1)))


def _pass_on(
    loads: FloatArray, rows: NDArray[np.intp], bearers: NDArray[np.int64], shares: FloatArray, load: FloatArray
) -> None:
    """Divide the loads ``load`` (r, 3) between the boxes that carry them, and add the shares to ``loads`` in place."""
    at, which = np.nonzero(bearers != NOTHING)
    passed = np.einsum("qab,qb->qa", shares[at, which], load[at])
    np.add.at(loads, (rows[at], bearers[at, which]), passed)


class _Turns(NamedTuple):
    """How boxes turn about edges of their bearings (the hulls of their contacts). There is one row for each edge beyond
    which the weight of a box acts.

    Attributes:
        rows: (r,) index of the box.
        towards: (r, 2) horizontal direction in which the box turns.
        edge: (r,) position of the edge along the direction ``towards``, mm.
        outside: (r,) distance beyond the edge at which the weight of the box acts, mm.
        apart: (r, k) distance of the pallet's boxes from their planned places, mm.
    """

    rows: NDArray[np.intp]
    towards: FloatArray
    edge: FloatArray
    outside: FloatArray
    apart: FloatArray

    def take(self, rows: NDArray[np.intp]) -> _Turns:
        """How the boxes in the given rows turn."""
        return _Turns(self.rows[rows], self.towards[rows], self.edge[rows], self.outside[rows], self.apart[rows])


@dataclass(frozen=True, eq=False)
class _Rests:
    """How m new boxes rest on the bodies below them. Of each pallet, only a given number of first boxes is considered.

    Attributes:
        low, high: (m, k, 3) lowest and highest corners of the boxes on the pallets, mm; ``here``: (m, k) whether each
            of these boxes is on the pallet.
        start, end: (m, 3) lowest and highest corners of the new boxes, mm.
        under: (m, k) whether the new box lies on each box of the pallet; ``on_carrier``: (m,) whether the new box lies
            on the carrier.
        rests: (m,) whether the new box lies on something, and overlaps no other box.
        bearers, shares: (m, b) the boxes on which the new box lies, and (m, b, 3, 3) matrices. Each matrix gives the
            part of a load that one of these boxes carries, by the pressure plane of ``petmjx.packers.pile_balance``.
        edges: (m, e, 3) edges of the new box's bearing, as (d, n_x, n_y). A point p is inside an edge by the distance d
            − n · p, mm. d is infinite if the box lies on the carrier, and minus infinity if it lies on nothing.
    """

    low: FloatArray
    high: FloatArray
    here: NDArray[np.bool_]
    start: FloatArray
    end: FloatArray
    under: NDArray[np.bool_]
    on_carrier: NDArray[np.bool_]
    rests: NDArray[np.bool_]
    bearers: NDArray[np.int64]
    shares: FloatArray
    edges: FloatArray

    @classmethod
    def of(cls, stock: BoxTable, request: Placements, count: NDArray[np.int64]) -> _Rests:
        """Find out how the requested boxes rest on the first ``count`` boxes of their pallets."""
        m, k = len(request), int(count.max(initial=0))
        here = np.arange(k) < count[:, None]
        low = stock.corner_mm[request.pallet, :k]
        high = low + stock.size_mm[request.pallet, :k]
        start, end = request.corner_mm, request.corner_mm + request.size_mm
        with np.errstate(invalid="ignore"):  # columns beyond a pallet's boxes hold NaN
            shared = np.minimum(high, end[:, None])[..., :2] - np.maximum(low, start[:, None])[..., :2]
            over = here & (shared > TOUCH_MM).all(axis=2)
            gap = start[:, None, 2] - high[..., 2]
            under = over & (np.abs(gap) <= TOUCH_MM)
            blocked = (over & (gap < -TOUCH_MM)).any(axis=1)
        on_carrier = np.abs(start[:, 2]) <= TOUCH_MM
        row, box = np.nonzero(under)
        rank = np.arange(len(row)) - np.searchsorted(row, row)
        few = np.bincount(row, minlength=m) <= MOST_BEARERS
        row, box, rank = (values[few[row]] for values in (row, box, rank))
        first = np.maximum(low[row, box], start[row])[:, :2]
        last = np.minimum(high[row, box], end[row])[:, :2]
        bearers, shares = np.full((m, MOST_BEARERS), NOTHING), np.zeros((m, MOST_BEARERS, 3, 3))
        bearers[row, rank] = box
        moments = pressure_moments(first, last)
        total = np.tile(np.eye(3), (m, 1, 1)) * ~few[:, None, None]
        np.add.at(total, row, moments)
        total[on_carrier | ~under.any(axis=1)] = np.eye(3)
        shares[row, rank] = moments @ np.linalg.inv(total)[row]
        edges = np.zeros((m, MOST_CORNERS, 3))
        edges[..., 0] = np.where(on_carrier, np.inf, -np.inf)[:, None]
        bearing = np.bincount(row, minlength=m)
        corners = np.stack(
            [first, np.stack([first[:, 0], last[:, 1]], 1), last, np.stack([last[:, 0], first[:, 1]], 1)], 1
        )
        for number in range(1, MOST_BEARERS + 1):
            same_bearing = np.flatnonzero((bearing == number) & ~on_carrier)
            edges[same_bearing] = _hull_edges(
                corners[np.isin(row, same_bearing)].reshape(len(same_bearing), 4 * number, 2)
            )
        rests = (on_carrier | (bearing > 0)) & ~blocked
        return cls(low, high, here, start, end, under, on_carrier, rests, bearers, shares, edges)

    def falls(self, request: Placements, apart: FloatArray, friction: float) -> NDArray[np.bool_]:
        """(m,) whether each new box falls beyond doubt.

        A falling box turns about an edge of its bearing (the hull of its contacts). When a falling box has turned by an
        angle, a point of its base is lower by the tangent of the angle times the point's distance from the edge. A
        point of the box's side has moved outwards by the sine of the angle times the point's height.

        Args:
            apart: (m, k) distance of the pallets' boxes from their planned places, as computed by ``boxes_apart_mm``.
            friction: the coefficient of friction between boxes.
        """
        sides = request.size_mm[:, :2]
        with np.errstate(invalid="ignore"):  # for a box that lies on nothing, self.edges has infinite distances
            outside = self.edges[..., 1:] @ (self.start[:, :2] + sides / 2)[..., None]
            outside = outside[..., 0] - self.edges[..., 0]
        least = np.maximum(HANGING_MM, HANGING_SHARE * sides.min(axis=1))
        falls: NDArray[np.bool_] = self.rests & ~self.on_carrier & (outside.max(axis=1) >= least)
        falls &= ~(self.under & (apart > 0)).any(axis=1)
        rows, which = np.nonzero(falls[:, None] & (outside > 0))
        edges = self.edges[rows, which]
        turns = _Turns(rows, edges[:, 1:], edges[:, 0], outside[rows, which], apart[rows])
        falls[rows[self._may_be_caught(turns, least[rows], friction)]] = False
        return falls

    def _turn_straight(self, turns: _Turns, least: FloatArray) -> NDArray[np.bool_]:
        """(r,) whether each box turns straight: about a single edge along x or y, without turning sideways at the same
        time. A box turns straight only if it is balanced along the edge: the edge must extend by more than ``least``
        (r,) on both sides of the point at which the weight acts."""
        middle = (self.start[turns.rows, :2] + self.end[turns.rows, :2]) / 2
        foot = middle - turns.outside[:, None] * turns.towards
        edges = self.edges[turns.rows]
        with np.errstate(invalid="ignore"):  # edges that do not exist are infinitely far away
            inside = edges[..., 0] - (edges[..., 1:] @ foot[..., None])[..., 0]
        same = (edges[..., 1:] @ turns.towards[..., None])[..., 0] > 1 - SAME_WAY
        along_axis = np.abs(turns.towards).max(axis=1) > 1 - SAME_WAY
        return np.asarray(along_axis & (same | (inside >= least[:, None])).all(axis=1))

    def _may_be_caught(self, turns: _Turns, least: FloatArray, friction: float) -> NDArray[np.bool_]:
        """(r,) whether some body may catch each box before it has turned too far.

        When a box has turned by an angle, its middle has moved down by ``turns.outside`` times the sine of the angle,
        and sideways by half of the box's height times the sine. Before a box has turned by ``TURN_DEG``, it is lost
        only if both motions reach ``GONE_MM``. The sideways motion alone does not count, because the edge about which
        the box turns may slide.

        Args:
            least: as in ``_turn_straight``.
            friction: the coefficient of friction between boxes.
        """
        rows, towards, edge, outside, apart = turns
        z, height = self.start[rows, 2], self.end[rows, 2] - self.start[rows, 2]
        lost_sine = np.maximum(GONE_MM / outside, 2 * GONE_MM / height)
        sine = np.minimum(np.sin(np.radians(TURN_DEG)), lost_sine)
        slope = (sine / np.sqrt(1 - sine**2))[:, None]
        start, end = self.start[rows, None, :2], self.end[rows, None, :2]
        low, high = self.low[rows] - apart[..., None], self.high[rows] + apart[..., None]
        with np.errstate(invalid="ignore"):  # columns beyond a pallet's boxes hold NaN
            shared_low = np.maximum(low[..., :2], start - NEAR_MM)
            shared_high = np.minimum(high[..., :2], end + NEAR_MM)
            over = (shared_high - shared_low > TOUCH_MM).all(axis=2) & ~self.under[rows]
            reach = np.where(towards[:, None] > 0, shared_high, shared_low) @ towards[..., None]
            depth = z[:, None] - high[..., 2]
            bed = over & (depth >= -NEAR_MM) & (depth < slope * (reach[..., 0] - edge[:, None]))
            rise = np.minimum(high[..., 2] - z[:, None], height[:, None])
            out = (sine[:, None] * rise)[..., None] * towards[:, None]
            swept_low = start - NEAR_MM + np.minimum(out, 0.0)
            swept_high = end + NEAR_MM + np.maximum(out, 0.0)
            beside = np.minimum(high[..., :2], swept_high) - np.maximum(low[..., :2], swept_low)
            wall = (rise > 0) & (beside > TOUCH_MM).all(axis=2)
        straight = np.flatnonzero(self._turn_straight(turns, least))
        wall[straight] &= ~self._hold_too_little(turns.take(straight), wall[straight], friction)
        far = (np.where(towards > 0, end[:, 0], start[:, 0]) * towards).sum(axis=1) - edge
        caught: NDArray[np.bool_] = (z < slope[:, 0] * far) | (self.here[rows] & (bed | wall)).any(axis=1)
        return caught

    def _hold_too_little(self, turns: _Turns, wall: NDArray[np.bool_], friction: float) -> NDArray[np.bool_]:
        """(r, k) whether each wall (a neighbouring box) is beside or behind a turning box, and cannot hold the turning
        box by friction. The turning boxes must turn straight, that is, about a single edge along x or y (see
        ``_turn_straight``).

        The force between a wall and the box is at most the friction under the box, which is μ times the box's weight.
        The friction at the wall is at most μ times the force between the wall and the box. The lever arm of the
        friction at the wall is at most the distance from the edge to the farthest point at which the box and the wall
        touch. A wall behind the box and a wall at its side share the friction under the box, so the two walls together
        hold at most √2 times as much as one wall. If there are walls on both sides, the box may be jammed.

        Args:
            wall: (r, k) whether each box of the pallet may touch the turning box.
        """
        rows, towards, edge, outside, apart = turns
        start, end = self.start[rows, None], self.end[rows, None]
        low, high = self.low[rows], self.high[rows]
        on_x = (np.abs(towards[:, :1]) > 0.5)[..., None]
        sign = np.sign(towards.sum(axis=1))[:, None]

        def along(values: FloatArray) -> FloatArray:
            """Distances of points from the edge about which the box turns, along x or y, positive on the side to which
            the box falls."""
            return np.asarray(np.where(on_x, values[..., :1], values[..., 1:2])[..., 0] * sign - edge[:, None])

        def across(values: FloatArray) -> FloatArray:
            return np.asarray(np.where(on_x, values[..., 1:2], values[..., :1])[..., 0])

        near, far = np.minimum(along(low), along(high)), np.maximum(along(low), along(high))
        back, front = np.minimum(along(start), along(end)), np.maximum(along(start), along(end))
        with np.errstate(invalid="ignore"):  # columns beyond a pallet's boxes hold NaN
            left, right = across(high) <= across(start) + TOUCH_MM, across(low) >= across(end) - TOUCH_MM
            behind = far <= back + TOUCH_MM
            beside = (apart == 0) & (near < front - TOUCH_MM) & (left | right | behind)
            lever = np.hypot(
                np.maximum(np.abs(np.maximum(near, back)), np.abs(np.minimum(far, front))),
                np.minimum(high[..., 2], end[..., 2]) - start[..., 2],
            )
        on_left, on_right = (wall & left).any(axis=1), (wall & right).any(axis=1)
        sides = (on_left | on_right).astype(float) + (wall & behind).any(axis=1)
        most = HOLDING * np.sqrt(sides) * friction**2
        weak = outside[:, None] > most[:, None] * lever
        jammed = np.asarray(on_left & on_right)
        return np.asarray(beside & weak & ~jammed[:, None])


def _margin(edges: FloatArray, place_mm: FloatArray) -> FloatArray:
    """(…,) distance of points (…, 2) from the edges (…, e, 3) of bearings, mm: positive inside, negative outside."""
    margin: FloatArray = (edges[..., 0] - (edges[..., 1:] @ place_mm[..., None])[..., 0]).min(axis=-1)
    return margin


def _hull_edges(corners: FloatArray) -> FloatArray:
    """(m, e, 3) edges of the convex hulls of (m, c, 2) points, as (d, n_x, n_y): a point p is inside an edge by the
    distance d − n · p. An edge leads from a corner of the hull to the farthest point for which all other points are on
    the left of the edge. If a hull has fewer than e edges, the remaining edges are infinitely far away.
    """
    m = len(corners)
    along = corners[:, None] - corners[:, :, None]  # (m, first, second, 2) vectors between corners
    length = np.linalg.norm(along, axis=-1)
    left = along[..., None, 0] * along[:, :, None, :, 1] - along[..., None, 1] * along[:, :, None, :, 0]
    is_edge = (left >= -ROUNDING_MM2).all(axis=-1) & (length > TOUCH_MM)
    to = np.where(is_edge, length, -1.0).argmax(axis=-1)
    row, start = np.nonzero(is_edge.any(axis=-1))
    x, y = (along[row, start, to[row, start]] / length[row, start, to[row, start], None]).T
    edges = np.zeros((m, MOST_CORNERS, 3))
    edges[..., 0] = np.inf
    edges[row, start] = np.stack([y * corners[row, start, 0] - x * corners[row, start, 1], y, -x], axis=1)
    return edges
