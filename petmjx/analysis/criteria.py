"""Closed-form criteria of static stability for one plan.

``CRITERIA`` lists all criteria: the name of each criterion, its condition and its slack (the number whose sign gives
the answer). Tables, columns and docs are generated from this list. ``CriterionInputs`` holds the contacts of a plan,
and the values that several criteria use, so that each value is computed only once. The formulas in this module need
only the base of a box and the areas on which the box lies, or the load as a whole. Other modules compute force balance
and the loads that boxes pass to the boxes below.

docs/extending.md explains how to add a criterion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from petmjx.analysis.force_balance import NO_SLACK, Friction, balance_slack
from petmjx.analysis.load_paths import equilibrium_slack, even_bedding, lever_rule, load_slack, strength_slack
from petmjx.analysis.load_polygons import load_polygon_slack
from petmjx.analysis.plan_contacts import (
    N_CORNERS,
    ON_EDGE_MM,
    Hulls,
    IntArray,
    PlanContacts,
    contact_hulls,
    find_contacts,
)
from petmjx.common.checked_records import CheckedRecord, CliFlag, hint, within
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.engines.metrics import DIMENSIONLESS
from petmjx.options.carriers import AnyCarrier, Carrier
from petmjx.options.physics import PHYSICS
from petmjx.options.walls import Walls
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM
from petmjx.world.body_shapes import Room
from petmjx.world.history import CARRIER


@dataclass(frozen=True, eq=False)
class CriterionInputs:
    """The inputs of the criteria for one plan of n boxes.

    Attributes:
        friction: coefficients of friction, used by force balance.
        leans: whether force balance is also computed for boxes that may lean on their neighbours.
        strength_n: (n,) the largest force that each box can bear on its top, N; NaN if unknown. ``strength_n`` is None
            if no box has a known strength.
    """

    contacts: PlanContacts
    friction: Friction
    leans: bool
    strength_n: FloatArray | None

    @cached_property
    def share(self) -> FloatArray:
        """(n,) share of each box's base that lies on boxes or the carrier."""
        return support_share(self.contacts)

    @cached_property
    def corners(self) -> IntArray:
        """(n,) number of bottom corners of each box that lie on a support."""
        return corners_supported(self.contacts)

    @cached_property
    def hulls(self) -> Hulls:
        """For each box, the convex hull of the areas on which it lies."""
        return contact_hulls(self.contacts)

    @cached_property
    def balance(self) -> tuple[FloatArray, FloatArray]:
        """Two arrays (n,) with the slacks of force balance: the first if boxes do not lean on their neighbours, the
        second if boxes may lean. If ``leans`` is not set, the second array is NaN."""
        return balance_slack(self.contacts, self.hulls, self.friction, self.leans)


YES: Final = 1
NO: Final = 0
NOT_ASKED: Final = -1

_ROUNDING: Final = {"mm": ON_EDGE_MM, "1": -NO_SLACK}
"""Unit of a slack → rounding error of the slack, in this unit. A negative slack that differs from 0 by less than this
error counts as 0. For slacks without a unit ("1"), the error is the same as for the criterion force balance. Slacks
that are shares of an area have no unit either. Their rounding error is only 1e-16, but the same value is used for
them."""


@dataclass(frozen=True, eq=False)
class Answers:
    """The answers of c criteria for n boxes. Each box is judged at the moment of its placement, so boxes that are
    placed later do not affect the answers for this box.

    Attributes:
        n_supports: (n,) number of areas on which the box lies (``PlanContacts.n_supports``).
        share: (n,) share of each box's base that lies on boxes or the carrier.
        corners: (n,) number of bottom corners of each box that lie on a support.
        slack: (n, c) the slack of each criterion for each box; NaN if it cannot be computed.
        stable: (n, c) ``YES``, ``NO`` or ``NOT_ASKED``. Force balance is not evaluated for boxes after the first box
            that fails.
    """

    n_supports: IntArray
    share: FloatArray
    corners: IntArray
    slack: FloatArray
    stable: NDArray[np.int8]


