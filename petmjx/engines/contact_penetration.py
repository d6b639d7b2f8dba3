"""Contact penetration: how far boxes sink into their supports because simulated contacts are softer than any carton.

``petmjx.world.contact_laws`` computes the depth of a contact at rest. The depth follows from the plan, the masses and
the largest force on each box. On all engines, these data are in the CPU's memory. The depth is not read from final
poses: if a stack fell because its support gave way, the final poses do not show the depth.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.contact_tilt import BOUND_SHARE
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict, judge
from petmjx.options.physics import Cone, Physics
from petmjx.options.simulation import Schedule, Simulation
from petmjx.plans.plan_warnings import overlap
from petmjx.world.contact_laws import CONTACTS_PER_FACE, MOST_IMPEDANCE, cone_factor, depth_m
from petmjx.world.job import Job
from petmjx.world.scene import Scene

LEAST_TIME_CONSTANT_STEPS = 4
"""Smallest time constant of contacts, in timesteps. MuJoCo requires 2. With 2.5 timesteps, simulations of pallets
exploded."""

STIFF_QUIET_STEPS = 25
"""In attempts with stiff contacts, boxes must be quiet for at least this number of steps (``Quiet.steps``). The
verdicts of these attempts depend on movements of less than a millimetre. Of 6,000 small stacks whose verdicts follow
from statics, some fell although they should stand: 5 stacks if boxes had to be quiet for 15 steps, 4 for 25 steps, and
3 for 50 steps. With 50 steps, the simulation of a pallet with trembling boxes takes three times as long."""

STIFF_INTERVAL_S = 0.2
"""Value of ``Simulation.interval_s`` in attempts with stiff contacts and the schedule ``adaptive``, s: the time after
which a short wait (docs/rules.md, section 5) ends, even if the pallet is not quiet. A pile with a trembling box may
never be quiet for ``STIFF_QUIET_STEPS``. With the usual 0.7 s, such a pile would wait for 0.7 s before each further
box. 0.2 s are twice the time for which a box counts as landing. The last wait of a world stays long, so a box that tips
slowly is still found."""


def stiffened(sim: Simulation, share: float, timestep_divisor: int = 1) -> Simulation:
    """The options ``sim``, but with stiffer contacts. Boxes in stiffer contacts must be quiet for longer
    (``STIFF_QUIET_STEPS``), and the wait for boxes that are never quiet is shorter (``STIFF_INTERVAL_S``).

    Args:
        share: see ``stiffened_physics``.
        timestep_divisor: usual timestep, divided by the timestep of ``sim``.
    """
    quiet = sim.quiet.model_copy(update={"steps": max(sim.quiet.steps, STIFF_QUIET_STEPS * timestep_divisor)})
    interval_s = min(sim.interval_s, STIFF_INTERVAL_S) if sim.schedule is Schedule.ADAPTIVE else sim.interval_s
    return sim.changed(physics=stiffened_physics(sim.physics, share), quiet=quiet, interval_s=interval_s)


def stiffened_physics(physics: Physics, share: float) -> Physics:
    """The physics ``physics``, but with stiffer contacts. With stiffer contacts, light boxes can carry heavy boxes, and
    slender boxes stay upright.

    The stiffer contacts have a constant impedance (MuJoCo's ``solimp``), the largest that MuJoCo accepts, instead of an
    impedance that rises with the depth. The contacts' time constants are multiplied by ``share``. With a share of 0.5,
    contacts are 40 times as stiff as in the preset ``pallet``; with 0.1, 1,000 times.
    """
    time_s, damping = physics.solref
    if time_s > 0:
        time_s = min(time_s, max(share * time_s, LEAST_TIME_CONSTANT_STEPS * physics.timestep_s))
    friction_s, friction_damping = physics.solreffriction
    changed = {
        "solimp": (MOST_IMPEDANCE, MOST_IMPEDANCE, physics.solimp[2]),
        "solref": (time_s, damping),
        "solreffriction": (share * friction_s if friction_s > 0 else friction_s, friction_damping),
    }
    # The options are not validated again: the timestep may be below the smallest timestep that users may set.
    return physics.model_copy(update=changed)


def contact_penetration_m(scene: Scene, physics: Physics, top_force_n: FloatArray, enough_m: float = 0.0) -> FloatArray:
    """(n,) upper estimate of the distance by which each box's centre descends because contacts below it give way, m.

    Args:
        top_force_n: (n,) largest force on each box's top, N; 0 for boxes that were not placed. If the force is larger
            than the planned weight of all boxes above, it comes from an impact. An impact is over before the box has
            sunk, so only the planned weight is used then.
        enough_m: if no box can descend by more than this distance, zeros are returned without an exact computation.
    """
    gravity, mass, carrier = physics.gravity_m_s2, scene.mass, scene.carrier.mass
    box, plate = scene.friction[:, 0].max(), scene.carrier.friction[:, 0].max()
    of_boxes, of_carrier = cone_factor(physics, box, box), cone_factor(physics, box, plate)
    low = scene.target - scene.half_size
    stands_on_carrier = low[:, 2] < ON_CARRIER_M
    own_per_kg = np.where(stands_on_carrier, of_carrier * (1 / mass + 1 / carrier), of_boxes / mass) / CONTACTS_PER_FACE
    on_floor = (
        cone_factor(physics, plate, scene.floor_friction[0]) * scene.total_mass * gravity / carrier / CONTACTS_PER_FACE
    )
    base = float(depth_m(physics, on_floor))

    def pulls(top_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Each box's part in the products A · f of its contacts, m/s², as two arrays (n,): for a contact on the box's
        top, and for a contact under its base. A · f is the sum of the inverse masses of the two bodies, times the
        contact's force (petmjx.world.contact_laws).
        """
        return of_boxes * top_n / mass / CONTACTS_PER_FACE, own_per_kg * (top_n + mass * gravity)

    def is_enough(top_n: FloatArray) -> bool:
        # The depth of a contact depends on the product A · f, which is the sum of the two parts that ``pulls`` returns.
        # The depth grows less than proportionally to A · f, so it is at most the sum of the depths for the two parts.
        return bool(base + sum(depth_m(physics, part).sum() for part in pulls(top_n)) <= enough_m)

    if is_enough(top_force_n):
        return np.zeros(len(mass))
    stack = _stack(scene)
    at_rest_n = np.minimum(top_force_n, gravity * stack.mass_above)
    if is_enough(at_rest_n):
        return np.zeros(len(mass))
    above, below = pulls(at_rest_n)
    alone = base + depth_m(physics, below)
    pairs = stack.pairs
    through = depth_m(physics, below[pairs.upper] + above[pairs.lower])
    sinking = np.zeros(len(mass))
    for number, span in zip(stack.order, pairs.spans, strict=True):
        sinking[number] = (sinking[pairs.lower[span]] + through[span]).max(initial=alone[number])
    return sinking


def may_penetrate(scene: Scene, sim: Simulation) -> bool:
    """Whether boxes would descend far enough for ``has_penetrated`` if each box carried the whole weight of all boxes
    above it."""
    most_n = np.full(scene.n_boxes, scene.total_mass * sim.physics.gravity_m_s2)
    bound_m = BOUND_SHARE * sim.thresholds.shift_m
    return bool((contact_penetration_m(scene, sim.physics, most_n, enough_m=bound_m) > bound_m).any())


class _Stack:
    """The boxes of a plan sorted by height, and the pairs of boxes that overlap as seen from above."""

    def __init__(self, scene: Scene) -> None:
        low, high = scene.target - scene.half_size, scene.target + scene.half_size
        over = overlap(low[:, 0], high[:, 0]) & overlap(low[:, 1], high[:, 1])
        self.order = np.argsort(scene.target[:, 2], kind="stable")
        """(n,) numbers of the boxes, from the lowest to the highest."""
        self._over = over[np.ix_(self.order, self.order)]
        self.mass_above = _mass_above(scene.mass, self._over, self.order)
        """(n,) total mass of the boxes that each box may carry, directly or through other boxes, kg."""

    @cached_property
    def pairs(self) -> _Pairs:
        """All pairs of boxes that overlap as seen from above."""
        under = np.tril(self._over, -1)
        places, lower_places = np.nonzero(under)
        ends = np.cumsum(under.sum(axis=1)).tolist()
        spans = [slice(begin, end) for begin, end in pairwise([0, *ends])]
        return _Pairs(self.order[places], self.order[lower_places], spans)


class _Pairs(NamedTuple):
    """Pairs of boxes that overlap as seen from above, sorted by their upper boxes, from the lowest to the highest.

    Attributes:
        upper, lower: (p,) numbers of the two boxes of each pair.
        spans: for each box, from the lowest to the highest, the slice of the pairs in which the box is the upper box.
    """

    upper: NDArray[np.intp]
    lower: NDArray[np.intp]
    spans: list[slice]


@lru_cache(maxsize=256)
def _stack(scene: Scene) -> _Stack:
    """The boxes of a scene, sorted by height. The result is cached, since many worlds of a sweep have the same
    scene."""
    return _Stack(scene)


def _mass_above(mass: FloatArray, over: NDArray[np.bool_], order: NDArray[np.intp]) -> FloatArray:
    """(n,) total mass of the boxes that each box may carry, directly or through other boxes, kg.

    No box at rest carries more than this mass on its top: each box passes its load and its weight on to the boxes below
    it, so no weight acts twice on the same box.

    Args:
        over: (n, n) whether two boxes overlap as seen from above; rows and columns are sorted as in ``order``.
        order: (n,) numbers of the boxes, from the lowest to the highest.
    """
    total = np.empty(len(mass))
    total[order] = _transitive_closure(over).astype(float) @ mass[order]
    return total


def _transitive_closure(over: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(…, n, n) 1 where the box of the column is above the box of the row, directly or through other boxes; 0
    elsewhere. Rows and columns are sorted from the lowest to the highest box."""
    above = np.triu(over, 1).astype(np.float32)
    while True:  # each product doubles the longest chain of boxes on boxes that the matrix covers
        further = np.minimum(above + above @ above, 1.0)
        if np.array_equal(further, above):
            return above
        above = further


_SUM_ERROR = 1e-9
"""Largest relative difference between two sums of the same numbers that are added in different orders."""

_MOST_PAIRS = 1 << 17
"""Largest number of pairs of boxes that are computed together, unless a single world has more pairs. A matrix over
these pairs takes 1 MB and fits in CPU caches."""

ON_CARRIER_M = 0.001
"""A box stands on the carrier if its planned bottom is less than this height, m, above the carrier's top."""


def note_penetration(outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation) -> list[Outcome]:
    """The outcomes, with ``Flag.SINKING`` if boxes sank so far that the depth of contacts may have decided the verdict.

    A world that gets the flag from this function becomes invalid. With pyramidal friction cones, as in the preset
    ``reference``, all worlds keep their verdict.
    """
    noted, elliptic = list(outcomes), sim.physics.cone is Cone.ELLIPTIC
    scenes = [job.scene for job in jobs]
    did_not = penetration_excluded(outcomes, scenes, sim) if elliptic else [False] * len(outcomes)
    for k, (outcome, scene) in enumerate(zip(outcomes, scenes, strict=True)):
        if outcome.verdict is Verdict.INVALID or scene.soft is not None:  # the law of this module is not for soft boxes
            continue
        if not did_not[k] and has_penetrated(outcome, scene, sim):
            flags = outcome.flags | Flag.SINKING
            verdict, reason = judge(flags, outcome.boxes, outcome.n_placed, sim.thresholds, sank=elliptic)
            noted[k] = replace(outcome, flags=flags, verdict=verdict, reason=reason)
    return noted


def penetration_excluded(outcomes: Sequence[Outcome], scenes: Sequence[Scene], sim: Simulation) -> list[bool]:
    """For each world, whether ``has_penetrated`` is certainly False. This is so if no box of the world descended too
    far, and the reason of the verdict is not a descent (``_failed_otherwise``). For all other worlds,
    ``has_penetrated`` must be called. This function is much faster than ``has_penetrated``, since it computes all
    worlds together. It is valid only for elliptic friction cones."""
    if not outcomes:
        return []
    enough_m = (1 - _SUM_ERROR) * BOUND_SHARE * sim.thresholds.shift_m
    sinking_m = _most_sinking_m(outcomes, scenes, sim.physics)
    counts = np.array([scene.n_boxes for scene in scenes], np.intp)
    open_ = np.flatnonzero(sinking_m > enough_m)
    open_ = open_[np.argsort(counts[open_], kind="stable")]
    while len(open_):
        at_a_time = max(_MOST_PAIRS // int(counts[open_[-1]]) ** 2, 1)
        some, open_ = open_[-at_a_time:], open_[:-at_a_time]
        numbers = some.tolist()
        sinking_m[some] = _deepest_m([outcomes[k] for k in numbers], [scenes[k] for k in numbers], sim.physics)
    of_other_reason = [_failed_otherwise(outcome, sim.thresholds.shift_m) for outcome in outcomes]
    mask: list[bool] = ((sinking_m <= enough_m) & of_other_reason).tolist()
    return mask


def _failed_otherwise(outcome: Outcome, limit_m: float) -> bool:
    """Whether something other than a descent of boxes led to the verdict of a world. The result is True if the reason
    of the verdict is not a shift, or if a box shifted too far sideways or upwards."""
    if outcome.reason is not Reason.SHIFT:
        return True
    shift = outcome.boxes.shift_m[: outcome.n_placed]
    return bool(((np.abs(shift) > limit_m) & (shift > [-np.inf, -np.inf, 0.0])).any())


def _most_sinking_m(outcomes: Sequence[Outcome], scenes: Sequence[Scene], physics: Physics) -> FloatArray:
    """(m,) an upper bound of the largest ``contact_penetration_m`` in each world, m: the sum of the contact depths of
    all boxes of the world, each under the largest force on its top. The bound does not depend on which box lies on
    which."""
    counts = np.array([scene.n_boxes for scene in scenes], np.intp)
    begins = np.cumsum(counts) - counts
    placed = np.arange(counts.sum()) - np.repeat(begins + [outcome.n_placed for outcome in outcomes], counts) < 0
    top_n = np.where(placed, np.concatenate([outcome.boxes.max_top_force_n for outcome in outcomes]), 0.0)
    mass, target, half = (
        np.concatenate([getattr(scene, name) for scene in scenes]) for name in ("mass", "target", "half_size")
    )
    carrier, gravity = np.array([scene.carrier.mass for scene in scenes]), physics.gravity_m_s2
    on_carrier = (target - half)[:, 2] < ON_CARRIER_M
    inverse = 1 / mass + np.where(on_carrier, np.repeat(1 / carrier, counts), 0.0)
    parts = top_n / mass, inverse * (top_n + mass * gravity)
    depth = sum(depth_m(physics, part / CONTACTS_PER_FACE) for part in parts)
    on_floor = np.array([scene.total_mass for scene in scenes]) * gravity / carrier
    bound: FloatArray = depth_m(physics, on_floor / CONTACTS_PER_FACE) + np.add.reduceat(depth, begins)
    return bound


_PLACES: Final = (("target", np.inf), ("half_size", 0.0))


def _deepest_m(outcomes: Sequence[Outcome], scenes: Sequence[Scene], physics: Physics) -> FloatArray:
    """(m,) an upper bound of the largest ``contact_penetration_m`` in each world, m. The value is an upper bound for
    two reasons. First, the depths on the two sides of a contact are added. Second, the largest force on each box's top
    is taken as a force at rest, although it may come from an impact. The forces of impacts are rarely larger than the
    weight of all boxes above, so the bound is close to the exact value."""
    counts = np.array([scene.n_boxes for scene in scenes], np.intp)
    is_box = np.arange(counts.max()) < counts[:, None]

    def filled(values: Iterable[FloatArray], otherwise: float) -> FloatArray:
        joined = np.concatenate([*values])
        table = np.full((*is_box.shape, *joined.shape[1:]), otherwise)
        table[is_box] = joined
        return table

    # each world is padded to the largest number of boxes, with boxes at infinite height, which overlap no box
    place, half = (filled((getattr(scene, name) for scene in scenes), fill) for name, fill in _PLACES)
    order = np.argsort(place[..., 2], axis=1, kind="stable")
    placed = np.arange(counts.max()) < np.array([outcome.n_placed for outcome in outcomes])[:, None]
    top_n = np.where(placed, filled((outcome.boxes.max_top_force_n for outcome in outcomes), 0.0), 0.0)
    mass = filled((scene.mass for scene in scenes), np.inf)
    carrier = np.array([scene.carrier.mass for scene in scenes])
    total, gravity = np.array([scene.total_mass for scene in scenes]), physics.gravity_m_s2
    low, high = place - half, place + half
    inverse = 1 / mass + np.where(low[..., 2] < ON_CARRIER_M, 1 / carrier[:, None], 0.0)
    pull = top_n + np.where(is_box, mass, 0.0) * gravity
    above, below = (depth_m(physics, part / CONTACTS_PER_FACE) for part in (top_n / mass, inverse * pull))
    columns = (low[..., 0], high[..., 0], low[..., 1], high[..., 1], above, below)
    low_x, high_x, low_y, high_y, above, below = (
        np.ascontiguousarray(np.take_along_axis(values, order, axis=1).T) for values in columns
    )
    # From here on, arrays have one column per world and one row per box, from the lowest box to the highest. ``depth``
    # is the distance by which the top of each box descends. It has one more row, the first, for the carrier's top.
    depth = np.empty((len(above) + 1, len(scenes)))
    depth[0] = depth_m(physics, total * gravity / carrier / CONTACTS_PER_FACE)
    over = np.ones((len(above), *depth.shape), bool)
    over[:, 1:] = (high_x > low_x[:, None]) & (low_x < high_x[:, None])
    over[:, 1:] &= (high_y > low_y[:, None]) & (low_y < high_y[:, None])
    otherwise = np.where(over, 0.0, -np.inf)
    for box, part in enumerate(above + below, start=1):
        (depth[:box] + otherwise[box - 1, :box]).max(axis=0, out=depth[box])
        depth[box] += part
    deepest: FloatArray = (depth[1:] - above).max(axis=0)
    return deepest


def has_penetrated(outcome: Outcome, scene: Scene, sim: Simulation) -> bool:
    """Whether the depth of contacts may have decided the verdict of a world."""
    placed = np.arange(outcome.n_boxes) < outcome.n_placed
    force = np.where(placed, outcome.boxes.max_top_force_n, 0.0)
    limit_m = sim.thresholds.shift_m
    bound_m = BOUND_SHARE * limit_m
    otherwise = _failed_otherwise(outcome, limit_m)
    sinking = contact_penetration_m(scene, sim.physics, force, enough_m=bound_m if otherwise else 0.0)
    too_deep = bool((sinking > bound_m).any())
    if too_deep or otherwise:
        return too_deep
    shift = outcome.boxes.shift_m[placed]
    without = shift.copy()
    without[:, 2] += np.where(shift[:, 2] < 0, sinking[placed], 0.0)
    return bool((np.abs(shift) > limit_m).any() and not (np.abs(without) > limit_m).any())
