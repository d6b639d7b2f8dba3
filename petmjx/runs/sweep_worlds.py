"""All worlds (simulations) of a sweep over its plans, in groups of worlds that share one placement of boxes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.common.units import STANDARD_GRAVITY, deg_to_rad, seconds_to_steps
from petmjx.options.carriers import walls_of
from petmjx.options.simulation import Check, Schedule
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import Skipped
from petmjx.runs.chain_legs import in_a_row
from petmjx.runs.eumos_limits import EUMOS_ELASTIC_SHARE, EUMOS_PROFILE
from petmjx.runs.study import MAX_WORLDS
from petmjx.runs.sweep_axes import AXIS_KINDS
from petmjx.runs.sweep_design import Design
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.profiles.profile import Profile, Strength, allowed_sway_m
from petmjx.world.random_streams import WorldKey
from petmjx.world.scene import Scene, build_scene
from petmjx.world.variants import PLACE_AND_SIZE_ERRORS, DriveSpec, LegSpec, Variant, apply_all


@dataclass(frozen=True, eq=False)
class PlacementGroup:
    """Worlds of one plan that share a placement of boxes. The placement is simulated once, and all worlds of the group
    start from its settled state.

    Attributes:
        number: number of the placement within its plan, from 0.
        placement: the variant whose scene is simulated. The drive of this variant is not used.
        variants: the variants of the worlds in the group. A variant without a drive has the outcome of the placement.
            In a search, ``variants`` is empty, because `SweepPlan.search_variant` makes the variants level by level.
    """

    plan: Plan
    number: int
    placement: Variant
    variants: tuple[Variant, ...] = ()

    @property
    def index(self) -> int:
        """Number of the variant of the group's first world. In a search, which has no variants yet, the result is the
        number of the placement."""
        return self.variants[0].index if self.variants else self.number

    @property
    def driven(self) -> bool:
        """Whether the worlds of the group have drives (motions of the carrier) or legs. Either all worlds of a group
        have them, or none has. The result is True for a search."""
        return all(variant.drive is not None or variant.legs for variant in self.variants)


@dataclass(eq=False)
class SweepPlan(Design):
    """All worlds of a sweep, made one placement at a time.

    Args:
        plans: the plans of the sweep. The constructor removes plans that cannot be simulated.
        allow_large: whether more than a million worlds are accepted.
        strict: whether to raise an error instead of skipping a plan.

    Attributes:
        skipped: plans that are not simulated, because ``total_time_factor`` would end their simulation before the
            profile begins.

    Raises:
        InputError: there is no usable plan, there are more than a million worlds without ``allow_large``, there is an
            axis ``placing`` although boxes may not be carried, legs are combined with soft boxes or with
            ``total_time_factor``, or the frequencies of a profile are too high for the timestep.
    """

    plans: Sequence[Plan]
    allow_large: bool = False
    strict: bool = False
    skipped: list[Skipped] = field(init=False, default_factory=list)
    _drives: dict[tuple[object, ...], Drive] = field(init=False, default_factory=dict, repr=False)
    _rows: dict[tuple[LegSpec, str, int], Excitation] = field(init=False, default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        file = self.sweep.file
        self.plans = [plan for plan in self.plans if self._has_time(plan)]
        if not self.plans:
            first = f"; the first skipped plan: {self.skipped[0].message}" if self.skipped else ""
            raise InputError(f"{file}: plans: no usable plan to sweep over{first}")
        if self.n_worlds > MAX_WORLDS and not self.allow_large:
            raise InputError(
                f"{file}: axes make {self.n_worlds:,} worlds ({self._plans_and_variants}), more than {MAX_WORLDS:,}: "
                f"pass {option('--yes', 'True', python='allow_large')} to confirm"
            )
        if "placing" in self.sweep.axes and not self.sweep.simulation.may_carry:
            needs = "simulation.placing='auto', 'hand' or 'tines', check='one-by-one' and schedule='adaptive'"
            raise InputError(f"{file}: axes.placing needs {needs}")
        if self.sweep.legs:
            sim = self.sweep.simulation
            if sim.total_time_factor is not None:
                raise InputError(f"{file}: legs contradict total_time_factor, which would end a world before its legs")
            if sim.has_soft:
                raise InputError(
                    f"{file}: legs contradict soft boxes: petmjx cannot keep the state of soft boxes for the next leg"
                )
            sides = walls_of(sim.carrier, sim.walls).sides or ()
            for place, leg in enumerate(self.sweep.legs):
                if missing := [side.value for side in leg.open_walls if side not in sides]:
                    reason = f"the carrier has no wall {missing[0]!r}; simulation.walls or another carrier gives it one"
                    raise InputError(f"{file}: legs[{place}].open_walls: {reason}")
        # Excitations are made here, before the run begins, so that a frequency that is too high for the timestep is
        # refused in time.
        for profile in self.sweep.profiles.values():
            try:
                profile.excitation(self.sweep.simulation.physics.timestep_s)
            except InputError as error:
                raise InputError(f"{file}: {error}") from None

    def _has_time(self, plan: Plan) -> bool:
        """Whether a profile can begin before the simulation of a plan ends. A plan without time for a profile is added
        to ``skipped``."""
        left = self.drive_steps_left(plan)
        if left is None or left > 0:
            return True
        at = f"at {self.sweep.simulation.total_time_factor:g} times the placement time (total_time_factor)"
        reason = f": its worlds end before the profile begins, {at}"
        self.skipped.append(Skipped.plan(plan, reason, self.strict))
        return False

    @property
    def n_worlds(self) -> int:
        """Number of worlds of all plans. For a search, this is the largest possible number."""
        return len(self.plans) * self.n_variants

    def groups(self, without: Callable[[Plan], bool] = lambda plan: False) -> Iterator[PlacementGroup]:
        """Every placement of every plan with its worlds, plan by plan. Plans for which ``without`` returns True are
        left out."""
        for plan in (plan for plan in self.plans if not without(plan)):
            for number, (placement, variants) in enumerate(self.placements()):
                yield PlacementGroup(plan, number, placement, variants)

    def most_forks(self, group: PlacementGroup) -> int:
        """Largest number of worlds that start from the settled state of a placement at the same time. In a search,
        these are the tests of a round, for all profiles and directions."""
        search = self.sweep.search
        if search is None or group.variants:
            return len(group.variants)
        return len(self.search_items()) * search.sections

    def find(self, plan_id: str, index: int) -> tuple[PlacementGroup, Variant]:
        """The variant of a plan that has the number ``index``, and the group of worlds to which it belongs.

        Raises:
            InputError: the sweep has no such plan, or the plan has no such variant.
        """
        groups = (group for group in self.groups() if group.plan.plan_id == plan_id)
        levels = len(self.sweep.search_levels)
        for group in groups:
            for variant in group.variants:
                if variant.index == index:
                    return group, variant
            number, level = divmod(index - 1, levels) if levels and not group.variants else (-1, 0)
            placement, item = divmod(number, max(len(self.search_items()), 1))
            if not group.variants and placement == group.number:
                return group, self.search_variant(group, item, level)
        raise InputError(f"{self.sweep.file}: plan {printable_name(plan_id)} has no variant {index}")

    def search_variant(self, group: PlacementGroup, item: int, level_index: int) -> Variant:
        """The variant with which a search tests one level of a profile in one direction. ``item``: index of this
        profile and direction in ``search_items``. The drive of the variant starts from the placement of ``group``. The
        number of the variant does not depend on the order in which worlds are simulated."""
        items, levels = self.search_items(), self.sweep.search_levels
        search_item, level = items[item], float(levels[level_index])
        index = 1 + (group.number * len(items) + item) * len(levels) + level_index
        drive = DriveSpec(search_item.profile, level, search_item.direction_deg)
        column = AXIS_KINDS[self.sweep.strength].column
        parameters = {**group.placement.parameters, "profile": search_item.profile, column: level}
        if "direction" in self.sweep.axes:
            parameters["direction_deg"] = search_item.direction_deg
        return replace(group.placement, index=index, drive=drive, parameters=parameters)

    def scene(self, group: PlacementGroup) -> Scene:
        """The scene of the placement that the worlds of a group share."""
        ((_, scene),) = self.scenes([group])
        return scene

    def scenes(self, groups: Iterable[PlacementGroup]) -> Iterator[tuple[PlacementGroup, Scene]]:
        """Each group of worlds, together with the scene of the placement that they share. Scenes of consecutive groups
        of one plan are made together, which saves time."""
        for plan, plan_groups in itertools.groupby(groups, key=lambda group: group.plan):
            these, groups_again = itertools.tee(plan_groups)
            placements = (group.placement for group in groups_again)
            nominal = build_scene(plan, self.sweep.simulation)
            yield from zip(these, apply_all(nominal, plan.plan_id, placements, self.sweep.seed), strict=True)

    def job(
        self, group: PlacementGroup, scene: Scene, *, keep_state: bool = False, record: Record | None = None
    ) -> Job:
        """The job that simulates the placement of a group. If the placement has random errors, the simulation ends as
        soon as a box is lost (has tilted too far), because it only has to answer whether the pallet stands."""
        has_errors = group.placement.placement.random
        return Job(scene, keep_state=keep_state, record=record, has_errors=has_errors)

    # Drives.

    def drive_start_s(self, plan: Plan) -> float:
        """With the fixed schedule, the time at which a drive begins, s: ``settle_s`` after the nominal end of the
        placement. The nominal end of the placement of n boxes is at n × ``interval_s``, as in the reference
        implementation."""
        sim = self.sweep.simulation
        placed_s = sim.interval_s * plan.n_boxes if sim.check is Check.ONE_BY_ONE else 0.0
        return placed_s + sim.settle_s

    def drive(self, plan: Plan, variant: Variant, load_height_m: float = 0.0) -> Drive | None:
        """The drive (motion of the carrier) of one variant of a plan. Variants whose drives have the same samples share
        one array of samples.

        Args:
            load_height_m: height of the settled load, m. EUMOS's test limits the sway of boxes to a share of this
                height.
        """
        spec = variant.drive
        if spec is None:
            return None
        profile = self.sweep.profiles[spec.profile]
        start_s = self.drive_start_s(plan) if self.sweep.simulation.schedule is Schedule.FIXED else 0.0
        key: tuple[object, ...] = (spec.profile, start_s)
        if profile.random:
            key = (*key, plan.plan_id, variant.replicate)
            self._drives = {k: v for k, v in self._drives.items() if len(k) == 2 or k[2] == plan.plan_id}
        if key not in self._drives:
            world = WorldKey(self.sweep.seed, plan.plan_id, variant.replicate)
            self._drives[key] = self._unit_drive(profile, plan, start_s, world)
        unit, yaw_rad = self._drives[key], deg_to_rad(spec.direction_deg)
        tested = spec.profile == EUMOS_PROFILE
        allowed_m = EUMOS_ELASTIC_SHARE * load_height_m if tested else allowed_sway_m(profile)
        return Drive(unit.excitation, spec.scale, yaw_rad, unit.rest_s, allowed_m)

    def leg_drive(self, plan: Plan, variant: Variant, leg: LegSpec, load_height_m: float = 0.0) -> Drive:
        """All drives of one leg in one variant of a plan, joined into one drive. A leg without drives does not shake
        the pallet. Variants whose drives have the same samples share one array of samples."""
        sim = self.sweep.simulation
        made = (
            self.drive(plan, replace(variant, drive=self._with_strength(plan, variant, leg, place)), load_height_m)
            for place in range(len(leg.drives))
        )
        drives = [drive for drive in made if drive is not None]
        if len(drives) == 1:
            return drives[0]
        random = any(map(self.is_drawn, leg.drives))
        key = (leg, plan.plan_id, variant.replicate) if random else (leg, "", 0)
        if key not in self._rows:
            if random:
                self._rows = {k: row for k, row in self._rows.items() if k[1] in ("", plan.plan_id)}
            self._rows[key] = in_a_row(leg.name, drives, leg.pause_s, sim.physics.timestep_s)
        rest_s, allowed_m = (
            (drives[0].rest_s, max(drive.allowed_sway_m for drive in drives)) if drives else (sim.rest_s, 0)
        )
        return Drive(self._rows[key], rest_s=rest_s, allowed_sway_m=allowed_m)

    def _with_strength(self, plan: Plan, variant: Variant, leg: LegSpec, place: int) -> DriveSpec:
        """A drive of a leg, with the strength that is drawn for one variant of a plan. Two variants that differ only by
        a remedy (a change of one leg) get the same strength."""
        spec = leg.drives[place]
        if spec.scale_to is None:
            return spec
        rng = WorldKey(self.sweep.seed, plan.plan_id, variant.replicate).rng(f"strength:{leg.name}:{place}")
        return replace(spec, scale=spec.scale + rng.random() * (spec.scale_to - spec.scale), scale_to=None)

    def _unit_drive(self, profile: Profile, plan: Plan, start_s: float, world: WorldKey) -> Drive:
        """The drive of a profile at scale 1, without a turn.

        With ``total_time_factor``, the simulation ends at a multiple of the placement time, as in the demo of the
        reference implementation, even if the profile is not over.
        """
        sim = self.sweep.simulation
        timestep_s = sim.physics.timestep_s
        excitation = profile.excitation(timestep_s, start_s, world)
        if profile.strength is Strength.ANGLE and sim.physics.gravity_m_s2 != STANDARD_GRAVITY:
            # a tilt turns gravity, so its samples are proportional to gravity; other accelerations do not depend on
            # gravity
            turned = excitation.samples * (sim.physics.gravity_m_s2 / STANDARD_GRAVITY)
            excitation = replace(excitation, samples=turned)
        left = self.drive_steps_left(plan)
        if left is None:
            return Drive(excitation, rest_s=sim.rest_s)
        samples = excitation.samples[:left]
        # Half a step is added, so that rounding down to whole steps gives exactly the right number in spite of rounding
        # errors.
        rest_s = (left - len(samples) + 0.5) * timestep_s
        return Drive(replace(excitation, samples=samples), rest_s=rest_s)

    def drive_steps_left(self, plan: Plan) -> int | None:
        """Number of steps from the beginning of a drive to the end of the simulation. If ``total_time_factor`` does not
        set the end, the result is None."""
        sim = self.sweep.simulation
        if sim.total_time_factor is None or not self.sweep.profiles:
            return None
        timestep_s = sim.physics.timestep_s
        total_s = sim.total_time_factor * (sim.interval_s * plan.n_boxes)
        return seconds_to_steps(total_s, timestep_s) - seconds_to_steps(self.drive_start_s(plan), timestep_s)

    @property
    def amount(self) -> str:
        """A text about the size of the sweep: the numbers of worlds, plans, variants and placements."""
        if not self.sweep.axes and not self.sweep.legs:
            return count_text(len(self.plans), "plan")
        most = "at most " if self.sweep.search is not None else ""
        placements = count_text(len(self.plans) * self.all_placements, "placement")
        return f"{most}{count_text(self.n_worlds, 'world')} ({self._plans_and_variants}) from {placements}"

    @property
    def has_errors(self) -> bool:
        """Whether places or sizes have errors in some worlds."""
        return any(not PLACE_AND_SIZE_ERRORS.isdisjoint(axis.kind.changes) for axis in self.sweep.axes.values())

    @property
    def all_placements(self) -> int:
        """Number of placements per plan, including the placement of the nominal world."""
        return self.n_placements + int(self.sweep.nominal)

    @property
    def _plans_and_variants(self) -> str:
        return f"{count_text(len(self.plans), 'plan')} × {count_text(self.n_variants, 'variant')}"
