"""Compares boxes that give with MuJoCo's soft bodies: how deep loads sink into cartons, and which stacks stand.

``compared``: a load on one carton, by closed form, by the contact law, as a soft box of petmjx (``--soft``: edges held
by equality), and as a bare flex of 3 × 3 × 3 points with linear elasticity, which petmjx does not use (Young's modulus
k·h / A, so that between two plates it is a spring of the stiffness k). ``stacks``, ``piles``: two to five boxes by the
law and as soft boxes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from benchmarks.result_fields import environment
from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

SIZE_MM: Final = (400.0, 300.0, 200.0)
MASS_KG: Final = 10.0
CASES: Final = ((20.0, 20.0), (50.0, 20.0), (100.0, 50.0), (200.0, 50.0))
"""Pairs of the stiffness of a carton, N/mm, and the load on its top, kg."""

SECONDS: Final = 2.0
"""Simulated time, s, after which the boxes of both kinds rest."""


class Stack(NamedTuple):
    """A stack of boxes of the size ``SIZE_MM``.

    Attributes:
        mass_kg: masses of the boxes, from the lowest box up.
        aside_mm: distance of each box from the lowest box along x.
        stiffness_n_mm: stiffness of each box; NaN for rigid boxes.
        stands: whether the stack stands if its boxes are rigid.
    """

    mass_kg: tuple[float, ...]
    aside_mm: tuple[float, ...]
    stiffness_n_mm: tuple[float, ...]
    stands: bool = True

    @property
    def plan(self) -> Plan:
        places = [(aside, 0.0, SIZE_MM[2] * level) for level, aside in enumerate(self.aside_mm)]
        plan = Plan.from_boxes("a", size_mm=[SIZE_MM] * len(places), corner_mm=places, mass_kg=list(self.mass_kg))
        return replace(plan, stiffness_n_mm=np.array(self.stiffness_n_mm))


RIGID: Final = float("nan")
STACKS: Final = {
    "light under heavy": Stack((2, 50), (0, 0), (100, RIGID)),
    "heavy under light": Stack((50, 2), (0, 0), (100, 100)),
    "five": Stack((10,) * 5, (0,) * 5, (100,) * 5),
    "five under 40 kg": Stack((10,) * 4 + (40,), (0,) * 5, (100,) * 4 + (RIGID,)),
    "100 mm aside": Stack((10, 10), (0, 100), (100, 100)),
    "180 mm aside": Stack((10, 10), (0, 180), (200, 200)),
    "180 mm aside, soft": Stack((10, 10), (0, 180), (20, 20)),
    "210 mm aside": Stack((10, 10), (0, 210), (200, 200), stands=False),
    "stairs of 60 mm": Stack((10,) * 4, (0, 60, 120, 180), (100,) * 4),
    "stairs of 110 mm": Stack((10,) * 4, (0, 110, 220, 330), (100,) * 4, stands=False),
}
"""Stacks by name. A rigid box topples if the common centre of mass of all boxes above it is beyond its edge: more than
200 mm aside, or, for stairs of four boxes, more than 100 mm from box to box."""


def stacks() -> Iterator[dict[str, Any]]:
    """A line for each stack: descent and lean of the highest box, and whether the stack stands, in both ways."""
    for name, stack in STACKS.items():
        load = np.cumsum(stack.mass_kg[::-1])[::-1] - np.array(stack.mass_kg)
        give = (load + np.array(stack.mass_kg) / 2) / np.array(stack.stiffness_n_mm)
        spring = STANDARD_GRAVITY * float(np.nansum(give[:-1] if np.isnan(give[-1]) else give))
        rows: dict[str, Any] = {}
        for way, soft in (("law", False), ("soft", True)):
            outcome, seconds = _simulated(stack.plan, soft)
            down = 1e3 * float(SIZE_MM[2] / 1e3 * (len(load) - 0.5) - outcome.boxes.pos[-1, 2])
            rows[way] = {
                "verdict": str(outcome.verdict),
                "down_mm": round(down, 3),
                "tilt_deg": round(float(outcome.boxes.max_tilt_deg[-1]), 3),
                "force_n": round(float(outcome.boxes.max_top_force_n[0]), 1),
                "steps": outcome.n_steps,
                "cpu_s": round(seconds, 2),
            }
        centred = not any(stack.aside_mm)
        yield {
            "case": "soft-stack",
            "group": "flex",
            "stack": name,
            "spring_top_mm": round(spring, 3) if centred else None,
            "stands_rigid": stack.stands,
            **rows,
            **environment(),
        }


PILES: Final = 24
SEED: Final = 7


def piles() -> dict[str, Any]:
    """A line about random piles of two to four boxes, in which each box is shifted by up to 35 % of its length: in how
    many piles both methods have the same verdict."""
    rng = np.random.default_rng(SEED)
    seconds = np.zeros(2)
    verdicts: list[list[Verdict]] = []
    for _ in range(PILES):
        count = int(rng.integers(2, 5))
        size = np.column_stack([10.0 * rng.integers(low, high, count) for low, high in ((20, 45), (20, 35), (10, 25))])
        corner = np.zeros((count, 3))
        corner[1:, 0] = np.cumsum(rng.uniform(-0.35, 0.35, count - 1) * size[1:, 0])
        corner[1:, 2] = np.cumsum(size[:-1, 2])
        plan = Plan.from_boxes("a", size_mm=size, corner_mm=corner, mass_kg=rng.uniform(2, 15, count))
        plan = replace(plan, stiffness_n_mm=rng.choice([30.0, 60.0, 100.0, 200.0], count))
        both = [_simulated(plan, soft) for soft in (False, True)]
        verdicts.append([outcome.verdict for outcome, _ in both])
        seconds += [time_s for _, time_s in both]
    return {
        "case": "soft-piles",
        "group": "flex",
        "piles": PILES,
        "stand": {way: sum(pair[k] is Verdict.STABLE for pair in verdicts) for k, way in enumerate(("law", "soft"))},
        "agree": sum(law is soft for law, soft in verdicts),
        "cpu_s": dict(zip(("law", "soft"), seconds.round(1).tolist(), strict=True)),
        **environment(),
    }


def _simulated(plan: Plan, soft: bool) -> tuple[Outcome, float]:
    sim = Simulation(soft=soft)
    begin = time.process_time()
    (outcome,) = MujocoEngine(1).run([Job(build_scene(plan, sim))], sim)
    return outcome, time.process_time() - begin


def compared() -> Iterator[dict[str, Any]]:
    """Yield a line for each case: the depth by which the load sinks in, mm."""
    for stiffness, load in CASES:
        spring = (load + MASS_KG / 2) * STANDARD_GRAVITY / stiffness
        plan = Stack((MASS_KG, load), (0, 0), (stiffness, RIGID)).plan
        (law, law_s), (soft, soft_s) = _simulated(plan, False), _simulated(plan, True)
        flex, flex_s = _as_flex(stiffness, load)
        yield {
            "case": "flex",
            "group": "flex",
            "stiffness_n_mm": stiffness,
            "load_kg": load,
            "spring_mm": round(spring, 3),
            "law_mm": round(1.5e3 * SIZE_MM[2] / 1e3 - 1e3 * float(law.boxes.pos[1, 2]), 3),
            "soft_mm": round(1.5e3 * SIZE_MM[2] / 1e3 - 1e3 * float(soft.boxes.pos[1, 2]), 3),
            "flex_mm": round(flex, 3),
            "cpu_s": {"law": round(law_s, 2), "soft": round(soft_s, 2), "flex": round(flex_s, 2)},
            **environment(),
        }


def _as_flex(stiffness: float, load: float) -> tuple[float, float]:
    length, width, height = (side / 1e3 for side in SIZE_MM)
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
