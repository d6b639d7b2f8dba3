"""Tests of the comparison with other simulators (referees): which plans each referee gets, and how their worlds are
run. The simulators are mocks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.plans import make_plan, make_scene, stack

from benchmarks.__main__ import main
from benchmarks.crossengine import sieve
from benchmarks.referees.box_by_box import stand
from benchmarks.referees.referee import CARRIER, FIRST_BOX, FLOOR, top_forces
from benchmarks.stack_forces import PILES, by_statics
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene, build_scene

STABLE, UNSTABLE, INVALID = (verdict.value for verdict in Verdict)


@pytest.mark.parametrize(
    ("ours", "verdicts", "asked", "against"),
    [
        # a plan is decided if the first referee agrees; of two referees, also if the first one's answer depends on the
        # timestep
        (STABLE, [(STABLE, UNSTABLE), (UNSTABLE, UNSTABLE), (UNSTABLE, UNSTABLE)], [[STABLE]], []),
        (STABLE, [(UNSTABLE, STABLE), (UNSTABLE, UNSTABLE)], [[UNSTABLE, STABLE]], []),
        # a single referee whose answer does not depend on the timestep is not enough
        (STABLE, [(UNSTABLE, UNSTABLE), (STABLE, UNSTABLE)], [[UNSTABLE, UNSTABLE], [STABLE]], ["0"]),
        (UNSTABLE, [(STABLE, STABLE), (STABLE, STABLE)], [[STABLE, STABLE], [STABLE, STABLE]], ["0", "1"]),
        # with three referees, the second one may fail
        (
            STABLE,
            [(UNSTABLE, UNSTABLE), (UNSTABLE, STABLE), (UNSTABLE, UNSTABLE)],
            [[UNSTABLE, UNSTABLE], [UNSTABLE, STABLE], [UNSTABLE, UNSTABLE]],
            ["0", "2"],
        ),
        # an invalid world is no answer, and a plan without a valid verdict cannot be contradicted
        (STABLE, [(INVALID, INVALID), (UNSTABLE, UNSTABLE)], [[INVALID, INVALID]], []),
        (INVALID, [(STABLE, STABLE), (STABLE, STABLE)], [[STABLE, STABLE]], []),
    ],
)
def test_two_converged_referees_overrule_petmjx(
    ours: str, verdicts: list[tuple[str, str]], asked: list[list[str]], against: list[str]
) -> None:
    names = [str(number) for number in range(len(verdicts))]
    trial = sieve(ours, names, lambda name, fine: verdicts[int(name)][fine])
    assert list(trial.said.values()) == asked
    assert trial.converged_against == against
    assert trial.is_contradicted == (len(against) == 2)


class MadeUp:
    """A mock world in which each box moves along a given path after its placement: (number of the box, time in s) →
    displacement in m."""

    timestep_s = 0.001

    def __init__(self, scene: Scene, path: Callable[[int, float], tuple[float, float, float]]) -> None:
        self._scene, self._path = scene, path
        self._now = 0
        self.placed_at: list[int] = []

    def place(self, box: int) -> None:
        assert box == len(self.placed_at)
        self.placed_at.append(self._now)

    def step(self, count: int) -> None:
        self._now += count

    def pose(self) -> FloatArray:
        moved = [self._path(box, (self._now - at) * self.timestep_s) for box, at in enumerate(self.placed_at)]
        k = len(moved)
        return np.column_stack((self._scene.start_pos[:k] + np.reshape(moved, (k, 3)), self._scene.start_quat[:k]))

    def top_forces(self) -> FloatArray:
        return np.arange(len(self.placed_at), dtype=float)

    def close(self) -> None:
        pass


def test_boxes_that_rest_stand_and_are_placed_one_by_one() -> None:
    scene, sim = make_scene(3), Simulation()
    world = MadeUp(scene, lambda box, seconds: (0.0, 0.0, 0.0))
    outcome = stand(world, scene, sim)
    assert (outcome.verdict, outcome.margin, outcome.moving) == (Verdict.STABLE, 1.0, False)
    assert outcome.boxes.rest_top_force_n.tolist() == [0.0, 1.0, 2.0]
    # boxes are placed as by petmjx: after three checks, that is, 15 steps of 2 ms
    assert np.diff(world.placed_at).tolist() == [30, 30]
    together = MadeUp(scene, lambda box, seconds: (0.0, 0.0, 0.0))
    stand(together, scene, sim.changed(check="static"))
    assert len(set(together.placed_at)) == 1


@pytest.mark.parametrize(
    ("path", "verdict", "reason", "moving"),
    [
        # the box slides by 50 mm within a second, and then rests
        (lambda box, s: (0.05 * min(s, 1.0), 0.0, 0.0), Verdict.UNSTABLE, Reason.SHIFT, False),
        (lambda box, s: (0.0, 0.0, -0.5 * 9.81 * s * s), Verdict.UNSTABLE, Reason.DROP, True),
        # the box begins to topple so slowly that it counts as quiet; the world must not end yet
        (lambda box, s: (1e-4 * (np.exp(2 * s) - 1), 0.0, 0.0), Verdict.UNSTABLE, Reason.SHIFT, True),
        # the box creeps for ever
        (lambda box, s: (0.0015 * s, 0.0, 0.0), Verdict.STABLE, Reason.NONE, True),
        (lambda box, s: (np.nan, 0.0, 0.0), Verdict.INVALID, Reason.NONFINITE, True),
    ],
)
def test_boxes_that_move_are_judged_as_petmjx_judges_them(
    path: Callable[[int, float], tuple[float, float, float]], verdict: Verdict, reason: Reason, moving: bool
) -> None:
    scene = make_scene(1)
    outcome = stand(MadeUp(scene, path), scene, Simulation())
    assert (outcome.verdict, outcome.reason, outcome.moving) == (verdict, reason, moving)


def test_forces_press_on_the_lower_box_whichever_comes_first() -> None:
    scene = make_scene(2)
    pose = np.column_stack((scene.start_pos, scene.start_quat))
    bodies = [(FIRST_BOX, FIRST_BOX + 1), (FIRST_BOX + 1, FIRST_BOX), (CARRIER, FIRST_BOX), (FLOOR, CARRIER)]
    assert top_forces(bodies, [1.0, -1.0, 1.0, 1.0], [20.0, -30.0, 100.0, 500.0], pose).tolist() == [50.0, 0.0]


def test_statics_knows_the_forces_where_each_box_has_one_support() -> None:
    tower = build_scene(make_plan(boxes=stack(3, kg=[5.0, 3.0, 2.0])), Simulation())
    assert by_statics(tower, 10.0) == pytest.approx([50.0, 20.0, 0.0])
    known = {pile.name: by_statics(build_scene(pile.plan, Simulation()), 9.81) is not None for pile in PILES}
    assert [name for name, is_known in known.items() if is_known] == ["tower", "leaning tower", "balance"]


def test_an_unknown_referee_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["crossengine", "--referees", "oracle"]) == 2
    assert "no referee 'oracle'; there are: physx, bullet, drake" in capsys.readouterr().err
