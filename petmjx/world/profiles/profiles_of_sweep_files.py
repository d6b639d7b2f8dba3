"""The tables ``[profiles.NAME]`` of sweep files, in which users define profiles: a class for each kind of table."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, StrictFloat, Tag, TypeAdapter, model_validator

from petmjx.common.checked_records import LIST, VALUE, CheckedRecord, by_entry, complaint, shape, shown_value, within
from petmjx.common.errors import InputError
from petmjx.world.profiles.accelerations import HalfSine, Tilt, Trapezoid, eumos_40509
from petmjx.world.profiles.force_windows import WindowProfile, chain
from petmjx.world.profiles.measured_profiles import (
    MAX_FORCE,
    MAX_PUSH_S,
    MAX_WINDOWS,
    Component,
    LongerThanNothing,
    PsdRows,
    Rows,
    Seconds,
    read_psd,
    read_windows,
)
from petmjx.world.profiles.profile import MAX_PROFILE_S, Profile
from petmjx.world.profiles.profile_registry import BUILT_IN, FAMILIES, resolve
from petmjx.world.profiles.random_vibration import PsdTable, RandomVibration

_USERS: Final = "user's sweep file"
_TILT: Final = Tilt()
_HALF_SINE: Final = HalfSine()
_TRAPEZOID: Final = eumos_40509()

MAX_NAME: Final = 100
"""Largest number of characters of a profile's name."""
Name = Annotated[str, Field(max_length=MAX_NAME)]
FileName = Annotated[str, Field(max_length=4096)]


class _Table(CheckedRecord):
    """A table of a sweep file that defines a profile."""

    @abstractmethod
    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> Profile:
        """The profile that this table defines.

        Args:
            name: name of the profile.
            folder: folder of the sweep file. File names in the table are relative to this folder.
            known: profiles that are defined earlier in the sweep file. A table of kind "chain" may name these profiles,
                and built-in profiles.

        Raises:
            ValidationError: a field is wrong. The path of the field begins with ``name``.
            InputError: a file that the table names cannot be used.
        """


class WindowsTable(_Table):
    """Force windows, given in the table or in a file."""

    kind: Literal["windows"]
    windows: Rows | None = Field(None, description="one row [start_s, duration_s, x, y, z] for each push")
    file: FileName | None = Field(
        None, description="Parquet or TOML file of pushes with the columns start_s, duration_s, x, y, z"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.windows is None) == (self.file is None):
            raise ValueError("needs either windows = [[start_s, duration_s, x, y, z], …] or file = …")
        return self

    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> WindowProfile:
        rows = self.windows if self.file is None else read_windows(folder / self.file)
        source = _USERS if self.file is None else f"user's file {Path(self.file).name}"
        return WindowProfile(name, tuple(row.window for row in rows or ()), source)


class Link(CheckedRecord):
    """One profile as a link of a chain."""

    profile: Name = Field(description="name of a force profile")
    offset_s: Seconds = Field(0.0, description="time at which the profile begins, s after the beginning of the chain")
    scale: Annotated[StrictFloat, Field(gt=0), within(0, MAX_FORCE)] = Field(
        1.0, description="factor on the forces of the profile"
    )


class ChainTable(_Table):
    """A chain of force profiles, each with an offset in time."""

    kind: Literal["chain"]
    of: Annotated[tuple[Link, ...], Field(min_length=1, max_length=MAX_WINDOWS)] = Field(
        description="links of the chain: a list of {profile, offset_s, scale}"
    )
    overlap: Literal["add", "replace"] = Field("add", description="how pushes that act at the same time combine")

    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> WindowProfile:
        links: list[tuple[WindowProfile, float, float]] = []
        for number, link in enumerate(self.of):
            try:
                member = resolve(link.profile, known)[0]
            except InputError as error:
                raise complaint(f": {error}", name, "of", number, "profile") from None
            if not isinstance(member, WindowProfile):
                text = f": only force profiles can be chained, but {link.profile!r} is not one"
                raise complaint(text, name, "of", number, "profile")
            links.append((member, link.offset_s, link.scale))
        # chains of chains can have very many windows, so the windows are counted before they are made
        if sum(len(member.windows) for member, _, _ in links) > MAX_WINDOWS:
            raise complaint(f"must have at most {MAX_WINDOWS:,} windows", name, "of")
        chained = chain(name, links, _USERS, replaces=self.overlap == "replace")
        pushing_s = sum(window.duration_s for window in chained.windows)
        if pushing_s > MAX_PUSH_S:
            raise complaint(f"must push for at most {MAX_PUSH_S:g} s in all, got {pushing_s:g} s", name, "of")
        if chained.end_s > MAX_PROFILE_S:
            raise complaint(f"must take at most {MAX_PROFILE_S:g} s, got {chained.end_s:g} s", name, "of")
        strongest = max(abs(component) for window in chained.windows for component in window.vector)
        if not strongest <= MAX_FORCE:
            raise complaint(
                f"must have forces of at most {MAX_FORCE:g} times the total weight, got {strongest:g}", name, "of"
            )
        return chained


