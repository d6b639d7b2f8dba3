"""Sweep files (``sweeps/*.toml``): reading and checking. What may stand in one: sweeps/README.md."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from petmjx.checked import describe
from petmjx.config import Simulation
from petmjx.errors import InputError
from petmjx.sweeps.axes import Axis, read_axis
from petmjx.world.profiles.registry import Profile, Strength, define_profile, resolve
from petmjx.world.variants import Distribution

SAMPLES = "samples"
"""Value of ``plans`` that stands for the samples petmjx brings along."""

DEFAULT_TOLERANCE = {Strength.LEVEL: 0.01, Strength.SCALE: 0.02}
"""To what a search narrows the largest level survived (g) or scale."""

MAX_SEARCH_LEVELS = 1_000_000


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Search(_Table):
    """``[search]``: instead of an axis ``level`` or ``scale``, find the largest one survived."""

    lower: float = Field(0.0, ge=0)
    upper: float = Field(2.0, gt=0)
    tolerance: float | None = Field(None, gt=0)
    sections: int = Field(3, ge=1, le=1000)


class _File(_Table):
    """The whole file; ``axes`` and ``profiles`` are read by hand, because their keys are data."""

    name: str | None = None
    description: str = ""
    plans: str | list[str] | None = None
    mode: Literal["grid", "sample"] = "grid"
    sample: int | None = Field(None, ge=1)
    seed: int = Field(0, ge=0)
    replicates: int = Field(1, ge=1)
    nominal: bool = False
    shifts_from: Literal["plan", "release"] = "plan"
    simulation: Simulation = Simulation()
    search: Search | None = None
    axes: dict[str, Any] = {}
    profiles: dict[str, Any] = {}


class Sweep(BaseModel):
    """A checked sweep.

    Attributes:
        file: as the user named it, for messages.
        plans: paths of plan files, ``"samples"``, or None where the file names none.
        n_sample: number of variants drawn at random; None for the full grid.
        seed: with plan id and replicate it determines every random number.
        replicates: repetitions with random numbers of their own.
        nominal: whether variant 0, the unchanged world without a drive, is simulated too.
        axes: by name, in the order of `petmjx.sweepaxes.AXIS_KINDS`.
        profiles: those the sweep uses, by name.
    """

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)

    file: str
    name: str
    description: str
    plans: Literal["samples"] | tuple[Path, ...] | None
    n_sample: int | None
    seed: int
    replicates: int
    nominal: bool
    shifts_from_release: bool
    simulation: Simulation
    search: Search | None
    axes: dict[str, Axis]
    profiles: dict[str, Any]

    def profile(self, name: str) -> Profile:
        """A profile the sweep uses."""
        found: Profile = self.profiles[name]
        return found

    def resolved(self) -> dict[str, Any]:
        """What is written beside the results: every setting, defaults included, as plain JSON values."""
        record = self.model_dump(mode="json", exclude={"axes", "profiles"})
        record["axes"] = {
            name: {"from": axis.low, "to": axis.high} if axis.continuous else [_plain(value) for value in axis.values]
            for name, axis in self.axes.items()
        }
        record["profiles"] = {name: {"kind": p.kind, "source": p.source} for name, p in self.profiles.items()}
        return record


def _plain(value: float | str | Distribution) -> float | str:
    return value.label() if isinstance(value, Distribution) else value


def load_sweep(path: str | Path, plans_given: bool = False, simulation: Mapping[str, Any] | None = None) -> Sweep:
    """Read and check a sweep file.

    Args:
        plans_given: plans come from the command line, so the file need not name any, and those it names
            need not exist.
        simulation: fields of ``Simulation`` that replace those of the file.

    Raises:
        InputError: one line that names file and field, such as
            "sweeps/x.toml: axes.scale must be > 0, got -1".
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            raw = tomllib.load(stream)
    except FileNotFoundError:
        raise InputError(f"{path}: no such sweep file") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not valid TOML: not UTF-8 text") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        sweep = _check(raw, path, plans_given)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not simulation:
        return sweep
    return sweep.model_copy(update={"simulation": sweep.simulation.changed(**simulation)})


def nominal_sweep(sim: Simulation) -> Sweep:
    """The sweep with one variant, the unchanged plan: a score."""
    return Sweep(
        file="",
        name="nominal",
        description="",
        plans=None,
        n_sample=None,
        seed=0,
        replicates=1,
        nominal=True,
        shifts_from_release=False,
        simulation=sim,
        search=None,
        axes={},
        profiles={},
    )