def answer(
    plan: Plan,
    criteria: Sequence[Criterion],
    friction: Friction,
    tolerance_mm: float,
    deck_mm: FloatArray | None = None,
    room: Room | None = None,
) -> Answers:
    """Evaluate criteria for one plan.

    Args:
        friction: coefficients of friction, used by force balance.
        tolerance_mm, deck_mm, room: arguments of ``petmjx.analysis.plan_contacts.find_contacts``, which explains them.
    """
    contacts = find_contacts(plan, tolerance_mm, deck_mm, room)
    inputs = CriterionInputs(
        contacts, friction, any(criterion.name == LEANING for criterion in criteria), plan.strength_n
    )
    slacks = [criterion.slack_of(inputs) for criterion in criteria]
    stable = [_stable(slack, criterion) for slack, criterion in zip(slacks, criteria, strict=True)]
    return Answers(
        contacts.n_supports, inputs.share, inputs.corners, np.stack(slacks, axis=1), np.stack(stable, axis=1)
    )


def _stable(slack: FloatArray, criterion: Criterion) -> NDArray[np.int8]:
    """(n,) the answer for each box, which is ``YES`` or ``NO``, depending on the sign of the slack. A slack of NaN
    gives ``NO``. If ``Criterion.ends`` is set, boxes after the first box that fails get ``NOT_ASKED``."""
    rounding = _ROUNDING[criterion.unit]
    stable = (slack > rounding if criterion.strict else slack >= -rounding).astype(np.int8)
    if criterion.ends:
        stable[np.logical_or.accumulate(np.r_[False, stable[:-1] == NO])] = NOT_ASKED
    return stable


def support_share(contacts: PlanContacts) -> FloatArray:
    """(n,) share of each box's base that lies on boxes or the carrier (borne area / base area); 0 for a box that lies
    on nothing.

    If the bodies below a box overlap each other, as in invalid plans, the area that they have in common is counted only
    once.
    """
    area = (contacts.high_mm - contacts.low_mm).prod(axis=1)
    borne = np.bincount(contacts.upper, weights=area, minlength=contacts.n_boxes)
    for box in _with_overlaps(contacts):
        borne[box] = _union_area(contacts, box)
    share: FloatArray = borne / contacts.size_mm[:, :2].prod(axis=1)
    return np.minimum(share, 1.0)


def _with_overlaps(contacts: PlanContacts) -> IntArray:
    """Indices of the boxes that lie on areas which overlap each other."""
    if not (contacts.n_supports > 1).any():
        return np.zeros(0, dtype=np.int64)
    is_overlap = np.equal.outer(contacts.upper, contacts.upper)
    for axis in range(2):
        low, high = contacts.low_mm[:, axis], contacts.high_mm[:, axis]
        is_overlap &= np.minimum.outer(high, high) > np.maximum.outer(low, low)
    return np.unique(contacts.upper[np.triu(is_overlap, k=1).any(axis=1)])


def _union_area(contacts: PlanContacts, box: int) -> float:
    import shapely

    box_contacts = contacts.upper == box
    return float(
        shapely.union_all(shapely.box(*contacts.low_mm[box_contacts].T, *contacts.high_mm[box_contacts].T)).area
    )


def corners_supported(contacts: PlanContacts) -> IntArray:
    """(n,) number of each box's four bottom corners that lie on a support, within the tolerance. A corner on the edge
    of a support counts as lying on the support."""
    count: IntArray = contacts.borne_corners(np.ones(len(contacts.upper), dtype=bool)).sum(axis=1)
    return count


def corner_and_area_slack(share: FloatArray, corners: IntArray, least: tuple[float, float, float]) -> FloatArray:
    """(n,) slack of each box: the borne share of the box's base, minus the required share. The required share depends
    on how many corners of the base are borne.

    Args:
        least: shares of the base that are required with four borne corners, with three, and with fewer.
    """
    four, three, fewer = least
    least_share: FloatArray = np.select([corners >= N_CORNERS, corners == N_CORNERS - 1], [four, three], fewer)
    return share - least_share


SUPPORT_CRITERIA: Final = {f"support_{100 * share:.0f}": share for share in (1.0, 0.9, 0.8, 0.75, 0.7, 0.6, 0.5)}
"""Name of a criterion → share of a box's base that must lie on boxes or the carrier. The share 1 is the whole base; the
other shares are values from Bortfeldt & Wäscher's survey and from a study with the multibody simulator ADAMS."""

LEAST_CORNERS: Final = 3

CORNER_AREA_PAPER: Final = (0.60, 0.80, 0.95)
CORNER_AREA_CODE: Final = (0.50, 0.85, 0.95)
"""Shares of a box's base that must be borne if the box has four borne corners, three, or fewer. ``CORNER_AREA_PAPER``
is from the paper that proposes the criterion, and ``CORNER_AREA_CODE`` from the code of the paper's authors."""

