"""The cone of a contact on mjx-warp.

The force of a contact is the slope of a cost, and the curvature of that cost is the slope of the force.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import EFC_WORDS

set_up_warp()

STIFFNESS, FRICTION = 3.0, 0.5
STEP = 1e-6
"""Step of central differences, in double precision."""

RESIDUALS = np.array(
    [
        [-0.30, 0.40, 0.70],  # slides
        [-0.30, -0.20, 0.10],  # slides or sticks, by impratio
        [-0.30, 0.01, -0.01],  # sticks
        [0.30, 0.01, 0.02],  # does not touch
        [-0.01, 2.00, -1.00],  # slides fast
    ]
)
"""(n, 3) residuals of a contact in m/s²: accelerations minus reference accelerations, along the normal and tangents."""


@wp.func_native(
    "const petmjx::Numbers numbers(contact.data, 1, 0);"
    "petmjx::respond(pyramidal, slack, j.data, numbers, anew, drag.data, push.data, bend.data);"
)
def _respond(
    pyramidal: int,
    slack: wp.float64,
    j: wp.array[wp.float64],
    contact: wp.array[float],
    anew: bool,
    drag: wp.array[float],
    push: wp.array[wp.float64],
    bend: wp.array[wp.float64],
) -> None: ...


@wp.func_native("petmjx::follow(j.data, v.data, drag.data);")
def _follow(j: wp.array[wp.float64], v: wp.array[wp.float64], drag: wp.array[float]) -> None: ...


@wp.func_native(
    "double cost[2] = {0.0, 0.0};"
    "petmjx::respond_along(pyramidal, slack, j.data, v.data, length, petmjx::Numbers(contact.data, 1, 0), cost);"
    "along.data[0] = cost[0]; along.data[1] = cost[1];"
)
def _respond_along(
    pyramidal: int,
    slack: wp.float64,
    j: wp.array[wp.float64],
    v: wp.array[wp.float64],
    length: wp.float64,
    contact: wp.array[float],
    along: wp.array[wp.float64],
) -> None: ...


def one_contact(
    pyramidal: int,
    slack: wp.float64,
    j: wp.array[wp.float64],
    contact: wp.array[float],
    anew: bool,
    drag: wp.array[float],
    push: wp.array[wp.float64],
    bend: wp.array[wp.float64],
) -> None:
    _respond(pyramidal, slack, j, contact, anew, drag, push, bend)


def one_follow(j: wp.array[wp.float64], v: wp.array[wp.float64], drag: wp.array[float]) -> None:
    _follow(j, v, drag)


def along_a_line(
    pyramidal: int,
    slack: wp.float64,
    j: wp.array[wp.float64],
    v: wp.array[wp.float64],
    length: wp.float64,
    contact: wp.array[float],
    along: wp.array[wp.float64],
) -> None:
    _respond_along(pyramidal, slack, j, v, length, contact, along)


def compiled(function: Any) -> Any:
    return with_cpp(function, newton.defines(newton.SLIP_MACROS) + newton.source("contact.cuh"))


@pytest.fixture(scope="module")
def kernel() -> Any:
    return compiled(one_contact)


def doubles(values: Any) -> wp.array[wp.float64]:
    return wp.array(values, dtype=wp.float64, device="cpu")


def numbers() -> wp.array[float]:
    """Return the numbers of a contact. The kernel reads only the last two."""
    contact = np.zeros(EFC_WORDS, np.float32)
    contact[30:32] = STIFFNESS, FRICTION
    return wp.array(contact, dtype=float, device="cpu")


def force_and_curvature(
    kernel: Any, j: np.ndarray, pyramidal: int, impratio: float, drag: Any = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the force (3,) and the curvature (3, 3) of a contact.

    Args:
        drag: Friction of a sliding contact as a share of its largest friction, with opposite sign. If None, the kernel
            computes it from the residual.
    """
    push, bend = wp.zeros(3, dtype=wp.float64, device="cpu"), wp.zeros(6, dtype=wp.float64, device="cpu")
    share = wp.array([0.0, 0.0] if drag is None else drag, dtype=float, device="cpu")
    inputs = [pyramidal, impratio**-0.5, doubles(j), numbers(), drag is None, share, push, bend]
    wp.launch(kernel, dim=1, inputs=inputs, device="cpu")
    upper = np.zeros((3, 3))
    upper[np.triu_indices(3)] = bend.numpy()
    return push.numpy(), upper + np.triu(upper, 1).T


@pytest.mark.parametrize("pyramidal", [0, 1])
@pytest.mark.parametrize("impratio", [1.0, 20.0, 100.0])
def test_the_curvature_is_the_slope_of_the_force(kernel: Any, pyramidal: int, impratio: float) -> None:
    for j in RESIDUALS:
        _, curvature = force_and_curvature(kernel, j, pyramidal, impratio)
        slope = np.zeros((3, 3))
        for axis, step in enumerate(STEP * np.eye(3)):
            after, _ = force_and_curvature(kernel, j + step, pyramidal, impratio)
            before, _ = force_and_curvature(kernel, j - step, pyramidal, impratio)
            slope[axis] = (before - after) / (2 * STEP)
        np.testing.assert_allclose(curvature, slope, rtol=1e-5, atol=1e-6 * max(np.abs(curvature).max(), 1.0))


