"""Tests of how supports share the load of a box. Supports can only push. A load counts as beyond an edge only if
vertical forces cannot balance the boxes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog, nnls
from support.plan_edges import plan_edges
from support.plans import Box, make_scene

import petmjx
from petmjx.common.units import FloatArray
from petmjx.options.simulation import Simulation
from petmjx.world import building_edges as building_edges_module
from petmjx.world.building_edges import building_edges, building_loads_of
from petmjx.world.history import CARRIER
from petmjx.world.pushing_forces import on_edges, pulls, pushes
from petmjx.world.rectangle_hulls import hull_table
from petmjx.world.scene import Scene, build_scene
from petmjx.world.supports import bearing_of, bearings_of

EXACT = Simulation(size_reduction_mm=0.0)
MM = 1e-3
CASES = Path(__file__).parents[3] / "shared/cases"

N_PILES = 60


def scene_of(*boxes: Box) -> Scene:
    return make_scene(boxes, EXACT)


def bridging_pile(rng: np.random.Generator) -> Scene:
    """A random pile: rows of boxes with random lengths, masses and gaps, one row above the other. Most boxes lie on
    several boxes."""
    boxes: list[Box] = []
    below: list[tuple[float, float]] = [(0.0, 1100.0)]
    z = 0.0
    for _ in range(int(rng.integers(2, 5))):
        height, x, row = float(rng.choice([100, 150, 200])), 0.0, []
        while x < 1100:
            length = 10.0 * int(rng.integers(8, 45))
            if any(min(x + length, end) > max(x, begin) for begin, end in below):
                corner = (x, 100.0 + 10 * int(rng.integers(-6, 7)), z)
                boxes.append(((length, 300.0, height), corner, float(np.exp(rng.uniform(-1, 3.2)))))
                row.append((x, x + length))
            x += length + 10.0 * int(rng.integers(0, 12))
        if not row:
            break
        below, z = row, z + height
    return make_scene(boxes, EXACT)


def balances(scene: Scene, placed: int) -> bool:
    """Whether vertical pushing forces at the corners of contacts can balance the first ``placed`` boxes of a scene."""
    bearing = bearing_of(scene)
    n, c = scene.n_boxes, len(bearing.upper)
    force = np.zeros((n, 3, c, 4))
    x = np.stack([bearing.low[:, 0], bearing.high[:, 0], bearing.high[:, 0], bearing.low[:, 0]], axis=1)
    y = np.stack([bearing.low[:, 1], bearing.low[:, 1], bearing.high[:, 1], bearing.high[:, 1]], axis=1)
    for k, (upper, lower) in enumerate(zip(bearing.upper, bearing.lower, strict=True)):
        wrench = np.stack([np.ones(4), x[k], y[k]])
        force[upper, :, k] += wrench
        if lower != CARRIER:
            force[lower, :, k] -= wrench
    chosen = bearing.upper < placed
    matrix = force[:placed][:, :, chosen].reshape(3 * placed, -1)
    weights = bearing.weights[:placed, :3].ravel()
    return bool(linprog(np.zeros(matrix.shape[1]), A_eq=matrix, b_eq=weights, method="highs").status == 0)


PILES = [bridging_pile(np.random.default_rng(seed)) for seed in range(N_PILES)]


def test_a_load_is_beyond_an_edge_only_if_nothing_balances_the_boxes() -> None:
    """A load is beyond an edge only if no forces balance the boxes. The rule is checked with an independent linear
    programme over all forces, for 60 random piles, when they are complete and after each placement."""
    by_plan = plan_edges(PILES, [scene.n_boxes for scene in PILES])
    verdicts = [bool(np.nanmin(edges.by_load) >= 0) for edges in by_plan]
    assert verdicts == [balances(scene, scene.n_boxes) for scene in PILES]
    assert 0.2 * N_PILES < sum(verdicts) < 0.9 * N_PILES
    held = [edges for edges, stands in zip(by_plan, verdicts, strict=True) if stands]
    assert min(np.nanmin(edges.least) for edges in held) >= 0
    while_built = [
        least.edge_m >= 0 for least in building_edges(bearings_of(PILES), [scene.n_boxes for scene in PILES])
    ]
    assert while_built == [all(balances(scene, k) for k in range(1, scene.n_boxes + 1)) for scene in PILES]
    assert sum(while_built) < sum(verdicts)  # because some counterweights are placed too late


def test_the_least_edge_is_as_large_as_forces_allow() -> None:
    """The smallest distance from an edge is as large as forces allow. A beam lies on a light box and on another
    support. If supports were springs, 0.3 of the load would press on the light box, whose own centre is only 10 mm
    inside an edge. But the other support can carry the whole load."""
    boxes: tuple[Box, ...] = (
        ((400, 300, 200), (0, 0, 0), 10.0),
        ((200, 300, 100), (690, 0, 0), 5.0),
        ((200, 300, 100), (600, 0, 100), 0.5),
        ((800, 300, 50), (0, 0, 200), 1.0),
        ((400, 300, 200), (100, 0, 250), 20.0),
    )
    (edges,) = plan_edges([scene_of(*boxes)], [5])
    assert edges.by_weight[2] == pytest.approx(10 * MM)
    assert 0 < edges.by_load[2] <= 10 * MM + 1e-7
    assert np.nanmin(edges.by_load) > 5 * MM


def test_forces_push_with_the_least_energy() -> None:
    """The forces for 200 random loads on two to five areas balance the loads, and push within the areas. No other such
    forces have less energy, according to non-negative least squares over the corners of the areas."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        k = int(rng.integers(2, 6))
        low = rng.uniform(0, 0.6, (k, 2))
        high = low + rng.uniform(0.01, 0.3, (k, 2))
        x = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1)
        y = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1)
        share = rng.dirichlet(np.full(4 * k, 0.3))
        load = 5.0 * np.array([1.0, share @ x.ravel(), share @ y.ravel()])
        force = pushes(load[None], np.zeros(k, int), low, high)
        np.testing.assert_allclose(force.sum(axis=0), load, atol=1e-7)
        assert not pulls(force, low, high, np.full(k, 5.0)).any()
        root = np.zeros((k, 3, 3))  # matrices that turn a force and its moments into numbers whose squares are energies
        middle, half, area = (low + high) / 2, (high - low) / 2, (high - low).prod(axis=1)
        root[:, 0, 0] = 1.0
        for axis in range(2):
            root[:, 1 + axis, 0] = -np.sqrt(3) * middle[:, axis] / half[:, axis]
            root[:, 1 + axis, 1 + axis] = np.sqrt(3) / half[:, axis]
        root /= np.sqrt(area)[:, None, None]
        corner = np.stack([np.ones((k, 4)), x, y], axis=1)
        energy = np.zeros((k, 3, k, 4))
        energy[np.arange(k), :, np.arange(k)] = root @ corner
        balance = corner.transpose(1, 0, 2).reshape(3, -1)
        weight = 1e5  # weight of the equations of balance, relative to the energy
        least, _ = nnls(
            np.concatenate([weight * balance, energy.reshape(3 * k, -1)]), np.r_[weight * load, np.zeros(3 * k)]
        )
        expected = ((energy.reshape(3 * k, -1) @ least) ** 2).sum()
        assert (np.einsum("cij,cj->ci", root, force) ** 2).sum() == pytest.approx(expected, rel=1e-3)


