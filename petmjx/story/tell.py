"""One world as people see it: what was simulated, frame by frame, and what came of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

from petmjx.basics.arguments import flag_of, number_of, text_of, whole_of
from petmjx.basics.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.basics.text import shown
from petmjx.engines.base import Engine
from petmjx.engines.choose import ENGINES, has_option, make_engine
from petmjx.engines.resolve import engine_for
from petmjx.history import History, Record
from petmjx.options.config import Simulation
from petmjx.options.run_options import FRAME_INTERVAL_S, RunOptions, sorted_options
from petmjx.plans.gather import PlanSource, find_plan, usable_plans
from petmjx.plans.plan import Plan
from petmjx.results.files import RUN_FILE
from petmjx.results.histories import read_history
from petmjx.results.reader import RunResults, load_run
from petmjx.results.recording import Recording
from petmjx.results.worlds import read_outcome, world_row
from petmjx.sweeps.again import worlds_of_run
from petmjx.sweeps.file import nominal_sweep
from petmjx.sweeps.grid import SweepPlan
from petmjx.sweeps.run import SweepRun
from petmjx.sweeps.summary import SweepColumns
from petmjx.verdict import Outcome
from petmjx.world.job import Drive
from petmjx.world.scene import Scene


@dataclass(frozen=True, eq=False)
class Story:
    """One simulated world with its frames.

    Attributes:
        plan: the plan; ``scene``: its world in numbers, the variant's changes included.
        outcome: verdict, first box, metrics of each box.
        history: the frames; the last one has the poses of ``outcome.boxes``.
        engine: which engine simulated it.
        variant: index of the variant, and its values by column; 0 and empty where the plan has one world.
        drive: what shook it.
        options: the options of the simulation (``petmjx.Simulation``) by field, as in ``run.json``.
        note: one line that readers must see, e.g. that another engine than the run's was used; "" for none.
    """

    plan: Plan
    scene: Scene
    outcome: Outcome
    history: History
    engine: str
    variant: int = 0
    values: Mapping[str, Any] = field(default_factory=dict)
    drive: Drive | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""

    page: ClassVar[Callable[[Story], str] | None] = None
    """Makes a story's page for notebooks. ``petmjx.pages.told`` sets it: pages are made of stories, not the other way
    round."""

    def __repr__(self) -> str:
        outcome = self.outcome
        verdict = f"{outcome.verdict.value}" + (f" by {outcome.reason.value}" if outcome.reason.value else "")
        return f"Story({self.name}: {verdict}; {self.history!r}, engine {self.engine})"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the story's page, to play and turn."""
        return None if Story.page is None else Story.page(self)

    @property
    def name(self) -> str:
        """The plan's id for people, with the variant if the plan has many worlds: "tower, variant 3"."""
        return shown(self.plan.plan_id) + (f", variant {self.variant}" if self.values else "")


def tell(
    plan_id: str | Plan,
    source: RunResults | PlanSource | None = None,
    *,
    plans: PlanSource | None = None,
    variant: int | None = None,
    interval_s: float | None = None,
    details: bool | None = None,
    **options: Any,
) -> Story:
    """One world, frame by frame: as a run recorded it, or simulated again.

    ``petmjx.tell("s0-000016", "results")`` is the world in the table ``worlds`` of the run in the folder ``results``,
    simulated with the same options and attempts, to the last bit. If the run's engine cannot run here, ``mujoco`` takes
    its place, and ``Story.note`` says whether the result differs.

    Args:
        plan_id: the plan's id; or the plan itself, without a source.
        source: a run (its folder, or what ``petmjx.load_run`` returned), or plans as ``petmjx.score`` takes them; None:
            the bundled plans.
        plans: of a run whose plan files are not where they were: where they are now.
        variant: of a run with several worlds a plan, its index as in ``worlds``; by default the nominal one.
        interval_s: time between two frames, s, by default 0.05; each placement, and the end, is a frame too.
        details: also accelerations, penetrations and contacts, on the engine ``mujoco``; by default so. What a run has
            recorded is taken as it is, unless one of these two is given.
        options: without a run, fields of ``petmjx.Simulation`` and of ``petmjx.RunOptions``.

    Raises:
        InputError: no such plan or variant, plans or a sweep file that are gone or have changed, or unusable options.
        EngineUnavailable: the engine asked for cannot run here.
        PetmjxError: the simulation failed, or the engine records no histories.
    """
    if isinstance(plan_id, Plan):
        source = plan_id if source is None else source
        plan_id = plan_id.plan_id
    text_of(plan_id, "plan_id")
    if variant is not None:
        whole_of(variant, "variant", 0)
    if details is not None:
        flag_of(details, "details")
    if interval_s is not None and not number_of(interval_s, "interval_s") > 0:
        raise InputError(f"interval_s must be > 0, got {interval_s}")
    record = Record(FRAME_INTERVAL_S if interval_s is None else interval_s, details is not False)
    run = _run_in(source)
    if run is None:
        if variant is not None or plans is not None:
            raise InputError("variant and plans select a world of a run: name the run's folder")
        assert not isinstance(source, RunResults)
        return _of_plans(plan_id, source, record, options)
    if options:
        raise InputError(f"{next(iter(options))}: a story of a run uses the run's options; drop this one")
    worlds, index = worlds_of_run(run, plan_id, plans, variant)
    if interval_s is None and details is None and (story := _recorded(run, worlds, index)) is not None:
        return story
    engine, note = _engine_of(run.info["config"])
    story = _story(worlds, index, engine, record)
    return replace(story, note="; ".join(filter(None, (note, _difference(story, run)))))


