"""Tests of the order of bodies in models of the engine ``mujoco``. The order reduces the fill-in of a factorisation;
results are always in packing order."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.plans import CARTON_MM, Box, make_scene

from petmjx.engines.mujoco.elimination_order import body_order, minimum_degree
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene

NO_CONTACTS = np.zeros((0, 2), dtype=int)


def joined(n: int, edges: list[tuple[int, int]]) -> NDArray[np.bool_]:
    matrix = np.zeros((n, n), dtype=bool)
    for a, b in edges:
        matrix[a, b] = matrix[b, a] = True
    return matrix


def blocks(matrix: NDArray[np.bool_], order: list[int]) -> int:
    """Number of non-zero blocks of the factor, including the diagonal, computed by elimination on a matrix."""
    left, count = matrix.copy(), 0
    for node in order:
        clique = np.flatnonzero(left[node])
        count += 1 + len(clique)
        left[np.ix_(clique, clique)] = True
        left[node] = left[:, node] = False
        np.fill_diagonal(left, val=False)
    return count


def wall(columns: int, levels: int) -> Scene:
    """A scene with a wall of cartons, placed level after level."""
    x, _, z = CARTON_MM
    boxes: list[Box] = [(CARTON_MM, (x * i, 0.0, z * k), 5.0) for k in range(levels) for i in range(columns)]
    return make_scene(boxes)


def test_a_tree_is_eliminated_without_fill_in() -> None:
    star = joined(5, [(0, 1), (0, 2), (0, 3), (0, 4)])
    assert minimum_degree(star) == [1, 2, 3, 0, 4]
    assert blocks(star, minimum_degree(star)) == 5 + 4
    assert blocks(star, [0, 1, 2, 3, 4]) == 5 + 4 + 3 + 2 + 1
    chain = joined(6, [(k, k + 1) for k in range(5)])
    assert blocks(chain, minimum_degree(chain)) == 6 + 5
    assert minimum_degree(joined(0, [])) == []
    assert minimum_degree(np.ones((2, 2), dtype=bool)) == [0, 1]


def test_a_grid_has_less_fill_in_than_in_its_own_order() -> None:
    n = 9
    edges = [(n * i + j, n * i + j + 1) for i in range(n) for j in range(n - 1)]
    edges += [(n * i + j, n * i + j + n) for i in range(n - 1) for j in range(n)]
    grid = joined(n * n, edges)
    order = minimum_degree(grid)
    assert sorted(order) == list(range(n * n))
    assert blocks(grid, order) < 0.7 * blocks(grid, list(range(n * n)))


def test_boxes_beside_each_other_count_where_they_touch_or_will() -> None:
    scene = wall(3, 1)
    # without contacts, all bodies are equal: the lowest number is eliminated first, and is therefore the last body
    assert body_order(scene, 3, NO_CONTACTS, shaken=False).tolist() == [2, 1, 0]
    # in a row of three boxes, the ends are eliminated first
    assert body_order(scene, 3, NO_CONTACTS, shaken=True).tolist() == [2, 1, 0]
    # bodies 1 and 2 touch only body 0: of these two, body 1 has the lower number and is eliminated first
    assert body_order(scene, 3, np.array([[0, 1], [2, 0]]), shaken=False).tolist() == [2, 0, 1]
    assert body_order(wall(2, 2), 3, NO_CONTACTS, shaken=False).tolist() == [2, 0, 1]


@pytest.mark.parametrize(
    ("physics", "ordered_from", "packing_order"),
    [("pallet", 12, False), ("pallet", 13, True), ("reference", 12, True)],
)
def test_rows_are_in_packing_order_whatever_the_order_of_bodies(
    physics: str, ordered_from: int, packing_order: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("petmjx.engines.mujoco.live_world.ORDERED_FROM", ordered_from)
    sim = Simulation(physics=PHYSICS[physics])
    scene = wall(4, 3)
    live = LiveWorld(scene, sim)
    for box in range(scene.n_boxes):
        live.place_next()
        np.testing.assert_array_equal(live.pose[box, :2], scene.start_pos[box, :2])
        assert abs(live.pose[box, 2] - live.release.pos[box, 2]) < 0.001  # supports have sunk a little
        live.step(30)
    assert (live.order.tolist() == list(range(12))) is packing_order
    names = [live.model.body(body).name for body in range(live.model.nbody)]
    assert [name for name in names if name.startswith("box_")] == [f"box_{box}" for box in live.order]
    live.step(200)
    np.testing.assert_allclose(live.pose[:, :3], scene.target, atol=0.005)
    assert np.abs(live.velocity).max() < 0.05
    pos, quat = live.sampled_pose()
    np.testing.assert_allclose(pos, scene.target, atol=0.005)
    assert quat.shape == (12, 4)
    # each level carries the levels above
    np.testing.assert_allclose(
        live.top_forces().reshape(3, 4), np.outer([2, 1, 0], [5 * 9.81] * 4), rtol=0.02, atol=0.5
    )
    state = live.body_state()
    np.testing.assert_array_equal(state.pose[1:], live.pose)
    again = LiveWorld.resume(scene, sim, state, 0.0)
    np.testing.assert_array_equal(again.pose, live.pose)
    np.testing.assert_array_equal(again.velocity, live.velocity)
    np.testing.assert_array_equal(again.body_state().warmstart, state.warmstart)


@pytest.mark.parametrize("ordered_from", [1, 100])
def test_a_world_that_grows_keeps_its_state_to_the_last_bit(ordered_from: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.mujoco.live_world.ORDERED_FROM", ordered_from)
    scene = wall(5, 2)
    live = LiveWorld(scene, Simulation())
    for _ in range(8):
        live.place_next()
        live.step(20)
    before = live.body_state()
    assert live.capacity == 8
    live.place_next()
    assert live.capacity == 10
    after = live.body_state()
    for name in ("pose", "velocity", "warmstart"):
        np.testing.assert_array_equal(getattr(after, name)[:9], getattr(before, name))
    # the ninth box is at its place; the tenth box is not placed yet, and hangs far away
    assert abs(live.pose[8, 2] - live.release.pos[8, 2]) < 0.001
    assert live.pose[9, 2] > 10