def test_where_no_support_pulls_the_pressure_is_a_plane() -> None:
    """If no support pulls, the pressure is linear. A beam on two equal posts is loaded at a third of its length: both
    computations give the forces of the lever rule."""
    low, high = np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([[0.1, 0.2], [0.6, 0.2]])
    plane = bearing_of(
        scene_of(
            ((100, 200, 100), (0, 0, 0), 1.0), ((100, 200, 100), (500, 0, 0), 1.0), ((600, 200, 50), (0, 0, 100), 6.0)
        )
    )
    load = np.array([9.0, 9.0 * 0.25, 9.0 * 0.1])
    contacts = np.flatnonzero(plane.upper == 2)
    shared = plane.shared(contacts, np.tile(load, (2, 1)))
    np.testing.assert_allclose(pushes(load[None], np.zeros(2, int), low, high), shared, atol=1e-9)
    assert shared[0, 0] + shared[1, 0] == pytest.approx(9.0)


def test_what_is_beyond_the_edge_is_borne_by_the_edge() -> None:
    """A load acts beyond the far ends of two areas. The two far corners share the load by the lever rule along the edge
    between them."""
    low, high = np.array([[0.0, 0.0], [0.2, 0.3]]), np.array([[0.5, 0.1], [0.5, 0.4]])
    load = np.array([[4.0, 4.0 * 0.7, 4.0 * 0.1]])
    force = on_edges(load, np.zeros(2, int), low, high, hull_table(low, high, np.array([2])), np.array([0]))
    np.testing.assert_allclose(force, [[3.0, 3.0 * 0.5, 0.0], [1.0, 0.5, 0.4]], atol=1e-12)


