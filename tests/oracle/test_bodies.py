"""Worlds with bodies that no option makes yet, on all engines, against what statics says.

The bodies are a carrier of two boards, boxes of two coefficients of friction, and boxes whose centre of mass is not in
the middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import numpy as np
import pytest

from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.body_shapes import Body
from petmjx.world.history import Record
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job
from petmjx.world.scene import Scene
from petmjx.world.surface_pairs import NOT_GIVEN

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.plans import make_scene
from support.tiny_worlds import engine as warp_engine

from petmjx.engines.mjx.engine import MjxJaxEngine

pytestmark = pytest.mark.slow

SIM = Simulation(interval_s=0.2, rest_window_s=0.1, settle_s=0.2, size_reduction_mm=0)
SIDE_MM, GAP_M = 200.0, 0.3
HALF_HEIGHT_M = SIM.physics.carrier_half_height_m
BEYOND_M = 0.03
"""Distance of the middle of a box beyond the edge of the board that it stands on."""
LOWER, LOW, HIGH, PUSH_G = 0.1, 0.2, 0.6, 0.4
"""Coefficients of friction of boxes that slide (``LOWER`` and ``LOW``) and of a box that does not (``HIGH``), when the
carrier is accelerated by ``PUSH_G`` times standard gravity."""
SAME_PLACE_M = 1e-3
SAME_FRICTION = 0.03
"""Relative tolerance of a coefficient of friction that a test computes from positions in float32."""


def boards(friction: float) -> Body:
    """Return a carrier of two boards along y, with a gap between them. The inner edges of the boards are at x = 0 and
    ``GAP_M``."""
    half = np.array([[0.2, 0.4, HALF_HEIGHT_M]] * 2)
    center = np.array([[-0.2, 0.4, -HALF_HEIGHT_M], [GAP_M + 0.2, 0.4, -HALF_HEIGHT_M]])
    return Body.of_boards(center, half, np.array([10.0, 10.0]), np.tile([friction, 0.005, 0.0001], (2, 1)))


def at_the_edge(toward_board_m: float) -> Scene:
    """Return a scene of two boxes on the left board.

    The middle of the first box is beyond the board's edge. The centre of mass of the first box is ``toward_board_m``
    from its middle, towards the board.
    """
    corner = -SIDE_MM / 2 + 1000 * BEYOND_M
    scene = make_scene([((SIDE_MM,) * 3, (corner, 0, 0), 4.0), ((SIDE_MM,) * 3, (-300, 500, 0), 4.0)], SIM)
    aside = np.array([[-toward_board_m, 0.0, 0.0], [0.0, 0.0, 0.0]])
    return replace(scene, carrier=boards(0.5), mass_center=aside)


def slippery_and_rough() -> Scene:
    scene = make_scene([((SIDE_MM, SIDE_MM, 100), (-300, y, 0), 4.0) for y in (0, 500)], SIM)
    return replace(scene, carrier=boards(0.1), friction=np.array([[LOW, 0.005, 1e-4], [HIGH, 0.005, 1e-4]]))


def on_own_carrier(beyond_mm: float) -> Scene:
    """Return a scene with a post on a carrier of two boards that are not centred over each other.

    The lower board stands on the floor. The upper board is the deck, and covers one half of the lower one. The middle
    of the post is ``beyond_mm`` beyond the edge of the deck.
    """
    boards = [((0, 0, 0), (800, 400, 60), 12.0), ((0, 0, 60), (400, 400, 60), 4.0)]
    tables = [{"corner_mm": corner, "size_mm": size, "mass_kg": kg} for corner, size, kg in boards]
    sim = SIM.changed(carrier={"boards": tables})
    return make_scene([((60, 60, 200), (370 + beyond_mm, 100, 0), 3.0), ((SIDE_MM,) * 3, (0, 100, 0), 4.0)], sim)


def by_pairs() -> Scene:
    """Return a scene of three equal boxes on a rough carrier, with coefficients of friction given by pairs of surfaces.

    With the coefficients of the pairs, the first two boxes slide on the carrier. Without pairs, the larger coefficient
    of box and carrier would count, and would hold both boxes.
    """
    boxes = [((SIDE_MM, SIDE_MM, 100), (-300, y, 0), 4.0) for y in (0, 300, 600)]
    table = np.full((4, 4), NOT_GIVEN)
    for surface, friction in ((1, LOW), (2, LOWER)):
        table[surface, 3] = table[3, surface] = friction
    carrier = replace(boards(0.9), surface=np.array([3, 3]))
    return replace(make_scene(boxes, SIM), carrier=carrier, surface=np.array([1, 2, 0]), pairs={"friction": table})


def push() -> Drive:
    samples = np.zeros((200, 3))
    samples[:, 0] = PUSH_G * STANDARD_GRAVITY
    return Drive(Excitation("push", ACCELERATION, samples), rest_s=0.1)


SCENES = {
    "stands": at_the_edge(2 * BEYOND_M),
    "tips": at_the_edge(0.0),
    "slides": slippery_and_rough(),
    "pairs": by_pairs(),
    "own stands": on_own_carrier(-8.0),
    "own tips": on_own_carrier(8.0),
}


@pytest.fixture(scope="module", params=["mujoco", "mjx-jax", "mjx-warp"])
def outcomes(request: pytest.FixtureRequest) -> Iterator[dict[str, Outcome]]:
    engines: dict[str, type[Engine] | object] = {"mujoco": MujocoEngine, "mjx-jax": MjxJaxEngine}
    engine = warp_engine() if request.param == "mjx-warp" else engines[request.param](4)  # type: ignore[operator]
    drives = {"slides": push(), "pairs": push()}
    jobs = [Job(scene, drives.get(name), record=Record(0.1)) for name, scene in SCENES.items()]
    with jax.numpy_rank_promotion("allow"):
        yield {list(SCENES)[outcome.job]: outcome for outcome in engine.run(jobs, SIM)}


def test_a_gap_bears_nothing_and_the_centre_of_mass_decides(outcomes: dict[str, Outcome]) -> None:
    assert outcomes["stands"].verdict is Verdict.STABLE
    assert outcomes["tips"].verdict is Verdict.UNSTABLE
    assert outcomes["tips"].culprit == 0


def test_a_carrier_of_ones_own_bears_up_to_its_edge(outcomes: dict[str, Outcome]) -> None:
    outcome = outcomes["own stands"]
    assert outcome.verdict is Verdict.STABLE
    np.testing.assert_allclose(outcome.boxes.pos, SCENES["own stands"].target, atol=SAME_PLACE_M)
    assert outcomes["own tips"].verdict is Verdict.UNSTABLE
    assert outcomes["own tips"].culprit == 0


def test_places_are_those_of_middles(outcomes: dict[str, Outcome]) -> None:
    outcome, scene = outcomes["stands"], SCENES["stands"]
    np.testing.assert_allclose(outcome.boxes.pos, scene.target, atol=SAME_PLACE_M)
    np.testing.assert_allclose(outcome.boxes.shift_m, 0.0, atol=SAME_PLACE_M)
    assert outcome.history is not None
    np.testing.assert_allclose(outcome.history.pos[-1], scene.target, atol=SAME_PLACE_M)


def test_each_box_has_its_own_friction(outcomes: dict[str, Outcome]) -> None:
    """The boards have less friction than both boxes, and the larger coefficient of board and box counts.

    While the carrier is accelerated, the slippery box slides against the acceleration. Seen from the carrier, the
    distance is ½ (a − μ g) t².
    """
    sway = outcomes["slides"].boxes.max_sway_m
    seconds = 200 * SIM.physics.timestep_s
    assert sway[0] >= 0.95 * (PUSH_G - LOW) * STANDARD_GRAVITY * seconds**2 / 2
    assert sway[1] < SAME_PLACE_M


def test_each_box_slides_by_the_friction_of_its_pair(outcomes: dict[str, Outcome]) -> None:
    """Seen from the carrier, a box that slides has moved by ½ (a − μ g) (t − t₀)² at time t.

    So the square root of that distance grows with time at the rate √(½ (a − μ g)). The third box has no surface number:
    the larger coefficient of box and carrier counts for it, and holds it.
    """
    history = outcomes["pairs"].history
    assert history is not None
    way = np.abs(history.pos[:, :, 0] - SCENES["pairs"].target[:, 0])
    first = int(np.argmax(way[:, 1] > 5 * SAME_PLACE_M))
    sliding = slice(first, first + 2)
    growth = np.diff(np.sqrt(way[sliding, :2]), axis=0)[0] / np.diff(history.time_s[sliding])
    np.testing.assert_allclose(PUSH_G - 2 * growth**2 / STANDARD_GRAVITY, [LOW, LOWER], rtol=SAME_FRICTION)
    assert way[sliding, 2].max() < SAME_PLACE_M
