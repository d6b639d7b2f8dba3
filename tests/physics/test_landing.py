"""Boxes that land: how hard they hit does not depend on when one looks."""

from __future__ import annotations

import mujoco
import numpy as np
from support.plans import Box, make_scene

from petmjx.basics.units import STANDARD_GRAVITY
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.engines.cpu.forces import largest_top_forces, pressed
from petmjx.engines.cpu.live import LiveWorld
from petmjx.options.config import Simulation
from petmjx.world.job import Job

STACK: tuple[Box, ...] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (0, 0, 200), 5.0))
HEIGHT_MM = 100.0

SAME_PEAK = 0.05
"""Of a peak at half the timestep, relative: it lasts for dozens of steps."""


def peak_n(sample_interval_s: float, timestep_s: float) -> float:
    sim = Simulation(
        placing={"name": "drop", "height_mm": HEIGHT_MM},
        sample_interval_s=sample_interval_s,
        physics={"timestep_s": timestep_s},
    )
    (outcome,) = MujocoEngine(1).run([Job(make_scene(STACK, sim))], sim)
    return float(outcome.boxes.max_top_force_n[0])


def test_peaks_depend_neither_on_samples_nor_on_timesteps() -> None:
    every = peak_n(0.002, 0.002)
    assert {peak_n(interval_s, 0.002) for interval_s in (0.2, 0.034, 1.0)} == {every}
    np.testing.assert_allclose([peak_n(0.2, 0.001), peak_n(0.2, 0.0005)], every, rtol=SAME_PEAK)
    # what stops 5 kg that have fallen 100 mm within 10 mm presses by more than 11 times their weight on the average
    assert every > 11 * 5.0 * STANDARD_GRAVITY


def test_forces_of_many_steps_are_those_of_each() -> None:
    sim = Simulation()
    live = LiveWorld(make_scene((*STACK, ((200, 200, 100), (50, 50, 400), 2.0)), sim), sim, n_boxes=3)
    live.data.qvel[-4] = -1.0
    steps, expected = [], np.zeros(3)
    for number in range(60):
        counts = 2 if number < 10 else 3
        live.step(1)
        steps.append(pressed(live.data, live.geom_bodies, counts))
        expected[:counts] = np.maximum(expected[:counts], live.top_forces()[:counts])
    assert expected[1] > 3 * 2.0 * STANDARD_GRAVITY
    np.testing.assert_array_equal(largest_top_forces(steps, 3), expected)
    mujoco.mj_resetData(live.model, live.data)
    assert largest_top_forces([pressed(live.data, live.geom_bodies, 3)], 3).tolist() == [0.0, 0.0, 0.0]
