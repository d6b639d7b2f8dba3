"""The axes of a sweep: which there are, in which units, and what may stand on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from petmjx.errors import InputError
from petmjx.world.random import WorldKey
from petmjx.world.variants import Distribution, Shape

MAX_AXIS_VALUES = 100_000
"""Values one axis may have; a range with a mistyped step must not fill the memory."""

Value = float | str | Distribution


class Kind(Enum):
    """What the values of an axis are."""

    PROFILE = auto()
    POSITIVE = auto()
    DIRECTION = auto()
    ERROR = auto()
    """A distribution; a plain number is the standard deviation of a normal one around 0."""
    HEIGHT = auto()
    """A distribution; a plain number is that height itself."""


@dataclass(frozen=True)
class AxisKind:
    """One axis: its values, its column in the results with unit, and whether it needs a new placement."""

    kind: Kind
    column: str
    unit: str
    placement: bool


AXIS_KINDS: dict[str, AxisKind] = {
    "profile": AxisKind(Kind.PROFILE, "profile", "", False),
    "direction": AxisKind(Kind.DIRECTION, "direction_deg", "deg", False),
    "scale": AxisKind(Kind.POSITIVE, "scale", "1", False),
    "level": AxisKind(Kind.POSITIVE, "level_g", "g", False),
    "friction_factor": AxisKind(Kind.POSITIVE, "friction_factor", "1", True),
    "box_friction_factor": AxisKind(Kind.POSITIVE, "box_friction_factor", "1", True),
    "carrier_friction_factor": AxisKind(Kind.POSITIVE, "carrier_friction_factor", "1", True),
    "mass_factor": AxisKind(Kind.POSITIVE, "mass_factor", "1", True),
    "size_tolerance_mm": AxisKind(Kind.ERROR, "size_tolerance_mm", "mm", True),
    "size_tolerance_rel": AxisKind(Kind.ERROR, "size_tolerance_rel", "1", True),
    "placement_error_mm": AxisKind(Kind.ERROR, "placement_error_mm", "mm", True),
    "placement_error_x_mm": AxisKind(Kind.ERROR, "placement_error_x_mm", "mm", True),
    "placement_error_y_mm": AxisKind(Kind.ERROR, "placement_error_y_mm", "mm", True),
    "yaw_error_deg": AxisKind(Kind.ERROR, "yaw_error_deg", "deg", True),
    "drop_height_mm": AxisKind(Kind.HEIGHT, "drop_height_mm", "mm", True),
}
"""Every axis a sweep file may have. Order is the order of nesting: the last varies fastest among its half."""

DIRECTIONS_DEG = {"+x": 0.0, "+y": 90.0, "-x": 180.0, "-y": 270.0}


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
        plain = Shape.FIXED if self.kind.kind is Kind.HEIGHT else Shape.NORMAL
        numbers = [_plain_number(entry, plain) for entry in self.values]
        if any(number is None for number in numbers):
            return value.label()
        number = _plain_number(value, plain)
        return value.label() if number is None else number


def _plain_number(value: Value, plain: Shape) -> float | None:
    if not isinstance(value, Distribution) or value.shape is not plain:
        return None
    if plain is Shape.FIXED:
        return value.centre
    return value.spread if value.centre == 0 else None


def read_axis(name: str, raw: object, continuous_allowed: bool) -> Axis:
    """One entry of ``[axes]``: a value, a list of them, or a range {from, to, step} or {from, to, count}.

    Args:
        continuous_allowed: whether {from, to} alone is meant, as it is when a sweep samples.

    Raises:
        InputError: "axes.scale must be > 0, got -1"; the caller adds the file.
    """
    where = f"axes.{name}"
    if name not in AXIS_KINDS:
        raise InputError(f"{where}: unknown axis (known: {', '.join(AXIS_KINDS)})")
    kind = AXIS_KINDS[name].kind
    if isinstance(raw, dict) and "from" in raw:
        if kind is not Kind.POSITIVE and kind is not Kind.DIRECTION:
            raise InputError(f"{where}: a range {{from, to}} is only for numbers, not for {kind.name.lower()} values")
        return _read_range(name, raw, continuous_allowed)
    entries = raw if isinstance(raw, list) else [raw]
    if not entries:
        raise InputError(f"{where} is empty: give at least one value, or leave the axis out")
    values = tuple(_read_value(where, kind, entry) for entry in entries)
    if len(set(values)) != len(values):
        twice = next(entry for index, entry in enumerate(values) if entry in values[:index])
        raise InputError(f"{where} holds {_shown(twice)} twice")
    return Axis(name, values)


def _read_range(name: str, raw: Mapping[str, Any], continuous_allowed: bool) -> Axis:
    where = f"axes.{name}"
    for key in raw:
        if key not in ("from", "to", "step", "count"):
            raise InputError(f"{where}.{key}: unknown field of a range (known: from, to, step, count)")
    low = _number(f"{where}.from", raw["from"])
    if "to" not in raw:
        raise InputError(f"{where}.to is missing")
    high = _number(f"{where}.to", raw["to"])
    if AXIS_KINDS[name].kind is Kind.POSITIVE and low <= 0:
        raise InputError(f"{where}.from must be > 0, got {low:g}")
    if high <= low:
        raise InputError(f"{where}.to must be > from = {low:g}, got {high:g}")
    if "step" in raw and "count" in raw:
        raise InputError(f"{where} has both step and count: give one of them")
    if "step" in raw:
        step = _number(f"{where}.step", raw["step"])
        if step <= 0:
            raise InputError(f"{where}.step must be > 0, got {step:g}")
        # A hair more than the quotient, so that 0.1 … 1.6 by 0.1 includes 1.6.
        count = math.floor((high - low) / step + 1e-9) + 1
    elif "count" in raw:
        if not isinstance(raw["count"], int) or isinstance(raw["count"], bool) or raw["count"] < 2:
            raise InputError(f"{where}.count must be a whole number ≥ 2, got {raw['count']!r}")
        count = raw["count"]
        step = (high - low) / (count - 1)
    elif continuous_allowed:
        return Axis(name, (), low, high)
    else:
        raise InputError(f"{where} needs step or count: a grid has no continuous axes")
    if count > MAX_AXIS_VALUES:
        raise InputError(f"{where} has {count:,} values, more than {MAX_AXIS_VALUES:,}")
    return Axis(name, tuple(round(low + index * step, 12) for index in range(count)))


def _read_value(where: str, kind: Kind, raw: object) -> Value:
    if kind is Kind.PROFILE:
        if not isinstance(raw, str):
            raise InputError(f"{where} must hold names of profiles, got {raw!r}")
        return raw
    if kind is Kind.POSITIVE:
        number = _number(where, raw)
        if number <= 0:
            raise InputError(f"{where} must be > 0, got {number:g}")
        return number
    if kind is Kind.DIRECTION:
        if isinstance(raw, str):
            if raw not in DIRECTIONS_DEG:
                raise InputError(f"{where} must be degrees or one of {', '.join(DIRECTIONS_DEG)}, got {raw!r}")
            return DIRECTIONS_DEG[raw]
        return _number(where, raw)
    return _read_distribution(where, kind, raw)


def _read_distribution(where: str, kind: Kind, raw: object) -> Distribution:
    if not isinstance(raw, dict):
        number = _number(where, raw)
        if number < 0:
            raise InputError(f"{where} must be ≥ 0, got {number:g}")
        if kind is Kind.HEIGHT:
            return Distribution(Shape.FIXED, number)
        return Distribution(Shape.NORMAL, 0.0, number)
    table = dict(raw)
    shape = table.pop("distribution", None)
    fields = {"normal": ("mean", "sd"), "uniform": ("low", "high"), "fixed": ("value",)}
    if shape not in fields:
        raise InputError(f"{where}.distribution must be one of normal, uniform, fixed, got {shape!r}")
    for key in table:
        if key not in fields[shape]:
            raise InputError(f"{where}.{key}: unknown field of a {shape} distribution (known: {fields[shape]})")
    if shape == "normal":
        spread = _field(where, table, "sd")
        if spread < 0:
            raise InputError(f"{where}.sd must be ≥ 0, got {spread:g}")
        return Distribution(Shape.NORMAL, _field(where, table, "mean", 0.0), spread)
    if shape == "uniform":
        low, high = _field(where, table, "low"), _field(where, table, "high")
        if high < low:
            raise InputError(f"{where}.high must be ≥ low = {low:g}, got {high:g}")
        return Distribution(Shape.UNIFORM, (low + high) / 2, (high - low) / 2)
    return Distribution(Shape.FIXED, _field(where, table, "value"))


def _field(where: str, table: Mapping[str, object], key: str, default: float | None = None) -> float:
    if key not in table:
        if default is None:
            raise InputError(f"{where}.{key} is missing")
        return default
    return _number(f"{where}.{key}", table[key])


def _number(where: str, raw: object) -> float:
    if not isinstance(raw, int | float) or isinstance(raw, bool) or not math.isfinite(raw):
        raise InputError(f"{where} must be a finite number, got {raw!r}")
    return float(raw)


def _shown(value: Value) -> str:
    if isinstance(value, Distribution):
        return value.label()
    return repr(value) if isinstance(value, str) else f"{value:g}"
