"""From a sweep and its plans to the worlds to simulate, in groups that share one placement."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from petmjx.config import Check, Schedule
from petmjx.engines.cost import Work
from petmjx.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.sweeps.axes import AXIS_KINDS, Axis, Value
from petmjx.sweeps.file import Search, Sweep
from petmjx.text import counted, duration, rounded
from petmjx.units import seconds_to_steps
from petmjx.world.job import Drive
from petmjx.world.profiles.registry import Profile, Strength, build_drive
from petmjx.world.random import WorldKey
from petmjx.world.scene import Scene, build_scene
from petmjx.world.variants import ZERO, Distribution, DriveSpec, PlacementChange, PlacementKey, Variant

MAX_WORLDS = 1_000_000
"""More worlds than this are refused unless the user insists."""

Point = Mapping[str, Value]


@dataclass(frozen=True)
class SearchItem:
    """One question of a search: how much of this profile in this direction does a placement survive?"""

    profile: str
    direction_deg: float


@dataclass(frozen=True, eq=False)
class PlacementGroup:
    """Worlds of one plan that share a placement: simulate that once, fork its settled state.

    Attributes:
        number: running number of the placement within its plan, from 0.
        placement: the variant whose scene is simulated (its drive does not matter).
        variants: the worlds. One without a drive takes the placement's own outcome. Empty in a search,
            whose variants are made level by level with `SweepPlan.search_variant`.
    """

    plan: Plan
    number: int
    placement: Variant
    variants: tuple[Variant, ...] = ()


@dataclass(eq=False)
class SweepPlan:
    """All worlds of a sweep, made one placement at a time.

    Variants are numbered from 1 in the order of the file's axes, the same for every plan; 0 is the nominal
    world, which is simulated only where the sweep asks for it.

    Args:
        allow_large: accept more than a million worlds.

    Raises:
        InputError: no plans, or more than a million worlds without ``allow_large``.
    """

    sweep: Sweep
    plans: Sequence[Plan]
    allow_large: bool = False
    _drives: dict[tuple[object, ...], Drive] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if not self.plans:
            raise InputError(f"{self.sweep.file}: plans: no usable plan to sweep over")
        if self.n_worlds > MAX_WORLDS and not self.allow_large:
            raise InputError(
                f"{self.sweep.file}: axes make {self.n_worlds:,} worlds ({counted(len(self.plans), 'plan')} × "
                f"{counted(self.n_variants, 'variant')}), more than {MAX_WORLDS:,}: pass --yes if that is meant"
            )

    # Counting never enumerates, so that a grid too large is refused at once.

    @property
    def n_variants(self) -> int:
        """Variants a plan, nominal included; in a search: at most, were every item to test all its rounds."""
        nominal = int(self.sweep.nominal)
        if self.sweep.n_sample is not None:
            return self.sweep.n_sample + nominal
        per_profile = self._n_points(self._drive_axes(), skip="profile")
        total = 0
        for change, repeats in self._placement_counts():
            for profile in self._profiles_or_none():
                again = self.sweep.replicates if repeats == 1 and _is_random(profile) else 1
                total += change * repeats * again * per_profile
        if self.search is not None:
            total *= self.tests_per_search_item
        return total + nominal

    @property
    def n_worlds(self) -> int:
        """Worlds of all plans; at most, in a search."""
        return len(self.plans) * self.n_variants

    @property
    def n_placements(self) -> int:
        """Placements a plan. For samples: at most."""
        if self.sweep.n_sample is not None:
            return len({variant.placement_key for variant in self._sampled()})
        return sum(change * repeats for change, repeats in self._placement_counts())

    @property
    def search(self) -> Search | None:
        return self.sweep.search

    @property
    def search_levels(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """(n,) the levels a search can test: from lower to upper by its tolerance. Index 0 is `lower`."""
        search = self._search()
        tolerance = search.tolerance or 0.01
        count = round((search.upper - search.lower) / tolerance) + 1
        return np.round(search.lower + np.arange(count) * tolerance, 12)

    @property
    def tests_per_search_item(self) -> int:
        """Worlds one item of a search needs: rounds × levels a round, at most."""
        sections = self._search().sections
        open_levels, tests = len(self.search_levels), 0
        while open_levels > 0:
            tests += min(sections, open_levels)
            open_levels = -(-(open_levels - min(sections, open_levels)) // (sections + 1))
        return tests

    def search_items(self) -> tuple[SearchItem, ...]:
        """What a search asks of each placement: every profile in every direction."""
        directions = self.sweep.axes.get("direction", Axis("direction", (0.0,))).values
        return tuple(
            SearchItem(name, float(direction))
            for name in self.sweep.profiles
            for direction in directions
            if not isinstance(direction, str | Distribution)
        )

    @property
    def parameter_columns(self) -> dict[str, str]:
        """Result column → unit ("1" for factors, "" for names)."""
        columns = {AXIS_KINDS[name].column: AXIS_KINDS[name].unit for name in self.sweep.axes}
        if self.search is not None:
            strength = AXIS_KINDS[self._search_axis()]
            columns[strength.column] = strength.unit
        if self.sweep.replicates > 1 or self.sweep.n_sample is not None:
            columns["replicate"] = ""
        return columns

    # Enumeration.

    def groups(self) -> Iterator[PlacementGroup]:
        """Every placement of every plan with its worlds, plan by plan."""
        for plan in self.plans:
            for number, (placement, variants) in enumerate(self._grouped_variants()):
                yield PlacementGroup(plan, number, placement, variants)

    def variants(self) -> Iterator[Variant]:
        """The variants of any one plan; none in a search but the nominal one."""
        for _, variants in self._grouped_variants():
            yield from variants

    def search_variant(self, group: PlacementGroup, item: int, level_index: int) -> Variant:
        """The world that tests one level of one item of a search. Its number says which, in any order."""
        items = self.search_items()
        levels = self.search_levels
        level = float(levels[level_index])
        asked = items[item]
        index = 1 + (group.number * len(items) + item) * len(levels) + level_index
        axis = self._search_axis()
        drive = DriveSpec(asked.profile, level, asked.direction_deg)
        parameters = {**group.placement.parameters, "profile": asked.profile, AXIS_KINDS[axis].column: level}
        if "direction" in self.sweep.axes:
            parameters["direction_deg"] = asked.direction_deg
        return replace(group.placement, index=index, drive=drive, parameters=parameters)

    def scene(self, group: PlacementGroup) -> Scene:
        """The scene of a group's placement."""
        nominal = build_scene(group.plan, self.sweep.simulation)
        return group.placement.apply(nominal, group.plan.plan_id, self.sweep.seed)

    def drive_start_s(self, plan: Plan) -> float:
        """Absolute time at which a drive begins under the fixed schedule, s: settle after the nominal end of
        placement, n × interval, as in the reference. Rounding to steps puts the last placement a little later."""
        simulation = self.sweep.simulation
        placed_s = simulation.interval_s * plan.n_boxes if simulation.check is Check.ONE_BY_ONE else 0.0
        return placed_s + simulation.settle_s

    def drive(self, plan: Plan, variant: Variant) -> Drive | None:
        """What the engine is given for one world. Worlds that feel the same samples share the array."""
        spec = variant.drive
        if spec is None:
            return None
        profile = self.sweep.profile(spec.profile)
        simulation = self.sweep.simulation
        start_s = self.drive_start_s(plan) if simulation.schedule is Schedule.FIXED else 0.0
        key: tuple[object, ...] = (spec.profile, start_s)
        if profile.random:
            key = (*key, plan.plan_id, variant.replicate)
            self._drives = {k: v for k, v in self._drives.items() if len(k) == 2 or k[2] == plan.plan_id}
        if key not in self._drives:
            world = WorldKey(self.sweep.seed, plan.plan_id, variant.replicate)
            self._drives[key] = self._unit_drive(profile, plan, start_s, world)
        unit = self._drives[key]
        return replace(unit, scale=spec.scale, yaw_rad=float(np.radians(spec.direction_deg)))

    def _unit_drive(self, profile: Profile, plan: Plan, start_s: float, world: WorldKey) -> Drive:
        """A profile at scale 1, unturned.

        With ``total_time_factor`` the run ends as the reference's demo does, at a multiple of the placement
        time, wherever the profile is then.
        """
        simulation = self.sweep.simulation
        timestep_s = simulation.physics.timestep_s
        factor = simulation.total_time_factor
        drive = build_drive(profile, timestep_s, 1.0, 0.0, start_s, simulation.rest_s, world)
        if factor is None:
            return drive
        total_s = factor * (simulation.interval_s * plan.n_boxes)
        left = seconds_to_steps(total_s, timestep_s) - seconds_to_steps(start_s, timestep_s)
        if left <= 0:
            raise InputError(f"{self.sweep.file}: simulation.total_time_factor {factor:g} ends plan {plan.plan_id} "
                             "before its profile begins")  # fmt: skip
        samples = drive.excitation.samples[:left]
        # Half a step more, so that truncation to whole steps gives back the number meant.
        rest_s = (left - len(samples) + 0.5) * timestep_s
        return replace(drive, excitation=replace(drive.excitation, samples=samples), rest_s=rest_s)

    # Cost.

    def work(self) -> Work:
        """What all worlds together are expected to cost."""
        sim, profiles = self.sweep.simulation, list(self.sweep.profiles.values())
        rest_steps = seconds_to_steps(sim.rest_s, sim.physics.timestep_s)
        drives = [profile.n_steps(sim.physics.timestep_s) + rest_steps for profile in profiles]
        nominal = int(self.sweep.nominal)
        return Work(
            sim=sim,
            boxes=[plan.n_boxes for plan in self.plans],
            placements=self.n_placements + nominal,
            drives=self.n_variants - nominal if profiles else 0,
            drive_steps=sum(drives) / len(drives) if drives else 0.0,
        )

    def size(self, seconds: float | None) -> str:
        """One line on how much there is to simulate, and how long that is expected to take (None: nobody knows)."""
        most = "at most " if self.search is not None else ""
        variants = f" ({counted(len(self.plans), 'plan')} × {counted(self.n_variants, 'variant')})"
        what = counted(len(self.plans), "plan")
        if self.sweep.axes:
            placements = counted(len(self.plans) * self.n_placements, "placement")
            what = f"{most}{counted(self.n_worlds, 'world')}{variants} from {placements}"
        long = "" if seconds is None else f", about {duration(seconds)}"
        return f"{what}, about {rounded(float(self.work().steps.sum()))} steps{long}"

    # Inside.

    def _search(self) -> Search:
        if self.search is None:
            raise ValueError("this sweep has no [search]")
        return self.search

    def _search_axis(self) -> str:
        strengths = {self.sweep.profile(name).strength for name in self.sweep.profiles}
        return "level" if Strength.LEVEL in strengths else "scale"

    def _placement_axes(self) -> list[Axis]:
        return [self.sweep.axes[name] for name in AXIS_KINDS if name in self.sweep.axes and AXIS_KINDS[name].placement]

    def _drive_axes(self) -> list[Axis]:
        return [
            self.sweep.axes[name] for name in AXIS_KINDS if name in self.sweep.axes and not AXIS_KINDS[name].placement
        ]

    @staticmethod
    def _n_points(axes: Sequence[Axis], skip: str = "") -> int:
        count = 1
        for axis in axes:
            count *= 1 if axis.name == skip else len(axis.values)
        return count

    def _profiles_or_none(self) -> list[Profile | None]:
        return list(self.sweep.profiles.values()) or [None]

    def _placement_counts(self) -> list[tuple[int, int]]:
        """(points, replicates of each): points with a random error are repeated, the others are not."""
        if not self.sweep.axes:
            return []
        axes = self._placement_axes()
        everything = self._n_points(axes)
        calm = 1
        for axis in axes:
            calm *= sum(1 for value in axis.values if not (isinstance(value, Distribution) and value.random))
        return [(calm, 1), (everything - calm, self.sweep.replicates)]

    def _grouped_variants(self) -> Iterator[tuple[Variant, tuple[Variant, ...]]]:
        """(placement, its variants), the same for every plan."""
        if self.sweep.nominal:
            nominal = Variant(0, PlacementChange(shifts_from_release=self.sweep.shifts_from_release))
            yield nominal, (nominal,)
        if not self.sweep.axes:
            return
        if self.sweep.n_sample is not None:
            grouped: dict[PlacementKey, list[Variant]] = {}
            for variant in self._sampled():
                grouped.setdefault(variant.placement_key, []).append(variant)
            for members in grouped.values():
                yield replace(members[0], drive=None), tuple(members)
            return
        index = itertools.count(1)
        for point in _points(self._placement_axes()):
            change = self._change(point)
            for replicate in range(self.sweep.replicates if change.random else 1):
                placement = self._variant(0, point, replicate, change)
                if self.search is not None:
                    yield placement, ()
                    continue
                variants = tuple(
                    self._variant(next(index), {**point, **drive_point}, again, change)
                    for drive_point in _points(self._drive_axes())
                    for again in self._drive_replicates(drive_point, replicate, change)
                )
                yield placement, variants

    def _drive_replicates(self, point: Point, replicate: int, change: PlacementChange) -> Sequence[int]:
        name = point.get("profile")
        if not change.random and isinstance(name, str) and self.sweep.profile(name).random:
            return range(self.sweep.replicates)
        return (replicate,)

    def _sampled(self) -> Iterator[Variant]:
        """Variants drawn from the axes; each is a replicate of its own and the same for every plan."""
        axes = [*self._placement_axes(), *self._drive_axes()]
        for number in range(1, (self.sweep.n_sample or 0) + 1):
            key = WorldKey(self.sweep.seed, "", number)
            point = {axis.name: axis.pick(key) for axis in axes}
            yield self._variant(number, point, number, self._change(point))

    def _variant(self, index: int, point: Point, replicate: int, change: PlacementChange) -> Variant:
        parameters: dict[str, float | int | str] = {
            AXIS_KINDS[name].column: self.sweep.axes[name].cell(value) for name, value in point.items()
        }
        if "replicate" in self.parameter_columns:
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
        def factor(*names: str) -> float:
            return float(np.prod([value for name in names if isinstance(value := point.get(name, 1.0), float)]))

        def error(*names: str) -> Distribution:
            found = (point.get(name) for name in names)
            return next((value for value in found if isinstance(value, Distribution)), ZERO)

        return PlacementChange(
            box_friction_factor=factor("friction_factor", "box_friction_factor"),
            carrier_friction_factor=factor("friction_factor", "carrier_friction_factor"),
            mass_factor=factor("mass_factor"),
            size_mm=error("size_tolerance_mm"),
            size_rel=error("size_tolerance_rel"),
            x_mm=error("placement_error_mm", "placement_error_x_mm"),
            y_mm=error("placement_error_mm", "placement_error_y_mm"),
            yaw_deg=error("yaw_error_deg"),
            drop_height_mm=error("drop_height_mm"),
            shifts_from_release=self.sweep.shifts_from_release,
        )


def _points(axes: Sequence[Axis]) -> Iterator[dict[str, Value]]:
    """The full grid, the last axis varying fastest; one empty point where there is no axis."""
    names = [axis.name for axis in axes]
    for values in itertools.product(*(axis.values for axis in axes)):
        yield dict(zip(names, values, strict=True))


def _is_random(profile: Profile | None) -> bool:
    return profile is not None and profile.random
