"""``petmjx.jax``: pallets as pure functions, under jit and scan. The functions report what ``petmjx.Pallets``
reports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import petmjx
import petmjx.jax
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Reason, failures
from petmjx.jax.placement_arrays import REASONS, PlacementArrays
from petmjx.options.thresholds import Thresholds

pytestmark = pytest.mark.usefixtures("few_spare_worlds", "ranks_may_differ")

SIZE = np.array([[400, 300, 200], [300, 200, 250]], np.float32)
STEPS = np.array([[[0, 0, 0], [100, 100, 0]], [[0, 0, 200], [110, 100, 250]], [[260, 0, 400], [100, 110, 500]]], float)
"""(3, 2, 3) corners in mm of three boxes on each of two pallets. The third box on the first pallet falls."""
MASS = np.array([6.0, 3.0], np.float32)


def assert_told(report: PlacementArrays, expected: petmjx.PlacementResults, exactly: bool) -> None:
    close = {"rtol": 1e-6} if exactly else {"rtol": 2e-3, "atol": 2e-2}
    np.testing.assert_array_equal(report.stable, expected.stable)
    assert [REASONS[number] for number in report.reason] == expected.reason.tolist()
    np.testing.assert_array_equal(report.culprit, expected.culprit)
    np.testing.assert_array_equal(report.n_boxes, expected.n_boxes)
    stands, k = np.asarray(report.stable), expected.top_force_n.shape[1]
    np.testing.assert_allclose(report.margin[stands], expected.margin[stands], **close)
    forces = np.nan_to_num(expected.top_force_n)[stands]
    np.testing.assert_allclose(report.top_force_n[stands, :k], forces, **close)
    np.testing.assert_allclose(report.middle_mm[stands, :k], np.nan_to_num(expected.middle_mm)[stands], **close)


def check_program(
    engine: Any, steps: np.ndarray, candidates: tuple[np.ndarray, ...], most_boxes: int
) -> tuple[PlacementArrays, PlacementArrays]:
    """Compare a jitted program with ``petmjx.Pallets``.

    The program places boxes one after another on two pallets, and then tries candidates (places for a next box).
    """
    state = petmjx.jax.empty(2, engine=engine, most_boxes=most_boxes)

    @jax.jit
    def program(state: Any) -> Any:
        step = jax.lax.scan(lambda state, corner: petmjx.jax.place(state, SIZE, corner, MASS), state, jnp.array(steps))
        return step, petmjx.jax.try_all(step[0], *candidates)

    # arrays of NumPy, since JAX would compile each index
    (after, report), tried = jax.tree.map(np.asarray, program(state))
    pallets, exactly = petmjx.Pallets(2, engine=engine, most_boxes=most_boxes), engine == "mujoco"
    for number, corners in enumerate(steps):
        expected = pallets.place(size_mm=SIZE, corner_mm=corners, mass_kg=MASS)
        assert_told(jax.tree.map(lambda values, number=number: values[number], report), expected, exactly)
    size, corner, mass, which = candidates
    expected = pallets.try_all(size_mm=size, corner_mm=corner, mass_kg=mass, pallet=which)
    assert_told(tried, expected, exactly)
    (again, _), _ = program(state)
    for one, other in zip(jax.tree.leaves(after), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    return report, tried


def test_a_jitted_scan_places_as_pallets_do() -> None:
    corners, which = np.array([[100, 100, 750], [250, 100, 750], [600, 400, 0]], np.float32), np.array([1, 1, 1])
    report, tried = check_program("mujoco", STEPS, (SIZE[[1, 1, 0]], corners, MASS[[1, 1, 0]], which), 4)
    assert report.stable.tolist() == [[True, True], [True, True], [False, True]]
    assert tried.stable.tolist() == [True, False, True]


@pytest.mark.slow
def test_on_mjx_warp_the_kernel_runs_inside_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """A further reason is that a box bears more than 50 N. Of two boxes, one gets 59 N when a candidate is set down on
    it, and the other one 29 N."""
    pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    from support.tiny_worlds import engine

    def failures_with_load(boxes: Any, limits: Thresholds) -> Iterator[tuple[Reason, Any]]:
        yield from failures(boxes, limits)
        yield Reason.SINKING, boxes.max_top_force_n > 50.0

    for module in ("petmjx.engines.verdict", "petmjx.jax.device_pallets"):
        monkeypatch.setattr(f"{module}.failures", failures_with_load)
    corners = np.array([[0, 0, 200], [1100, 100, 0], [100, 100, 250]], np.float32)
    candidates = (SIZE[[0, 1, 1]], corners, MASS[[0, 1, 1]], np.array([0, 1, 1]))
    report, tried = check_program(engine(), STEPS[:1], candidates, 4)
    assert report.stable.tolist() == [[True, True]]
    assert tried.stable.tolist() == [False, False, True]
    assert [REASONS[number] for number in tried.reason] == ["sinking", "drop", ""]
    one = petmjx.jax.empty(1, engine=engine(), most_boxes=4)
    place = jax.jit(jax.vmap(lambda *box: petmjx.jax.place(one, *box)[1]))
    vmapped = jax.tree.map(np.asarray, place(SIZE[:, None], STEPS[0][:, None].astype(np.float32), MASS[:, None]))
    for ours, theirs in zip(jax.tree.leaves(vmapped), jax.tree.leaves(report), strict=True):
        np.testing.assert_array_equal(ours[:, 0], theirs[0])


def test_what_cannot_get_a_box_stays_as_it_is() -> None:
    state = petmjx.jax.empty(2, engine="mujoco", most_boxes=1)
    place = jax.jit(petmjx.jax.place)
    one, report = place(state, SIZE, STEPS[0], MASS, jnp.array([True, False]))
    assert (report.stable.tolist(), report.ended.tolist(), report.n_boxes.tolist()) == ([True] * 2, [False] * 2, [1, 0])
    two, report = place(one, SIZE, STEPS[1], MASS)  # the first pallet is full
    assert (report.stable[0], report.n_boxes.tolist()) == (True, [1, 1])
    gone, report = place(state, SIZE, np.array([[1100, 0, 0], [0, 0, 0]]), MASS)  # the box on the first pallet falls
    assert (report.ended.tolist(), REASONS[report.reason[0]]) == ([True, False], "drop")
    _, report = place(gone, SIZE, STEPS[0], MASS)
    assert (report.ended.tolist(), REASONS[report.reason[0]]) == ([True, False], "ended")
    tried = petmjx.jax.try_all(two, SIZE, STEPS[1], MASS, np.array([0, 7]))
    assert not tried.stable.any()
    assert state.n == 2


def test_settled_worlds_are_built_again_when_they_are_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.jax.host_pallets.KEPT_PER_PALLET", 2)
    monkeypatch.setattr("petmjx.jax.host_pallets.SPARE_WORLDS", 1)
    state = petmjx.jax.empty(2, engine="mujoco", most_boxes=4)
    place = jax.jit(petmjx.jax.place)
    first, report = place(state, SIZE, STEPS[0], MASS)
    second, expected = place(first, SIZE, STEPS[1], MASS)
    for shift in range(4):  # other pallets, which take all the memory for settled worlds
        place(state, SIZE, STEPS[0] + 10 * shift + 10, MASS)
    _, second_report = place(first, SIZE, STEPS[1], MASS)
    for one, other in zip(second_report, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    assert second.count.tolist() == [2, 2]
    assert report.stable.all()


def test_what_was_refused_leaves_nothing_behind() -> None:
    """If the mass for one pallet is wrong, the other pallet does not get its box either."""
    state = petmjx.jax.empty(2, engine="mujoco", most_boxes=3)
    for _ in range(2):
        with pytest.raises(Exception, match="mass_kg must be from"):
            jax.block_until_ready(jax.jit(petmjx.jax.place)(state, SIZE, STEPS[0], np.array([5.0, 0.0])))
    first, report = petmjx.jax.place(state, SIZE, STEPS[0], MASS)
    assert report.n_boxes.tolist() == [1, 1]
    _, report = petmjx.jax.place(first, SIZE, STEPS[1], MASS)
    assert (report.stable.tolist(), report.n_boxes.tolist()) == ([True, True], [2, 2])


def test_wrong_shapes_and_numbers_are_one_line() -> None:
    state = petmjx.jax.empty(2, engine="mujoco", most_boxes=2)
    for call, message in (
        (lambda: petmjx.jax.place(state, SIZE[:1], STEPS[0], MASS), r"size_mm must have the shape \(2, 3\)"),
        (lambda: petmjx.jax.place(state, SIZE, STEPS[0], MASS[:, None]), r"mass_kg must have the shape \(2,\)"),
        (lambda: petmjx.jax.try_all(state, SIZE, STEPS[0], MASS, 0), r"pallet must have the shape \(m,\)"),
        (
            lambda: petmjx.jax.try_all(state, SIZE, STEPS[0], MASS, [0.7, 1.0]),
            "pallet must be an array of whole numbers",
        ),
        (lambda: petmjx.jax.place(state, SIZE, STEPS[0], MASS, [1, 0]), "active must be an array of true or false"),
        (lambda: petmjx.jax.place(state, SIZE, STEPS[0], np.array([5.0, -6.0])), "mass_kg must be from .*, got -6"),
        (lambda: petmjx.jax.try_all(state, SIZE * np.nan, STEPS[0], MASS, [0, 1]), "size_mm must be from .*, got nan"),
        (lambda: petmjx.jax.place(2, SIZE, STEPS[0], MASS), "state must be a state from petmjx.jax.empty"),
        (lambda: petmjx.jax.empty(0), "n must be at least 1"),
        (
            lambda: petmjx.jax.empty(1, engine="mjx-jax"),
            "engine must be mujoco, mjx-warp or mjx-warp-cpu in petmjx.jax",
        ),
    ):
        with pytest.raises(InputError, match=message):
            call()


def test_the_old_name_warns() -> None:
    with pytest.warns(FutureWarning, match=r"petmjx\.jax\.Told is now petmjx\.jax\.PlacementArrays"):
        assert petmjx.jax.Told is PlacementArrays
