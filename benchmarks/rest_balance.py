"""Checks by statics, without a simulation, whether the boxes of stable worlds are in balance where they came to
rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.analysis.force_balance import WRENCH, wrenches
from petmjx.analysis.force_intervals import find_touch_points
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Flag, Verdict
from petmjx.options.physics import Physics
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.results.run_reader import RunResults
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene, build_scene

BALANCED: Final = 0.01
"""A world is in balance if at most this share of a box's weight stays unbalanced. The limit is not 0, since poses at
rest are kept in float32, and contacts are a tenth of a millimetre deep."""

_EDGES: Final = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""Signs of the two tangents along the edges of a pyramid inside the cone of friction."""


def left_over(scene: Scene, physics: Physics, pos: FloatArray, quat: FloatArray) -> float:
    """How far the boxes are from balance. The function searches for the forces at the contact points that balance the
    boxes best; forces can only press, and friction must be within the cone. The result is the largest force that
    remains on a box, as a share of the box's weight. Moments count as forces at half the box's shorter side.

    Args:
        pos, quat: (n, 3) centres, m, and (n, 4) orientations (w, x, y, z).
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csc_array, hstack, vstack

    touching = find_touch_points(scene, physics, pos, quat)
    direction = touching.frame[:, :1] + np.einsum("ks,ps,psx->pkx", _EDGES, touching.friction, touching.frame[:, 1:])
    first, second = (np.where(ends == CARRIER, -1, ends) for ends in (touching.first, touching.second))
    forces = wrenches(first, second, touching.position_m, direction, pos)
    weight = scene.mass * physics.gravity_m_s2
    arm = scene.half_size[:, :2].min(axis=1)
    scale = np.c_[np.tile(1 / weight, (3, 1)).T, np.tile(1 / (weight * arm), (3, 1)).T].ravel()
    rows, n_forces = len(scale), direction.shape[0] * direction.shape[1]
    # forces are in units of the mean weight, which suits the solver's tolerances
    share = weight.mean() * forces.value * scale[forces.row]
    matrix = csc_array((share, (forces.row, forces.column)), shape=(rows, n_forces))
    wanted = np.zeros((len(weight), WRENCH))
    wanted[:, 2] = 1.0
    # −s ≤ matrix @ g − wanted ≤ s, with one s for all rows
    both = vstack([hstack([matrix, -np.ones((rows, 1))]), hstack([-matrix, -np.ones((rows, 1))])])
    costs = np.r_[np.zeros(n_forces), 1.0]
    most = np.r_[wanted.ravel(), -wanted.ravel()]
    solution = milp(costs, constraints=LinearConstraint(both, -np.inf, most), bounds=Bounds(0, np.inf))
    return float("nan") if solution.x is None else float(solution.fun)


def balances(plans: Sequence[Plan], run: RunResults, sim: Simulation) -> pd.DataFrame:
    """A row for each stable world of a run without variants: ``left_over``, and whether it has the flag *moving*."""
    worlds = run.worlds[run.worlds["verdict"].astype(str) == Verdict.STABLE].set_index("plan_id")
    by_plan = {plan.plan_id: plan for plan in plans}
    boxes = dict(list(run.boxes.groupby("plan_id", observed=True)))
    return pd.DataFrame(_rows(worlds, boxes, by_plan, sim))


def _rows(
    worlds: pd.DataFrame, boxes: Mapping[Any, pd.DataFrame], plans: Mapping[str, Plan], sim: Simulation
) -> Iterator[dict[str, Any]]:
    for plan_id, world in worlds.iterrows():
        poses = boxes[plan_id].sort_values("box")
        pos = poses[["pos_x_m", "pos_y_m", "pos_z_m"]].to_numpy(float)
        quat = poses[["quat_w", "quat_x", "quat_y", "quat_z"]].to_numpy(float)
        scene = build_scene(plans[str(plan_id)], sim)
        moving = bool(int(world["flags"]) & Flag.MOVING)
        yield {"plan_id": plan_id, "left_over": left_over(scene, sim.physics, pos, quat), "moving": moving}


def summary(table: pd.DataFrame) -> dict[str, Any]:
    """The number of worlds in balance, and the worlds that are not in balance although they do not have the flag
    *moving*."""
    balanced = table["left_over"] <= BALANCED
    wrong = table[~balanced & ~table["moving"]]
    return {
        "stable": len(table),
        "balanced": int(balanced.sum()),
        "moving": int(table["moving"].sum()),
        "not_balanced": dict(zip(wrong["plan_id"], wrong["left_over"].round(4), strict=True)),
        "left_over": {f"{q:g}": float(table["left_over"].quantile(q)) for q in (0.5, 0.99, 1.0)},
    }