class HalfSineTable(_Table):
    """A shock along any axis. The strength of the profile is a level in g."""

    kind: Literal["half-sine"]
    duration_ms: Annotated[StrictFloat, Field(gt=0), within(0, 10_000)] = Field(
        _HALF_SINE.duration_ms, description="length of the pulse, ms"
    )
    axis: tuple[Component, Component, Component] = Field(
        _HALF_SINE.axis, description="direction of the carrier's acceleration; its length does not matter"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.axis):
            raise complaint("must not be zero", "axis")
        return self

    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> HalfSine:
        return HalfSine(name, self.duration_ms, self.axis)


class TiltTable(_Table):
    """Gravity that turns slowly, up to an angle."""

    kind: Literal["tilt"]
    max_deg: Annotated[StrictFloat, within(0, 90)] = Field(_TILT.max_deg, gt=0, description="largest angle, degrees")
    rate_deg_s: Annotated[StrictFloat, within(0, 3600)] = Field(
        _TILT.rate_deg_s, gt=0, description="how fast the angle grows, degrees/s"
    )
    hold_s: Seconds = Field(_TILT.hold_s, description="time at the largest angle, s")
    return_s: LongerThanNothing = Field(_TILT.return_s, description="time in which the carrier turns back, s")

    @model_validator(mode="after")
    def _not_too_slow(self) -> Self:
        if self.max_deg / self.rate_deg_s > MAX_PROFILE_S:
            raise complaint(f"must be at least max_deg / {MAX_PROFILE_S:g} s, got {self.rate_deg_s:g}", "rate_deg_s")
        return self

    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> Tilt:
        return Tilt(name, self.max_deg, self.rate_deg_s, self.hold_s, self.return_s)


class TrapezoidTable(_Table):
    """A horizontal acceleration like the one of EUMOS 40509. The strength of the profile is a level in g."""

    kind: Literal["trapezoid"]
    ramp_s: LongerThanNothing = Field(_TRAPEZOID.ramp_s, description="length of each ramp, s")
    hold_s: Seconds = Field(_TRAPEZOID.hold_s, description="length of the plateau, s")

    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> Trapezoid:
        return Trapezoid(name, _USERS, 1.0, self.ramp_s, self.hold_s)


def _some_axes(axes: str) -> str:
    if not axes or set(axes) - set("xyz"):
        raise ValueError(f"must be made of x, y and z, {shown_value(axes)}")
    return axes


class RandomTable(_Table):
    """Random vibration. The strength of the profile is a scale."""

    kind: Literal["random"]
    psd: Annotated[Annotated[PsdRows, Tag(LIST)] | Annotated[FileName, Tag(VALUE)], Discriminator(shape)] = Field(
        description="PSD table of the vibration: rows [[Hz, g²/Hz], …], or the name of a CSV file"
    )
    axes: Annotated[str, AfterValidator(_some_axes)] = Field(
        "z", description="axes that vibrate: one or more of the letters x, y and z"
    )
    duration_s: LongerThanNothing = Field(10.0, description="length, s")

    def profile(self, name: str, folder: Path, known: Mapping[str, Profile]) -> RandomVibration:
        table: PsdTable = read_psd(folder / self.psd) if isinstance(self.psd, str) else self.psd
        first_hz = table[0][0]
        if self.duration_s * first_hz < 0.5:
            text = (
                f"must be at least {0.5 / first_hz:g} for a PSD that begins at {first_hz:g} Hz, got {self.duration_s:g}"
            )
            raise complaint(text, name, "duration_s")
        return RandomVibration(name, table, self.duration_s, self.axes)


ProfileTable = Annotated[
    Annotated[WindowsTable, Tag("<windows>")]
    | Annotated[ChainTable, Tag("<chain>")]
    | Annotated[HalfSineTable, Tag("<half-sine>")]
    | Annotated[TiltTable, Tag("<tilt>")]
    | Annotated[RandomTable, Tag("<random>")]
    | Annotated[TrapezoidTable, Tag("<trapezoid>")],
    by_entry("kind"),
]
"""A profile table of any kind. The table's entry ``kind`` names the kind."""

_TABLES: Final = TypeAdapter(dict[Name, ProfileTable])


def define_profiles(tables: Any, folder: Path) -> dict[str, Profile]:
    """The profiles that a sweep file defines, by name. A validator of pydantic calls this function.

    Args:
        tables: the table ``profiles`` of the sweep file.
        folder: folder of the sweep file. File names in the tables are relative to this folder.

    Raises:
        ValidationError: a field of a table is wrong. The message names the field and states what is allowed.
        InputError: a file that a table names is wrong. The message names the field and states what is allowed.
    """
    profiles: dict[str, Profile] = {}
    for name, table in _TABLES.validate_python(tables).items():
        if name in BUILT_IN or name in FAMILIES:
            raise complaint(": is the name of a built-in profile; choose another name", name)
        profiles[name] = table.profile(name, folder, profiles)
    return profiles