LEAST_TOLERABLE_G: Final = 0.5
"""Acceleration, in g, that a load on a road vehicle must withstand sideways and rearward. Source: EN 12195-1:2010."""


def tolerable_acceleration_g(contacts: PlanContacts, hulls: Hulls, friction: float) -> FloatArray:
    """(n,) for each box, the smallest horizontal acceleration, in g, at which this box, or the whole load placed so
    far, begins to slide or tip.

    The box and the load count as rigid bodies. A body slides when the acceleration in g reaches the coefficient of
    friction. A body tips when the acceleration in g reaches a / h. Here, a is the horizontal distance between the
    body's centre of mass and the edge over which the body tips, and h is the height of the centre above this edge. Both
    conditions follow from statics; EN 12195-1 has the same conditions.
    """
    half_mm = contacts.centre_mm[:, 2] - contacts.corner_mm[:, 2]
    of_box = hulls.distance(np.arange(contacts.n_boxes), contacts.centre_mm[:, :2]) / half_mm
    least: FloatArray = np.minimum(np.minimum(of_box, load_tipping_g(contacts)), friction)
    return least


def load_tipping_g(contacts: PlanContacts) -> FloatArray:
    """(n,) for each box, the horizontal acceleration, in g, at which the load tips. The load is this box and all boxes
    placed before it, taken as one rigid body. The base of this body is the bounding rectangle of the boxes that stand
    on the carrier."""
    low, high = np.full((contacts.n_boxes, 2), np.inf), np.full((contacts.n_boxes, 2), -np.inf)
    on_carrier = contacts.lower == CARRIER
    np.minimum.at(low, contacts.upper[on_carrier], contacts.low_mm[on_carrier])
    np.maximum.at(high, contacts.upper[on_carrier], contacts.high_mm[on_carrier])
    low, high = np.minimum.accumulate(low), np.maximum.accumulate(high)
    mass_kg = contacts.mass_kg[:, None]
    centre = np.cumsum(mass_kg * contacts.centre_mm, axis=0) / np.cumsum(mass_kg, axis=0)
    tipping: FloatArray = np.minimum(centre[:, :2] - low, high - centre[:, :2]).min(axis=1) / centre[:, 2]
    return tipping


MOST_POINTS: Final = {
    "height": 25.0,
    "quadrants": 25.0,
    "fill": 10.0,
    "interlock": 10.0,
    "overhang": 15.0,
    "order": 15.0,
}
"""Property of a load → largest number of points for this property. A seller (docs/criteria.md) gives a load points for
these properties, from 0 to 100 in all. ``load_points`` explains the properties; docs/criteria.md counts ``fill`` and
``interlock`` as one rule. The seller publishes the numbers of points and ``LEAST_POINTS``, but no formulas. The
formulas of ``load_points`` are assumptions: the points for a property are a linear function of a value, from the worst
to the best possible value."""

LEAST_POINTS: Final = 75.0
"""A load with this number of points or more is stable, according to the seller whose rating ``load_points`` imitates
(``MOST_POINTS``)."""


