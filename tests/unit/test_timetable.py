"""Tables of steps compared with MuJoCo's clock, which is a running sum of timesteps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.step_clock import Clock
from petmjx.options.simulation import Check, Simulation

DT = 0.002
BOXES = 6


@pytest.mark.parametrize("interval_s", [0.002, 0.1, 0.2, 0.3, 0.5, 0.7, 1.1])
def test_due_is_the_first_step_at_which_the_interval_has_passed(interval_s: float) -> None:
    table = build_timetable(Simulation(interval_s=interval_s), BOXES)
    clock = [0.0, *itertools.accumulate([DT] * (len(table.clock) - 1))]
    assert table.clock.tolist() == clock
    known = len(clock) - 1 - int(interval_s / DT) - 2
    due = 0
    for step in range(max(known, 1)):
        while clock[due] - clock[step] < interval_s:
            due += 1  # the clock goes forwards, so no later step is due earlier
        assert table.due[step] == due


@pytest.mark.parametrize("interval_s", [0.2, 0.5, 0.7])
def test_ends_are_truncated_as_the_reference_does(interval_s: float) -> None:
    table = build_timetable(Simulation(interval_s=interval_s), BOXES)
    assert table.one_by_one_end.tolist() == [int((n + 1) * interval_s / DT) for n in range(BOXES + 1)]


def test_the_table_reaches_to_the_last_placement_of_the_largest_plan() -> None:
    sim = Simulation(interval_s=0.7, settle_s=2.0)
    table = build_timetable(sim, BOXES)
    step = 0
    for _ in range(BOXES + 1):
        step = int(table.due[step])
    assert step < len(table.clock)
    assert table.settled[step] > step
    assert table.clock[step] >= (BOXES + 1) * 0.7


@pytest.mark.parametrize("timestep_s", [0.002, 0.005, 0.01])
@pytest.mark.parametrize("interval_s", [0.011, 0.1, 0.2, 0.7])
def test_the_last_boxes_are_due_as_with_a_longer_table(interval_s: float, timestep_s: float) -> None:
    """Each placement takes whole steps, so many placements take longer than their intervals together."""
    sim = Simulation(interval_s=interval_s, settle_s=0.0, physics={"name": "pallet", "timestep_s": timestep_s})
    boxes = 200
    table, longer = (build_timetable(sim, n) for n in (boxes, 3 * boxes))
    step = 0
    for _ in range(boxes + 1):
        assert table.due[step] == longer.due[step]
        step = int(table.due[step])
    assert table.settled[step] == longer.settled[step]


def test_times_go_on_behind_the_table_as_a_running_sum() -> None:
    table, longer = (build_timetable(Simulation(), n) for n in (1, 20))
    time_s = Clock(DT).time_s
    assert len(table.clock) < len(longer.clock)
    assert [time_s(step) for step in range(len(longer.clock))] == longer.clock.tolist()
    assert time_s(3) == table.clock[3]


def test_steps_between_samples_and_of_the_rest_window() -> None:
    table = build_timetable(Simulation(sample_interval_s=0.032, rest_window_s=0.2), 1)
    assert (table.sample_every, table.rest_steps) == (16, 100)
    every = build_timetable(Simulation(sample_interval_s=0.002), 1)
    assert every.sample_every == 1


def test_a_static_check_ends_after_its_duration() -> None:
    table = build_timetable(Simulation(check=Check.STATIC, duration_s=3.0), BOXES)
    assert table.static_end == int(3.0 / DT)
    assert len(table.clock) > table.static_end
    np.testing.assert_array_equal(table.settled_nominally, int(2.0 / DT))
