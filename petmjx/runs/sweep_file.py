"""Reads and checks sweep files (``sweeps/*.toml``). docs/sweeps.md describes their contents."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    PlainValidator,
    StrictBool,
    StrictFloat,
    StrictInt,
    Tag,
    ValidationInfo,
    model_validator,
)

from petmjx.common.checked_records import LIST, VALUE, CheckedRecord, complaint, shape
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.common.toml_files import read_toml
from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.options.simulation import Simulation
from petmjx.runs.chain_legs import MOST_LEGS, Leg, Remedy, check_chain, profiles_of_legs
from petmjx.runs.ready_sweeps import find_sweep
from petmjx.runs.sweep_axes import AXIS_KINDS, MAX_STRENGTH, Axis, read_axes
from petmjx.world.profiles.profile import Profile, Strength
from petmjx.world.profiles.profile_registry import resolve
from petmjx.world.profiles.profiles_of_sweep_files import MAX_NAME, FileName, define_profiles

SAMPLES: Final = "samples"
"""The value ``plans = "samples"`` in a sweep file means the bundled sample plans."""

DEFAULT_TOLERANCE: Final = {Strength.LEVEL: 0.01, Strength.SCALE: 0.02}
"""Default accuracy of the largest level (g) or scale that a search finds."""

MAX_SEARCH_LEVELS: Final = 1_000_000
MAX_PROFILE_STEPS: Final = 4_000_000
"""Largest number of steps of one profile. The samples of a profile take 24 bytes per step."""
MAX_TEXT: Final = 100_000
"""Largest number of characters of a description."""
MIN_TOLERANCE: Final = 1e-5
"""Smallest tolerance of a search, in g or as a difference of scales: a thousandth of the default tolerance of levels.
Levels are rounded to 12 decimals, that is, by far less than 1e-5, so neighbouring levels stay different."""
MAX_REPEATS: Final = 2**31 - 1
"""Largest number of samples or replicates. The results store the number of a variant in 32 bits."""


class Search(CheckedRecord):
    """The table ``[search]`` of a sweep file, which requests a search for the largest level or scale that pallets
    survive. A sweep with the table ``[search]`` has no axis ``level`` or ``scale``."""

    lower: StrictFloat = Field(0.0, ge=0, le=MAX_STRENGTH, description="lowest level (g) or scale of the search")
    upper: StrictFloat = Field(2.0, gt=0, le=MAX_STRENGTH, description="highest level (g) or scale of the search")
    tolerance: StrictFloat | None = Field(
        None,
        ge=MIN_TOLERANCE,
        description="accuracy of the largest level or scale that a pallet survives; by default 0.01 g for levels "
        "and 0.02 for scales",
    )
    sections: StrictInt = Field(
        3,
        ge=1,
        le=1000,
        description="number of levels that are tested at the same time, for each direction",
    )

    @model_validator(mode="after")
    def _upper_above_lower(self) -> Self:
        if self.upper <= self.lower:
            raise complaint(f"must be > lower = {self.lower:g}, got {self.upper:g}", "upper")
        return self

    def tests(self, n_levels: int) -> int:
        """Largest number of simulations that one search for the largest level needs (one plan with one value of every
        axis): the number of tested levels, summed over all rounds."""
        return sum(self._tests_of_rounds(n_levels))

    def rounds(self, n_levels: int) -> int:
        """Largest number of rounds that one search for the largest level needs."""
        return len(self._tests_of_rounds(n_levels))

    def _tests_of_rounds(self, n_levels: int) -> list[int]:
        """Largest number of tested levels in each round of one search."""
        tests: list[int] = []
        while n_levels > 0:
            tests.append(min(self.sections, n_levels))
            n_levels = -(-(n_levels - tests[-1]) // (self.sections + 1))
        return tests


def _plan_paths(plans: str) -> str | tuple[Path, ...]:
    return plans if plans == SAMPLES else (Path(plans),)


def _own_profiles(tables: Any, info: ValidationInfo) -> dict[str, Profile]:
    return define_profiles(tables, info.context.parent if isinstance(info.context, Path) else Path())


def _named_axes(tables: Any, info: ValidationInfo) -> dict[str, Axis]:
    """Name → axis. If the axis ``profile`` names a family of profiles, the names of the profiles in the family replace
    the name of the family."""
    axes = read_axes(tables, info.data.get("mode") == "sample")
    if "profile" in axes:
        names: list[str] = []
        for value in axes["profile"].values:
            try:
                profiles = resolve(str(value), info.data.get("own_profiles"))
            except InputError as error:
                raise complaint(f": {error}", "profile") from None
            names += [profile.name for profile in profiles]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise complaint(f"holds {twice[0]!r} twice", "profile")
        axes["profile"] = Axis("profile", tuple(names))
    return axes


class Sweep(CheckedRecord):
    """The content of a sweep file, after all checks."""

    name: str = Field("", max_length=MAX_NAME, description="name of the sweep; by default the name of its file")
    description: str = Field("", max_length=MAX_TEXT, description="the question that the sweep answers")
    plans: (
        Annotated[
            Annotated[tuple[Path, ...], Tag(LIST)] | Annotated[FileName, AfterValidator(_plan_paths), Tag(VALUE)],
            Discriminator(shape),
        ]
        | None
    ) = Field(
        None,
        description="plans to simulate: a path or a list of paths, relative to the folder of the sweep file, or "
        '"samples"',
    )
    mode: Literal["grid", "sample"] = Field(
        "grid",
        description="'grid': every combination of the values of the axes is simulated; 'sample': random combinations "
        "are drawn",
    )
    sample: StrictInt | None = Field(
        None, ge=1, le=MAX_REPEATS, description="number of random combinations, if mode is 'sample'"
    )
    seed: StrictInt = Field(
        0,
        ge=0,
        lt=2**63,
        description="seed that determines all random numbers, together with the plan's id and the number of the "
        "replicate",
    )
    replicates: StrictInt = Field(
        1,
        ge=1,
        le=MAX_REPEATS,
        description="number of times that each variant is simulated, each time with other random numbers",
    )
    nominal: StrictBool = Field(
        False, description="whether variant 0, the world without changes and without a drive, is simulated too"
    )
    shifts_from: Literal["plan", "release"] = Field(
        "plan",
        description="'plan': shifts of boxes are measured from the planned place; 'release': from the place of "
        "release, which includes the placement error",
    )
    simulation: Simulation = Field(Simulation(), description="how worlds are simulated")
    search: Search | None = Field(
        None,
        description="search for the largest level or scale that pallets survive; it replaces the axis 'level' or "
        "'scale'",
    )
    own_profiles: Annotated[dict[str, Any], PlainValidator(_own_profiles)] = Field(
        {}, alias="profiles", description="the file's own profiles, by name"
    )
    axes: Annotated[dict[str, Axis], PlainValidator(_named_axes)] = Field(
        {}, description="parameters that are varied: axes by name, in the order of the file"
    )
    legs: tuple[Leg, ...] = Field(
        (),
        max_length=MOST_LEGS,
        description="legs of a chain: parts of the journey, with the profiles that shake the pallet",
    )
    remedies: tuple[Remedy, ...] = Field(
        (), max_length=MOST_LEGS, description="changes of the chain, to be compared with the unchanged chain"
    )

    _file: Path | None = None
    _tables: Mapping[str, Any] | None = None

    def model_post_init(self, context: Any) -> None:
        """Store the path of the sweep file, which pydantic passes to this function as the context of the validation."""
        self._file = context

    @property
    def file(self) -> str:
        """The path of the file as the user gave it, for messages."""
        return str(self._file or self.name)

    @cached_property
    def profiles(self) -> dict[str, Profile]:
        """Name → profile, for the profiles that the sweep uses, either on its axis ``profile`` or in the legs of its
        chain."""
        if self.legs:
            return profiles_of_legs(self.legs, self.own_profiles)
        names = [str(value) for value in self.axes["profile"].values] if "profile" in self.axes else []
        return {name: resolve(name, self.own_profiles)[0] for name in names}

    @property
    def is_random(self) -> bool:
        """Whether anything in the sweep is random, so that replicates of the same variant differ."""
        axes, profiles = self.axes.values(), self.profiles.values()
        drawn = any(event.drawn for leg in self.legs for event in leg.events)
        return drawn or any(axis.random for axis in axes) or any(profile.random for profile in profiles)

    @property
    def has_drives(self) -> bool:
        """Whether something shakes the pallet after all boxes are placed: profiles, or the legs of a chain."""
        return bool(self.profiles or self.legs)

    @property
    def strength(self) -> Strength:
        """The quantity that a search varies: a level or a scale. The value of the returned enum member is the name of
        the axis."""
        levels = any(profile.strength is Strength.LEVEL for profile in self.profiles.values())
        return Strength.LEVEL if levels else Strength.SCALE

    @cached_property
    def search_levels(self) -> FloatArray:
        """(n,) the levels that a search can test, in ascending order: from `lower` in steps of the search's tolerance,
        followed by `upper`.

        The last step is shorter if the tolerance does not divide the range. No level is above `upper`.
        """
        if self.search is None:
            return np.zeros(0)
        lower, upper = self.search.lower, self.search.upper
        # 1e-6 is subtracted because of rounding errors: the levels 0, 0.01 … 2 must end with `upper`, without another
        # level just below `upper`.
        count = max(math.ceil((upper - lower) / self._tolerance - 1e-6), 1)
        return np.append(np.round(lower + np.arange(count) * self._tolerance, 12), upper)

    @property
    def _tolerance(self) -> float:
        tolerance = self.search.tolerance if self.search is not None else None
        return tolerance or DEFAULT_TOLERANCE[self.strength]

    def resolved(self) -> dict[str, Any]:
        """The sweep as it is written to ``run.json``: all settings, including defaults, as plain JSON values."""
        record = {
            "file": self.file,
            "tables": _json_tables(self._tables),
            **self.model_dump(mode="json", exclude={"axes", "own_profiles"}),
        }
        if self.search is not None:
            record["search"]["tolerance"] = self._tolerance
        record["axes"] = {name: axis.described() for name, axis in self.axes.items()}
        record["profiles"] = {name: {"kind": p.kind, "source": p.source} for name, p in self.profiles.items()}
        return record

    # Checks that refuse settings which contradict each other.

    @model_validator(mode="after")
    def _mode(self) -> Self:
        if self.mode == "grid":
            if self.sample is not None:
                raise complaint('contradicts mode = "grid": set mode = "sample"', "sample")
            return self
        if self.sample is None:
            raise complaint('is missing: mode = "sample" needs the number of variants to draw', "sample")
        if self.search is not None:
            raise ValueError('[search] contradicts mode = "sample": a search needs the full grid of the other axes')
        if self.replicates > 1:
            raise complaint(
                'contradicts mode = "sample": every sample already has its own random numbers', "replicates"
            )
        return self

    @model_validator(mode="after")
    def _search_has_one_strength(self) -> Self:
        if self.search is None:
            return self
        for axis in (Strength.LEVEL, Strength.SCALE):
            if axis in self.axes:
                raise _contradiction(axis, f"[search], which looks for the largest {axis}: drop one of them")
        if not self.profiles:
            raise ValueError("[search] needs axes.profile: without a profile there is no level to search for")
        for name, profile in self.profiles.items():
            if profile.strength is Strength.ANGLE:
                raise ValueError(
                    f"[search] cannot be used with profile {name!r}, which tilts the carrier through all angles by "
                    "itself"
                )
            if profile.strength is not self.strength:
                raise ValueError(
                    "[search] needs profiles of one kind: some profiles here have a level in g, others a scale"
                )
        if (self.search.upper - self.search.lower) / self._tolerance > MAX_SEARCH_LEVELS:
            raise complaint(f"{self._tolerance:g} makes more than {MAX_SEARCH_LEVELS:,} levels", "search", "tolerance")
        return self

    @model_validator(mode="after")
    def _chain_fits(self) -> Self:
        check_chain(self.legs, self.remedies, self.own_profiles)
        if not self.legs:
            return self
        if self.search is not None:
            raise ValueError(
                "[search] contradicts legs: a search varies a level, but a chain is the same journey for every pallet"
            )
        if self.sample is not None:
            raise complaint(
                'contradicts legs: instead of mode = "sample", set replicates to the number of worlds', "sample"
            )
        for name, axis in self.axes.items():
            if not axis.kind.placement:
                raise _contradiction(name, "legs: the events of the legs determine what shakes the pallet")
            if len(axis.values) > 1:
                raise complaint(f"must be one value in a chain, got {len(axis.values)}", "axes", name)
        turns = next((place for place, leg in enumerate(self.legs) if leg.wrap_turns is not None), None)
        if turns is not None and "wrap_turns" in self.axes:
            raise _contradiction("wrap_turns", f"legs[{turns}].wrap_turns: drop one of them")
        return self

    @model_validator(mode="after")
    def _strengths_fit_profiles(self) -> Self:
        if self.legs:
            return self
        axes = self.axes
        for name in ("scale", "level", "direction"):
            if name in axes and not self.profiles:
                raise complaint("needs axes.profile: it changes a profile, and no profile is given", "axes", name)
        if "scale" in axes and "level" in axes:
            raise _contradiction("scale", "axes.level: both set how strong the profile is; drop one of them")
        for name, profile in self.profiles.items():
            wrong = next((other for other in ("scale", "level") if other in axes and other != profile.strength), None)
            if wrong is None:
                continue
            faults = {
                Strength.ANGLE: "whose strength is its angle",
                Strength.LEVEL: "whose strength is a level in g: use axes.level",
                Strength.SCALE: "which has no level in g: use axes.scale",
            }
            raise _contradiction(wrong, f"profile {name!r}, {faults[profile.strength]}")
        return self

    @model_validator(mode="after")
    def _profiles_fit_the_timestep(self) -> Self:
        timestep_s = self.simulation.physics.timestep_s
        for name, profile in self.profiles.items():
            n_steps = profile.n_steps(timestep_s)
            if n_steps > MAX_PROFILE_STEPS:
                text = f"{n_steps:,} steps of {timestep_s:g} s, more than {MAX_PROFILE_STEPS:,}"
                field = ("legs",) if self.legs else ("axes", "profile")
                raise complaint(f": profile {name!r} takes {text}", *field)
        for number, leg in enumerate(self.legs):
            profiles = [profile for event in leg.events for profile in resolve(event.profile, self.own_profiles)]
            n_steps = sum(
                profile.n_steps(timestep_s) + seconds_to_steps(leg.pause_s, timestep_s) for profile in profiles
            )
            if n_steps > MAX_PROFILE_STEPS:
                text = f"take {n_steps:,} steps of {timestep_s:g} s, more than {MAX_PROFILE_STEPS:,}"
                raise complaint(text, "legs", number, "events")
        return self

    @model_validator(mode="after")
    def _axes_do_not_overlap(self) -> Self:
        kinds = [kind for kind in AXIS_KINDS.values() if kind.name in self.axes]
        for one, other in itertools.combinations(kinds, 2):
            if set(one.changes) & set(other.changes):
                raise _contradiction(one.name, f"axes.{other.name}: drop one of them")
        return self

    @model_validator(mode="after")
    def _something_varies(self) -> Self:
        if not self.axes and not self.nominal and not self.legs:
            text = "is empty: nothing is varied (nominal = true simulates the unchanged plans)"
            raise complaint(text, "axes")
        if self.replicates > 1 and not self.is_random:
            raise ValueError(
                f"replicates = {self.replicates} needs a random axis or profile: otherwise all replicates are the same"
            )
        return self


def _contradiction(axis: str, other: str) -> ValueError:
    return complaint(f"contradicts {other}", "axes", axis)


def load_sweep(path: str | Path, plans_given: bool = False, simulation: Mapping[str, Any] | None = None) -> Sweep:
    """Read a sweep file and check its content.

    Args:
        plans_given: whether the caller provides plans. If the caller provides plans, the file need not name plans, and
            plans that the file names need not exist.
        simulation: fields of ``Simulation`` that replace the fields of the file.

    Raises:
        InputError: the file is wrong. The message is one line with file and field, such as "x.toml: axes.scale must be
            > 0, got -1".
    """
    path = Path(path)
    return sweep_of_tables(read_toml(path), path, plans_given, simulation)


def sweep_of_tables(
    tables: Mapping[str, Any], path: Path, plans_given: bool = False, simulation: Mapping[str, Any] | None = None
) -> Sweep:
    """Check the tables of a sweep file that has already been read, as :func:`load_sweep` does after reading a file."""
    said_by_file = _json_tables(tables)
    simulation_table = tables.get("simulation")
    if simulation and "carrier" in simulation and isinstance(simulation_table, dict):
        # The carrier in the argument ``simulation`` replaces the carrier that the sweep file names. The file of the
        # replaced carrier is not read, because it may have been deleted or changed since an earlier run.
        simulation_table.pop("carrier", None)
    try:
        sweep = Sweep.read({"name": path.stem, **tables}, context=path)
        changes: dict[str, Any] = {"plans": None if plans_given else _existing_files(sweep.plans, path.parent)}
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if simulation:
        changes["simulation"] = sweep.simulation.changed(**simulation)
    sweep = sweep.model_copy(update=changes)
    sweep._tables = said_by_file
    return sweep


def _json_tables(tables: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Tables of TOML as JSON values; None if JSON cannot represent the tables, because they contain times or infinities
    or are nested too deeply."""
    try:
        return None if tables is None else json.loads(json.dumps(tables, allow_nan=False))
    except (TypeError, ValueError, RecursionError):
        return None


