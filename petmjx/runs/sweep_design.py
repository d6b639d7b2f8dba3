"""The variants of a sweep (sets of changes to a plan), and the settings that identify a sweep. All plans of a sweep
have the same variants. Two sweeps with the same identifying settings have the same variants.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

from petmjx.runs.chain_legs import AS_IS, Remedy, legs_with
from petmjx.runs.sweep_axes import AXIS_KINDS, Axis, Value
from petmjx.runs.sweep_file import Sweep
from petmjx.world.error_distributions import Distribution
from petmjx.world.profiles.profile import Profile
from petmjx.world.random_streams import WorldKey
from petmjx.world.variants import DriveSpec, LegSpec, PlacementChange, PlacementKey, Variant

MOST_KEPT: Final = 100_000
"""Largest number of variants that are made once and kept in memory for all plans. If a sweep has more variants, all
variants are made again for each plan. A variant takes 1 kB of memory."""

REMEDY: Final = "remedy"
"""Column of the table ``worlds`` in the run of a chain: the name of the remedy (a change of the chain that is
tried)."""

Point = Mapping[str, Value]
"""A point of the grid: name of an axis → a value of this axis."""


@dataclass(frozen=True)
class SearchItem:
    """One question of a search: what is the largest level of the profile ``profile``, in the direction
    ``direction_deg``, that a pallet survives?"""

    profile: str
    direction_deg: float


@dataclass(eq=False)
class Design:
    """The variants of a sweep.

    Variants are numbered from 1, in the order of the axes. Number 0 is the nominal world (the unchanged plan), which is
    simulated only on request. The size of a grid is computed without making its variants, so that a grid that is too
    large is refused at once.
    """

    sweep: Sweep

    @property
    def parameter_columns(self) -> dict[str, str]:
        """Column of the results → unit ("1" for factors, "" for names)."""
        columns = {axis.kind.column: axis.kind.unit for axis in self.sweep.axes.values()}
        if self.sweep.search is not None:
            strength = AXIS_KINDS[self.sweep.strength]
            columns[strength.column] = strength.unit
        if self._has_replicates:
            columns["replicate"] = ""
        if self.sweep.legs:
            columns[REMEDY] = ""
        return columns

    @property
    def _has_replicates(self) -> bool:
        return self.sweep.replicates > 1 or self.sweep.sample is not None

    # Counting.

    @property
    def n_variants(self) -> int:
        """Number of variants per plan, including the nominal world if the sweep has it. For a search, this is the
        largest possible number, which is reached if all rounds of the search are needed for every placement, profile
        and direction."""
        sweep = self.sweep
        nominal = int(sweep.nominal)
        if sweep.sample is not None:
            return sweep.sample + nominal
        if sweep.legs:
            return self._chain_replicates * len(self.ways) + nominal
        per_profile = _n_points(axis for axis in self._axes(placement=False) if axis.name != "profile")
        profiles: list[Profile | None] = [*sweep.profiles.values()] or [None]
        total = 0
        for points, repeats in self._placement_counts():
            for profile in profiles:
                n_repeats = sweep.replicates if repeats == 1 and profile is not None and profile.random else 1
                total += points * repeats * n_repeats * per_profile
        if sweep.search is not None:
            total *= sweep.search.tests(len(sweep.search_levels))
        return total + nominal

    @property
    def n_placements(self) -> int:
        """Number of placements that are simulated per plan, not counting the placement of the nominal world."""
        if self.sweep.sample is not None:
            return len({variant.placement_key for variant in self._sampled()})
        return sum(points * repeats for points, repeats in self._placement_counts())

    @property
    def n_random_placements(self) -> int:
        """Number of placements with random errors that are simulated per plan."""
        if self.sweep.sample is not None:
            return self.n_placements if any(axis.random for axis in self._axes(placement=True)) else 0
        return sum(points * repeats for points, repeats in self._placement_counts()[1:])

    def _placement_counts(self) -> tuple[tuple[int, int], ...]:
        """Two pairs of numbers: for the grid points without a random error, and for those with a random error. Each
        pair has the number of points, and the number of placements that are simulated for each point."""
        if not self.sweep.axes and not self.sweep.legs:
            return ()
        axes = self._axes(placement=True)
        calm = math.prod(
            sum(not (isinstance(value, Distribution) and value.random) for value in axis.values) for axis in axes
        )
        return (calm, 1), (_n_points(axes) - calm, self.sweep.replicates)

    # Chains.

    @cached_property
    def ways(self) -> Mapping[str, tuple[LegSpec, ...]]:
        """Name of a remedy → the legs of the chain, changed by this remedy. The first entry, ``AS_IS``, is the
        unchanged chain."""
        sweep = self.sweep
        remedies: tuple[Remedy | None, ...] = (None, *sweep.remedies)
        return {
            AS_IS if remedy is None else remedy.name: legs_with(sweep.legs, remedy, sweep.own_profiles)
            for remedy in remedies
        }

    @property
    def _chain_replicates(self) -> int:
        """Number of replicates (repetitions with other random numbers) of a chain; 1 if nothing in the chain is
        random."""
        random = [axis.random for axis in self.sweep.axes.values()]
        random += [self.is_drawn(drive) for legs in self.ways.values() for leg in legs for drive in leg.drives]
        return self.sweep.replicates if any(random) else 1

    def is_drawn(self, drive: DriveSpec) -> bool:
        """Whether a drive (motion of the carrier) has random numbers, so that it differs from world to world."""
        return drive.scale_to is not None or self.sweep.profiles[drive.profile].random

    def _ways_from(self, placement: Variant, again: Sequence[int]) -> Iterator[Variant]:
        """The variants of a chain that share a placement: one for each replicate of the legs and each remedy."""
        ways = self.ways
        for replicate in again:
            for number, (remedy, legs) in enumerate(ways.items()):
                parameters = {**placement.parameters, REMEDY: remedy}
                if self._has_replicates:
                    parameters["replicate"] = replicate
                index = 1 + replicate * len(ways) + number
                yield replace(placement, index=index, replicate=replicate, parameters=parameters, legs=legs)

    def _axes(self, placement: bool) -> list[Axis]:
        """The axes that change placements, or, if ``placement`` is False, the axes that change drives (motions of the
        carrier). The axes are in the order of nesting, which may differ from their order in the file."""
        axes = self.sweep.axes
        return [axes[name] for name, kind in AXIS_KINDS.items() if name in axes and kind.placement is placement]

    # Enumeration.

    def placements(self) -> Iterator[tuple[Variant, tuple[Variant, ...]]]:
        """Each placement, together with the variants that start from its settled state. In a search, a placement comes
        without variants, because a search makes its variants level by level."""
        return iter(self._kept_placements if self.n_variants <= MOST_KEPT else self._placements())

    @cached_property
    def _kept_placements(self) -> tuple[tuple[Variant, tuple[Variant, ...]], ...]:
        return tuple(self._placements())

    def _placements(self) -> Iterator[tuple[Variant, tuple[Variant, ...]]]:
        sweep = self.sweep
        if sweep.nominal:
            nominal = Variant(0, self._change({}))
            yield nominal, (nominal,)
        if not sweep.axes and not sweep.legs:
            return
        if sweep.sample is not None:
            grouped: dict[PlacementKey, list[Variant]] = {}
            for variant in self._sampled():
                grouped.setdefault(variant.placement_key, []).append(variant)
            for members in grouped.values():
                yield replace(members[0], drive=None), tuple(members)
            return
        index = itertools.count(1)
        for point in _points(self._axes(placement=True)):
            change = self._change(point)
            for replicate in range(sweep.replicates if change.random else 1):
                placement = self._variant(0, point, replicate, change)
                if sweep.search is not None:
                    yield placement, ()
                    continue
                if sweep.legs:
                    drive_replicates = (replicate,) if change.random else range(self._chain_replicates)
                    yield placement, tuple(self._ways_from(placement, drive_replicates))
                    continue
                variants = tuple(
                    self._variant(next(index), {**point, **drive_point}, drive_replicates, change)
                    for drive_point in _points(self._axes(placement=False))
                    for drive_replicates in self._drive_replicates(drive_point, replicate, change)
                )
                yield placement, variants

    def draws(self) -> dict[int, int]:
        """Number of a variant → number of its draw, for variants with random values. Variants of the same draw use the
        same random numbers.

        In a grid, the draw is the replicate, and the random numbers of a draw differ from plan to plan. In a sample,
        each variant is a separate draw, and the values of a variant are the same for all plans.
        """
        sweep = self.sweep
        if sweep.sample is not None:
            return {number: number for number in range(1, sweep.sample + 1)}
        drawn = (
            variant
            for _, variants in self.placements()
            for variant in variants
            if variant.placement.random or any(map(self.is_drawn, _drives(variant)))
        )
        return {variant.index: variant.replicate for variant in drawn}

    def search_items(self) -> tuple[SearchItem, ...]:
        """The search items of each placement: one for each profile in each direction. For each item, a search finds the
        largest level survived."""
        directions = self.sweep.axes["direction"].values if "direction" in self.sweep.axes else (0.0,)
        return tuple(
            SearchItem(name, direction)
            for name in self.sweep.profiles
            for direction in directions
            if isinstance(direction, float)
        )

    def _drive_replicates(self, point: Point, replicate: int, change: PlacementChange) -> Sequence[int]:
        name = point.get("profile")
        if not change.random and isinstance(name, str) and self.sweep.profiles[name].random:
            return range(self.sweep.replicates)
        return (replicate,)

    def _sampled(self) -> Iterator[Variant]:
        """The variants of a sample: the value of each axis is drawn at random. All plans have the same variants. Every
        variant has a replicate number of its own."""
        axes = [*self._axes(placement=True), *self._axes(placement=False)]
        for number in range(1, (self.sweep.sample or 0) + 1):
            key = WorldKey(self.sweep.seed, "", number)
            point = {axis.name: axis.pick(key) for axis in axes}
            yield self._variant(number, point, number, self._change(point))

    def _variant(self, index: int, point: Point, replicate: int, change: PlacementChange) -> Variant:
        parameters: dict[str, float | int | str] = {
            AXIS_KINDS[name].column: self.sweep.axes[name].cell(value) for name, value in point.items()
        }
        if self._has_replicates:
            parameters["replicate"] = replicate
        drive = None
        if "profile" in point:
            strength = point.get("level", point.get("scale", 1.0))
            direction = point.get("direction", 0.0)
            assert isinstance(strength, float)
            assert isinstance(direction, float)
            drive = DriveSpec(str(point["profile"]), strength, direction)
        return Variant(index, change, drive, replicate, parameters)

    def _change(self, point: Point) -> PlacementChange:
        # A sweep never has two axes that change the same field, so no value replaces another value.
        changes: dict[str, Any] = {field: value for name, value in point.items() for field in AXIS_KINDS[name].changes}
        return PlacementChange(shifts_from_release=self.sweep.shifts_from == "release", **changes)


def _drives(variant: Variant) -> Iterator[DriveSpec]:
    """The drives (motions of the carrier) of a variant, including the drives of its legs."""
    if variant.drive is not None:
        yield variant.drive
    for leg in variant.legs:
        yield from leg.drives


def _points(axes: Sequence[Axis]) -> Iterator[dict[str, Value]]:
    """All points of the grid, in an order in which the last axis varies fastest. Without axes, there is one point
    without values."""
    names = [axis.name for axis in axes]
    for values in itertools.product(*(axis.values for axis in axes)):
        yield dict(zip(names, values, strict=True))


def _n_points(axes: Iterable[Axis]) -> int:
    return math.prod(len(axis.values) for axis in axes)


_NOT_IDENTIFYING = {"name", "description", "plans", "simulation", "axes", "own_profiles"}
"""Fields of ``Sweep`` that do not identify a sweep: fields that do not change worlds, and fields that are compared
separately when a run is resumed."""


def sweep_identity(sweep: Sweep) -> dict[str, Any]:
    """The settings that identify a sweep, as plain JSON values. The options of the simulation are left out, and each
    profile is represented by a digest of its samples."""
    settings = sweep.model_dump(mode="json", exclude=_NOT_IDENTIFYING)
    if sweep.search is not None:
        settings["search"]["levels"] = len(sweep.search_levels)
    if not sweep.legs:  # without these entries, the settings equal those of runs by earlier versions of petmjx
        del settings["legs"], settings["remedies"]
    settings["axes"] = {name: _values(axis) for name, axis in sweep.axes.items()}
    settings["profiles"] = {name: _digest(sweep, name) for name in sweep.profiles}
    return settings


def _values(axis: Axis) -> object:
    if axis.continuous:
        return {"from": axis.low, "to": axis.high}
    return [value if isinstance(value, float | int | str) else repr(value) for value in axis.values]


def _digest(sweep: Sweep, name: str) -> str:
    """Digest of the samples of a profile. For a random profile, the samples of one realisation are used, because all
    realisations come from the same settings."""
    profile = sweep.profiles[name]
    excitation = profile.excitation(sweep.simulation.physics.timestep_s, 0.0, WorldKey(sweep.seed, "", 0))
    digest = hashlib.blake2b(f"{excitation.kind} {excitation.samples.shape}".encode(), digest_size=8)
    digest.update(excitation.samples.tobytes())
    return digest.hexdigest()
