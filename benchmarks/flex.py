"""Boxes that give against MuJoCo's own soft bodies: how deep a load sinks into a carton, as spring and as flex.

A flex is the box as 3 × 3 × 3 points with linear elasticity (Young's modulus k·h / A, so that between two plates it is
a spring of the stiffness k) and no contact with itself. Its points weigh a 27th of the box each, and contacts of light
points are soft; so what it gives beyond the spring is in its contacts.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np

from benchmarks.record import environment
from petmjx.config import Simulation
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.plans.plan import Plan
from petmjx.units import STANDARD_GRAVITY
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

SIZE_MM: Final = (400.0, 300.0, 200.0)
MASS_KG: Final = 10.0
CASES: Final = ((20.0, 20.0), (50.0, 20.0), (100.0, 50.0), (200.0, 50.0))
"""Stiffness, N/mm, and load on top, kg."""

SECONDS: Final = 2.0
"""After which both rest."""


def compared() -> Iterator[dict[str, Any]]:
    """A line for each case: how deep the load sinks, mm."""
    for stiffness, load in CASES:
        spring = (load + MASS_KG / 2) * STANDARD_GRAVITY / stiffness
        law, law_s = _by_law(stiffness, load)
        flex, flex_s = _as_flex(stiffness, load)
        yield {
            "case": "flex",
            "group": "flex",
            "stiffness_n_mm": stiffness,
            "load_kg": load,
            "spring_mm": round(spring, 3),
            "law_mm": round(law, 3),
            "flex_mm": round(flex, 3),
            "cpu_s": {"law": round(law_s, 2), "flex": round(flex_s, 2)},
            **environment(),
        }


def _by_law(stiffness: float, load: float) -> tuple[float, float]:
    plan = Plan.from_boxes(
        "a", size_mm=[SIZE_MM] * 2, corner_mm=[(0, 0, 0), (0, 0, SIZE_MM[2])], mass_kg=[MASS_KG, load]
    )
    sim = Simulation()
    scene = build_scene(replace(plan, stiffness_n_mm=np.array([stiffness, np.nan])), sim)
    begin = time.process_time()
    (outcome,) = MujocoEngine(1).run([Job(scene)], sim)
    return 1e3 * float(scene.target[1, 2] - outcome.boxes.pos[1, 2]), time.process_time() - begin


def _as_flex(stiffness: float, load: float) -> tuple[float, float]:
    length, width, height = (each / 1e3 for each in SIZE_MM)
    young = 1e3 * stiffness * height / (length * width)
    contact = 'solref="0.004 1" solimp="0.9999 0.9999 0.0001"'
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="0.001" solver="CG" integrator="discrete"/><worldbody>
          <geom type="plane" size="2 2 0.1"/>
          <flexcomp name="box" type="grid" dim="3" count="3 3 3" spacing="{length / 2} {width / 2} {height / 2}"
                    radius="0.0001" mass="{MASS_KG}" pos="0 0 {height / 2 + 0.0001}">
            <contact selfcollide="none" {contact}/><elasticity young="{young}" poisson="0" damping="0.02"/>
          </flexcomp>
          <body name="load" pos="0 0 {height + 0.0102}"><freejoint/>
            <geom type="box" size="{length / 2} {width / 2} 0.01" mass="{load}" {contact}/>
          </body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    begin = time.process_time()
    mujoco.mj_step(model, data, nstep=round(SECONDS / model.opt.timestep))
    return 1e3 * (height + 0.0102 - float(data.body("load").xpos[2])), time.process_time() - begin
