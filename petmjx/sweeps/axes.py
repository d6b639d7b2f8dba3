"""The axes of a sweep: which there are, in which units, and what may stand on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    StrictFloat,
    StrictInt,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from petmjx.checked import LIST, TABLE, VALUE, Checked, by_entry, complaint, got, shape
from petmjx.config import within
from petmjx.world.random import WorldKey
from petmjx.world.variants import Distribution, Shape

MAX_AXIS_VALUES: Final = 100_000
"""Values one axis may have; a range with a mistyped step must not fill the memory."""

MAX_STRENGTH: Final = 1000.0
"""Largest level (g), scale or factor. More is a slip of the pen: shocks of packed goods stay below 100 g."""
MAX_FRICTION_FACTOR: Final = 100.0
MIN_MASS_FACTOR: Final = 0.001
"""Smallest factor on masses: MuJoCo takes no body without mass."""
MAX_ERROR: Final = 10_000.0
"""Largest error of a place, mm."""
MAX_ERRORS: Final = {"size_tolerance_mm": 1000.0, "size_tolerance_rel": 1.0, "yaw_error_deg": 360.0}
"""Of what is no error of a place."""

DIRECTIONS_DEG: Final = {"+x": 0.0, "+y": 90.0, "-x": 180.0, "-y": 270.0}

Value = float | str | Distribution


@dataclass(frozen=True)
class AxisKind:
    """One axis as the results have it.

    Attributes:
        column: its column in the results.
        unit: of that column; "1" for factors, "" for names.
        placement: whether another value needs a new placement.
        plain: of an axis of errors, the distribution that a plain number stands for: the standard deviation of a
            normal one around 0, or the fixed value itself.
    """

    column: str
    unit: str
    placement: bool
    plain: Shape = Shape.NORMAL


# Numbers, ranges of them, and lists.

T = TypeVar("T")


def _each_once(values: tuple[T, ...]) -> tuple[T, ...]:
    if not values:
        raise ValueError("is empty: give at least one value, or leave the axis out")
    if len(values) > MAX_AXIS_VALUES:
        raise ValueError(f"has {len(values):,} values, more than {MAX_AXIS_VALUES:,}")
    seen = set()
    for value in values:
        if value in seen:
            raise ValueError(f"holds {_shown(value)} twice")
        seen.add(value)
    return values


def _shown(value: object) -> str:
    if isinstance(value, Distribution):
        return value.label()
    return f"{value:g}" if isinstance(value, float) else repr(value)


def _is_table(value: object) -> str:
    return TABLE if shape(value) == TABLE else VALUE


def _is_list(value: object) -> str:
    return LIST if shape(value) == LIST else VALUE


OneOrMore = Annotated[
    Annotated[tuple[T, ...], AfterValidator(_each_once), Tag(LIST)] | Annotated[T, Tag(VALUE)],
    Discriminator(_is_list),
]
"""A value or a list of values."""


def _degrees(value: object) -> object:
    if isinstance(value, str):
        if value not in DIRECTIONS_DEG:
            raise ValueError(f"must be degrees or one of {', '.join(DIRECTIONS_DEG)}, {got(value)}")
        return DIRECTIONS_DEG[value]
    return value


Positive = Annotated[StrictFloat, Field(gt=0), within(0, MAX_STRENGTH)]
Direction = Annotated[StrictFloat, within(-3600, 3600), BeforeValidator(_degrees)]


class Range(Checked):
    """Numbers from one to another: by a step, so many, or, where a sweep draws samples, any."""

    low: float = Field(alias="from", description="the first value")
    high: float = Field(alias="to", description="the last value, where the step leads there")
    step: Annotated[StrictFloat, Field(gt=0)] | None = Field(None, description="from one value to the next")
    count: Annotated[StrictInt, Field(ge=2, le=MAX_AXIS_VALUES)] | None = Field(None, description="how many values")

    @model_validator(mode="after")
    def _rises_in_steps(self) -> Self:
        if self.high <= self.low:
            raise complaint(f"must be > from = {self.low:g}, got {self.high:g}", "to")
        if self.step is not None and self.count is not None:
            raise ValueError("has both step and count: give one of them")
        if self.step is not None and (self.high - self.low) / self.step >= MAX_AXIS_VALUES:
            raise complaint(f"{self.step:g} makes more than {MAX_AXIS_VALUES:,} values", "step")
        return self

    @property
    def continuous(self) -> bool:
        return self.step is None and self.count is None

    def values(self) -> tuple[float, ...]:
        """Rounded, so that 0.1 + 2 × 0.1 is 0.3."""
        if self.step is not None:
            # A hair more than the quotient, so that 0.1 … 1.6 by 0.1 includes 1.6.
            step, count = self.step, math.floor((self.high - self.low) / self.step + 1e-9) + 1
        else:
            count = self.count or 2
            step = (self.high - self.low) / (count - 1)
        return tuple(round(self.low + index * step, 12) for index in range(count))


class PositiveRange(Range):
    """Of factors and strengths."""

    low: Positive = Field(alias="from", description="the first value")
    high: Positive = Field(alias="to", description="the last value, where the step leads there")


class DirectionRange(Range):
    """Of directions."""

    low: Direction = Field(alias="from", description="the first direction")
    high: Direction = Field(alias="to", description="the last direction, where the step leads there")


Positives = Annotated[
    Annotated[PositiveRange, Tag(TABLE)] | Annotated[OneOrMore[Positive], Tag(VALUE)], Discriminator(_is_table)
]
Directions = Annotated[
    Annotated[DirectionRange, Tag(TABLE)] | Annotated[OneOrMore[Direction], Tag(VALUE)], Discriminator(_is_table)
]

# Errors, each a distribution.

Error = Annotated[StrictFloat, within(-MAX_ERROR, MAX_ERROR)]
Spread = Annotated[StrictFloat, Field(ge=0), within(0, MAX_ERROR)]


class _Normal(Checked):
    distribution: Literal["normal"]
    mean: Error = Field(0.0, description="mean")
    sd: Spread = Field(description="standard deviation")

    def made(self) -> Distribution:
        return Distribution(Shape.NORMAL, self.mean, self.sd)


class _Uniform(Checked):
    distribution: Literal["uniform"]
    low: Error = Field(description="smallest value")
    high: Error = Field(description="largest value")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.high < self.low:
            raise complaint(f"must be ≥ low = {self.low:g}, got {self.high:g}", "high")
        return self

    def made(self) -> Distribution:
        return Distribution(Shape.UNIFORM, (self.low + self.high) / 2, (self.high - self.low) / 2)


class _Fixed(Checked):
    distribution: Literal["fixed"]
    value: Error = Field(description="the error itself")

    def made(self) -> Distribution:
        return Distribution(Shape.FIXED, self.value)


_Table = Annotated[
    Annotated[_Normal, Tag("<normal>")] | Annotated[_Uniform, Tag("<uniform>")] | Annotated[_Fixed, Tag("<fixed>")],
    by_entry("distribution"),
    AfterValidator(lambda table: table.made()),
    Tag(TABLE),
]

Errors = OneOrMore[
    Annotated[
        _Table | Annotated[Spread, AfterValidator(lambda sd: Distribution(Shape.NORMAL, 0.0, sd)), Tag(VALUE)],
        Discriminator(shape),
    ]
]
"""Distributions; a plain number is the standard deviation of a normal one around 0."""

Heights = OneOrMore[
    Annotated[
        _Table | Annotated[Spread, AfterValidator(lambda height: Distribution(Shape.FIXED, height)), Tag(VALUE)],
        Discriminator(shape),
    ]
]
"""Distributions; a plain number is that height itself."""


class Axes(Checked):
    """``[axes]``. Order is the order of nesting: the last axis varies fastest among its half."""

    profile: Annotated[
        OneOrMore[Annotated[str, Field(max_length=100)]] | None, AxisKind("profile", "", placement=False)
    ] = Field(None, description="names of profiles")
    direction: Annotated[Directions | None, AxisKind("direction_deg", "deg", placement=False)] = Field(
        None, description="degrees from +x towards +y, by which the profile is turned; or +x, -x, +y, -y"
    )
    scale: Annotated[Positives | None, AxisKind("scale", "1", placement=False)] = Field(
        None, description="factor on the profile"
    )
    level: Annotated[Positives | None, AxisKind("level_g", "g", placement=False)] = Field(
        None, description="level of the profile, g"
    )
    friction_factor: Annotated[Positives | None, AxisKind("friction_factor", "1", placement=True)] = Field(
        None, description="factor on the friction of boxes and carrier"
    )
    box_friction_factor: Annotated[Positives | None, AxisKind("box_friction_factor", "1", placement=True)] = Field(
        None, description="factor on the friction of boxes alone"
    )
    carrier_friction_factor: Annotated[Positives | None, AxisKind("carrier_friction_factor", "1", placement=True)] = (
        Field(None, description="factor on the friction of the carrier alone")
    )
    mass_factor: Annotated[Positives | None, AxisKind("mass_factor", "1", placement=True)] = Field(
        None, description="factor on the mass of boxes"
    )
    size_tolerance_mm: Annotated[Errors | None, AxisKind("size_tolerance_mm", "mm", placement=True)] = Field(
        None, description="error of each dimension of each box, mm"
    )
    size_tolerance_rel: Annotated[Errors | None, AxisKind("size_tolerance_rel", "1", placement=True)] = Field(
        None, description="the same as a share of the dimension"
    )
    placement_error_mm: Annotated[Errors | None, AxisKind("placement_error_mm", "mm", placement=True)] = Field(
        None, description="error of each box's place in x and in y, mm"
    )
    placement_error_x_mm: Annotated[Errors | None, AxisKind("placement_error_x_mm", "mm", placement=True)] = Field(
        None, description="the same in x alone, mm"
    )
    placement_error_y_mm: Annotated[Errors | None, AxisKind("placement_error_y_mm", "mm", placement=True)] = Field(
        None, description="the same in y alone, mm"
    )
    yaw_error_deg: Annotated[Errors | None, AxisKind("yaw_error_deg", "deg", placement=True)] = Field(
        None, description="turn of each box about the vertical, degrees"
    )
    drop_height_mm: Annotated[Heights | None, AxisKind("drop_height_mm", "mm", True, Shape.FIXED)] = Field(
        None, description="height of release above the place, mm"
    )

    @field_validator("mass_factor")
    @classmethod
    def _leaves_a_mass(cls, given: Any) -> Any:
        lowest = given.low if isinstance(given, Range) else min(given) if isinstance(given, tuple) else given
        if lowest < MIN_MASS_FACTOR:
            raise ValueError(f"must be ≥ {MIN_MASS_FACTOR:g}, got {lowest:g}")
        return given

    @field_validator("friction_factor", "box_friction_factor", "carrier_friction_factor")
    @classmethod
    def _is_a_friction(cls, given: Any) -> Any:
        highest = given.high if isinstance(given, Range) else max(given) if isinstance(given, tuple) else given
        if highest > MAX_FRICTION_FACTOR:
            raise ValueError(f"must be from 0 to {MAX_FRICTION_FACTOR:g}, got {highest:g}")
        return given

    @field_validator(*MAX_ERRORS)
    @classmethod
    def _is_an_error(cls, given: Any, info: ValidationInfo) -> Any:
        largest = MAX_ERRORS[info.field_name or ""]
        for error in given if isinstance(given, tuple) else (given,):
            if max(abs(error.centre), error.spread) > largest:
                raise ValueError(f"must be from {-largest:g} to {largest:g}, got {error.label()}")
        return given


AXIS_KINDS: Final[dict[str, AxisKind]] = {
    name: next(entry for entry in info.metadata if isinstance(entry, AxisKind))
    for name, info in Axes.model_fields.items()
}
"""Every axis a sweep file may have, in the order of `Axes`."""


@dataclass(frozen=True)
class Axis:
    """One axis of a sweep: its values, or for samples a continuous range."""

    name: str
    values: tuple[Value, ...] = ()
    low: float = math.nan
    high: float = math.nan

    @property
    def continuous(self) -> bool:
        return not self.values

    @property
    def kind(self) -> AxisKind:
        return AXIS_KINDS[self.name]

    @property
    def random(self) -> bool:
        """Whether two replicates differ on it."""
        return any(isinstance(value, Distribution) and value.random for value in self.values)

    def pick(self, key: WorldKey) -> Value:
        """One value at random, depending on the key and the axis alone."""
        rng = key.rng(f"design:{self.name}")
        if self.continuous:
            return float(rng.uniform(self.low, self.high))
        return self.values[int(rng.integers(len(self.values)))]

    def cell(self, value: Value) -> float | str:
        """A value as it stands in the results: distributions by their number where the axis has one shape
        around zero, else written out."""
        if not isinstance(value, Distribution):
            return value
        numbers = [self._plain_number(entry) for entry in self.values]
        if any(number is None for number in numbers):
            return value.label()
        number = self._plain_number(value)
        return value.label() if number is None else number

    def _plain_number(self, value: Value) -> float | None:
        """The plain number that stands for a value in a sweep file; None where it takes a table."""
        if not isinstance(value, Distribution) or value.shape is not self.kind.plain:
            return None
        if value.shape is Shape.FIXED:
            return value.centre
        return value.spread if value.centre == 0 else None

    def described(self) -> object:
        """The axis as plain JSON values."""
        if self.continuous:
            return {"from": self.low, "to": self.high}
        return [value.label() if isinstance(value, Distribution) else value for value in self.values]


def read_axes(tables: Any, sampled: bool) -> dict[str, Axis]:
    """``[axes]`` as axes by name, in the order of the file; for a validator.

    Args:
        sampled: whether values are drawn from the axes, so that {from, to} alone is a continuous range.

    Raises:
        ValidationError: names the axis and what it should be.
    """
    checked = Axes.model_validate(tables)
    given = {name: getattr(checked, name) for name in tables}
    return {name: _axis(name, value, sampled) for name, value in given.items() if value is not None}


def _axis(name: str, given: Any, sampled: bool) -> Axis:
    if not isinstance(given, Range):
        return Axis(name, given if isinstance(given, tuple) else (given,))
    if not given.continuous:
        return Axis(name, given.values())
    if not sampled:
        raise complaint("needs step or count: a grid has no continuous axes", name)
    return Axis(name, (), given.low, given.high)
