"""How resting pallets drift: each box's speed long after the last placement, and the cause.

A pallet that stands should rest. If its boxes still move long after the last placement, the cause is the model of
contacts, and a verdict may depend on the time of observation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.mujoco.box_motion import tilt_deg
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.live_world import BodyState, LiveWorld
from petmjx.engines.mujoco.top_forces import VERTICAL_COSINE, contact_normal_and_tangents
from petmjx.engines.mujoco.world_run import SettledState
from petmjx.engines.verdict import Verdict
from petmjx.options.physics import PHYSICS, Cone
from petmjx.options.simulation import LONGEST_S, Check, Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

LOOK_STEPS = 20
"""Number of steps between two looks at the contacts."""

SHORTEST_S = 0.1
"""Shortest window, s. With the timestep of any variant, such a window has several looks."""

COMES_AND_GOES = 0.02
"""A box whose number of contacts changes in more than this share of the looks has contacts that come and go."""

PUSHED = 0.02
"""A box is pushed if the horizontal contact forces at its sides exceed this share of its weight."""

ASKEW_DEG = 0.05
"""A box that leans by more than this angle stands on supports of different height: 0.3 mm over 400 mm."""

SLIDES = 0.95
"""A box whose contacts use more than this share of the friction that they have slides by Coulomb's law."""

MOVES_UM_S = 0.5
"""Boxes slower than this speed count as resting. At this speed, a box moves by 0.06 mm in two minutes."""

AS_PRESSURE = {"solreffriction": (0.0, 0.0)}
"""Friction with the time constant of contacts."""

OLD = {"solref": (0.02, 1.0), "solimp": (0.99, 0.99, 0.01), "impratio": 1.0, "skin_m": 0.0, **AS_PRESSURE}
"""Contacts of MuJoCo's constant impedance, as ``pallet`` had them in petmjx 0.1."""

VARIANTS: dict[str, Simulation] = {
    "pallet": Simulation(),
    "no skin": Simulation(physics={"name": "pallet", "skin_m": 0.0}),
    "friction as damped as pressure (time constant 20 ms)": Simulation(physics={"name": "pallet", **AS_PRESSURE}),
    "friction as soft as pressure (impratio 1)": Simulation(physics={"name": "pallet", "impratio": 1.0}),
    "hard onset (impedance 0.999 throughout)": Simulation(physics={"name": "pallet", "solimp": (0.999, 0.999, 0.0001)}),
    "softer contacts (impedance up to 0.99)": Simulation(physics={"name": "pallet", "solimp": (0.1, 0.99, 0.0001)}),
    "critically damped (damping ratio 1)": Simulation(physics={"name": "pallet", "solref": (0.02, 1.0)}),
    "overdamped (damping ratio 2)": Simulation(physics={"name": "pallet", "solref": (0.02, 2.0)}),
    "timestep 1 ms": Simulation(physics={"name": "pallet", "timestep_s": 0.001}),
    "gaps of 1 mm between neighbours": Simulation(size_reduction_mm=1.0),
    "petmjx 0.1": Simulation(physics={"name": "pallet", **OLD}),
    "petmjx 0.1, impratio 10": Simulation(physics={"name": "pallet", **OLD, "impratio": 10.0}),
    "reference": Simulation(physics=PHYSICS["reference"]),
}
"""Name of a variant → its options. Each variant changes one cause of drift."""


@dataclass(frozen=True)
class Window:
    """The time in which drift is measured: from ``begin_s`` to ``end_s`` after the pallet has settled, s."""

    begin_s: float = 10.0
    end_s: float = 60.0

    def __post_init__(self) -> None:
        if not 0 <= self.begin_s < self.begin_s + SHORTEST_S <= self.end_s <= LONGEST_S:
            at = f"got {self.begin_s:g} s to {self.end_s:g} s"
            raise InputError(
                f"drift is measured from 0 s on, for {SHORTEST_S:g} s at least, to {LONGEST_S:g} s at most, {at}"
            )


def drift_table(plans: Sequence[Plan], sim: Simulation, window: Window, threads: int) -> pd.DataFrame:
    """One row for each box of the plans that stand.

    Columns: plan_id, box; drift_um_s (distance between the two poses / time), vertical_um_s (its vertical part),
    rms_um_s (root mean square of the speed), changes (share of the looks with a changed number of contacts), pushed
    (horizontal force at its sides / weight), askew_deg (tilt), used (share of the friction that its contacts have),
    cause.
    """
    with ThreadPoolExecutor(threads) as pool:
        tables = pool.map(partial(_of_plan, sim=sim, window=window), plans)
        rows = [row for table in tables for row in table]
    return pd.DataFrame(rows)


