"""The story of one world (one simulation of one plan): its frames, its outcome, and what was simulated.

``tell`` reads the recording of a world, or simulates the world again, and returns a ``Story``.
petmjx.analysis.story_in_words describes stories in words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from petmjx.common.argument_checks import flag_of, integer_of, number_of, text_of
from petmjx.common.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.common.text import printable_name
from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.engines.engine_of_run import engine_for
from petmjx.engines.engine_registry import ENGINES, has_option, make_engine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome
from petmjx.options.run_options import FRAME_INTERVAL_S, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PlanSource, find_plan, usable_plans
from petmjx.results.history_tables import read_history
from petmjx.results.plan_lookup import is_run
from petmjx.results.recording import Recording
from petmjx.results.run_reader import RunResults, opened_run, read_outcome, world_row
from petmjx.runs.sweep_cost import work_of
from petmjx.runs.sweep_file import nominal_sweep
from petmjx.runs.sweep_run import SweepRun
from petmjx.runs.sweep_summary import SweepColumns
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.runs.worlds_of_earlier_run import worlds_of_run
from petmjx.world.compliance import sinks_m
from petmjx.world.history import History, Record
from petmjx.world.job import Drive
from petmjx.world.scene import Scene


@dataclass(frozen=True, eq=False)
class Story:
    """One simulated world (one simulation of one plan) with its frames.

    Attributes:
        plan: the plan that was simulated.
        scene: the input of the engine, such as the masses and places of boxes, including random errors.
        outcome: the verdict, the first box that failed, and metrics of each box.
        history: the frames, with the pose of each box. The last frame has the poses of ``outcome.boxes``.
        engine: the engine that simulated the world.
        variant: index of the variant (the set of changes and errors of this simulation); 0 if the plan has only one
            world.
        values: column of the table ``worlds`` → value, for the columns that distinguish the variants of a plan; empty
            if the plan has only one world.
        drive: the motion or force with which the carrier is shaken; None if it is not shaken.
        options: the options of the simulation: fields of ``petmjx.Simulation`` and their values, as in ``run.json``.
        note: an important remark for the reader, such as that the story was simulated on a different engine than the
            run; "" if there is none.
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
    """Function that makes the HTML page of a story for notebooks. The module ``petmjx.show.pages.story_page`` sets this
    attribute. The present module cannot import ``story_page``, because ``story_page`` imports the present module."""

    def __repr__(self) -> str:
        outcome = self.outcome
        verdict = f"{outcome.verdict.value}" + (f" by {outcome.reason.value}" if outcome.reason.value else "")
        return f"Story({self.name}: {verdict}; {self.history!r}, engine {self.engine})"

    def _repr_html_(self) -> str | None:
        """HTML for notebooks: the page of the story, in which the motion of the boxes can be played and viewed from all
        sides."""
        return None if Story.page is None else Story.page(self)

    @property
    def name(self) -> str:
        """The plan's id as printable text. If the plan has several worlds, the variant follows, as in "tower, variant
        3"."""
        return printable_name(self.plan.plan_id) + (f", variant {self.variant}" if self.values else "")


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
    """Tell the story of one world (one simulation of one plan), frame by frame. The frames come from a recording or
    from a new simulation.

    ``petmjx.tell("s0-000016", "results")`` tells the story of plan ``s0-000016`` in the run in the folder ``results``.
    A new simulation uses the options of the run, and repeats failed attempts as the run did, so its result is
    bit-identical to the run's result. If the run's engine cannot run on this machine, ``mujoco`` is used instead, and
    ``Story.note`` states whether the result differs.

    Args:
        plan_id: the plan's id; or the plan itself.
        source: a run (its folder, or the result of ``petmjx.load_run``), or plans as for ``petmjx.score``. If
            ``source`` is None, the bundled sample plans are used.
        plans: the files of a run's plans, if these files have been moved since the run.
        variant: index of the variant, as in the table ``worlds``, for a run that simulated each plan several times. The
            default is the nominal variant, which has no errors.
        interval_s: time between two frames, s. The default is 0.05 s. There is also a frame at each placement of a box
            and at the end.
        details: whether frames of a new simulation also have accelerations, penetrations and contacts. By default,
            frames have these details if the engine is ``mujoco``; no other engine can record them. If the run has a
            recording of the world, the recording is used, unless ``interval_s`` or ``details`` is given.
        options: fields of ``petmjx.Simulation`` and of ``petmjx.RunOptions``; they are allowed only if the source is
            not a run.

    Raises:
        InputError: the plan or variant does not exist, a plan or sweep file is gone or has changed, or options are
            unusable.
        EngineUnavailable: the requested engine cannot run on this machine.
        PetmjxError: the simulation failed, or the engine cannot record histories.
    """
    if isinstance(plan_id, Plan):
        source = plan_id if source is None else source
        plan_id = plan_id.plan_id
    text_of(plan_id, "plan_id")
    if variant is not None:
        integer_of(variant, "variant", 0)
    if details is not None:
        flag_of(details, "details")
    if interval_s is not None and not number_of(interval_s, "interval_s") > 0:
        raise InputError(f"interval_s must be > 0, got {interval_s}")
    record = Record(FRAME_INTERVAL_S if interval_s is None else interval_s, details is not False)
    if not (isinstance(source, RunResults) or is_run(source)):
        if variant is not None or plans is not None:
            raise InputError(
                "the arguments variant and plans select a world of a run, but no run is given: name the run's folder"
            )
        return _of_plans(plan_id, source, record, options)
    run = opened_run(source)
    if options:
        raise InputError(f"{next(iter(options))}: a world of a run has the run's options; drop this option")
    worlds, index = worlds_of_run(run, plan_id, plans, variant)
    if interval_s is None and details is None and (story := _recorded_story(run, worlds, index)) is not None:
        return story
    engine, note = _engine_of(run.info["config"])
    story = _story(worlds, index, engine, record)
    return replace(story, note="; ".join(filter(None, (note, _difference(story, run)))))


