"""The physical parameters of a simulation (``Physics``) and their presets: contacts, carrier, floor, gravity and
timestep."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import AfterValidator, Field, computed_field, model_validator

from petmjx.common.checked_records import CheckedRecord, shown_value, within

SHORTEST_TIMESTEP_S: Final = 0.0001
HIGHEST_FRICTION: Final = 100.0
"""Largest allowed coefficient of friction. A larger coefficient is probably a mistake."""

HIGHEST_RESTITUTION: Final = 0.9
"""Largest allowed restitution (speed after a bounce as a share of the speed before). Cardboard has 0.1 to 0.3, and up
to 0.6 in single tosses."""

LANDING_S: Final = 0.003
"""Time in which the preset ``pallet`` stops a landing box, s. With this time, a box that falls 10 mm penetrates its
support by less than 1 mm, and a box that falls 300 mm by less than 9 mm. The time is one and a half steps of 2 ms,
which is sufficient for an accurate landing. The time is an assumption, because no measurements of the stiffness of
landing cartons are known."""

SHORTEST_LANDING_S: Final = 0.0002
LONGEST_LANDING_S: Final = 0.02
"""Smallest and largest allowed value of ``landing_s``, the time in which a landing box is stopped, s."""

RESTITUTION: Final = 0.2
"""Restitution of cardboard (speed after a bounce as a share of the speed before): the middle of the range 0.1 to 0.3.
Measurements of four cartons on a conveyor gave the ranges .05 to .40, 0 to .35, .25 to .40 and .40 to .60 (TU/e, T-RO
2023)."""


class Cone(StrEnum):
    """Shape of the friction cone in MuJoCo's contact model."""

    PYRAMIDAL = "pyramidal"
    ELLIPTIC = "elliptic"


Triple = tuple[float, float, float]


def _no_negatives(values: Triple) -> Triple:
    if min(values) < 0:
        raise ValueError(f"must be ≥ 0, got {values}")
    if max(values) > HIGHEST_FRICTION:
        raise ValueError(f"must be from 0 to {HIGHEST_FRICTION:g}, got {values}")
    return values


def _impedances(values: Triple) -> Triple:
    if not (0 < values[0] < 1 and 0 < values[1] < 1 and values[2] > 0):
        raise ValueError(f"must be two impedances between 0 and 1 and a width > 0 m, got {values}")
    if values[2] > 1:
        raise ValueError(f"must have a width of at most 1 m, got {values}")
    return values


def _contact_times(values: tuple[float, float]) -> tuple[float, float]:
    # Two negative numbers are allowed, because MuJoCo reads negative numbers as stiffness and damping.
    if max(map(abs, values)) > 1e6:
        raise ValueError(f"must be from -1e+06 to 1e+06, got {values}")
    return values


Friction = Annotated[Triple, AfterValidator(_no_negatives)]
"""MuJoCo's coefficients of sliding, torsional and rolling friction of a geom. When two geoms touch, MuJoCo uses the
larger of the two geoms' values for each of the three coefficients. Only the coefficient of sliding friction has an
effect, since contacts have three dimensions (``condim`` 3)."""

CUSTOM: Final = "custom"


