"""Profiles by name: built in, read from files, or defined in a sweep file. Details: docs/profiles.md."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from petmjx.errors import InputError
from petmjx.units import deg_to_rad
from petmjx.world.job import Drive
from petmjx.world.profiles.acceleration import HalfSine, Tilt, en_12195_1, eumos_40509
from petmjx.world.profiles.base import ACCELERATION, FORCE, Profile, Strength
from petmjx.world.profiles.vibration import PsdTable, RandomVibration, check_psd, psd_integral, psd_rms_g, read_psd_csv
from petmjx.world.profiles.windows import JOLTS, RADIAL, RADIAL_CHAIN, SINE, Window, WindowProfile, chain
from petmjx.world.random import WorldKey

__all__ = [
    "ACCELERATION",
    "BUILT_IN",
    "FAMILIES",
    "FORCE",
    "HalfSine",
    "Profile",
    "PsdTable",
    "RandomVibration",
    "Strength",
    "Tilt",
    "Window",
    "WindowProfile",
    "build_drive",
    "chain",
    "define_profile",
    "psd_integral",
    "psd_rms_g",
    "read_windows",
    "resolve",
]

_ALL: tuple[Profile, ...] = (RADIAL, JOLTS, SINE, RADIAL_CHAIN, eumos_40509(), *en_12195_1(), Tilt(), HalfSine())

BUILT_IN: dict[str, Profile] = {profile.name: profile for profile in _ALL}
"""Profiles that need no parameters, by name."""

FAMILIES: dict[str, tuple[str, ...]] = {"en-12195-1": tuple(profile.name for profile in en_12195_1())}
"""Names that stand for several profiles."""

DEFAULT_REST_S = 1.0
"""Time a world has to come to rest after a profile's last sample."""

_KINDS = ("windows", "chain", "half-sine", "tilt", "random", "trapezoid")
_WINDOW_COLUMNS = ("start_s", "duration_s", "x", "y", "z")


def resolve(name: str, defined: Mapping[str, Profile] | None = None) -> tuple[Profile, ...]:
    """The profiles a name stands for: one, or all of a family such as ``en-12195-1``.

    Raises:
        InputError: nothing has that name; the message lists what there is.
    """
    known = {**BUILT_IN, **(defined or {})}
    if name in known:
        return (known[name],)
    if name in FAMILIES:
        return tuple(known[member] for member in FAMILIES[name])
    if name == "random":
        raise InputError("'random' needs a PSD table: define [profiles.NAME] with kind = \"random\" and psd")
    raise InputError(f"unknown profile {name!r} (known: {', '.join(sorted([*known, *FAMILIES]))})")


def build_drive(
    profile: Profile,
    timestep_s: float,
    scale: float = 1.0,
    direction_deg: float = 0.0,
    start_s: float = 0.0,
    rest_s: float = DEFAULT_REST_S,
    world: WorldKey | None = None,
) -> Drive:
    """One profile as one world feels it.

    Args:
        scale: factor, or level in g for profiles whose strength is a level.
        direction_deg: by which the profile is turned about the vertical, degrees from +x towards +y.
        start_s: absolute time at which the profile begins, s (matters for force windows only).

    Raises:
        ValueError: a scale other than 1 for a profile whose strength is an angle.
    """
    if profile.strength is Strength.ANGLE and scale != 1.0:
        raise ValueError(f"profile {profile.name} cannot be scaled")
    excitation = profile.excitation(timestep_s, start_s, world)
    return Drive(excitation, scale=scale, yaw_rad=deg_to_rad(direction_deg), rest_s=rest_s)


