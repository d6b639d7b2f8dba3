"""How far boxes sink into what bears them because contacts are soft, as no carton is.

MuJoCo's contacts are springs. At rest (its documentation, chapter Computation, solver parameters) a contact of
stiffness k and impedance d(x) under the force f is x deep, with

    k · d(x)² · x / (1 − d(x)) = A · f,   k = 1 / (d₁ · τ · ζ)²

and A the sum of the partners' inverse masses, d₁ the impedance beyond the width, τ the time constant and ζ the damping
ratio. Beyond the width that is x = (1 − d₁) · τ² · ζ² · A · f. So a light box gives way under a heavy load, however
stiff it is meant to be: with the values of ``pallet`` and four contacts a face by 0.003 mm × load / own mass.

What is needed for it is known on the host for every engine: plans, masses and the largest force on each box. It is not
read from final poses, since a column that stood on a box which gave way may have fallen.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.config import Cone, Physics, Simulation, Triple
from petmjx.units import FloatArray
from petmjx.verdict import Flag, Outcome, Reason, Verdict
from petmjx.world.scene import Scene

CONTACTS_PER_FACE = 4
"""Contacts that MuJoCo makes between two faces: the corners of their common rectangle."""

BOUND_SHARE = 0.25
"""A box may sink by this share of the threshold of shift: 5 mm of 20 mm. Ten equal boxes on top of each other sink by
1 mm, thirty by 9 mm."""

MOST_IMPEDANCE = 0.9999
"""The largest that MuJoCo takes (mjMAXIMP): contacts 10 times as stiff as with 0.999."""

STIFF_TIME_CONSTANT = 0.5
"""Share of the time constant that stiff contacts have: 4 times as stiff."""

LEAST_TIME_CONSTANT_STEPS = 4
"""It stays at least so many timesteps: MuJoCo asks for 2, and at 2.5 pallets were seen to explode."""


def stiffened(physics: Physics) -> Physics:
    """The same physics with contacts that bear light boxes under heavy ones: 40 times as stiff as in ``pallet``."""
    low, high, width = physics.solimp
    solimp = (low if low < high else MOST_IMPEDANCE, MOST_IMPEDANCE, width)
    time_s, damping = physics.solref
    if time_s > 0:
        least_s = LEAST_TIME_CONSTANT_STEPS * physics.timestep_s
        time_s = min(time_s, max(STIFF_TIME_CONSTANT * time_s, least_s))
    return physics.changed(solimp=solimp, solref=(time_s, damping))


DEPTHS_M = np.geomspace(1e-9, 1e3, 2000)
"""Depths for which the force is worked out; between them it is interpolated, to 0.02 %."""


@lru_cache(maxsize=16)
def _pulls_m_s2(solref: tuple[float, float], solimp: Triple, timestep_s: float) -> FloatArray:
    """A · f, m/s², at which a contact is as deep as each of ``DEPTHS_M``."""
    time_s, damping = solref
    low, high = np.minimum(solimp[:2], MOST_IMPEDANCE)
    x = np.minimum(DEPTHS_M / solimp[2], 1.0)
    impedance = low + (high - low) * np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)
    # negative values are stiffness and damping themselves
    stiffness = -time_s if time_s < 0 else 1 / (max(time_s, 2 * timestep_s) * damping) ** 2
    pulls: FloatArray = stiffness / high**2 * impedance**2 * DEPTHS_M / (1 - impedance)
    return np.maximum.accumulate(pulls)


def _depth_m(physics: Physics, pull_m_s2: FloatArray | float) -> FloatArray:
    """Depth of one contact at rest, m, for each A · f in m/s², ≥ 0."""
    pulls = _pulls_m_s2(physics.solref, physics.solimp, physics.timestep_s)
    return np.asarray(np.interp(pull_m_s2, pulls, DEPTHS_M, left=0.0))


def _cone_factor(physics: Physics, *frictions: float) -> float:
    """How much softer a contact of this friction is for its cone.

    A pyramid's four edges have the regularisation 2μ²(1 + μ²) of the elliptic cone's normal each, and act together.
    """
    if physics.cone is Cone.ELLIPTIC:
        return 1.0
    mu2 = max(frictions) ** 2
    return 2 * mu2 * (1 + mu2) / 4


def sinking_m(scene: Scene, physics: Physics, top_force_n: FloatArray, enough_m: float = 0.0) -> FloatArray:
    """(n,) how far each box's centre comes down because the contacts below it give way, m: an upper estimate.

    Args:
        top_force_n: (n,) what presses on each box's top, N; 0 for boxes that were not placed. What exceeds the weight
            of all that the plan has above a box is an impact, over before a box has sunk, and does not count.
        enough_m: where no box can sink by more than this, zeros are returned and nothing is looked at closely.
    """
    gravity, mass, carrier = physics.gravity_m_s2, scene.mass, scene.carrier_mass
    box, plate, floor = scene.box_friction[0], scene.carrier_friction[0], scene.floor_friction[0]
    of_boxes, of_carrier = _cone_factor(physics, box), _cone_factor(physics, box, plate)
    low = scene.target - scene.half_size
    stands_on_carrier = low[:, 2] < ON_CARRIER_M
    own_per_kg = np.where(stands_on_carrier, of_carrier * (1 / mass + 1 / carrier), of_boxes / mass) / CONTACTS_PER_FACE
    on_floor = _cone_factor(physics, plate, floor) * scene.total_mass * gravity / carrier / CONTACTS_PER_FACE
    base = float(_depth_m(physics, on_floor))

    def pulls(top_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) each: a box's part in A · f of a contact on its top, and of one below it, m/s²."""
        return of_boxes * top_n / mass / CONTACTS_PER_FACE, own_per_kg * (top_n + mass * gravity)

    def is_enough(top_n: FloatArray) -> bool:
        # the depth grows less than in proportion to A · f, so that the parts' depths are a bound
        return bool(base + sum(_depth_m(physics, part).sum() for part in pulls(top_n)) <= enough_m)

    if is_enough(top_force_n):
        return np.zeros(len(mass))
    stack = _stack(scene)
    at_rest_n = np.minimum(top_force_n, gravity * stack.mass_above)
    if is_enough(at_rest_n):
        return np.zeros(len(mass))
    above, below = pulls(at_rest_n)
    alone = base + _depth_m(physics, below)
    through = _depth_m(physics, below[stack.upper] + above[stack.lower])
    sinking = np.zeros(len(mass))
    for number, pairs in zip(stack.order, stack.pairs, strict=True):
        sinking[number] = (sinking[stack.lower[pairs]] + through[pairs]).max(initial=alone[number])
    return sinking