def _existing_files(plans: str | tuple[Path, ...] | None, folder: Path) -> str | tuple[Path, ...]:
    """The paths of the plan files that a sweep file names. In the sweep file, these paths are relative to the folder of
    the sweep file. Raises InputError if a plan file does not exist."""
    if plans is None:
        raise InputError("plans is missing: name plan files in the sweep file or on the command line (plans = "
        f'"{SAMPLES}" takes the bundled samples)')  # fmt: skip
    if isinstance(plans, str):
        return plans
    if not plans:
        raise InputError("plans is empty: name at least one plan file")
    paths = tuple(folder / plan for plan in plans)
    for path in paths:
        try:
            exists = path.exists()
        except (OSError, ValueError):  # for example, the name is too long or has a null character
            exists = False
        if not exists:
            raise InputError(f"plans: no such file or folder: {printable(str(path))}")
    return paths


def nominal_sweep(sim: Simulation) -> Sweep:
    """The sweep that stands for a plain score: its only variant is the unchanged plan."""
    return Sweep(name="nominal", nominal=True, simulation=sim)


def chain_sweep(file: str | Path, n_worlds: int | None, simulation: Mapping[str, Any]) -> Sweep:
    """The sweep that a score with a transport chain simulates. The sweep has the variants of the chain, and the
    nominal world, in which the unchanged plan is placed but not shaken.

    Args:
        file: a sweep file with legs, or the name of a ready-made one.
        n_worlds: number of worlds with errors for each plan. If ``n_worlds`` is None, the number in the file is used.
        simulation: fields of ``Simulation`` that replace the fields of the file.

    Raises:
        InputError: the file is unusable or has no legs.
    """
    path = find_sweep(file)
    tables = read_toml(path)
    if not tables.get("legs"):
        raise InputError(f"{path}: has no [[legs]], which a chain needs; for other sweeps, use 'petmjx sweep'")
    sweep = sweep_of_tables(tables, path, plans_given=True, simulation=simulation)
    if (n_worlds or 1) > 1 and not sweep.is_random:
        raise InputError(
            f"{sweep.file}: confidence = {n_worlds} needs a random axis or profile: otherwise all worlds are the same"
        )
    return sweep.model_copy(update={"nominal": True, "replicates": n_worlds or sweep.replicates})