class Physics(CheckedRecord):
    """The physical parameters of a simulation: contacts, carrier, floor, gravity and timestep. The default values are
    the same as in the reference implementation (PET-Physics), except for values that differ between the presets. These
    are the cone, the carrier's friction, the seven values of contacts (solref, solreffriction, solimp, impratio,
    slip_correction, landing_s, skin_m), and whether boxes fall into their places. The coefficient of friction between
    boxes, 0.5, is the value for cardboard on cardboard (CTU Code, Annex 7, Appendix 2).

    A ``Physics`` can be made in three ways. The name of a preset, such as "pallet", gives the values of this preset. A
    mapping names a preset and changes some of its values (``{"name": "reference", "timestep_s": 0.001}``). The call
    ``Physics(timestep_s=0.001)`` changes values of the preset ``pallet``.
    """

    cone: Cone = Field(Cone.ELLIPTIC, description="friction cone")
    carrier_friction: Friction = Field(
        (0.5, 0.005, 0.0001),
        description="coefficients of sliding, torsional and rolling friction of the carrier, as in MuJoCo; "
        "only sliding friction acts",
    )
    box_friction: Friction = Field(
        (0.5, 0.005, 0.0001),
        description="coefficients of sliding, torsional and rolling friction of boxes, as in MuJoCo; "
        "only sliding friction acts",
    )
    floor_friction: Friction = Field(
        (1.0, 0.005, 0.0001),
        description="coefficients of sliding, torsional and rolling friction of the floor, as in MuJoCo; "
        "only sliding friction acts",
    )
    floor_z_m: Annotated[float, within(-20, 0)] = Field(
        -0.144,
        lt=0,
        description="z of the floor, m; the carrier's top is at z = 0, so the default is a pallet's height below it",
    )
    carrier_half_height_m: Annotated[float, within(0.001, 10)] = Field(
        0.072, gt=0, description="half the carrier's height, m"
    )
    carrier_mass_kg: Annotated[float, within(0.001, 100_000)] = Field(25.0, gt=0, description="mass of the carrier, kg")
    timestep_s: Annotated[float, within(SHORTEST_TIMESTEP_S, 0.02)] = Field(
        0.002, gt=0, description="length of a time step, s"
    )
    gravity_m_s2: Annotated[float, within(0.001, 100)] = Field(9.81, gt=0, description="gravity, downwards, m/s²")
    solref: Annotated[tuple[float, float], AfterValidator(_contact_times)] = Field(
        (0.02, 1.25), description="MuJoCo's solref of contacts: time constant, s, and damping ratio"
    )
    solreffriction: Annotated[tuple[float, float], AfterValidator(_contact_times)] = Field(
        (0.004, 1.0),
        description="MuJoCo's solreffriction, which needs elliptic cones: time constant of friction, s, and damping "
        "ratio of friction; 0, 0: friction uses the values of solref",
    )
    solimp: Annotated[Triple, AfterValidator(_impedances)] = Field(
        (0.1, 0.999, 0.0001),
        description="MuJoCo's solimp of contacts: impedance at first touch, impedance at full depth, and the full "
        "depth, m",
    )
    impratio: Annotated[float, within(1, 10_000)] = Field(
        100.0,
        description="MuJoCo's impratio: stiffness of friction / stiffness of the normal force, with elliptic cones",
    )
    slip_correction: bool = Field(
        True,
        description="with elliptic cones: true: sliding leaves the normal force of a contact unchanged "
        "(petmjx/world/contact_laws.py); false: sliding increases the normal force, as in MuJoCo itself, so sliding "
        "boxes hop",
    )
    kinetic_friction_share: Annotated[float, within(0.1, 1)] = Field(
        1.0,
        description="coefficient of friction of a contact that slides faster than 2 cm/s, as a share of the contact's "
        "coefficient at rest, with elliptic cones; Annex 7 of the CTU Code sets 0.75",
    )
    landing_s: Annotated[float, within(0, LONGEST_LANDING_S)] = Field(
        LANDING_S,
        description="time in which a landing box is stopped, s, with elliptic cones; 0: the contacts of a landing box "
        "have the same springs as the contacts of a box at rest",
    )
    restitution: Annotated[float, within(0, HIGHEST_RESTITUTION)] = Field(
        RESTITUTION,
        description="speed of a box after it bounces at a landing, as a share of its speed before; used only if "
        "landing_s is not 0",
    )
    skin_m: Annotated[float, within(0, 0.001)] = Field(
        0.0001,
        description="length by which collision detection enlarges boxes on each side, m; collision detection then "
        "prefers contacts of faces to contacts of edges. The carrier is enlarged by twice this length. Contacts of "
        "faces still begin where the boxes themselves touch",
    )
    falls_into_place: bool = Field(
        False,
        description="whether boxes are released above their places, by at least size_reduction_mm, and fall; if "
        "false, boxes are released where they will rest",
    )

    @property
    def carrier_skin_m(self) -> float:
        """Distance by which the carrier is enlarged for collision detection, m.

        The carrier is enlarged by twice the length by which boxes are enlarged. So if a box stands flush with the
        carrier's edge, the box's face is inside the enlarged carrier, and collision detection finds contacts at the
        box's corners (benchmarks/notebook/contacts.md).
        """
        return 2 * self.skin_m

    @property
    def has_landings(self) -> bool:
        """Whether boxes that land have another contact law than boxes at rest (petmjx/world/contact_laws.py). A contact
        law for landings needs elliptic friction cones."""
        return self.cone is Cone.ELLIPTIC and self.landing_s > 0

    @property
    def has_own_friction(self) -> bool:
        """Whether friction has another time constant than the normal force of a contact. A separate time constant needs
        elliptic friction cones."""
        return self.cone is Cone.ELLIPTIC and any(self.solreffriction)

    @computed_field(description="name of the preset that has these values, or 'custom'")  # type: ignore[prop-decorator]  # pydantic's own way
    @property
    def name(self) -> str:
        """The name of the preset that has exactly these values, or "custom"."""
        return next((name for name, preset in PHYSICS.items() if preset == self), CUSTOM)

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, values: Any) -> Any:
        """Accept the name of a preset, or a mapping that changes a preset, as the value of the record."""
        if values == CUSTOM:  # the name "custom" without further values defines no parameters
            raise ValueError(f"must be {' or '.join(PHYSICS)}, or a table of values, {shown_value(values)}")
        if isinstance(values, str):
            values = {"name": values}
        if not isinstance(values, Mapping) or "name" not in values:
            return values
        changes = dict(values)
        name = changes.pop("name")
        if name not in (*PHYSICS, CUSTOM):
            raise ValueError(f"must be {' or '.join(PHYSICS)}, or a table of values, {shown_value(name)}")
        preset = {} if name == CUSTOM else PHYSICS[name].model_dump(exclude={"name"})
        return preset | changes


PHYSICS: dict[str, Physics] = {}
PHYSICS["pallet"] = Physics()
PHYSICS["reference"] = Physics(
    cone=Cone.PYRAMIDAL,
    carrier_friction=(3.0, 0.005, 0.0001),
    solref=(0.02, 1.0),
    solreffriction=(0.0, 0.0),
    solimp=(0.99, 0.99, 0.01),
    impratio=1.0,
    slip_correction=False,
    landing_s=0.0,
    skin_m=0.0,
    falls_into_place=True,
)
"""The presets, by name. ``reference`` has the values of the reference implementation (PET-Physics). With ``pallet``,
simulated pallets come to rest instead of creeping (benchmarks/notebook/contacts.md). For this purpose, ``pallet`` has
elliptic friction cones, an impedance that rises from 0.1 to 0.999 within 0.1 mm, and stiff friction. A box that a
sideways force pushes, but that friction holds, slips 250 times more slowly than with MuJoCo's defaults. ``pallet`` also
has the friction of cardboard on a wooden pallet (CTU Code, Annex 7, Appendix 2)."""
