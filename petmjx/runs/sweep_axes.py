"""The axes (varied quantities) of a sweep: their names, units and allowed values. docs/sweeps.md explains them to
users."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Final, Generic, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    StrictFloat,
    StrictInt,
    Tag,
    create_model,
    model_validator,
)

from petmjx.common.checked_records import (
    LIST,
    TABLE,
    VALUE,
    CheckedRecord,
    by_entry,
    complaint,
    shape,
    shown_value,
    within,
)
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.random_streams import WorldKey
from petmjx.world.variants import SIZE_ERRORS

MAX_AXIS_VALUES: Final = 100_000
"""Largest number of values of one axis. Without a limit, a typing error in a step could fill the memory."""

MAX_STRENGTH: Final = 1000.0
"""Largest level (g), scale or factor. A larger value must be a typing error, since shocks of packed goods are below 100
g."""
MAX_FRICTION_FACTOR: Final = 100.0
MIN_MASS_FACTOR: Final = 0.001
"""Smallest factor on masses, since MuJoCo refuses bodies without mass."""
MAX_ERROR: Final = 10_000.0
"""Largest error of a position, mm."""
MAX_SIZE_ERROR_MM: Final = 1000.0
MAX_RELATIVE_ERROR: Final = 1.0
MAX_YAW_ERROR_DEG: Final = 360.0

DIRECTIONS_DEG: Final = {"+x": 0.0, "+y": 90.0, "-x": 180.0, "-y": 270.0}

Value = float | str | Distribution


# Checks of values on axes: numbers, ranges of numbers, and lists.

T = TypeVar("T")


def _distinct_values(values: tuple[T, ...]) -> tuple[T, ...]:
    if not values:
        raise ValueError("is empty: give at least one value, or leave the axis out")
    if len(values) > MAX_AXIS_VALUES:
        raise ValueError(f"has {len(values):,} values, more than {MAX_AXIS_VALUES:,}")
    distinct = set()
    for value in values:
        if value in distinct:
            raise ValueError(f"holds {_axis_text(value)} twice")
        distinct.add(value)
    return values


def _axis_text(value: object) -> str:
    if isinstance(value, Distribution):
        return value.label()
    return f"{value:g}" if isinstance(value, float) else repr(value)


def _value_or(tag: str) -> Discriminator:
    """A discriminator, with which pydantic chooses one type of a union of two: one type for values of the shape ``tag``
    (a table or a list), the other type for single values."""
    return Discriminator(lambda value: tag if shape(value) == tag else VALUE)


OneOrMore = Annotated[
    Annotated[tuple[T, ...], AfterValidator(_distinct_values), Tag(LIST)] | Annotated[T, Tag(VALUE)],
    _value_or(LIST),
]
"""The type of one value, or of a list of values."""
Names = OneOrMore[Annotated[str, Field(max_length=100)]]
Ways = OneOrMore[Literal["exact", "drop", "hand", "tines"]]


def _degrees(value: object) -> object:
    """The angle of a direction such as "+x", in degrees. Other values are returned unchanged."""
    if isinstance(value, str):
        if value not in DIRECTIONS_DEG:
            raise ValueError(f"must be degrees or one of {', '.join(DIRECTIONS_DEG)}, {shown_value(value)}")
        return DIRECTIONS_DEG[value]
    return value


Positive = Annotated[StrictFloat, Field(gt=0), within(0, MAX_STRENGTH)]
Turn = Annotated[StrictFloat, within(0, MAX_STRENGTH)]
Direction = Annotated[StrictFloat, within(-3600, 3600), BeforeValidator(_degrees)]


Number = TypeVar("Number", bound=float)


class Range(CheckedRecord, Generic[Number]):
    """A range of numbers. The range has a step or a number of values. In mode ``sample``, the range may have neither;
    then, every number between its ends is allowed."""

    low: Number = Field(alias="from", description="the first value")
    high: Number = Field(
        alias="to", description="upper end of the range; also the last value, if the steps reach it exactly"
    )
    step: Annotated[StrictFloat, Field(gt=0)] | None = Field(
        None, description="difference between two successive values"
    )
    count: Annotated[StrictInt, Field(ge=2, le=MAX_AXIS_VALUES)] | None = Field(None, description="number of values")

    @model_validator(mode="after")
    def _rises_in_steps(self) -> Self:
        if self.high <= self.low:
            raise complaint(f"must be > from = {self.low:g}, got {self.high:g}", "to")
        if self.step is not None and self.count is not None:
            raise ValueError("has both 'step' and 'count': give one of them")
        if self.step is not None and (self.high - self.low) / self.step >= MAX_AXIS_VALUES:
            raise complaint(f"{self.step:g} makes more than {MAX_AXIS_VALUES:,} values", "step")
        return self

    @property
    def continuous(self) -> bool:
        return self.step is None and self.count is None

    def values(self) -> tuple[float, ...]:
        """The values of the range, rounded so that 0.1 + 2 × 0.1 is 0.3."""
        if self.step is not None:
            # 1e-9 is added because of rounding errors, so that the last value of 0.1 … 1.6 with step 0.1 is 1.6
            step, count = self.step, math.floor((self.high - self.low) / self.step + 1e-9) + 1
        else:
            count = self.count or 2
            step = (self.high - self.low) / (count - 1)
        return tuple(round(self.low + index * step, 12) for index in range(count))


class DrawnRange(Range[Positive]):
    """A range of levels or scales in a chain. For each world, one value is drawn from the range."""

    low: Positive = Field(alias="from", description="lower end of the range from which values are drawn")
    high: Positive = Field(alias="to", description="upper end of the range from which values are drawn")


Positives = Annotated[
    Annotated[Range[Positive], Tag(TABLE)] | Annotated[OneOrMore[Positive], Tag(VALUE)], _value_or(TABLE)
]
Turns = Annotated[Annotated[Range[Turn], Tag(TABLE)] | Annotated[OneOrMore[Turn], Tag(VALUE)], _value_or(TABLE)]
Directions = Annotated[
    Annotated[Range[Direction], Tag(TABLE)] | Annotated[OneOrMore[Direction], Tag(VALUE)], _value_or(TABLE)
]


Strengths = Annotated[Annotated[DrawnRange, Tag(TABLE)] | Annotated[Positive, Tag(VALUE)], _value_or(TABLE)]
"""The type of the strength of a profile: a level, a scale, or a range from which one of these is drawn at random."""


def _value_list(setting: Any) -> tuple[Any, ...]:
    """The values of a setting as a tuple. The setting in the file may be one value or a list of values
    (`OneOrMore`)."""
    return setting if isinstance(setting, tuple) else (setting,)


def _ends(setting: Any) -> tuple[float, float]:
    """The smallest and the largest number of a setting: a range, a list, or one value."""
    return (
        (setting.low, setting.high)
        if isinstance(setting, Range)
        else (min(_value_list(setting)), max(_value_list(setting)))
    )


def _leave_a_mass(setting: Any) -> Any:
    lowest, _ = _ends(setting)
    if lowest < MIN_MASS_FACTOR:
        raise ValueError(f"must be ≥ {MIN_MASS_FACTOR:g}, got {lowest:g}")
    return setting


Masses = Annotated[Positives, AfterValidator(_leave_a_mass)]


def _are_frictions(setting: Any) -> Any:
    _, highest = _ends(setting)
    if highest > MAX_FRICTION_FACTOR:
        raise ValueError(f"must be from 0 to {MAX_FRICTION_FACTOR:g}, got {highest:g}")
    return setting


Frictions = Annotated[Positives, AfterValidator(_are_frictions)]

# The types of errors. An axis of errors has distributions as values.

Error = Annotated[StrictFloat, within(-MAX_ERROR, MAX_ERROR)]
Spread = Annotated[StrictFloat, Field(ge=0), within(0, MAX_ERROR)]


class _Normal(CheckedRecord):
    distribution: Literal["normal"]
    mean: Error = Field(0.0, description="mean")
    sd: Spread = Field(description="standard deviation")

    def to_distribution(self) -> Distribution:
        return Distribution(DistributionShape.NORMAL, self.mean, self.sd)


class _Uniform(CheckedRecord):
    distribution: Literal["uniform"]
    low: Error = Field(description="smallest value")
    high: Error = Field(description="largest value")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.high < self.low:
            raise complaint(f"must be ≥ low = {self.low:g}, got {self.high:g}", "high")
        return self

    def to_distribution(self) -> Distribution:
        return Distribution(DistributionShape.UNIFORM, (self.low + self.high) / 2, (self.high - self.low) / 2)


class _FixedError(CheckedRecord):
    distribution: Literal["fixed"]
    value: Error = Field(description="the error itself")

    def to_distribution(self) -> Distribution:
        return Distribution(DistributionShape.FIXED, self.value)


_Table = Annotated[
    Annotated[_Normal, Tag("<normal>")]
    | Annotated[_Uniform, Tag("<uniform>")]
    | Annotated[_FixedError, Tag("<fixed>")],
    by_entry("distribution"),
    AfterValidator(lambda table: table.to_distribution()),
    Tag(TABLE),
]
_Sd = Annotated[Spread, AfterValidator(lambda sd: Distribution(DistributionShape.NORMAL, 0.0, sd)), Tag(VALUE)]
_Height = Annotated[Spread, AfterValidator(lambda height: Distribution(DistributionShape.FIXED, height)), Tag(VALUE)]
Errors = OneOrMore[Annotated[_Table | _Sd, Discriminator(shape)]]
"""Distributions of errors. A plain number in a sweep file means the standard deviation of a normal distribution around
0."""
Heights = OneOrMore[Annotated[_Table | _Height, Discriminator(shape)]]
"""Distributions of a height. A plain number means the height itself."""


def _up_to(largest: float) -> AfterValidator:
    """A validator that accepts only errors from −``largest`` to ``largest``. This range is narrower than the range for
    errors of positions."""

    def check(setting: Any) -> Any:
        for error in _value_list(setting):
            if max(abs(error.centre), error.spread) > largest:
                raise ValueError(f"must be from {-largest:g} to {largest:g}, got {error.label()}")
        return setting

    return AfterValidator(check)


SizeErrors = Annotated[Errors, _up_to(MAX_SIZE_ERROR_MM)]
RelativeErrors = Annotated[Errors, _up_to(MAX_RELATIVE_ERROR)]
YawErrors = Annotated[Errors, _up_to(MAX_YAW_ERROR_DEG)]


@dataclass(frozen=True)
class AxisKind:
    """One kind of axis (varied quantity): its allowed values, the fields that the values change, and its column in the
    results.

    Attributes:
        unit: unit of the column, such as "mm"; "1" for factors, "" for names.
        values: the type that checks the values.
        meaning: what the axis changes, in one line.
        changes: names of the fields of `PlacementChange` that get the value of the axis; empty if the axis changes the
            drive (motion of the carrier).
        suffix: end of the column's name, which follows the name of the axis.
        plain: for axes of errors, the distribution that a plain number stands for. With a normal distribution, the
            number is the standard deviation, and the mean is 0. With a fixed distribution, the number is the value
            itself.
    """

    name: str
    unit: str
    values: Any
    meaning: str
    changes: tuple[str, ...] = ()
    suffix: str = ""
    plain: DistributionShape = DistributionShape.NORMAL

    @property
    def column(self) -> str:
        return self.name + self.suffix

    @property
    def placement(self) -> bool:
        """Whether the placement of boxes must be simulated again for each value of the axis."""
        return bool(self.changes)

    @property
    def changes_sizes(self) -> bool:
        """Whether the axis changes the sizes of boxes."""
        return not SIZE_ERRORS.isdisjoint(self.changes)


_BOX, _CARRIER = "box_friction_factor", "carrier_friction_factor"

AXIS_KINDS: Final = {
    kind.name: kind
    for kind in (
        AxisKind("profile", "", Names, "names of profiles"),
        AxisKind(
            "direction", "deg", Directions, "angle by which the profile is turned from +x towards +y", suffix="_deg"
        ),
        AxisKind("scale", "1", Positives, "factor on the profile"),
        AxisKind("level", "g", Positives, "level of the profile", suffix="_g"),
        AxisKind("friction_factor", "1", Frictions, "factor on the friction of boxes and carrier", (_BOX, _CARRIER)),
        AxisKind(_BOX, "1", Frictions, "factor on the friction of boxes alone", (_BOX,)),
        AxisKind(_CARRIER, "1", Frictions, "factor on the friction of the carrier alone", (_CARRIER,)),
        AxisKind(
            "friction_tolerance_rel",
            "1",
            RelativeErrors,
            "error of the friction of boxes and carrier, as a share of the friction; all boxes and the carrier of a "
            "world have the same error",
            ("friction_rel",),
        ),
        AxisKind("mass_factor", "1", Masses, "factor on the mass of boxes", ("mass_factor",)),
        AxisKind(
            "mass_tolerance_rel", "1", RelativeErrors, "error of each box's mass, as a share of the mass", ("mass_rel",)
        ),
        AxisKind("size_tolerance_mm", "mm", SizeErrors, "error of each dimension of each box", ("size_mm",)),
        AxisKind(
            "size_tolerance_rel",
            "1",
            RelativeErrors,
            "error of each dimension of each box, as a share of the dimension",
            ("size_rel",),
        ),
        AxisKind("placement_error_mm", "mm", Errors, "error of each box's place in x and in y", ("x_mm", "y_mm")),
        AxisKind("placement_error_x_mm", "mm", Errors, "error of each box's place in x alone", ("x_mm",)),
        AxisKind("placement_error_y_mm", "mm", Errors, "error of each box's place in y alone", ("y_mm",)),
        AxisKind("yaw_error_deg", "deg", YawErrors, "turn of each box about the vertical axis", ("yaw_deg",)),
        AxisKind(
            "drop_height_mm",
            "mm",
            Heights,
            "height of a box above its place when it is released",
            ("drop_height_mm",),
            plain=DistributionShape.FIXED,
        ),
        AxisKind("placing", "", Ways, "how boxes are placed", ("placing_name",)),
        AxisKind(
            "placing_height_mm",
            "mm",
            Positives,
            "height of a box above its place when its carrying begins",
            ("placing_height_mm",),
        ),
        AxisKind(
            "placing_side_mm",
            "mm",
            Positives,
            "horizontal distance of a box from its place when its carrying begins",
            ("placing_side_mm",),
        ),
        AxisKind("placing_speed_m_s", "m/s", Positives, "largest speed of a carried box", ("placing_speed_m_s",)),
        AxisKind(
            "placing_force_n", "N", Positives, "largest force with which the hand presses a box", ("placing_force_n",)
        ),
        AxisKind("wrap_turns", "1", Turns, "turns of stretch film around the pallet", ("wrap_turns",)),
        AxisKind(
            "tines_height_mm",
            "mm",
            Positives,
            "height of the edge that comes down last when tines release a box",
            ("tines_height_mm",),
        ),
    )
}
"""All axes of sweep files, in the order in which the loops over their values are nested, the outermost loop first.
Among the axes that change placements, the last one varies fastest. Among the axes that change drives (motions of the
carrier), the last one varies fastest, too."""

_FIELDS: Final[dict[str, Any]] = {name: (kind.values | None, None) for name, kind in AXIS_KINDS.items()}
_Axes = create_model("_Axes", __base__=CheckedRecord, **_FIELDS)


@dataclass(frozen=True)
class Axis:
    """One axis of a sweep: its values, or (in mode ``sample``) a continuous range."""

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
        """Whether the values on this axis are random, so that they differ between replicates (repetitions with other
        random numbers)."""
        return any(isinstance(value, Distribution) and value.random for value in self.values)

    def pick(self, key: WorldKey) -> Value:
        """A random value of the axis. The random numbers depend only on ``key`` and the axis."""
        rng = key.rng(f"design:{self.name}")
        if self.continuous:
            return float(rng.uniform(self.low, self.high))
        return self.values[int(rng.integers(len(self.values)))]

    def cell(self, value: Value) -> float | str:
        """A value of the axis in the form in which it is written to the results. If plain numbers can stand for all
        values of the axis, a distribution becomes a plain number; otherwise, it becomes text."""
        if not isinstance(value, Distribution):
            return value
        number = self._plain_number(value)
        one_shape = all(self._plain_number(other) is not None for other in self.values)
        return number if one_shape and number is not None else value.label()

    def _plain_number(self, value: Value) -> float | None:
        """The plain number that stands for a value in a sweep file; None if only a table can stand for the value."""
        if not isinstance(value, Distribution) or value.shape is not self.kind.plain:
            return None
        if value.shape is DistributionShape.FIXED:
            return value.centre
        return value.spread if value.centre == 0 else None

    def described(self) -> object:
        """The values of the axis as plain JSON values."""
        if self.continuous:
            return {"from": self.low, "to": self.high}
        return [value.label() if isinstance(value, Distribution) else value for value in self.values]


def read_axes(tables: Any, sampled: bool) -> dict[str, Axis]:
    """Name → axis, for the table ``[axes]`` of a sweep file, in the order of the file. A validator calls this function.

    Args:
        sampled: whether a range {from, to} without step or count is allowed (mode ``sample``).

    Raises:
        ValidationError: an axis is wrong. The message names the axis and the allowed values.
    """
    checked = _Axes.model_validate(tables)
    settings = {name: getattr(checked, name) for name in tables}
    return {name: _axis(name, value, sampled) for name, value in settings.items() if value is not None}


def _axis(name: str, setting: Any, sampled: bool) -> Axis:
    if not isinstance(setting, Range):
        return Axis(name, _value_list(setting))
    if not setting.continuous:
        return Axis(name, setting.values())
    if not sampled:
        raise complaint("needs 'step' or 'count': mode = 'grid' needs single values, not a continuous range", name)
    return Axis(name, (), setting.low, setting.high)