def load_points(contacts: PlanContacts) -> dict[str, float]:
    """The points of a whole load, as a mapping from the names in ``MOST_POINTS`` to points. Each of the six properties
    gives points in proportion to a value:

    - height: all points if the load's centre of mass is at half of the load's height or lower, none if the centre is at
      the top;
    - quadrants: the mass over the lightest quadrant of the load's footprint, divided by a quarter of the load's mass.
      The mass of a box that lies across two quadrants is divided between them. If no box lies on the carrier, the load
      gets no points for this property;
    - fill: volume of the boxes, divided by the volume of the load's bounding box;
    - interlock: among the boxes above the first layer, the share that lies on two boxes or more; all points if there is
      only one layer;
    - overhang: the smallest borne share of any box's base;
    - order: among the contacts between boxes, the share in which the upper box is not heavier than the lower one.
    """
    low, high = contacts.corner_mm, contacts.corner_mm + contacts.size_mm
    extent_mm = high.max(axis=0) - low.min(axis=0)
    centre_mm = np.average(contacts.centre_mm, axis=0, weights=contacts.mass_kg)
    on_carrier = contacts.lower == CARRIER
    edges = np.array(
        [
            contacts.low_mm[on_carrier].min(axis=0, initial=np.inf),
            contacts.high_mm[on_carrier].max(axis=0, initial=-np.inf),
        ]
    )
    middle = edges.mean(axis=0) if on_carrier.any() else np.full(2, np.inf)
    # (n, 2) along x and along y, the share of each box's side that lies before the middle of the load's footprint
    left = np.clip((middle - low[:, :2]) / contacts.size_mm[:, :2], 0.0, 1.0)
    quadrants = [contacts.mass_kg @ (x * y) for x in (left[:, 0], 1 - left[:, 0]) for y in (left[:, 1], 1 - left[:, 1])]
    above = ~np.isin(np.arange(contacts.n_boxes), contacts.upper[on_carrier])
    upper, lower = contacts.upper[~on_carrier], contacts.lower[~on_carrier]
    shares = {
        "height": np.clip(2 * (1 - centre_mm[2] / high[:, 2].max()), 0.0, 1.0),
        "quadrants": 4 * min(quadrants) / contacts.mass_kg.sum(),
        "fill": min(contacts.size_mm.prod(axis=1).sum() / extent_mm.prod(), 1.0),
        "interlock": (contacts.n_supports[above] >= 2).mean() if above.any() else 1.0,
        "overhang": support_share(contacts).min(),
        "order": (contacts.mass_kg[upper] <= contacts.mass_kg[lower]).mean() if len(upper) else 1.0,
    }
    return {name: most * float(shares[name]) for name, most in MOST_POINTS.items()}


def load_points_slack(contacts: PlanContacts) -> FloatArray:
    """(n,) slack of the criterion that gives points to a load (``load_points``): the sum of the points minus
    ``LEAST_POINTS``. Only the last box of a plan gets the slack of the load, because an unfinished load has no points.
    All earlier boxes get the largest possible slack."""
    slack = np.full(contacts.n_boxes, sum(MOST_POINTS.values()) - LEAST_POINTS)
    slack[-1] = sum(load_points(contacts).values()) - LEAST_POINTS
    return slack


_MM: Final = "mm"

_CORNER_SHARE: Final = (
    "largest s such that forces balance all boxes, and each of the n corners under a box carries at least s / n of the "
    "box's weight"
)
"""The slack of force balance (docs/criteria.md, section "Force balance")."""

LEANING: Final = "force_balance_leaning"


@dataclass(frozen=True)
class Criterion:
    """A criterion of static stability.

    Attributes:
        name: name of the criterion, which is also the name of its column in tables.
        asks: the condition under which the criterion calls a box stable.
        slack: definition of the slack, in words. The sign of the slack gives the criterion's answer.
        unit: unit of the slack.
        source: publication from which the criterion comes.
        slack_of: function that computes the slacks (n,) of a plan's boxes; NaN for a box without a slack.
        strict: whether the criterion calls a box with a slack of 0 unstable.
        number: name of the quantity that the criterion compares with a threshold; "" if the criterion has no threshold.
        threshold: the threshold with which the quantity ``number`` is compared. The slack is the quantity minus the
            threshold.
        ends: whether the evaluation of a plan ends at the first box that fails. If the evaluation ends, later boxes get
            no answer.
        usual: whether the criterion is evaluated by default.
    """

    name: str
    asks: str
    slack: str
    unit: str
    source: str
    slack_of: Callable[[CriterionInputs], FloatArray]
    strict: bool = False
    number: str = ""
    threshold: float = 0.0
    ends: bool = False
    usual: bool = True


def _support(name: str, share: float) -> Criterion:
    return Criterion(
        name,
        f"at least {100 * share:.0f} % of the box's base is borne",
        f"borne share - {share:g}",
        DIMENSIONLESS,
        "Bortfeldt & Wäscher 2013",
        lambda inputs: inputs.share - share,
        number="borne share of the base" if share == 1 else "",
        threshold=share if share == 1 else 0.0,
    )


def _corner_area(name: str, least: tuple[float, float, float], source: str) -> Criterion:
    four, three, fewer = (f"{100 * share:.0f} %" for share in least)
    return Criterion(
        name,
        f"more than {four} of the box's base is borne if 4 corners are supported, more than {three} if 3 are, or more "
        f"than {fewer} if fewer are",
        "borne share of the base - required share",
        DIMENSIONLESS,
        source,
        lambda inputs: corner_and_area_slack(inputs.share, inputs.corners, least),
        strict=True,
    )