def test_loads_after_placements_are_those_of_the_plan_so_far() -> None:
    """The load of each box after each placement is that in a plan of the boxes placed so far. The loads are checked for
    ten piles, with and without supports that would have to pull."""
    for scene in PILES[:10]:
        bearing, n = bearing_of(scene), scene.n_boxes
        built = building_loads_of(bearing, [n])
        for step in range(n):
            pairs = built.step == step
            expected = bearing.loads(step + 1)[built.box[pairs], :3]
            np.testing.assert_allclose(built.load[pairs], expected, rtol=0, atol=1e-9)


def test_a_support_that_comes_later_bears_nothing_before() -> None:
    """The second support of a bridge is placed last, so it carries nothing before. Until then, the bridge overhangs."""
    bridge: tuple[Box, ...] = (
        ((200, 300, 200), (0, 0, 0), 5.0),
        ((600, 300, 200), (0, 0, 200), 8.0),
        ((200, 300, 200), (400, 0, 0), 5.0),
    )
    (late,) = building_edges(bearing_of(scene_of(*bridge)), [3])
    assert (late.edge_m, late.box, late.step) == (pytest.approx(-100 * MM), 1, 1)
    (in_time,) = building_edges(bearing_of(scene_of(bridge[0], bridge[2], bridge[1])), [3])
    assert in_time.edge_m == pytest.approx(100 * MM)


def test_a_load_on_an_edge_hides_none_beyond() -> None:
    """Three piles stand side by side. The upper box of the first pile is exactly on the edge. The other piles are long
    boxes, which overhang and bear one end of a beam. If supports were springs, both long boxes would tip. For the first
    of these piles, the support at the other end of the beam can bear enough. For the second, which comes last, it
    cannot."""

    def beam_on_overhang(y: float, begin: float, length: float, mass_kg: float) -> tuple[Box, ...]:
        return (
            ((400, 200, 100), (0, y, 0), 9.0),
            ((100, 200, 200), (900, y, 0), 9.0),
            ((700, 200, 100), (0, y, 100), 1.0),
            ((length, 200, 50), (begin, y, 200), mass_kg),
        )

    on_edge: tuple[Box, ...] = (((500, 200, 100), (0, 500, 0), 9.0), ((500, 200, 100), (250, 500, 100), 1.0))
    held, tips = beam_on_overhang(0, 600, 400, 0.7), beam_on_overhang(250, 690, 220, 0.4)
    (stands,) = building_edges(bearing_of(scene_of(*on_edge, *held)), [6])
    assert stands.edge_m == 0
    (least,) = building_edges(bearing_of(scene_of(*on_edge, *held, *tips)), [10])
    # 10/21 of the beam presses at 690 mm
    expected_mm = 400 - (350 + 690 * 0.4 * 10 / 21) / (1 + 0.4 * 10 / 21)
    assert (least.edge_m, least.box, least.step) == (pytest.approx(expected_mm * MM), 8, 9)


def test_without_a_programme_nothing_is_said_to_be_beyond(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = next(scene for scene in PILES if np.nanmin(plan_edges([scene], [scene.n_boxes])[0].by_load) >= 0)
    monkeypatch.setattr(building_edges_module, "MOST_PROGRAMMES", 0)
    (least,) = building_edges(bearing_of(scene), [scene.n_boxes])
    assert not least.edge_m < 0


@pytest.mark.skipif(not CASES.is_dir(), reason="needs ../shared/cases")
def test_the_light_box_under_a_heavy_one_keeps_its_edge() -> None:
    """If supports were springs, they would lift the light box under a heavy box. No load of the plan is nearer to an
    edge than 19.95 mm."""
    for name, expected_mm in (("edge_springs_pull.csv", {"pull": 19.95}), ("edge_hidden.csv", {"both": 0.25})):
        for plan in petmjx.load_plans(CASES / name).plans:
            scene = build_scene(plan, Simulation())
            (edges,) = plan_edges([scene], [scene.n_boxes])
            if plan.plan_id in expected_mm:
                assert np.nanmin(edges.least) == pytest.approx(expected_mm[plan.plan_id] * MM, abs=1e-9)


def test_edges_do_not_depend_on_the_unit_of_mass() -> None:
    """If all masses are a thousand times as large, the distances from edges are the same."""
    for scene in PILES[:10]:
        heavier = replace(scene, mass=scene.mass * 1000)
        light, heavy = (plan_edges([pile], [scene.n_boxes])[0].by_load for pile in (scene, heavier))
        same_sign(light, heavy)


def same_sign(one: FloatArray, other: FloatArray) -> None:
    np.testing.assert_allclose(one, other, atol=1e-6)
