"""Pictures of open pallets (pallets to which boxes can be added), drawn like the pictures of stories
(petmjx.analysis.story). The camera stays in place when boxes are added."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story
from petmjx.common.errors import InputError
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.open_world_protocol import Snapshot
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.show.pictures.box_colours import colouring
from petmjx.show.pictures.camera import Margins, framing, view_of
from petmjx.show.pictures.draw_story import Painter, PictureStyle
from petmjx.show.pictures.picture_files import why_nothing_is_drawn
from petmjx.show.pictures.picture_options import Colour
from petmjx.show.pictures.story_poses import poses_of_frame
from petmjx.world.growing_scenes import EmptyCarrier, NextBoxes
from petmjx.world.history import History
from petmjx.world.scene import IDENTITY_QUAT, Scene

SHOWN_HEIGHT_M: Final = 1.2
"""Height above the carrier up to which a picture shows the space, m. If the pile is higher, the picture shows the space
up to the highest top."""


def picture(scene: Scene, snapshot: Snapshot, sim: Simulation, size: tuple[int, int], view: str) -> NDArray[np.uint8]:
    """(height, width, 3) pixels of a picture of a pallet in its current state.

    Raises:
        InputError: nothing can be drawn on this machine.
    """
    if reason := why_nothing_is_drawn():
        raise InputError(f"show: {reason}")
    k = len(snapshot.pos)
    # A scene without boxes cannot be drawn, so a box is added. This box is not placed, and so is invisible.
    if not scene.n_boxes:
        scene = EmptyCarrier(sim).with_box(scene, NextBoxes(np.full((1, 3), 0.1), np.zeros((1, 3)), np.ones(1)), 0)
    story = _story(scene, snapshot, sim)
    look = PictureStyle(colouring(story, Colour.ORDER), view_of(view), size)
    camera = framing(_scene_corners(scene, snapshot), look.view, size, Margins(0, 0, 0, 0))
    with Painter(look) as painter:
        poses = poses_of_frame(story.history, 0)
        assert poses.n_placed == k
        return painter.picture(poses, camera)


def _scene_corners(scene: Scene, snapshot: Snapshot) -> FloatArray:
    """(c, 3) corners of a cuboid around the carrier and the boxes, m."""
    low, high = scene.carrier.low.copy(), scene.carrier.high.copy()
    tops = (scene.target + scene.half_size)[: len(snapshot.pos), 2]
    high[2] = max(SHOWN_HEIGHT_M, float(tops.max(initial=0.0)))
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def _story(scene: Scene, snapshot: Snapshot, sim: Simulation) -> Story:
    n, k = scene.n_boxes, len(snapshot.pos)

    def frame(values: FloatArray) -> FloatArray:
        table = np.full((1, n, *values.shape[1:]), np.nan)
        table[0, :k] = values
        return table

    history = History(
        time_s=np.array([snapshot.time_s]),
        n_placed=np.array([k], np.int32),
        pos=frame(snapshot.pos),
        quat=frame(snapshot.quat),
        top_force_n=frame(snapshot.top_force_n),
        carrier_pos=scene.carrier.pos[None],
        carrier_quat=np.array([IDENTITY_QUAT]),
        drive=np.zeros((1, 3)),
    )
    names = tuple(str(number) for number in range(n))
    sizes, corners = 2 * MM_PER_M * scene.half_size, MM_PER_M * (scene.target - scene.half_size)
    plan = Plan("pallet", "loop", sizes, corners, scene.mass, names, names, np.arange(1, n + 1))
    boxes = BoxMetrics.measured(n, pos=scene.target, quat=scene.start_quat)
    outcome = Outcome(
        job=0,
        verdict=Verdict.STABLE,
        reason=Reason.NONE,
        culprit=snapshot.culprit,
        first_sign_s=float("nan"),
        n_boxes=n,
        n_placed=k,
        sim_time_s=snapshot.time_s,
        n_steps=0,
        flags=Flag.NONE,
        boxes=boxes,
    )
    return Story(plan, scene, outcome, history, "", options=sim.model_dump(mode="json"))
