"""Sources of plans (files, folders, objects): collects the plans, and skips plans that cannot be simulated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import count
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.checked_records import option, similar
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable, printable_name
from petmjx.common.units import MM_PER_M
from petmjx.options.carriers import Carrier, OwnCarrier, extent_m, walls_of
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.walls import Walls
from petmjx.plans.bundled import bundled_path
from petmjx.plans.convention_checks import warn, with_conventions
from petmjx.plans.file_formats import SupportsArrow
from petmjx.plans.input_conventions import USUAL_CONVENTIONS, InputConventions
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import vanishing_side
from petmjx.plans.plan_reader import read_plans
from petmjx.plans.plan_set import PlanSet, Skipped

if TYPE_CHECKING:
    from petmjx.plans.articles import Articles

PathArgument = str | PathLike[str]
PlanSource = PathArgument | Plan | Sequence[PathArgument] | Sequence[Plan] | PlanSet | SupportsArrow
"""A file, a folder, or several of them; a plan, a list of plans, or a ``PlanSet``; a data frame of placements."""

_SOURCES = "paths or Plan objects, a single path or Plan, a PlanSet, or a data frame"


def usable_plans(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanSet:
    """The plans that can be simulated. Warns if plans appear to follow another convention than petmjx's.

    Args:
        plans: the source; None: the bundled plans.

    Raises:
        InputError: no plan can be simulated; or, with ``options.strict``, a plan would be skipped.
    """
    _check_no_boxes(plans)
    usual = InputConventions.checked(options.units, options.anchor) == USUAL_CONVENTIONS
    if not (usual or plans is None or isinstance(plans, str | PathLike | SupportsArrow)):
        given: Any = [plans] if isinstance(plans, Plan) else list_of(plans, "plans", object, _SOURCES)
        if any(isinstance(plan, Plan) for plan in given):
            raise InputError(
                "units and anchor apply only to files and data frames; for plan objects, give them to Plan.from_boxes"
            )
        plans = given
    earlier_lines = plans.conventions if isinstance(plans, PlanSet) else ()
    return usable_of(gather_plans(plans, sim, options), sim, options, earlier_lines)


def usable_of(gathered: PlanSet, sim: Simulation, options: RunOptions, earlier_lines: Collection[str] = ()) -> PlanSet:
    """The plans of :func:`gather_plans` that can be simulated. Warns as :func:`usable_plans`.

    Args:
        earlier_lines: lines about conventions of which the user has already been warned.

    Raises:
        InputError: as :func:`usable_plans`.
    """
    warn([line for line in gathered.conventions if line not in earlier_lines])
    plan_set = without_vanishing_boxes(gathered, sim.size_reduction_mm, options.strict)
    return with_some_plan(without_narrow_walls(plan_set, sim.carrier, sim.walls, options.strict))


def with_some_plan(plan_set: PlanSet) -> PlanSet:
    """The given set of plans, unchanged. Raises InputError if the set has no plans."""
    if not plan_set.plans:
        first = f"; the first: {plan_set.skipped[0].message}" if plan_set.skipped else ""
        raise InputError(f"no usable plan ({len(plan_set.skipped)} skipped){first}")
    return plan_set


def are_files(plans: PlanSource | None) -> bool:
    """Whether plans are read from files. The result is also True for the bundled plans (``plans`` is None)."""
    if isinstance(plans, PlanSet | Plan | SupportsArrow):
        return False
    given = [plans] if plans is None or isinstance(plans, str | PathLike) else plans
    return not any(isinstance(source, Plan) for source in given)


def _check_no_boxes(plans: object) -> None:
    """Raise InputError if ``plans`` is, or contains, a dictionary, list, tuple or array of boxes: only ``load_plans``
    reads these."""
    members = plans if isinstance(plans, list | tuple) else (plans,)
    boxes = next((value for value in members if isinstance(value, Mapping | np.ndarray | list | tuple)), None)
    if boxes is not None:
        form = "an array" if isinstance(boxes, np.ndarray) else f"a {type(boxes).__name__}"
        raise InputError(f"plans must be {_SOURCES}, got {form}; petmjx.load_plans reads dictionaries and arrays")


def gather_plans(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanSet:
    """All plans of a source, with properties of their boxes added from the table of articles.

    Files are read and checked. Plan objects are used unchanged, except that a repeated id is replaced by a new one.
    """
    extent_mm = carrier_extent_mm(sim)
    _check_no_boxes(plans)
    source: Any = bundled_path() if plans is None else plans
    if not isinstance(source, PlanSet | SupportsArrow):
        alone = isinstance(source, str | PathLike | Plan)
        given: list[Any] = [source] if alone else list_of(source, "plans", object, _SOURCES)
        plan_objects = [plan for plan in given if isinstance(plan, Plan)]
        if plan_objects and len(plan_objects) != len(given):
            raise InputError("plans: give either paths or Plan objects, not both")
        source = PlanSet(plan_objects) if plan_objects else [path_of(path, "plans") for path in given]
    if isinstance(source, PlanSet):
        plan_set = with_conventions(_distinct_plan_ids(source, options), extent_mm)
    else:
        plan_set = read_plans(source, options, extent_mm=extent_mm)
    return plan_set if options.articles is None else _with_articles(plan_set, options.articles, options.strict)


def carrier_extent_mm(sim: Simulation) -> tuple[float, float] | None:
    """Extent of the carrier along x and y, mm. The result is None if the carrier is as large as the plan."""
    extent = extent_m(sim.carrier)
    return None if extent is None else (extent[0] * MM_PER_M, extent[1] * MM_PER_M)


def _with_articles(plan_set: PlanSet, file: Path, strict: bool) -> PlanSet:
    """Add the properties of boxes from a table of articles to the plans. Plans that contradict the table are
    skipped."""
    from petmjx.plans.articles import read_articles, with_articles

    articles = read_articles(file)
    completed: dict[str, Plan] = {}
    faults: dict[str, str] = {}
    for plan in plan_set.plans:
        try:
            completed[plan.plan_id] = with_articles(plan, articles)
        except InputError as error:
            faults[plan.plan_id] = str(error)
    good = _without_faults(plan_set, lambda plan: faults.get(plan.plan_id), strict)
    plans = [completed[plan.plan_id] for plan in good.plans]
    name = printable(str(file))
    if any(plan is not before for plan, before in zip(plans, good.plans, strict=True)):
        notes = _idle_rows(articles, [*plan_set.plans, *plans], name)
    else:
        notes = [f"{name}: has nothing about the boxes of these plans"]
    return replace(good, plans=plans, notes=[*plan_set.notes, *notes])


def _idle_rows(articles: Articles, plans: Sequence[Plan], name: str) -> list[str]:
    """A list with at most one line: about the rows of a table of articles that match no box. The result is empty if
    every row matches a box.

    Args:
        plans: the plans before and after the table is applied. One row of the table may give a material to boxes, and
            another row may be about this material. The second row matches a box only after the table is applied.
    """
    from petmjx.plans.articles import material_key

    names_by_kind = {
        "article": {article for plan in plans for article in plan.articles},
        "product group": {group for plan in plans for group in plan.product_groups},
        "material": {material_key(material) for plan in plans for material in plan.materials or ()},
    }
    rows_by_kind = {
        "article": articles.by_article,
        "product group": articles.by_group,
        "material": articles.by_material,
    }
    idle = [
        f"{kind} {printable_name(row)}"
        for kind, rows in rows_by_kind.items()
        for row in rows
        if row not in names_by_kind[kind]
    ]
    total = sum(map(len, rows_by_kind.values()))
    if not idle:
        return []
    verb = "matches" if len(idle) == 1 else "match"
    return [f"{name}: {len(idle):,} of {count_text(total, 'row')} {verb} no box: {first_names(idle)}"]


def _distinct_plan_ids(plan_set: PlanSet, options: RunOptions) -> PlanSet:
    """The same plans with distinct ids, since ids are keys of tables. A second plan with the id ID is renamed to
    "ID#2".

    In files, an id identifies a single plan, so a second plan with this id is skipped (petmjx.plans.plan_reader). But a
    caller that passes plan objects expects a result for each object.
    """
    given = plan_set.plans[: options.limit]
    plan_ids = {plan.plan_id for plan in given}
    id_counts: Counter[str] = Counter()
    plans, renamed = [], []
    for plan in given:
        id_counts[plan.plan_id] += 1
        if id_counts[plan.plan_id] > 1:
            name = next(name for n in count(id_counts[plan.plan_id]) if (name := f"{plan.plan_id}#{n}") not in plan_ids)
            plan_ids.add(name)
            renamed.append(name)
            plan = replace(plan, plan_id=name)
        plans.append(plan)
    notes = list(plan_set.notes)
    if renamed:
        verb = "repeats an id and is" if len(renamed) == 1 else "repeat ids and are"
        notes.append(f"{count_text(len(renamed), 'plan')} {verb} called {first_names(renamed)}")
    numbers = {plan.plan_id: number for number, plan in enumerate(plans)}
    # ``numbers`` counts only plans that are not skipped, so old numbers of skipped plans would be misleading
    skipped = [replace(skip, number=None) for skip in plan_set.skipped]
    return replace(plan_set, plans=plans, skipped=skipped, notes=notes, numbers=numbers)


def without_vanishing_boxes(plan_set: PlanSet, size_reduction_mm: float, strict: bool = False) -> PlanSet:
    """Skip plans that have a box without extent after the size reduction (mm).

    Raises:
        InputError: with ``strict``, a plan would be skipped.
    """

    def fault(plan: Plan) -> str | None:
        thin = vanishing_side(plan.size_mm, size_reduction_mm)
        return None if thin is None else f", placement {thin[0]}: {thin[1]}"

    return _without_faults(plan_set, fault, strict)


def without_narrow_walls(
    plan_set: PlanSet, carrier: Carrier | OwnCarrier, walls: Walls, strict: bool = False
) -> PlanSet:
    """Skip plans for which the walls leave no room on the carrier. With the carrier ``footprint``, the plan's own
    extent is the extent of the carrier.

    Raises:
        InputError: with ``strict``, a plan would be skipped.
    """
    walls, extent = walls_of(carrier, walls), extent_m(carrier)

    def fault(plan: Plan) -> str | None:
        corner, size = plan.corner_mm[:, :2], plan.size_mm[:, :2]
        footprint_mm = (corner + size).max(axis=0) - corner.min(axis=0)
        room_fault = walls.room_fault(footprint_mm if extent is None else [side * MM_PER_M for side in extent])
        return None if room_fault is None else f": {room_fault}"

    return _without_faults(plan_set, fault, strict) if walls.sides else plan_set


def without_built_plans(plan_set: PlanSet, built: int, strict: bool = False) -> PlanSet:
    """Skip plans that have at most ``built`` boxes. If the first ``built`` boxes already stand, no box of such a plan
    is left to place.

    Raises:
        InputError: no plan is left; or, with ``strict``, a plan would be skipped.
    """

    def fault(plan: Plan) -> str | None:
        if built < plan.n_boxes:
            return None
        n_boxes = count_text(plan.n_boxes, "box", "boxes")
        return f": {option('--built')} must be less than its {n_boxes}, got {built}"

    return with_some_plan(_without_faults(plan_set, fault, strict))


def _without_faults(plan_set: PlanSet, fault_of: Callable[[Plan], str | None], strict: bool) -> PlanSet:
    """Skip plans with a fault. ``fault_of`` returns the part of the message after the plan's id; None if a
    plan has no fault."""
    good_plans, skipped = [], list(plan_set.skipped)
    for plan in plan_set.plans:
        fault = fault_of(plan)
        if fault is None:
            good_plans.append(plan)
            continue
        skip = Skipped.plan(plan, fault, strict)
        skipped.append(replace(skip, number=plan_set.numbers.get(plan.plan_id)))
    return replace(plan_set, plans=good_plans, skipped=skipped)


def find_plan(plan_set: PlanSet, plan_id: str) -> Plan:
    """The plan with an id.

    Raises:
        InputError: no plan has this id. If the plan was skipped, the message gives the reason.
    """
    for plan in plan_set.plans:
        if plan.plan_id == plan_id:
            return plan
    reasons = [skipped.message for skipped in plan_set.skipped if skipped.plan_id == plan_id]
    if reasons:
        raise InputError(reasons[0])
    similar_text = similar(plan_id, (plan.plan_id for plan in plan_set.plans))
    raise InputError(
        f"plan {printable_name(plan_id)} is not among the {count_text(len(plan_set.plans), 'plan')} read{similar_text}"
    )