CRITERIA: Final = (
    *(_support(name, share) for name, share in SUPPORT_CRITERIA.items()),
    Criterion(
        "three_corners",
        f"at least {LEAST_CORNERS} of the box's 4 bottom corners lie on something",
        f"number of supported corners - {LEAST_CORNERS}",
        DIMENSIONLESS,
        "Paquay, Schyns, Limbourg 2016",
        lambda inputs: (inputs.corners - LEAST_CORNERS).astype(np.float64),
    ),
    _corner_area("corner_area_paper", CORNER_AREA_PAPER, "Zhao et al. 2021, paper"),
    _corner_area("corner_area_code", CORNER_AREA_CODE, "Zhao et al. 2021, code"),
    Criterion(
        "centre",
        "the box's centre lies over the hull of its contact areas",
        "how far the box's centre is inside the edge of the hull of its contact areas; negative outside",
        _MM,
        "common",
        lambda inputs: inputs.hulls.distance(np.arange(inputs.contacts.n_boxes), inputs.contacts.centre_mm[:, :2]),
        number="how far the box's centre is inside the edge of the hull of its contact areas",
    ),
    Criterion(
        "load_polygon",
        "the box's centre lies over its load polygon, the hull of those parts of its contact areas that can bear loads",
        "how far the box's centre is inside the edge of its load polygon; negative outside",
        _MM,
        "Gao et al. 2025, arXiv 2507.09123",
        lambda inputs: load_polygon_slack(inputs.contacts),
        number="how far the box's centre is inside the edge of its load polygon",
    ),
    Criterion(
        "stacking_tree",
        "for the box and each box below, the resultant of weight and load acts inside the hull of the contact areas, "
        "if loads are passed down by the lever rule",
        "how far the resultant of weight and load is inside the edge of the hull of the contact areas: smallest value "
        "among the box and the boxes below it",
        _MM,
        "Zhao et al. 2022, arXiv 2108.13680",
        lambda inputs: load_slack(inputs.contacts, inputs.hulls, lever_rule),
        number="smallest distance by which a resultant of weight and load is inside the edge of the hull of the "
        "contact areas",
    ),
    Criterion(
        "equilibrium",
        "for the box and each box below, the resultant of weight and load acts inside the hull of the contact areas, "
        "if loads are passed down in balance of forces and moments",
        "how far the resultant of weight and load is inside the edge of the hull of the contact areas: smallest value "
        "among the box and the boxes below it",
        _MM,
        "Ramos et al. 2016",
        lambda inputs: equilibrium_slack(inputs.contacts, inputs.hulls),
        number="smallest distance by which a resultant of weight and load is inside the edge of the hull of the "
        "contact areas",
    ),
    Criterion(
        "force_balance",
        "every box can be balanced by forces at the corners of the contact areas",
        _CORNER_SHARE,
        DIMENSIONLESS,
        "StableLego, arXiv 2402.10711; Whiting et al. 2009",
        lambda inputs: inputs.balance[0],
        number=_CORNER_SHARE,
        ends=True,
    ),
    Criterion(
        LEANING,
        "every box can be balanced by forces at the corners of the contact areas, if boxes may also press on walls and "
        "on neighbours beside them",
        _CORNER_SHARE,
        DIMENSIONLESS,
        "StableLego, arXiv 2402.10711; Whiting et al. 2009",
        lambda inputs: inputs.balance[1],
        number=_CORNER_SHARE,
        ends=True,
    ),
    Criterion(
        "strength",
        "the box, and each box that bears part of its weight, carries no more than its own strength, if loads are "
        "passed down in balance of forces and moments",
        "smallest value of 1 - load / strength among the box and the boxes that bear part of its weight; 1 if no "
        "strength is known",
        DIMENSIONLESS,
        "McKee, Gander, Wachuta 1963, or the user's own strengths",
        lambda inputs: strength_slack(inputs.contacts, inputs.strength_n, even_bedding),
        usual=False,  # if no strengths are known, this criterion accepts all plans, so it is evaluated only on request
    ),
    Criterion(
        "tolerable_acceleration",
        f"at {LEAST_TOLERABLE_G:g} g, neither the box nor the whole load placed so far slides or tips as a rigid body",
        "smallest acceleration, in g, at which the box or the whole load placed so far slides or tips, minus "
        f"{LEAST_TOLERABLE_G:g}",
        DIMENSIONLESS,
        "EN 12195-1:2010, and statics",
        lambda inputs: (
            tolerable_acceleration_g(inputs.contacts, inputs.hulls, inputs.friction.flat) - LEAST_TOLERABLE_G
        ),
        number="tolerable acceleration, g",
        threshold=LEAST_TOLERABLE_G,
        usual=False,  # evaluated only on request, since this criterion is about transport, not about the load at rest
    ),
    Criterion(
        "load_points",
        f"the load has at least {LEAST_POINTS:g} of the {sum(MOST_POINTS.values()):g} points that five rules of "
        "thumb can give (docs/criteria.md)",
        f"for the last box, the load's points minus {LEAST_POINTS:g}; for all other boxes, "
        f"{sum(MOST_POINTS.values()) - LEAST_POINTS:g}",
        DIMENSIONLESS,
        "a seller's rule of thumb, with formulas of petmjx's own",
        lambda inputs: load_points_slack(inputs.contacts),
        number="points",
        threshold=LEAST_POINTS,
        usual=False,  # evaluated only on request, since this criterion is a rule of thumb
    ),
)
"""All criteria, in the order in which tables list them: criteria about the base of a box come first, and criteria about
the whole stack last."""