@pytest.mark.parametrize("impratio", [1.0, 20.0, 100.0])
def test_friction_is_within_the_cone_and_impratio_times_as_stiff(kernel: Any, impratio: float) -> None:
    for j in RESIDUALS:
        force, _ = force_and_curvature(kernel, j, 0, impratio)
        assert np.linalg.norm(force[1:]) <= FRICTION * force[0] * (1 + 1e-12)
    sticks, _ = force_and_curvature(kernel, RESIDUALS[2], 0, impratio)
    stiff = np.array([STIFFNESS, STIFFNESS * impratio, STIFFNESS * impratio])
    if np.linalg.norm(stiff[1:] * RESIDUALS[2][1:]) < FRICTION * STIFFNESS * 0.3:
        np.testing.assert_allclose(sticks, -stiff * RESIDUALS[2], rtol=1e-6)


@pytest.mark.parametrize("pyramidal", [0, 1])
@pytest.mark.parametrize("impratio", [1.0, 20.0])
def test_along_a_line_the_cost_has_the_slope_and_the_curvature_of_its_force(
    kernel: Any, pyramidal: int, impratio: float
) -> None:
    line = compiled(along_a_line)
    for start in RESIDUALS:
        for direction in (*np.eye(3), np.array([0.3, -0.5, 0.2])):
            for length in (0.0, 0.4, 1.5):
                force, curvature = force_and_curvature(kernel, start + length * direction, pyramidal, impratio)
                along = doubles([0.0, 0.0])
                inputs = [pyramidal, impratio**-0.5, doubles(start), doubles(direction), length, numbers(), along]
                wp.launch(line, dim=1, inputs=inputs, device="cpu")
                first, second = along.numpy()
                assert first == pytest.approx(-force @ direction, rel=1e-9, abs=1e-9 * STIFFNESS)
                # the drag that the curvature uses is in single precision
                assert second == pytest.approx(direction @ curvature @ direction, rel=1e-6, abs=1e-6 * STIFFNESS)


def test_a_drag_of_its_own_makes_the_curvature_across_no_less_round(kernel: Any) -> None:
    """With a drag of length 1 along the sliding, the curvature of the cost is that of a norm: zero along the sliding.

    With no drag, it is that of a bowl: the same along the sliding as across. The curvature is never negative.
    """
    slides = RESIDUALS[4]
    ahead = slides[1:] / np.linalg.norm(slides[1:])
    force, exact = force_and_curvature(kernel, slides, 0, 20.0)
    _, same = force_and_curvature(kernel, slides, 0, 20.0, ahead)
    np.testing.assert_allclose(same, exact, rtol=1e-5)
    _, round_ = force_and_curvature(kernel, slides, 0, 20.0, [0.0, 0.0])
    across = np.linalg.norm(force[1:]) / np.linalg.norm(slides[1:])
    np.testing.assert_allclose((round_ - exact)[1:, 1:], across * np.outer(ahead, ahead), rtol=1e-5, atol=1e-9)
    for angle in np.linspace(0, 2 * np.pi, 9):
        for length in (0.3, 1.0):
            _, curvature = force_and_curvature(
                kernel, slides, 0, 20.0, length * np.array([np.cos(angle), np.sin(angle)])
            )
            assert np.linalg.eigvalsh(curvature).min() >= -1e-6 * np.abs(curvature).max()


def test_a_drag_follows_the_linear_model_and_stays_within_the_cone() -> None:
    """The drag follows |j|·drag = j, for tangential residuals j. A step of Newton's method that would end the sliding
    does not change the drag. After a step of zero, the drag points along the sliding."""
    kernel = compiled(one_follow)

    def after(v: list[float], drag: list[float]) -> np.ndarray:
        drag_after = wp.array(drag, dtype=float, device="cpu")
        wp.launch(kernel, dim=1, inputs=[doubles([-0.1, 3.0, 4.0]), doubles(v), drag_after], device="cpu")
        return drag_after.numpy()

    np.testing.assert_allclose(after([0.0, 0.0, 0.0], [0.1, -0.2]), [0.6, 0.8], rtol=1e-6)
    np.testing.assert_allclose(after([5.0, -3.0, -4.0], [0.1, -0.2]), [0.1, -0.2], rtol=1e-6)
    aside = after([0.0, -400.0, 300.0], [0.0, 0.0])
    assert np.linalg.norm(aside) == pytest.approx(1.0)
    np.testing.assert_allclose(aside, [-0.8, 0.6], atol=0.02)