def define_profile(
    name: str, table: Mapping[str, Any], folder: Path, defined: Mapping[str, Profile] | None = None
) -> Profile:
    """A profile from a ``[profiles.NAME]`` table of a sweep file (keys: docs/profiles.md).

    Args:
        folder: where relative file names begin.
        defined: profiles defined earlier, which a chain may use.

    Raises:
        InputError: names the table's field and what it should be; the caller adds the file.
    """
    if name in BUILT_IN or name in FAMILIES:
        raise InputError(f"profiles.{name}: the name of a built-in profile cannot be used again")
    fields = _Fields(f"profiles.{name}", dict(table))
    kind = fields.text("kind")
    if kind not in _KINDS:
        raise InputError(f"profiles.{name}.kind must be one of {', '.join(_KINDS)}, got {kind!r}")
    profile: Profile
    if kind == "windows":
        profile = _define_windows(name, fields, folder)
    elif kind == "chain":
        profile = _define_chain(name, fields, defined or {})
    elif kind == "half-sine":
        profile = HalfSine(name, fields.number("duration_ms", 11.0, above=0.0), fields.vector("axis", (1.0, 0.0, 0.0)))
    elif kind == "tilt":
        profile = Tilt(
            name,
            max_deg=fields.number("max_deg", 45.0, above=0.0, up_to=90.0),
            rate_deg_s=fields.number("rate_deg_s", 5.0, above=0.0),
            hold_s=fields.number("hold_s", 1.0, at_least=0.0),
            return_s=fields.number("return_s", 1.0, above=0.0),
        )
    elif kind == "trapezoid":
        template = eumos_40509()
        profile = type(template)(
            name,
            "user's sweep file",
            1.0,
            fields.number("ramp_s", template.ramp_s, above=0.0),
            fields.number("hold_s", template.hold_s, at_least=0.0),
        )
    else:
        profile = _define_random(name, fields, folder)
    fields.refuse_rest()
    return profile


def _define_windows(name: str, fields: _Fields, folder: Path) -> WindowProfile:
    rows = fields.take("windows", None)
    file = fields.take("file", None)
    if (rows is None) == (file is None):
        raise InputError(f"{fields.where} needs either windows = [[start_s, duration_s, x, y, z], …] or file = …")
    if file is not None:
        if not isinstance(file, str):
            raise InputError(f"{fields.where}.file must be a file name, got {file!r}")
        return read_windows(folder / file, name)
    return _window_profile(name, rows, f"{fields.where}.windows", "user's sweep file")


def _define_chain(name: str, fields: _Fields, defined: Mapping[str, Profile]) -> WindowProfile:
    links = fields.take("of", None)
    if not isinstance(links, list) or not links:
        raise InputError(f"{fields.where}.of must list at least one {{profile, offset_s, scale}}")
    resolved = []
    for number, link in enumerate(links):
        where = f"{fields.where}.of[{number}]"
        if not isinstance(link, dict):
            raise InputError(f"{where} must be a table {{profile, offset_s, scale}}, got {link!r}")
        entry = _Fields(where, dict(link))
        member = entry.text("profile")
        try:
            profiles = resolve(member, defined)
        except InputError as error:
            raise InputError(f"{where}.profile: {error}") from None
        profile = profiles[0]
        if not isinstance(profile, WindowProfile):
            raise InputError(f"{where}.profile: only force profiles can be chained, {member!r} is none")
        resolved.append((profile, entry.number("offset_s", 0.0, at_least=0.0), entry.number("scale", 1.0, above=0.0)))
        entry.refuse_rest()
    overlap = fields.text("overlap", "add")
    if overlap not in ("add", "replace"):
        raise InputError(f"{fields.where}.overlap must be add or replace, got {overlap!r}")
    return chain(name, resolved, "user's sweep file", replaces=overlap == "replace")


def _define_random(name: str, fields: _Fields, folder: Path) -> RandomVibration:
    psd = fields.take("psd", None)
    if psd is None:
        raise InputError(f"{fields.where}.psd is missing: random vibration needs a PSD table "
                         "([[Hz, g²/Hz], …] or the name of a CSV file)")  # fmt: skip
    where = f"{fields.where}.psd"
    if isinstance(psd, str):
        table = read_psd_csv(folder / psd)
    else:
        if not isinstance(psd, list):
            raise InputError(f"{where} must be [[Hz, g²/Hz], …] or the name of a CSV file, got {psd!r}")
        rows = []
        for number, row in enumerate(psd):
            values = _numbers(row, 2, f"{where}, row {number}", "[Hz, g²/Hz]")
            rows.append((values[0], values[1]))
        table = check_psd(tuple(rows), where)
    axes = fields.text("axes", "z")
    if not axes or set(axes) - set("xyz"):
        raise InputError(f"{fields.where}.axes must be made of x, y and z, got {axes!r}")
    duration_s = fields.number("duration_s", 10.0, above=0.0)
    if duration_s * table[0][0] < 0.5:
        raise InputError(f"{fields.where}.duration_s must be at least {0.5 / table[0][0]:g} for a PSD that begins at "
                         f"{table[0][0]:g} Hz, got {duration_s:g}")  # fmt: skip
    return RandomVibration(name, table, duration_s, axes)