def _check(raw: Mapping[str, Any], path: Path, plans_given: bool) -> Sweep:
    try:
        file = _File.model_validate(raw)
    except ValidationError as error:
        raise InputError(describe(error)) from None
    if file.mode == "sample" and file.sample is None:
        raise InputError('sample is missing: mode = "sample" needs the number of variants to draw')
    if file.mode == "grid" and file.sample is not None:
        raise InputError('sample contradicts mode = "grid": set mode = "sample"')
    defined: dict[str, Profile] = {}
    for name, table in file.profiles.items():
        if not isinstance(table, dict):
            raise InputError(f"profiles.{name} must be a table, got {table!r}")
        defined[name] = define_profile(name, table, path.parent, defined)
    axes = {name: read_axis(name, value, file.mode == "sample") for name, value in file.axes.items()}
    profiles: dict[str, Profile] = {}
    if "profile" in axes:
        for value in axes["profile"].values:
            try:
                found = resolve(str(value), defined)
            except InputError as error:
                raise InputError(f"axes.profile: {error}") from None
            for profile in found:
                if profile.name in profiles:
                    raise InputError(f"axes.profile holds {profile.name!r} twice")
                profiles[profile.name] = profile
        axes["profile"] = Axis("profile", tuple(profiles))
    sweep = Sweep(
        file=str(path),
        name=file.name or path.stem,
        description=file.description,
        plans=_find_plans(file.plans, path.parent, plans_given),
        n_sample=file.sample,
        seed=file.seed,
        replicates=file.replicates,
        nominal=file.nominal,
        shifts_from_release=file.shifts_from == "release",
        simulation=file.simulation,
        search=_check_search(file, axes, profiles),
        axes=axes,
        profiles=profiles,
    )
    _refuse_contradictions(sweep)
    return sweep


def _find_plans(
    plans: str | list[str] | None, folder: Path, plans_given: bool
) -> Literal["samples"] | tuple[Path, ...] | None:
    if plans_given:
        return None
    if plans is None:
        raise InputError("plans is missing: name plan files here or on the command line "
                         f'(plans = "{SAMPLES}" takes the bundled ones)')  # fmt: skip
    if plans == SAMPLES:
        return "samples"
    names = [plans] if isinstance(plans, str) else plans
    if not names:
        raise InputError("plans is empty: name at least one plan file")
    paths = tuple(folder / name for name in names)
    for path in paths:
        if not path.exists():
            raise InputError(f"plans: no such file or folder: {path}")
    return paths


def _check_search(file: _File, axes: Mapping[str, Axis], profiles: Mapping[str, Profile]) -> Search | None:
    search = file.search
    if search is None:
        return None
    for name in ("level", "scale"):
        if name in axes:
            raise InputError(f"axes.{name} contradicts [search], which looks for the largest {name}: drop one of them")
    if file.mode == "sample":
        raise InputError('[search] contradicts mode = "sample": a search needs the full grid of the other axes')
    if not profiles:
        raise InputError("[search] needs axes.profile: without a profile there is no level to search for")
    strengths = {profile.strength for profile in profiles.values()}
    if Strength.ANGLE in strengths:
        name = next(name for name, profile in profiles.items() if profile.strength is Strength.ANGLE)
        raise InputError(f"[search] cannot be used with profile {name!r}, which itself passes through all its angles")
    if len(strengths) > 1:
        raise InputError("[search] needs profiles of one kind: some of these have a level in g, others a scale")
    strength = strengths.pop()
    if search.upper <= search.lower:
        raise InputError(f"search.upper must be > lower = {search.lower:g}, got {search.upper:g}")
    tolerance = search.tolerance or DEFAULT_TOLERANCE[strength]
    if (search.upper - search.lower) / tolerance > MAX_SEARCH_LEVELS:
        raise InputError(f"search.tolerance {tolerance:g} makes more than {MAX_SEARCH_LEVELS:,} levels")
    return search.model_copy(update={"tolerance": tolerance})


def _refuse_contradictions(sweep: Sweep) -> None:
    axes, profiles = sweep.axes, sweep.profiles
    for name in ("scale", "level", "direction"):
        if name in axes and not profiles:
            raise InputError(f"axes.{name} needs axes.profile: without a profile there is nothing to apply it to")
    if "scale" in axes and "level" in axes:
        raise InputError("axes.scale contradicts axes.level: both set how strong the profile is; drop one of them")
    for name, profile in profiles.items():
        if profile.strength is Strength.ANGLE:
            for axis in ("scale", "level"):
                if axis in axes:
                    raise InputError(f"axes.{axis} contradicts profile {name!r}, whose strength is its angle")
        elif "level" in axes and profile.strength is not Strength.LEVEL:
            raise InputError(f"axes.level contradicts profile {name!r}, which has no level in g: use axes.scale")
        elif "scale" in axes and profile.strength is Strength.LEVEL:
            raise InputError(f"axes.scale contradicts profile {name!r}, whose strength is a level in g: use axes.level")
    for general, parts in (
        ("friction_factor", ("box_friction_factor", "carrier_friction_factor")),
        ("placement_error_mm", ("placement_error_x_mm", "placement_error_y_mm")),
    ):
        for part in parts:
            if general in axes and part in axes:
                raise InputError(f"axes.{general} contradicts axes.{part}: drop one of them")
    errors = any(isinstance(v, Distribution) and v.random for axis in axes.values() for v in axis.values)
    if sweep.replicates > 1 and sweep.n_sample is not None:
        raise InputError('replicates contradicts mode = "sample": every sample has random numbers of its own')
    if sweep.replicates > 1 and not errors and not any(profile.random for profile in profiles.values()):
        raise InputError(f"replicates = {sweep.replicates} needs something random: no axis and no profile is")
    if not axes and not sweep.nominal:
        raise InputError("axes is empty: nothing is varied (nominal = true simulates the unchanged plans)")
