"""The engine mjx-warp: its kernel on the CPU, slow and small; and on a GPU, where marked (``pytest -m gpu``)."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import petmjx
from petmjx.config import Carrier, Check, Schedule, Simulation
from petmjx.engines.batch.engine import MAX_GROWTH, MIN_LANES, Group, Run
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.errors import InputError
from petmjx.plans.read import load_plans
from petmjx.plans.samples import bundled_path, generate_one, write_plans
from petmjx.verdict import Flag, Outcome, Reason, Verdict
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import Scene, build_scene

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same, run_all
from support.plans import make_scene
from support.worlds import boxes_by_plan, make_plan, simulate

from petmjx.engines.batch.template import MAX_ITERATIONS
from petmjx.engines.warp import engine as mjx_warp
from petmjx.engines.warp import rollout as rollouts
from petmjx.engines.warp import shape
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.records import MAX_BOXES, lane_bytes, most_panels
from petmjx.engines.warp.rollout import Rollout
from petmjx.engines.warp.shape import Shape, size_for

SAME_PLACE_M = 1e-3
"""Contacts are the same as C's; float32 settles elsewhere within soft contacts' give."""
SAME_FORCE = 0.05
"""For single boxes 3 % were measured."""
SMALL_FORCE_N = 1.0
SAME_SWAY_M = 1e-4
"""Pushed boxes stick and slide by some millimetres, and float32 begins elsewhere within soft contacts' give."""

TINY = ("hand-one-box", "hand-overhang-45", "hand-bridge", "hand-falls-off", "corner overhang of 30 %")

SHORT = Simulation(interval_s=0.1, rest_window_s=0.1, settle_s=0.3)

LONG_NS = 10**15
"""A slice of time in which all worlds of a test end."""

on_gpu = pytest.mark.gpu
devices = pytest.mark.parametrize("device", ["here", pytest.param("gpu", marks=on_gpu)])


@pytest.fixture(autouse=True)
def _ranks_may_differ() -> Iterator[None]:
    """MJX broadcasts as NumPy does."""
    with jax.numpy_rank_promotion("allow"):
        yield


def tiny_scenes(names: Sequence[str] = TINY) -> dict[str, Scene]:
    plans = boxes_by_plan()
    return {name: build_scene(make_plan(name, plans[name]), Simulation()) for name in names}


def tiny(name: str) -> Scene:
    return tiny_scenes((name,))[name]


@functools.cache
def exact() -> dict[str, Outcome]:
    return simulate(MujocoEngine(2), tiny_scenes(), Simulation())


def engine(**options: Any) -> MjxWarpEngine:
    return MjxWarpEngine(16, allow_cpu=True, **options)


@functools.cache
def shared_engine() -> MjxWarpEngine:
    return engine()


def assert_twin(found: Outcome, twin: Outcome, name: str = "") -> None:
    assert (found.verdict, found.reason, found.culprit) == (twin.verdict, twin.reason, twin.culprit), name
    if twin.verdict is Verdict.STABLE:
        np.testing.assert_allclose(found.boxes.pos, twin.boxes.pos, atol=SAME_PLACE_M, err_msg=name)
        np.testing.assert_allclose(
            found.boxes.rest_top_force_n,
            twin.boxes.rest_top_force_n,
            rtol=SAME_FORCE,
            atol=SMALL_FORCE_N,
            err_msg=name,
        )


def assert_twins(found: dict[str, Outcome], expected: dict[str, Outcome]) -> None:
    for name, twin in expected.items():
        assert_twin(found[name], twin, name)


@pytest.mark.slow
@devices
def test_tiny_plans_as_in_c(device: str) -> None:
    assert_twins(simulate(shared_engine(), tiny_scenes(), Simulation()), exact())


# ---------------------------------------------------------------------- rules


@pytest.mark.slow
@pytest.mark.parametrize("check", list(Check))
def test_the_fixed_schedule_to_the_step_of_c(check: Check) -> None:
    sim = Simulation(
        check=check, schedule=Schedule.FIXED, interval_s=0.2, duration_s=0.4, rest_window_s=0.1, early_stop=False
    )
    jobs = [Job(scene) for scene in tiny_scenes().values()]
    for found, twin in zip(run_all(shared_engine(), jobs, sim), run_all(MujocoEngine(2), jobs, sim), strict=True):
        assert (found.n_steps, found.sim_time_s) == (twin.n_steps, twin.sim_time_s)
        assert found.n_placed == twin.n_placed
        assert_twin(found, twin)