class _Stack(NamedTuple):
    """Which boxes of a plan are above which.

    Attributes:
        order: (n,) the boxes from the lowest to the highest.
        upper, lower: (p,) boxes that overlap seen from above, in the order of the upper ones.
        pairs: (n) the pairs of each upper box, in order.
        mass_above: (n,) mass of all boxes that a box may bear, directly or through others, kg.
    """

    order: NDArray[np.intp]
    upper: NDArray[np.intp]
    lower: NDArray[np.intp]
    pairs: list[slice]
    mass_above: FloatArray


@lru_cache(maxsize=256)
def _stack(scene: Scene) -> _Stack:
    """Kept, since in a sweep many worlds have the same scene."""
    low, high = scene.target - scene.half_size, scene.target + scene.half_size
    over = _overlap(low[:, 0], high[:, 0]) & _overlap(low[:, 1], high[:, 1])
    order = np.argsort(scene.target[:, 2], kind="stable")
    under = np.tril(over[np.ix_(order, order)], -1)
    places, lower_places = np.nonzero(under)
    ends = np.cumsum(under.sum(axis=1)).tolist()
    pairs = [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
    return _Stack(order, order[places], order[lower_places], pairs, _mass_above(scene.mass, over, order))


def _mass_above(mass: FloatArray, over: NDArray[np.bool_], order: NDArray[np.intp]) -> FloatArray:
    """(n,) the mass of all boxes that a box may bear, directly or through others, kg.

    No box at rest bears more on its top: what presses down on a box passes on, together with its weight, to the boxes
    under it, and none of it is counted twice.

    Args:
        over: (n, n) whether two boxes overlap seen from above.
        order: (n,) the boxes from the lowest to the highest.
    """
    bears = np.zeros_like(over)
    for place in range(len(order) - 1, -1, -1):
        number, higher = order[place], order[place + 1 :]
        direct = higher[over[number, higher]]
        bears[number, direct] = True
        bears[number] |= bears[direct].any(axis=0)
    total: FloatArray = bears @ mass
    return total


ON_CARRIER_M = 0.001
"""A box whose planned bottom is lower than this stands on the carrier."""


def _overlap(low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """(n, n) whether two boxes overlap along one axis."""
    return np.minimum.outer(high, high) > np.maximum.outer(low, low)


def note_sinking(outcome: Outcome, scene: Scene, sim: Simulation) -> Outcome:
    """The outcome, with ``Flag.SINKING`` where its boxes sank so far that a verdict may come from it.

    Such a world is invalid, so that it is simulated again with contacts that are stiff enough. With pyramidal cones,
    the reference's, it keeps its verdict.
    """
    if outcome.verdict is Verdict.INVALID:
        return outcome
    placed = np.arange(outcome.n_boxes) < outcome.n_placed
    force = np.where(placed, outcome.boxes.max_top_force_n, 0.0)
    limit_m = sim.thresholds.shift_m
    bound_m = BOUND_SHARE * limit_m
    shift = outcome.boxes.shift_m[placed]
    except_down = (np.abs(shift) > limit_m) & (shift > [-np.inf, -np.inf, 0.0])
    only_down = outcome.reason is Reason.SHIFT and not except_down.any()
    sinking = sinking_m(scene, sim.physics, force, enough_m=0.0 if only_down else bound_m)
    sank = bool((sinking > bound_m).any())
    if only_down and not sank:
        without = shift.copy()
        without[:, 2] += np.where(shift[:, 2] < 0, sinking[placed], 0.0)
        sank = bool((np.abs(shift) > limit_m).any() and not (np.abs(without) > limit_m).any())
    if not sank:
        return outcome
    flags = outcome.flags | Flag.SINKING
    if sim.physics.cone is Cone.PYRAMIDAL:
        return replace(outcome, flags=flags)
    return replace(outcome, flags=flags, verdict=Verdict.INVALID, reason=Reason.SINKING)