NAMES: Final = tuple(criterion.name for criterion in CRITERIA)
_UNNAMED: Final = tuple(criterion.name for criterion in CRITERIA if criterion.usual)


def chosen_criteria(names: Iterable[str] | None = None) -> tuple[Criterion, ...]:
    """The criteria with the given names, in the order of ``CRITERIA``; without names, the default criteria.

    Raises:
        InputError: there is no criterion with one of the names.
    """
    chosen_names = tuple(names or ()) or _UNNAMED
    for name in chosen_names:
        if name not in NAMES:
            raise InputError(f"criteria: there is no {printable_name(name)}; {hint(name, NAMES)}")
    return tuple(criterion for criterion in CRITERIA if criterion.name in chosen_names)


class CriteriaOptions(CheckedRecord):
    """The options of ``petmjx.criteria``: properties of the load and the carrier, and parameters of the comparison with
    a run."""

    friction: Annotated[float, within(0, 10), CliFlag("--friction", "MU")] = Field(
        PHYSICS["pallet"].box_friction[0],
        description="coefficient of friction under boxes, for the criteria force_balance and force_balance_leaning",
    )
    side_friction: Annotated[float, within(0, 10), CliFlag("--side-friction", "MU")] = Field(
        0.0,
        description="coefficient of friction where boxes touch side by side, for the criterion force_balance_leaning",
    )
    tolerance_mm: Annotated[float, within(0, 100), CliFlag("--tolerance-mm", "MM")] = Field(
        DEFAULT_TOLERANCE_MM, description="largest gap or overlap of two boxes that count as touching, mm"
    )
    carrier: Annotated[
        AnyCarrier,
        CliFlag(
            "--carrier", "NAME|FILE", default="the run's carrier; without a run, 'footprint' (the plan's bounding box)"
        ),
    ] = Field(
        Carrier.FOOTPRINT,
        description="carrier on which the boxes stand, as for 'petmjx score'; gaps between boards bear nothing, and a "
        "carrier without boards counts as reaching under all boxes",
    )
    walls: Walls = Field(Walls(), description="walls around the carrier's top, by default the run's walls")
    only: tuple[str, ...] | None = Field(
        None,
        description="names of the criteria to evaluate; by default all but 'strength', 'tolerable_acceleration' and "
        "'load_points'",
    )
    processes: Annotated[int, within(1, 1024)] = Field(
        1, description="number of processes among which the plans are divided"
    )
    p_arrives: Annotated[float, within(0, 1), CliFlag("--p-arrives", "P")] = Field(
        0.5,
        description="if the run is of a chain: least share of a plan's worlds that must arrive so that the plan counts "
        "as standing",
    )
    seed: Annotated[int, within(0, 2**63 - 1), CliFlag("--seed", "SEED")] = Field(
        0,
        description="seed of the random numbers that draw the bootstrap samples and divide the plans into two halves: "
        "thresholds are searched on one half, and tested on the other",
    )

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The criteria to evaluate."""
        return chosen_criteria(self.only)

    @model_validator(mode="after")
    def _names_criteria(self) -> Self:
        chosen_criteria(self.only)
        return self