def _of_plan(plan: Plan, sim: Simulation, window: Window) -> list[dict[str, Any]]:
    scene = build_scene(plan, sim)
    (outcome,) = MujocoEngine(1).run([Job(scene, keep_state=True)], sim)
    if outcome.verdict is not Verdict.STABLE or not isinstance(outcome.state, SettledState):
        return []
    bodies = outcome.state.bodies
    if not isinstance(bodies, BodyState):
        return []
    live = LiveWorld.resume(scene, sim, bodies, 0.0)
    dt = sim.physics.timestep_s
    live.step(seconds_to_steps(window.begin_s, dt))
    before = live.pose[:, :3].copy()
    looks = seconds_to_steps(window.end_s - window.begin_s, dt) // LOOK_STEPS
    squares, changes = np.zeros(len(before)), np.zeros(len(before))
    pushed, used = np.zeros(len(before)), np.zeros(len(before))
    last = _contacts(live)
    for look in range(looks):
        live.step(LOOK_STEPS)
        now = _contacts(live)
        changes += now != last
        last = now
        squares += (live.velocity[:, :3] ** 2).sum(axis=1)
        if look % max(looks // 20, 1) == 0:
            side, share = _loads(live, sim)
            pushed, used = np.maximum(pushed, side), np.maximum(used, share)
    seconds = looks * LOOK_STEPS * dt
    moved = live.pose[:, :3] - before
    pushed /= scene.mass * sim.physics.gravity_m_s2
    askew = tilt_deg(live.pose[:, 3:])
    rows: list[dict[str, Any]] = []
    for box in range(len(before)):
        row = {
            "plan_id": plan.plan_id,
            "box": box,
            "drift_um_s": float(np.linalg.norm(moved[box])) / seconds * 1e6,
            "vertical_um_s": abs(float(moved[box, 2])) / seconds * 1e6,
            "rms_um_s": float(np.sqrt(squares[box] / looks)) * 1e6,
            "changes": float(changes[box]) / looks,
            "pushed": float(pushed[box]),
            "askew_deg": float(askew[box]),
            "used": float(used[box]),
        }
        rows.append(row | {"cause": cause(row)})
    return rows


def cause(seen: Mapping[str, Any]) -> str:
    """The cause of a box's motion: the first cause of the list that fits the measured values."""
    if seen["drift_um_s"] < MOVES_UM_S:
        return "rests"
    if seen["vertical_um_s"] > 0.5 * seen["drift_um_s"]:
        return "sinks or tips"
    if seen["used"] > SLIDES:
        return "slides: a contact has no friction left"
    if seen["changes"] > COMES_AND_GOES:
        return "contacts come and go"
    if seen["pushed"] > PUSHED:
        return "a neighbour pushes"
    if seen["askew_deg"] > ASKEW_DEG:
        return "stands askew"
    return "friction gives way"


def _contacts(live: LiveWorld) -> FloatArray:
    """(n,) number of contacts of each box."""
    bodies = live.geom_bodies[np.reshape(live.data.contact.geom, -1)]
    return np.bincount(bodies[bodies >= 0], minlength=live.capacity).astype(float)


def _loads(live: LiveWorld, sim: Simulation) -> tuple[FloatArray, FloatArray]:
    """(n,) horizontal force at each box's sides, N, and (n,) the largest share of friction used among the contacts that
    bear a hundredth of its weight or more."""
    data = live.data
    index, force = contact_normal_and_tangents(data, sim.physics.cone is Cone.PYRAMIDAL)
    bodies = live.geom_bodies[np.asarray(data.contact.geom)[index]]
    vertical = np.abs(np.asarray(data.contact.frame)[index, 2]) >= VERTICAL_COSINE
    friction = np.asarray(data.contact.friction)[index, 0]
    tangent = np.linalg.norm(force[:, 1:], axis=1)
    share = tangent / np.maximum(friction * force[:, 0], 1e-12)
    side, used = np.zeros(live.scene.n_boxes), np.zeros(live.scene.n_boxes)
    weight = live.scene.mass * sim.physics.gravity_m_s2
    for part in range(2):
        here = bodies[:, part] >= 0
        boxes = bodies[here, part]
        np.add.at(side, boxes, np.where(vertical[here], 0.0, force[here, 0]))
        bears = vertical[here] & (force[here, 0] > 0.01 * weight[boxes])
        np.maximum.at(used, boxes, np.where(bears, share[here], 0.0))
    return side, used


def summaries(
    plans: Sequence[Plan], names: Sequence[str], window: Window, threads: int
) -> Iterator[tuple[str, Check, pd.DataFrame]]:
    """Yield the table of each variant, for each check: boxes stand from the start, or are placed one by one."""
    for name in names:
        for check in Check:
            yield name, check, drift_table(plans, VARIANTS[name].changed(check=check), window, threads)


def describe(table: pd.DataFrame) -> str:
    """One line that summarises a table."""
    if table.empty:
        return "no plan stands"
    drift = table.drift_um_s
    shares = table.cause.value_counts(normalize=True)
    causes = ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
    size = f"{count_text(table.plan_id.nunique(), 'plan')}, {count_text(len(table), 'box', 'boxes')}"
    return (
        f"{size}: median {drift.median():.3f}, 99 % {drift.quantile(0.99):.2f}, largest {drift.max():.1f} µm/s, "
        f"{(drift > 50).sum()} above 50; {causes}"
    )