def _run_in(source: RunResults | PlanSource | None) -> RunResults | None:
    """The run that a source is, if it is one."""
    if isinstance(source, RunResults):
        return source
    if isinstance(source, str | PathLike) and (Path(source) / RUN_FILE).is_file():
        return load_run(Path(source))
    return None


def _of_plans(plan_id: str, source: PlanSource | None, record: Record, options: Mapping[str, Any]) -> Story:
    of_simulation, of_run = sorted_options(options)
    sweep, run = nominal_sweep(Simulation(**of_simulation)), RunOptions(**of_run)
    plan = find_plan(usable_plans(source, sweep.simulation, run), plan_id)
    worlds = SweepPlan(sweep, [plan])
    with engine_for(run, worlds.work()) as (engine, _):
        return _story(worlds, 0, engine, record)


def _recorded(run: RunResults, worlds: SweepPlan, index: int) -> Story | None:
    """The story that a run recorded; None where it did not."""
    (plan,) = worlds.plans
    history = read_history(run, plan.plan_id, index, plan.n_boxes)
    outcome = read_outcome(run, plan.plan_id, index)
    if history is None or outcome is None:
        return None
    boxes = replace(outcome.boxes, pos=history.pos[-1], quat=history.quat[-1])  # in full precision
    group, variant = worlds.find(plan.plan_id, index)
    row = world_row(run, plan.plan_id, index) or {}
    return Story(
        plan=plan,
        scene=worlds.scene(group),
        outcome=replace(outcome, boxes=boxes),
        history=history,
        engine=str(run.info["config"].get("engine")),
        variant=index,
        values={param["name"]: row[param["name"]] for param in run.info["params"]},
        drive=worlds.drive(plan, variant) if history.drive_kind else None,
        options=worlds.sweep.simulation.model_dump(mode="json"),
    )


def _engine_of(config: Mapping[str, Any]) -> tuple[Engine, str]:
    """The engine of a run, or the one that takes its place, and a note about that."""
    name = config.get("engine")
    if name not in ENGINES:
        return make_engine("mujoco"), f"simulated on mujoco: the run's engine {shown(str(name))} is not petmjx's own"
    try:
        return make_engine(name, lanes=config.get("lanes") if has_option(name, "lanes") else None), ""
    except EngineUnavailable as error:
        return make_engine("mujoco"), f"simulated on mujoco: {error}"


def _story(worlds: SweepPlan, index: int, engine: Engine, record: Record) -> Story:
    """The story of a world that is simulated now."""
    (plan,) = worlds.plans
    recording = Recording(replace(record, details=record.details and engine.name == "mujoco"))
    world = SweepRun(worlds, engine, recording=recording).world(plan.plan_id, index)
    if world.outcome.history is None:
        why = world.outcome.message or f"engine {engine.name} records no histories"
        raise PetmjxError(f"plan {shown(plan.plan_id)}: there are no frames: {why}")
    sweep = worlds.sweep
    values = SweepColumns(worlds).of(world) if sweep.axes else {}
    return Story(
        plan=plan,
        scene=world.scene,
        outcome=replace(world.outcome, state=None),
        history=world.outcome.history,
        engine=engine.name,
        variant=index,
        values=values,
        drive=worlds.drive(plan, world.variant) if world.driven else None,
        options=sweep.simulation.model_dump(mode="json"),
    )


def _difference(story: Story, run: RunResults) -> str:
    """How a story differs from the run's row of the same world, in a line; empty where it does not."""
    row = world_row(run, story.plan.plan_id, story.variant)
    if row is None:
        return ""
    here, run_text = _said(vars(story.outcome)), _said(row)
    if here == run_text:
        return "" if story.engine == run.info["config"].get("engine") else f"as in the run: {here}"
    return f"in the run: {run_text}; here: {here}"


def _said(world: Mapping[str, Any]) -> str:
    """Verdict, reason and first box of a world, in a few words."""
    culprit = world["culprit"]
    by = f" by {world['reason']}" if world["reason"] else ""
    known = culprit is not None and culprit >= 0
    return f"{world['verdict']}{by}" + (f", first box {culprit}" if known else "")