@pytest.mark.slow
def test_a_static_check_as_in_c() -> None:
    sim = Simulation(check=Check.STATIC, duration_s=0.5, rest_window_s=0.1)
    jobs = [Job(scene) for scene in tiny_scenes().values()]
    for found, twin in zip(run_all(shared_engine(), jobs, sim), run_all(MujocoEngine(2), jobs, sim), strict=True):
        assert_twin(found, twin)
        if twin.verdict is not Verdict.STABLE:
            assert found.n_steps == twin.n_steps, "a drop is seen in the same sample"


# ---------------------------------------------------------------------- what results must not depend on


@pytest.fixture(scope="module")
def crowd() -> dict[str, Outcome]:
    """Tiny worlds, all in one slice of time."""
    return simulate(engine(slice_ns=LONG_NS), tiny_scenes(), SHORT)


def assert_equal_worlds(found: dict[str, Outcome], expected: dict[str, Outcome]) -> None:
    """To the last bit."""
    for name, outcome in found.items():
        assert_same(outcome, expected[name])
        assert outcome.flags == expected[name].flags


@pytest.mark.slow
@pytest.mark.parametrize("slice_ns", [0, 7_000_000])
def test_slices_of_any_length_give_the_same(slice_ns: int, crowd: dict[str, Outcome]) -> None:
    """On a CPU 7 ms are seven steps, since there each look at the clock takes a millisecond."""
    some = ("hand-overhang-45", "hand-falls-off")
    assert_equal_worlds(simulate(engine(slice_ns=slice_ns), tiny_scenes(some), SHORT), crowd)


@pytest.mark.slow
def test_alone_and_in_any_order_as_in_company(crowd: dict[str, Outcome]) -> None:
    assert_equal_worlds(simulate(shared_engine(), tiny_scenes(TINY[::-1]), SHORT), crowd)
    wide = make_scene(9)
    mixed = {"nine boxes": wide, **tiny_scenes(("hand-bridge", "hand-falls-off"))}
    found = simulate(shared_engine(), mixed, SHORT)
    assert found.pop("nine boxes").n_boxes == 9
    assert_equal_worlds(found, crowd)
    for name in ("hand-one-box", "hand-bridge"):
        assert_equal_worlds(simulate(shared_engine(), tiny_scenes((name,)), SHORT), crowd)


