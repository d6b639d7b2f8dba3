"""Values of contacts that depend on the two materials that touch, such as friction and bounces: built-in values with
their sources, values that users give, and the list of all such values (``PAIR_TABLES``)."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Final, NamedTuple, Protocol, Self, TypeVar

from pydantic import Field, StrictFloat, model_validator

from petmjx.common.checked_records import CheckedRecord, complaint, within
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.options.physics import HIGHEST_RESTITUTION, LONGEST_LANDING_S, RESTITUTION, SHORTEST_LANDING_S

WOOD: Final = "wood"
STEEL: Final = "steel"
TRAILER_FLOOR: Final = "trailer floor"
RACK_BEAM: Final = "rack beam"

_CTU: Final = {
    ("cardboard", "cardboard"): 0.5,
    ("cardboard", "wood"): 0.5,
    ("film", "wood"): 0.3,
    ("steel", "wood"): 0.3,
    ("plastic", "wood"): 0.2,
    ("plastic", "steel"): 0.15,
    ("steel", "steel"): 0.2,
}
"""Coefficients of static friction of dry surfaces, from the IMO/ILO/UNECE Code of Practice for Packing of Cargo
Transport Units (CTU Code), Annex 7, Appendix 2. The entries there are: cardboard against cardboard; cardboard against
wooden pallet; wooden pallet against shrink film; sawn timber against stainless steel sheet; plastic pallet against
plywood; plastic pallet against stainless steel sheet; smooth metal against smooth metal."""

_GUIDELINES: Final = {("wood", "wood"): 0.5, ("film", "film"): 0.3, ("film", "steel"): 0.3}
"""Coefficients of static friction, from a table of the European Best Practice Guidelines on Cargo Securing for Road
Transport (European Commission). The entries there are: sawn timber against wood; shrink film against shrink film;
shrink film against steel."""

_PALLETS_ON_TRAILERS: Final = {
    (TRAILER_FLOOR, "wood"): (0.32, 0.26),
    ("new wood", TRAILER_FLOOR): (0.35, 0.29),
    ("hickory", TRAILER_FLOOR): (0.32, 0.21),
    ("oak", TRAILER_FLOOR): (0.35, 0.25),
    ("hdpe", TRAILER_FLOOR): (0.31, 0.20),
    ("lldpe", TRAILER_FLOOR): (0.29, 0.24),
}
"""Coefficients of static and of kinetic friction of pallets on the wooden floor of a trailer (SAE 2001-01-2755 and
2002-01-3104). The pallets are of old wood, new wood, hickory, oak, and two plastics."""

_RACKS: Final = {(RACK_BEAM, "wood"): 0.37}
"""Coefficient of static friction of pallets on the beams of a rack. Measurements gave 0.37 to 0.45, at loads of 0.55 to
13 kN (Sideris and others 2010, Earthquake Spectra); the smallest value is used."""

_ON_FLOORS: Final = {
    ("cardboard", TRAILER_FLOOR): 0.5,
    ("film", TRAILER_FLOOR): 0.3,
    ("steel", TRAILER_FLOOR): 0.3,
    ("plastic", TRAILER_FLOOR): 0.2,
}
"""Coefficients of static friction of other materials on the wooden floor of a trailer: the values for wood from
``_CTU``."""

FRICTION_OF_PAIRS: Final[Mapping[tuple[str, str], float]] = {
    **_CTU,
    **_GUIDELINES,
    **_RACKS,
    **_ON_FLOORS,
    **{pair: static for pair, (static, _) in _PALLETS_ON_TRAILERS.items()},
}
"""Pair of materials in alphabetical order → coefficient of static friction between them. For cargo that already slides,
the CTU Code uses 75 % of this coefficient (option ``physics.kinetic_friction_share``)."""

KINETIC_OF_PAIRS: Final[Mapping[tuple[str, str], float]] = {
    pair: kinetic for pair, (_, kinetic) in _PALLETS_ON_TRAILERS.items()
}
"""Pair of materials in alphabetical order → coefficient of kinetic friction between them. Pairs whose coefficient is
unknown have no entry."""

RESTITUTION_OF_PAIRS: Final[Mapping[tuple[str, str], float]] = {
    ("cardboard", "cardboard"): RESTITUTION,
    ("cardboard", "wood"): RESTITUTION,
}
"""Pair of materials in alphabetical order → restitution (speed after a bounce as a share of the speed before). The
value is the middle of the usual range of cardboard (petmjx.options.physics.RESTITUTION). When a carton falls on a hard
surface, the carton itself absorbs the energy, so its restitution is the same on all hard surfaces."""

_MOST_NAMED: Final = 5

Name = Annotated[str, Field(min_length=1, max_length=100)]


class _MaterialPair(CheckedRecord):
    between: tuple[Name, Name] = Field(description="the two materials")

    @property
    def key(self) -> tuple[str, str]:
        """The two materials in alphabetical order, in lower case and without white space around them. Two pairs of the
        same two materials have equal keys, in whatever order the materials are given."""
        return _key(*self.between)


class FrictionPair(_MaterialPair):
    """The coefficient of sliding friction between two materials, which may be the same material."""

    friction: Annotated[StrictFloat, Field(ge=0, le=100)] = Field(
        description="coefficient of sliding friction between the two materials"
    )
    kinetic: Annotated[StrictFloat, Field(ge=0, le=100)] | None = Field(
        None,
        description="coefficient of friction while the materials slide on each other, at most 'friction'; by default "
        "'friction' times physics.kinetic_friction_share",
    )

    @model_validator(mode="after")
    def _slides_more_easily(self) -> Self:
        if self.kinetic is not None and self.kinetic > self.friction:
            raise complaint(f"must be ≤ friction, {self.friction:g}, got {self.kinetic:g}", "kinetic")
        return self


class LandingPair(_MaterialPair):
    """How a box of one material bounces and stops when it lands on another material, or on the same material."""

    restitution: Annotated[float, within(0, HIGHEST_RESTITUTION)] | None = Field(
        None,
        description="speed of a box of one material after it bounces off the other material, as a share of its speed "
        "before; by default the value of petmjx's own table, else physics.restitution",
    )
    landing_s: Annotated[float, within(SHORTEST_LANDING_S, LONGEST_LANDING_S)] | None = Field(
        None,
        description="time in which a box of one material is stopped by the other material, s; by default "
        "physics.landing_s",
    )


Pair = TypeVar("Pair", bound=_MaterialPair)


def friction_between(one: str, other: str, user_pairs: Sequence[FrictionPair]) -> float | None:
    """The coefficient of static friction of a pair of materials; None if it is unknown.

    Upper and lower case of names, and white space around names, are ignored.

    Args:
        user_pairs: pairs that the user gives. The pairs of the user take precedence over petmjx's values, and later
            pairs take precedence over earlier pairs.
    """
    user_pair = _last_of(user_pairs, one, other)
    return FRICTION_OF_PAIRS.get(_key(one, other)) if user_pair is None else user_pair.friction


def kinetic_share_between(one: str, other: str, user_pairs: Sequence[FrictionPair]) -> float | None:
    """The kinetic friction of a pair of materials, as a share of the pair's static friction. If the result is None, the
    share in ``petmjx.Physics`` is used.

    Args:
        user_pairs: pairs of materials that the user gives, as in ``friction_between``.
    """
    user_pair = _last_of(user_pairs, one, other)
    static = friction_between(one, other, user_pairs)
    kinetic = KINETIC_OF_PAIRS.get(_key(one, other)) if user_pair is None else user_pair.kinetic
    return None if kinetic is None or not static else kinetic / static


def _last_of(user_pairs: Sequence[Pair], one: str, other: str) -> Pair | None:
    """The last of the user's pairs that has these two materials; None if there is no such pair, or if one of the
    materials is unknown (empty)."""
    if not (one and other):
        return None
    key = _key(one, other)
    return next((pair for pair in reversed(user_pairs) if pair.key == key), None)


def _key(one: str, other: str) -> tuple[str, str]:
    first, second = sorted((one.strip().lower(), other.strip().lower()))
    return first, second


def check_pairs(boxes: Sequence[str], boards: Iterable[str], user_pairs: Sequence[FrictionPair]) -> None:
    """Check that the friction is known for each pair of materials that may touch: materials of two boxes, or of a box
    and a board.

    Args:
        boxes: the material of each box that has one. A material is paired with itself only if at least two boxes have
            it.
        boards: the materials of the carrier's boards.
        user_pairs: pairs whose friction the user gives.

    Raises:
        InputError: the friction of some pairs is unknown. The message names these pairs.
    """
    count = Counter(boxes)
    pairs = {*itertools.combinations(sorted(count), 2), *((name, name) for name, number in count.items() if number > 1)}
    pairs |= {(min(pair), max(pair)) for pair in itertools.product(count, {*boards})}
    missing = sorted(pair for pair in pairs if friction_between(*pair, user_pairs) is None)
    if missing:
        pair_names = ", ".join(
            f"{printable_name(one)} on {printable_name(other)}" for one, other in missing[:_MOST_NAMED]
        )
        more_text = f" and {count_text(len(missing) - _MOST_NAMED, 'more pair')}" if len(missing) > _MOST_NAMED else ""
        one, other = map(printable_name, missing[0])
        example = f'friction_pairs = [{{between = ["{one}", "{other}"], friction = 0.4}}]'
        raise InputError(f"no friction is known of {pair_names}{more_text}: give it, as in {example}")


class PairOptions(Protocol):
    """The options for pairs of materials, of a ``petmjx.Simulation``."""

    @property
    def friction_pairs(self) -> Sequence[FrictionPair]: ...

    @property
    def landing_pairs(self) -> Sequence[LandingPair]: ...


class PairTable(NamedTuple):
    """A value of contacts that depends on the materials of the two shapes that touch. The scenes of plans with
    materials have a table with an entry for each pair of surfaces (petmjx/world/surface_pairs.py).

    Attributes:
        name: key of the table in the ``pairs`` of scenes and of the tables of worlds on devices. In kernels, the array
            is called ``pair_`` + ``name``.
        noun: the value in messages.
        between: the entry for two materials, given the materials ("" if unknown), the coefficient of friction of the
            board that one of them belongs to (None if the board has none of its own), and the options. A None in the
            entry stands for the value that contacts have without materials.
        entry: shape of an entry; () is one number.
    """

    name: str
    noun: str
    between: Callable[[str, str, float | None, PairOptions], float | tuple[float | None, ...] | None]
    entry: tuple[int, ...] = ()


def _friction(one: str, other: str, of_board: float | None, options: PairOptions) -> float | None:
    return friction_between(one, other, options.friction_pairs) if of_board is None else of_board


def _landing(one: str, other: str, _: float | None, options: PairOptions) -> tuple[float | None, float | None]:
    user_pair = _last_of(options.landing_pairs, one, other)
    restitution, landing_s = (None, None) if user_pair is None else (user_pair.restitution, user_pair.landing_s)
    return RESTITUTION_OF_PAIRS.get(_key(one, other)) if restitution is None else restitution, landing_s


def _kinetic(one: str, other: str, of_board: float | None, options: PairOptions) -> float | None:
    """The kinetic friction as a share of the static friction, which must be the friction of the two materials."""
    return kinetic_share_between(one, other, options.friction_pairs) if of_board is None else None


PAIR_TABLES: Final = (
    PairTable("friction", "friction", _friction),
    PairTable("landing", "landing values", _landing, (2,)),
    PairTable("kinetic", "kinetic friction", _kinetic),
)
"""All values of contacts that depend on a pair of materials. ``friction`` is the coefficient of static friction.
``landing`` has the restitution, and the time in which a landing box is stopped, s. ``kinetic`` is the kinetic friction
as a share of the static friction."""