def _of_plans(plan_id: str, source: PlanSource | None, record: Record, options: Mapping[str, Any]) -> Story:
    of_simulation, of_run = sorted_options(options)
    sweep, run = nominal_sweep(Simulation(**of_simulation)), RunOptions(**of_run)
    plan = find_plan(usable_plans(source, sweep.simulation, run), plan_id)
    worlds = SweepPlan(sweep, [plan])
    with engine_for(run, work_of(worlds)) as (engine, _):
        return _story(worlds, 0, engine, record)


def _recorded_story(run: RunResults, worlds: SweepPlan, index: int) -> Story | None:
    """The story of a world from its recording; None if the run did not record the world."""
    (plan,) = worlds.plans
    history = read_history(run, plan.plan_id, index, plan.n_boxes)
    outcome = read_outcome(run, plan.plan_id, index)
    if history is None or outcome is None:
        return None
    # the history has the final poses with more precision than the table ``boxes``
    boxes = replace(outcome.boxes, pos=history.pos[-1], quat=history.quat[-1])
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
    """The engine with which a world of a run is simulated again, and a note. If the run's engine works on this machine,
    the result is this engine and an empty note. If the run's engine does not work here, the result is C MuJoCo, and the
    note states the reason."""
    name = config.get("engine")
    if name not in ENGINES:
        return make_engine(
            "mujoco"
        ), f"simulated on mujoco, because the run's engine {printable_name(str(name))} is not one of petmjx's own"
    try:
        return make_engine(name, lanes=config.get("lanes") if has_option(name, "lanes") else None), ""
    except EngineUnavailable as error:
        return make_engine("mujoco"), f"simulated on mujoco: {error}"


def _story(worlds: SweepPlan, index: int, engine: Engine, record: Record) -> Story:
    """Simulate a world and return its story."""
    (plan,) = worlds.plans
    recording = Recording(replace(record, details=record.details and engine.name == "mujoco"))
    world = SweepRun(worlds, engine, recording=recording).world(plan.plan_id, index)
    if world.outcome.history is None:
        reason = world.outcome.message or f"engine {engine.name} records no histories"
        raise PetmjxError(f"plan {printable_name(plan.plan_id)}: there are no frames: {reason}")
    sweep = worlds.sweep
    values = SweepColumns(worlds).of(world) if sweep.axes or sweep.legs else {}
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
    """One line that compares the story's outcome with the row of the same world in the run; "" if there is nothing to
    report."""
    row = world_row(run, story.plan.plan_id, story.variant)
    if row is None:
        return ""
    story_text, run_text = _outcome_text(vars(story.outcome)), _outcome_text(row)
    if story_text == run_text:
        return "" if story.engine == run.info["config"].get("engine") else f"as in the run: {story_text}"
    return f"in the run: {run_text}; here: {story_text}"


def _outcome_text(world: Mapping[str, Any]) -> str:
    """In a few words, the verdict on a world, the reason of the verdict, and the first box that failed."""
    culprit = world["culprit"]
    by = f" by {world['reason']}" if world["reason"] else ""
    known = culprit is not None and culprit >= 0
    return f"{world['verdict']}{by}" + (f", first box {culprit}" if known else "")


def thresholds_of(story: Story) -> Thresholds:
    """The thresholds from which the verdict of the story's world follows."""
    return Thresholds(**story.options.get("thresholds", {}))


def sinks_of(story: Story) -> FloatArray | None:
    """(n,) distance by which each box is expected to sink because the boxes below yield under their load, m; None if no
    box is compressible."""
    physics = story.options.get("physics", {})
    gravity = physics.get("gravity_m_s2", STANDARD_GRAVITY) if isinstance(physics, Mapping) else STANDARD_GRAVITY
    return sinks_m(story.scene, gravity)