@pytest.mark.slow
def test_any_number_of_lanes_gives_the_same(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    here = Shape.here
    monkeypatch.setattr(Shape, "here", lambda n_boxes: replace(here(n_boxes), lanes=3))
    assert_equal_worlds(simulate(engine(slice_ns=20_000_000), tiny_scenes(), SHORT), crowd)


@pytest.mark.slow
def test_groups_of_any_size_give_the_same(crowd: dict[str, Outcome]) -> None:
    assert_equal_worlds(simulate(engine(group_size=2), tiny_scenes(), SHORT), crowd)


def watched_rollouts(monkeypatch: pytest.MonkeyPatch, look: Callable[[int, int, int], None]) -> list[Rollout]:
    """Before programs and buffers are made ``look`` sees box columns, most contacts and lanes, and may raise. Returns a
    list of what is made."""
    made: list[Rollout] = []

    def rollout(run: Run, n_boxes: int, pairs: int, room: int, shape: Shape, lanes: int, slice_ns: int) -> Rollout:
        look(n_boxes, room, lanes)
        made.append(Rollout(run, n_boxes, pairs, room, shape, lanes, slice_ns))
        return made[-1]

    monkeypatch.setattr(mjx_warp, "Rollout", rollout)
    return made


def sizes_apart(monkeypatch: pytest.MonkeyPatch, most_boxes: int) -> None:
    """Lanes of two sizes also for tiny worlds, with as many threads each."""
    small, large = shape.SIZES
    alike = replace(small, most_boxes=most_boxes), replace(small, most_boxes=large.most_boxes)
    monkeypatch.setattr(shape, "SIZES", alike)
    here = Shape.here

    def sized(n_boxes: int) -> Shape:
        return replace(here(n_boxes), panels=most_panels(size_for(n_boxes).most_boxes))

    monkeypatch.setattr(Shape, "here", sized)


@pytest.mark.slow
def test_worlds_of_each_size_have_lanes_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large ones come first, in tables as wide as the run's largest; outcomes are those of their jobs."""
    scenes = {**tiny_scenes(), "five": make_scene(5), "nine": make_scene(9)}
    alike = simulate(engine(), scenes, SHORT)
    sizes_apart(monkeypatch, 4)
    some, sizes = engine(group_size=4), []
    march = some._march

    def watched(run: Any, jobs: list[Job]) -> Any:
        sizes.append(sorted(job.scene.n_boxes for job in jobs))
        return march(run, jobs)

    monkeypatch.setattr(some, "_march", watched)
    assert_equal_worlds(simulate(some, scenes, SHORT), alike)
    assert all(max(group) <= 4 or min(group) > 4 for group in sizes)
    assert [5, 9] in sizes
    assert len(some._kept) == 2
    assert {rollout.march.sizes["box"] for _, rollout in some._kept.values()} == {4, 12}


@pytest.mark.slow
def test_lanes_of_the_other_size_make_room(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    """Memory for the lanes of one size at a time: with the other size's gone as many fit as were wanted."""
    tried = []

    def look(n_boxes: int, room: int, lanes: int) -> None:
        tried.append((n_boxes, lanes))
        if any(not other.workspace.is_deleted() for other in made):
            raise out_of_memory()

    sizes_apart(monkeypatch, 4)
    made = watched_rollouts(monkeypatch, look)
    scenes = {**tiny_scenes(("hand-one-box",)), "five": make_scene(5)}
    found = simulate(engine(), scenes, SHORT)
    assert_same(found["hand-one-box"], crowd["hand-one-box"])
    assert found["five"].reason is not Reason.OUT_OF_MEMORY
    assert [n_boxes for n_boxes, _ in tried] == [8, 4, 4]
    assert len({lanes for _, lanes in tried}) == 1


# ---------------------------------------------------------------------- what goes wrong


@pytest.mark.slow
@devices
@pytest.mark.parametrize("buffer", ["CONTACTS_PER_BOX", "PAIRS_PER_BOX"])
def test_buffers_that_are_too_small_grow_and_give_the_same(
    device: str, buffer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 4 of each a world: of the bricks at least 5 pairs touch, in 20 contacts.
    some = tiny_scenes(("hand-one-box", "brickwork"))
    expected = simulate(shared_engine(), some, SHORT)
    monkeypatch.setattr(mjx_warp, buffer, 1)
    monkeypatch.setattr(mjx_warp, "MORE_BOXES", 0)
    found = simulate(engine(), some, SHORT)
    assert found["brickwork"].flags & Flag.RERUN_AFTER_OVERFLOW
    for name, outcome in found.items():
        assert not outcome.flags & Flag.CONTACT_OVERFLOW
        assert_same(outcome, expected[name])


@pytest.mark.slow
def test_what_overflows_for_ever_is_invalid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjx_warp, "CONTACTS_PER_BOX", 0)
    small = engine()
    found = simulate(small, tiny_scenes(("hand-one-box",)), SHORT)["hand-one-box"]
    assert (found.verdict, found.reason) == (Verdict.INVALID, Reason.OVERFLOW)
    assert list(small._room.values()) == [MAX_GROWTH]


MARKED = "hand-bridge"
NAN = float("nan")


def poisoned(monkeypatch: pytest.MonkeyPatch, poison: Callable[[Group, int], Group]) -> None:
    """Put what is no number into the tables of jobs with the most boxes."""
    plain = MjxWarpEngine._load_group

    def load(self: MjxWarpEngine, run: Any, jobs: Sequence[Job]) -> Group:
        group = plain(self, run, jobs)
        return poison(group, int(np.argmax([job.scene.n_boxes for job in jobs])))

    monkeypatch.setattr(MjxWarpEngine, "_load_group", load)


def in_release_pose(group: Group, row: int) -> Group:
    group.worlds = group.worlds._replace(start=group.worlds.start.at[row, 1].set(NAN))
    return group


def in_mass(group: Group, row: int) -> Group:
    group.worlds = group.worlds._replace(mass=group.worlds.mass.at[row, 1].set(NAN))
    return group


def in_carrier_velocity(group: Group, row: int) -> Group:
    group.table = group.table._replace(carrier_vel=group.table.carrier_vel.at[row, 2].set(NAN))
    return group


@pytest.mark.slow
@devices
@pytest.mark.parametrize("poison", [in_release_pose, in_mass, in_carrier_velocity])
def test_a_world_that_turns_into_no_number_harms_no_other(
    device: str, poison: Callable[[Group, int], Group], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("hand-one-box", MARKED, "hand-overhang-45")
    healthy = simulate(shared_engine(), tiny_scenes(names), SHORT)
    poisoned(monkeypatch, poison)
    found = simulate(shared_engine(), tiny_scenes(names), SHORT)
    ill = found.pop(MARKED)
    assert (ill.verdict, ill.reason) == (Verdict.INVALID, Reason.NONFINITE)
    assert_equal_worlds(found, healthy)


def test_a_plan_with_more_bodies_than_the_solver_has_room_for_is_refused() -> None:
    size, pitch = (10.0, 10.0, 10.0), 20.0
    boxes = [(size, (pitch * (k % 32), pitch * (k // 32), 0.0), 1.0) for k in range(MAX_BOXES + 1)]
    run = engine().run([Job(make_scene(boxes))], Simulation())
    with pytest.raises(InputError, match=rf"up to {MAX_BOXES} boxes, and one has {MAX_BOXES + 1}: choose the engine"):
        next(run)


def out_of_memory() -> RuntimeError:
    return RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 12884901888 bytes.")


def small_device(monkeypatch: pytest.MonkeyPatch, holds: Callable[[int, int], bool]) -> list[int]:
    """A device of 256 lanes that says whether it holds so many, with so many contacts each. Returns a list of the lanes
    that were tried."""
    tried = []

    def look(n_boxes: int, room: int, lanes: int) -> None:
        tried.append(lanes)
        if not holds(lanes, room):
            raise out_of_memory()

    here = Shape.here
    monkeypatch.setattr(Shape, "here", lambda n_boxes: replace(here(n_boxes), lanes=256))
    watched_rollouts(monkeypatch, look)
    return tried


@pytest.mark.slow
def test_too_many_lanes_are_halved_until_they_fit(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    tried = small_device(monkeypatch, lambda lanes, _: lanes <= 64)
    names = ("hand-one-box", "hand-bridge")
    assert_equal_worlds(simulate(MjxWarpEngine(allow_cpu=True), tiny_scenes(names), SHORT), crowd)
    assert tried == [256, 128, 64]


@pytest.mark.slow
def test_fewer_lanes_than_are_usually_worth_while_are_as_the_user_wants(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    tried = small_device(monkeypatch, lambda *_: True)
    few = MIN_LANES // 4
    found = simulate(MjxWarpEngine(few, allow_cpu=True), tiny_scenes(("hand-one-box",)), SHORT)
    assert_equal_worlds(found, crowd)
    assert tried == [few]


def test_a_device_without_any_room_gives_invalid_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = small_device(monkeypatch, lambda *_: False)
    for outcome in simulate(MjxWarpEngine(allow_cpu=True), tiny_scenes(), SHORT).values():
        assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OUT_OF_MEMORY)
    assert tried == [256, 128, 64, 32, 16]


@pytest.mark.slow
def test_memory_that_runs_out_while_buffers_grow_ends_what_is_not_at_its_end(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """One world has its outcome already, one waits for its drive, and one needs more room than there is."""
    monkeypatch.setattr(mjx_warp, "CONTACTS_PER_BOX", 2)
    small_device(monkeypatch, lambda _, room: room <= 12)
    drive = Drive(Excitation("still", "force", np.zeros((5, 3))), rest_s=0.1)
    one_box = tiny("hand-one-box")
    jobs = [Job(tiny("brickwork")), Job(one_box, drive), Job(one_box)]
    large, waits, ended = run_all(MjxWarpEngine(allow_cpu=True, slice_ns=LONG_NS), jobs, SHORT)
    assert large.reason is waits.reason is Reason.OUT_OF_MEMORY
    assert_same(ended, crowd["hand-one-box"])


class FailingRollout(Rollout):
    """Fails in its third slice of time if it has more than ``holds`` worlds."""

    holds = 2
    error: Exception = out_of_memory()

    def wait(self, group: Group) -> Any:
        self.waits = getattr(self, "waits", 0) + 1
        if len(group.jobs) > self.holds and self.waits >= 3:
            raise self.error
        return super().wait(group)


@pytest.mark.slow
def test_memory_that_runs_out_midway_loses_nothing(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    monkeypatch.setattr(mjx_warp, "Rollout", FailingRollout)
    found = run_all(engine(slice_ns=100_000_000), [Job(scene) for scene in tiny_scenes().values()], SHORT)
    assert_equal_worlds(dict(zip(TINY, found, strict=True)), crowd)


@pytest.mark.slow
def test_a_world_that_has_not_enough_memory_even_alone_is_invalid(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(FailingRollout):
        holds = 0

    monkeypatch.setattr(mjx_warp, "Rollout", Full)
    two = [Job(tiny("hand-one-box")), Job(tiny("hand-bridge"))]
    for outcome in run_all(engine(slice_ns=100_000_000), two, SHORT):
        assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OUT_OF_MEMORY)


@pytest.mark.slow
def test_other_errors_are_raised_and_the_engine_goes_on(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    class Broken(FailingRollout):
        error = RuntimeError("INTERNAL: illegal memory access")

    begun = engine(slice_ns=100_000_000)
    with monkeypatch.context() as patch:
        patch.setattr(mjx_warp, "Rollout", Broken)
        with pytest.raises(RuntimeError, match="illegal memory access"):
            simulate(begun, tiny_scenes(), SHORT)
    assert_equal_worlds(simulate(begun, tiny_scenes(TINY[:2]), SHORT), crowd)


@pytest.mark.slow
def test_a_run_that_is_left_early_does_not_change_the_next(crowd: dict[str, Outcome]) -> None:
    left = engine(slice_ns=100_000_000)
    begun = left.run([Job(scene) for scene in tiny_scenes().values()], SHORT)
    next(begun)
    begun.close()
    assert_equal_worlds(simulate(left, tiny_scenes(), SHORT), crowd)


@pytest.mark.slow
def test_one_program_a_shape() -> None:
    """Other jobs of as many boxes, another run, drives: the same programs, and the same lanes."""
    fresh = engine()
    some = list(tiny_scenes().values())
    for scenes in (some[:4], some[1:], some[:3]):
        run_all(fresh, [Job(scene) for scene in scenes], SHORT)
    ((_, rollout),) = fresh._kept.values()
    run_all(fresh, [Job(scene, pushes("force", 1.0)) for scene in some[1:3]], SHORT)
    assert [each for _, each in fresh._kept.values()] == [rollout]
    assert len(rollout._programs) == 2, "of up to four worlds, and of two with a profile"


# ---------------------------------------------------------------------- drives and forks


def pushes(kind: str, level: float, steps: int = 60) -> Drive:
    """A push along a direction of its own, which ends in the midst of the drive."""
    return Drive(Excitation("push", kind, np.tile([level, 0.0, 0.0], (steps, 1))), scale=0.5, yaw_rad=0.7, rest_s=0.1)


LEVELS = {"force": 2.1, "acceleration": 12.0}
"""With these a pallet slides on the floor, or a box on the pallet, by some millimetres."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(LEVELS))
def test_drives_as_in_c_and_forks_as_whole_runs(kind: str) -> None:
    scene = tiny("hand-bridge")
    drives = [pushes(kind, LEVELS[kind]), pushes(kind, 0.5 * LEVELS[kind], steps=35)]
    (kept,) = run_all(shared_engine(), [Job(scene, keep_state=True)], SHORT)
    assert kept.state is not None
    jobs = [Job(scene, drive) for drive in drives]
    forks = run_all(shared_engine(), [Job(scene, drive, start=kept.state) for drive in drives], SHORT)
    twins = run_all(MujocoEngine(2), jobs, SHORT)
    for drive, whole, fork, twin in zip(drives, run_all(shared_engine(), jobs, SHORT), forks, twins, strict=True):
        assert fork.flags == whole.flags | Flag.FORKED
        assert fork.n_steps == len(drive.excitation.samples) + 50 == whole.n_steps - kept.n_steps
        assert fork.sim_time_s == whole.sim_time_s
        for name, values in vars(whole.boxes).items():
            np.testing.assert_array_equal(getattr(fork.boxes, name), values, err_msg=name)
        assert_twin(whole, twin)
        assert (whole.n_steps, whole.sim_time_s) == (twin.n_steps, twin.sim_time_s)
        np.testing.assert_allclose(whole.boxes.max_sway_m, twin.boxes.max_sway_m, rtol=0.01, atol=SAME_SWAY_M)
    assert twins[0].boxes.max_sway_m.max() > 2e-3


@pytest.mark.slow
def test_a_drive_has_an_iteration_limit_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which placements do not feel, and which the user's own replaces."""
    jobs = [Job(tiny("hand-bridge"), pushes("force", LEVELS["force"])), Job(tiny("hand-bridge"))]

    def found(driven: int, **options: Any) -> list[Outcome]:
        monkeypatch.setattr(rollouts, "DRIVEN_ITERATIONS", driven)
        return run_all(engine(), jobs, SHORT.changed(**options))

    few, many, wanted = found(1), found(MAX_ITERATIONS), found(1, solver_iterations=MAX_ITERATIONS)
    assert not np.array_equal(few[0].boxes.max_sway_m, many[0].boxes.max_sway_m)
    assert_same(few[1], many[1])
    for one, other in zip(wanted, many, strict=True):
        assert_same(one, other)


@pytest.mark.slow
def test_a_state_goes_on_in_a_narrower_table_than_it_came_from() -> None:
    """As in a sweep whose largest plan does not stand."""
    scenes = [tiny("hand-one-box"), make_scene(9)]
    drive, alone = pushes("force", 0.5), run_all(shared_engine(), [Job(scenes[0], keep_state=True)], SHORT)[0]
    kept, _ = run_all(shared_engine(), [Job(scene, keep_state=True) for scene in scenes], SHORT)
    crowded, single = (
        run_all(shared_engine(), [Job(scenes[0], drive, start=o.state)], SHORT)[0] for o in (kept, alone)
    )
    assert_same(crowded, single)


@pytest.mark.slow
def test_a_world_that_fell_skips_its_drive_and_so_do_its_forks() -> None:
    scene = tiny("hand-falls-off")
    sim = SHORT.changed(settle_s=1.0)
    drive = pushes("force", 1.0)
    whole, kept = run_all(shared_engine(), [Job(scene, drive), Job(scene, keep_state=True)], sim)
    (fork,) = run_all(shared_engine(), [Job(scene, drive, start=kept.state)], sim)
    (twin,) = run_all(MujocoEngine(1), [Job(scene, drive)], sim)
    for outcome in (whole, kept, fork):
        assert (outcome.verdict, outcome.reason, outcome.culprit) == (twin.verdict, twin.reason, twin.culprit)
        assert np.isnan(outcome.boxes.max_sway_m).all()
    assert fork.flags & Flag.FORKED
    assert fork.n_steps == 0
    assert whole.n_steps == kept.n_steps


@pytest.mark.slow
def test_the_shortest_drives_end_as_in_c() -> None:
    drives = [Drive(Excitation("short", "force", np.zeros((steps, 3))), rest_s=0.0) for steps in (0, 1, 7)]
    jobs = [Job(tiny("hand-one-box"), drive) for drive in drives]
    outcomes, twins = (run_all(which, jobs, SHORT) for which in (shared_engine(), MujocoEngine(1)))
    # An end is seen after a step, so a drive without any takes one.
    assert [outcome.n_steps for outcome in outcomes] == [
        twin.n_steps + more for twin, more in zip(twins, (1, 0, 0), strict=True)
    ]
    assert {outcome.verdict for outcome in (*outcomes, *twins)} == {Verdict.STABLE}


@pytest.mark.slow
def test_a_held_carrier_carries() -> None:
    """Its pose is per-world data; as a welded body's model field MJX-Warp ignored it, and boxes fell through."""
    excitation = Excitation("still", "acceleration", np.zeros((20, 3)))
    jobs = [Job(tiny("hand-bridge"), drive=Drive(excitation, rest_s=0.3))]
    sim = Simulation(settle_s=0.4)
    (expected,) = MujocoEngine(1).run(jobs, sim)
    (found,) = shared_engine().run(jobs, sim)
    assert (found.verdict, found.n_steps) == (expected.verdict, expected.n_steps)
    assert found.verdict is Verdict.STABLE
    np.testing.assert_allclose(found.boxes.pos, expected.boxes.pos, atol=SAME_PLACE_M)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(LEVELS))
def test_the_floor_presses_on_no_box_that_lies_on_it(kind: str) -> None:
    """Not even on one that is flatter than the carrier, while the carrier is held."""
    boxes = [((400.0, 300.0, 200.0), (0.0, 0.0, 0.0), 5.0), ((300.0, 300.0, 20.0), (1300.0, 0.0, 0.0), 2.0)]
    sim = SHORT.changed(early_stop=False, carrier=Carrier.EURO_PALLET, settle_s=0.6)
    job = Job(make_scene(boxes, sim), Drive(Excitation("still", kind, np.zeros((20, 3))), rest_s=0.2))
    (expected,) = run_all(MujocoEngine(1), [job], sim)
    (found,) = run_all(shared_engine(), [job], sim)
    assert expected.boxes.dropped[1]
    assert found.boxes.dropped[1]
    np.testing.assert_allclose(found.boxes.rest_top_force_n, expected.boxes.rest_top_force_n, atol=SMALL_FORCE_N)


@pytest.mark.slow
def test_a_search_finds_the_levels_that_c_finds() -> None:
    """To the step of 0.01 g, with the box that fails first and how."""
    plans = [plan for plan in load_plans(bundled_path()).plans if plan.plan_id == "hand-bridge"]
    found, expected = (
        petmjx.sweep("eumos-search", plans, engine=which).summary for which in (engine(), MujocoEngine(2))
    )
    columns = ["plan_id", "direction_deg", "largest_level_g", "first_failed_level_g", "box", "mode"]
    assert len(expected) == 4
    pd.testing.assert_frame_equal(found[columns], expected[columns])


# ---------------------------------------------------------------------- on a GPU


@pytest.mark.gpu
def test_a_device_whose_memory_runs_out_goes_on_with_fewer_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    some = {f"{name} {k}": scene for name, scene in tiny_scenes().items() for k in range(20)}
    some["large"] = make_scene(120)
    alone = simulate(MjxWarpEngine(), some, SHORT)
    crowded = MjxWarpEngine()
    lanes, room = Shape.here(120).lanes, 120 + mjx_warp.MORE_BOXES
    whole = lanes * lane_bytes(120, mjx_warp.PAIRS_PER_BOX * room, mjx_warp.CONTACTS_PER_BOX * room)
    left = TABLES_BYTES + whole // 2
    ballast = []
    for piece in (1 << 30, 1 << 26, 1 << 22):
        while (free := free_bytes()) > left + piece:
            ballast.append(jax.block_until_ready(jnp.zeros(piece, jnp.uint8)))
    assert free < left + (1 << 22)
    tried = []

    def look(n_boxes: int, room: int, wanted: int) -> None:
        if n_boxes == 120:
            tried.append(wanted)

    watched_rollouts(monkeypatch, look)
    found = simulate(crowded, some, SHORT)
    del ballast
    assert tried[0] == lanes
    assert tried[-1] < lanes
    assert_equal_worlds(found, alone)


TABLES_BYTES = 64 << 20
"""More than the tables of some hundred worlds take, with what JAX needs beside them."""


def free_bytes() -> int:
    """Device memory that JAX can still take."""
    stats = jax.devices()[0].memory_stats()
    return stats["bytes_limit"] - stats["bytes_in_use"]


@pytest.mark.gpu
def test_bundled_and_generated_plans_as_in_c(tmp_path: Path) -> None:
    plans = load_plans(bundled_path()).plans
    more = tmp_path / "more.json"
    write_plans(more, (generate_one(index, seed=5) for index in range(64 - len(plans))))
    plans = [*plans, *load_plans(more).plans]
    assert len(plans) == 64
    sim = Simulation()
    jobs = [Job(build_scene(plan, sim)) for plan in plans]
    expected = {o.job: o for o in MujocoEngine().run(jobs, sim)}
    found = {o.job: o for o in MjxWarpEngine().run(jobs, sim)}
    assert found.keys() == expected.keys()
    differ = [plans[job].plan_id for job, o in found.items() if o.verdict is not expected[job].verdict]
    # The goal is 98 % of 2,000; one of 64 is as near as a small sample can say.
    assert len(differ) <= 1, differ
    for job, outcome in found.items():
        assert not (outcome.verdict is Verdict.STABLE and expected[job].reason is Reason.DROP)
