"""Stories for tests of pictures, and a check whether pictures can be drawn on this machine."""

from __future__ import annotations

import functools
import importlib.util

import numpy as np
import pytest

from petmjx.analysis.story import Story
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.show.pictures.offscreen import why_no_pictures
from petmjx.world.history import Contacts, History
from petmjx.world.scene import build_scene

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@functools.cache
def needs_pictures() -> pytest.MarkDecorator:
    """The mark of a test that draws pictures. Such a test is skipped if pictures cannot be drawn here."""
    missing = [name for name in ("PIL", "matplotlib", "OpenGL") if importlib.util.find_spec(name) is None]
    reason = f"{', '.join(missing)} not installed (extra: show)" if missing else why_no_pictures()
    return pytest.mark.skipif(bool(reason), reason=reason)


def cube_plan(plan_id: str, corners_mm: list[tuple[float, float, float]], articles: list[str]) -> Plan:
    """A plan of cubes of 200 mm and 2 kg at these corners."""
    n = len(corners_mm)
    return Plan(
        plan_id,
        "test",
        size_mm=np.full((n, 3), 200.0),
        corner_mm=np.array(corners_mm, dtype=np.float64),
        mass_kg=np.full(n, 2.0),
        item_ids=tuple(f"item-{box}" for box in range(n)),
        articles=tuple(articles),
        sequence=np.arange(n),
    )


def falling_story(plan_id: str = "tower", contacts: bool = True) -> Story:
    """A story of three cubes: two side by side, and a third on the first, placed at 0.5 s. The motion of the third cube
    is easily computed: until 1 s, the cube moves 300 mm to the right and turns by 90° about y. There is a frame every
    0.1 s until 2 s."""
    plan = cube_plan(plan_id, [(0, 0, 0), (200, 0, 0), (0, 0, 200)], ["tea", "salt", "tea"])
    scene = build_scene(plan, Simulation(size_reduction_mm=0.0))
    times = np.arange(21) / 10
    fallen = np.clip((times - 0.5) / 0.5, 0, 1)
    n_placed = np.where(times < 0.5, 2, 3).astype(np.int32)
    pos = np.tile(scene.target, (21, 1, 1))
    quat = np.tile(np.array(UPRIGHT), (21, 3, 1))
    pos[:, 2, 0] += 0.3 * fallen
    quat[:, 2, 0], quat[:, 2, 2] = np.cos(np.pi / 4 * fallen), np.sin(np.pi / 4 * fallen)
    force = np.where(times[:, None] < 0.5, [0.0, 0.0, np.nan], [19.62, 0.0, 0.0])
    waiting = times < 0.5
    pos[waiting, 2], quat[waiting, 2] = np.nan, np.nan
    touching = Contacts(
        frame=np.arange(21, dtype=np.int32).repeat(2),
        body=np.tile(np.array([[-1, 0], [1, -1]], dtype=np.int32), (21, 1)),
        point=np.tile(np.array([[0.1, 0.1, 0.0], [0.3, 0.1, 0.0]]), (21, 1)),
        normal=np.tile(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), (21, 1)),
        force=np.tile(np.array([[0.0, 0.0, 20.0], [0.0, 0.0, -20.0]]), (21, 1)),
        distance=np.zeros(42),
    )
    history = History(
        times,
        n_placed,
        pos,
        quat,
        force,
        carrier_pos=np.tile(scene.carrier.pos, (21, 1)),
        carrier_quat=np.tile(np.array(UPRIGHT), (21, 1)),
        drive=np.zeros((21, 3)),
        contacts=touching if contacts else None,
    )
    boxes = BoxMetrics.measured(
        3,
        shift_m=pos[-1] - scene.target,
        max_tilt_deg=np.array([0.0, 0.0, 90.0]),
        max_top_force_n=np.array([19.62, 0.0, 0.0]),
        rest_top_force_n=np.array([19.62, 0.0, 0.0]),
        pos=pos[-1],
        quat=quat[-1],
    )
    outcome = Outcome(
        0, Verdict.UNSTABLE, Reason.TILT, 2, 0.7, 3, 3, 2.0, 1000, Flag.NONE, boxes, margin=-14.0, history=history
    )
    return Story(plan, scene, outcome, history, "mujoco", options=Simulation().model_dump(mode="json"))


def standing_story(story: Story) -> Story:
    """A story with the same frames, whose outcome is stable."""
    from dataclasses import replace

    calm = replace(
        story.outcome, verdict=Verdict.STABLE, reason=Reason.NONE, culprit=-1, first_sign_s=np.nan, margin=0.9
    )
    return replace(story, outcome=calm)