def read_windows(path: Path, name: str | None = None) -> WindowProfile:
    """A force profile from a file with the columns start_s, duration_s, x, y, z.

    Parquet: those five columns. TOML: an array of tables ``[[window]]`` with those five keys. The vector is
    in units of the reference magnitude, scale × total mass × 9.81 m/s².

    Raises:
        InputError: one line with file, row and field.
    """
    try:
        if path.suffix == ".toml":
            with path.open("rb") as stream:
                rows = tomllib.load(stream).get("window", [])
        else:
            rows = _parquet_rows(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a list of windows: {error}") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path}: window must be an array of tables [[window]]")
    values = []
    for number, row in enumerate(rows):
        missing = [column for column in _WINDOW_COLUMNS if column not in row]
        if missing:
            raise InputError(f"{path}: window {number}: {missing[0]} is missing")
        values.append([row[column] for column in _WINDOW_COLUMNS])
    return _window_profile(name or path.stem, values, f"{path}: window", f"user's file {path.name}")


def _parquet_rows(path: Path) -> list[dict[str, Any]]:
    # Imported here: only people who keep windows in Parquet wait for pyarrow.
    import pyarrow
    import pyarrow.parquet

    try:
        rows: list[dict[str, Any]] = pyarrow.parquet.read_table(path).to_pylist()
    except pyarrow.ArrowInvalid as error:
        raise InputError(f"{path}: is not Parquet: {str(error).splitlines()[0]}") from None
    return rows


def _window_profile(name: str, rows: object, where: str, source: str) -> WindowProfile:
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{where} must list at least one window (start_s, duration_s, x, y, z)")
    windows = []
    for number, row in enumerate(rows):
        start_s, duration_s, x, y, z = _numbers(row, 5, f"{where} {number}", "start_s, duration_s, x, y, z")
        if start_s < 0:
            raise InputError(f"{where} {number}: start_s must be ≥ 0, got {start_s:g}")
        if duration_s <= 0:
            raise InputError(f"{where} {number}: duration_s must be > 0, got {duration_s:g}")
        windows.append(Window(start_s, duration_s, (x, y, z)))
    return WindowProfile(name, tuple(windows), source)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _numbers(row: object, count: int, where: str, meaning: str) -> list[float]:
    if not isinstance(row, Sequence) or isinstance(row, str) or len(row) != count or not all(map(_is_number, row)):
        raise InputError(f"{where}: expected {count} finite numbers ({meaning}), got {row!r}")
    return [float(value) for value in row]


class _Fields:
    """A table's fields, taken one by one; what is left over in the end was misspelt."""

    def __init__(self, where: str, table: dict[str, Any]) -> None:
        self.where = where
        self._table = table

    def take(self, key: str, default: object) -> Any:
        return self._table.pop(key, default)

    def text(self, key: str, default: str | None = None) -> str:
        value = self._table.pop(key, default)
        if value is None:
            raise InputError(f"{self.where}.{key} is missing")
        if not isinstance(value, str):
            raise InputError(f"{self.where}.{key} must be text, got {value!r}")
        return value

    def number(
        self,
        key: str,
        default: float,
        above: float | None = None,
        at_least: float | None = None,
        up_to: float | None = None,
    ) -> float:
        value = self._table.pop(key, default)
        if not _is_number(value):
            raise InputError(f"{self.where}.{key} must be a finite number, got {value!r}")
        if above is not None and not value > above:
            raise InputError(f"{self.where}.{key} must be > {above:g}, got {value:g}")
        if at_least is not None and value < at_least:
            raise InputError(f"{self.where}.{key} must be ≥ {at_least:g}, got {value:g}")
        if up_to is not None and value > up_to:
            raise InputError(f"{self.where}.{key} must be ≤ {up_to:g}, got {value:g}")
        return float(value)

    def vector(self, key: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = _numbers(self._table.pop(key, default), 3, f"{self.where}.{key}", "x, y, z")
        if x == y == z == 0:
            raise InputError(f"{self.where}.{key} must not be zero")
        return x, y, z

    def refuse_rest(self) -> None:
        for key in self._table:
            raise InputError(f"{self.where}.{key}: unknown field")
