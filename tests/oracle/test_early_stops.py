"""When a world on C MuJoCo ends early because its verdict is known, and what drives record.

A drive is a motion of the carrier in a test of the pallet.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.plans import Box, falling, make_scene, stack
from support.worlds import run_one

from petmjx.common.units import seconds_to_steps
from petmjx.engines.metrics import CONFIRM_S
from petmjx.engines.verdict import Flag, Reason, Verdict
from petmjx.options.carriers import Carrier
from petmjx.options.simulation import Simulation
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import Scene


def test_a_collapse_ends_early_unless_told_to_go_on() -> None:
    scene = falling()
    early = run_one(Job(scene), Simulation())
    full_run = run_one(Job(scene), Simulation(early_stop=False))
    assert early.verdict is full_run.verdict is Verdict.UNSTABLE
    assert early.culprit == full_run.culprit == 1
    assert early.flags & Flag.EARLY_STOP
    assert not full_run.flags & Flag.EARLY_STOP
    assert early.sim_time_s < full_run.sim_time_s
    assert np.isnan(early.boxes.rest_top_force_n).all()
    assert np.isfinite(full_run.boxes.rest_top_force_n).all()


def test_a_world_that_is_asked_whether_it_stands_ends_when_a_box_is_lost() -> None:
    """The only result that counts of a world with errors (``has_errors``) is whether the pallet stands. The world has
    the same verdict, culprit and time of the first sign as the full run. The world with errors lacks only what follows
    the early end."""
    with_errors, full_run = (
        run_one(Job(falling(), has_errors=has_errors), Simulation()) for has_errors in (True, False)
    )
    assert (with_errors.verdict, with_errors.culprit, with_errors.first_sign_s) == (
        full_run.verdict,
        full_run.culprit,
        full_run.first_sign_s,
    )
    assert with_errors.first_sign_s <= with_errors.sim_time_s < full_run.sim_time_s
    assert with_errors.flags & Flag.EARLY_STOP
    assert with_errors.boxes.max_tilt_deg.max() > Simulation().thresholds.tilt_deg
    assert (with_errors.reason, full_run.reason) == (Reason.TILT, Reason.DROP)
    on = run_one(Job(falling(), has_errors=True), Simulation(early_stop=False))
    assert on.sim_time_s > full_run.sim_time_s


def test_a_world_that_only_confirms_a_fall_ends_a_second_after_its_sign_and_two_placements() -> None:
    """A plank tips over the edge of a box, and remains tilted. The world has the same verdict, culprit and time of the
    first sign as the full run."""
    sim = Simulation(schedule="fixed", interval_s=0.7)
    beside: list[Box] = [((100, 100, 40), (150 * k, 500, 0), 1.0) for k in range(4)]
    scene = make_scene([((300, 300, 100), (0, 0, 0), 5.0), ((600, 300, 40), (160, 0, 100), 5.0), *beside], sim)
    confirming, full_run = (run_one(Job(scene, confirms=confirms), sim) for confirms in (True, False))
    assert (confirming.verdict, confirming.reason, confirming.culprit, confirming.first_sign_s) == (
        full_run.verdict,
        full_run.reason,
        full_run.culprit,
        full_run.first_sign_s,
    )
    assert confirming.verdict is Verdict.UNSTABLE
    assert confirming.flags & Flag.EARLY_STOP
    assert (confirming.n_placed, full_run.n_placed) == (4, 6)
    assert CONFIRM_S <= confirming.sim_time_s - confirming.first_sign_s < CONFIRM_S + sim.interval_s
    on = run_one(Job(scene, confirms=True), sim.changed(early_stop=False))
    assert on.sim_time_s == full_run.sim_time_s


PUSH = Excitation("push", "acceleration", np.tile([4.0, 0, 0], (300, 1)))
"""A constant acceleration along x, which topples a tower."""


def tower() -> Scene:
    """Return a scene with a tower that topples when it is pushed along x, and a flat box beside it that stays."""
    column = stack(4, size_mm=(150, 400, 300), at_mm=(800, 0))
    return make_scene([*column, ((300, 400, 60), (0, 0, 0), 5.0)], Simulation(carrier=Carrier.EURO_PALLET))


@pytest.mark.parametrize("kind", ["force", "acceleration"])
def test_a_drive_ends_when_its_culprit_is_lost(kind: str) -> None:
    """The world has the same verdict, culprit and time of the first sign as the full run, because it is known how the
    first box failed."""
    shaken = Drive(Excitation("push", kind, np.tile([4.0 if kind == "acceleration" else 2.0, 0, 0], (300, 1))))
    early, full_run = (run_one(Job(tower(), shaken), Simulation(early_stop=stop)) for stop in (True, False))
    assert (early.verdict, early.culprit, early.first_sign_s) == (
        full_run.verdict,
        full_run.culprit,
        full_run.first_sign_s,
    )
    assert early.flags & Flag.EARLY_STOP
    assert (early.reason, full_run.reason) == (Reason.TILT, Reason.DROP)
    assert early.first_sign_s < early.sim_time_s < full_run.boxes.drop_s[full_run.boxes.dropped].min()
    limit = Simulation().thresholds.tilt_deg
    assert early.boxes.max_tilt_deg[early.culprit] > limit
    assert round(early.sim_time_s / Simulation().physics.timestep_s) % Simulation().quiet.poll_steps == 0


def test_a_drive_that_may_be_passed_goes_on_until_the_culprit_has_swayed_too_far() -> None:
    sway_m = []
    for allowed_m in (0.0, 0.6, 10.0):
        outcome = run_one(Job(tower(), Drive(PUSH, allowed_sway_m=allowed_m)), Simulation())
        assert outcome.verdict is Verdict.UNSTABLE
        assert outcome.reason is (Reason.DROP if allowed_m > 1 else Reason.TILT)
        sway_m.append(float(outcome.boxes.max_sway_m[outcome.culprit]))
    assert sway_m[0] < 0.6 <= sway_m[1] < sway_m[2]


def test_a_drive_ends_at_the_look_after_the_one_that_finds_its_culprit() -> None:
    """Looks are the regular checks of all boxes. In this test, the culprit passes both of its thresholds at the same
    look."""
    sim = Simulation(thresholds={"tilt_deg": 0.01})
    outcome = run_one(Job(tower(), Drive(PUSH)), sim)
    assert outcome.flags & Flag.EARLY_STOP
    look_s = sim.quiet.poll_steps * sim.physics.timestep_s
    assert outcome.sim_time_s - outcome.first_sign_s == pytest.approx(look_s)


def test_with_pyramidal_cones_a_drive_ends_by_a_drop_alone_and_is_seen_at_samples() -> None:
    sim = Simulation(physics="reference", carrier=Carrier.EURO_PALLET)
    column = make_scene(stack(4, size_mm=(150, 400, 300), at_mm=(800, 0)), sim)
    outcome = run_one(Job(column, Drive(PUSH, rest_s=2.0)), sim)
    assert outcome.reason is Reason.DROP
    timestep_s = sim.physics.timestep_s
    assert round(outcome.first_sign_s / timestep_s) % seconds_to_steps(sim.sample_interval_s, timestep_s) == 0


def test_what_is_seen_of_a_drive_does_not_depend_on_how_often_samples_are_taken() -> None:
    """A box on its small side rocks in a short pulse, between two samples."""
    scene = make_scene([((200, 400, 400), (0, 0, 0), 10.0)], Simulation(carrier=Carrier.EURO_PALLET))
    pulse = Drive(Excitation("pulse", "acceleration", np.tile([9.0, 0, 0], (40, 1))), rest_s=1.0)
    often, seldom = (
        run_one(Job(scene, pulse), Simulation(sample_interval_s=interval)).boxes for interval in (0.02, 1.0)
    )
    assert often.max_tilt_deg[0] > 1.0
    np.testing.assert_allclose(seldom.max_tilt_deg, often.max_tilt_deg, rtol=0.1)
    np.testing.assert_allclose(seldom.max_sway_m, often.max_sway_m, rtol=0.1)


def test_a_box_that_comes_back_is_not_lost() -> None:
    """A board tips under a box by more than twice the threshold of shift. Then the next box on the board's other end
    tips it back."""
    sim = Simulation(carrier=Carrier.EURO_PALLET, placing="hand")
    boxes = [
        ((200, 800, 60), (500, 0, 0), 10.0),
        ((1200, 800, 20), (0, 0, 60), 2.0),
        ((200, 800, 100), (0, 0, 80), 5.0),
        ((200, 800, 100), (1000, 0, 80), 5.0),
    ]
    scene = make_scene(boxes, sim)
    outcome = run_one(Job(scene, record=Record(0.1), has_errors=True, confirms=True), sim)
    assert outcome.verdict is Verdict.STABLE
    assert outcome.history is not None
    sunk = scene.target[2, 2] - np.nanmin(outcome.history.pos[:, 2, 2])
    assert sunk > 2 * sim.thresholds.shift_m
