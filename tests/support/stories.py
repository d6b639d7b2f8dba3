"""A story whose movements have a closed form: two cartons stand, and a third carton falls off beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.analysis.story import Story
from petmjx.common.units import FloatArray
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.results.to_json import to_json
from petmjx.world.history import CARRIER, Contacts, History
from petmjx.world.job import ACCELERATION, Drive, Excitation
from petmjx.world.scene import Scene, build_scene
from support.plans import Box, make_plan

FRAME_S: Final = 0.05
PLACED_S: Final = (0.0, 0.2, 0.4)
FALLS_FROM_S: Final = 0.6
END_S: Final = 1.0
SIGN_S: Final = 0.8
TURN_RAD_S: Final = 4.0
FALLING: Final = 2

BOXES: Final[tuple[Box, ...]] = (
    ((400, 400, 200), (0, 0, 0), 6.0),
    ((400, 400, 200), (0, 0, 200), 6.0),
    ((200, 400, 200), (400, 0, 0), 2.5),
)


def falling_story(plan_id: str = "plan-1", articles: tuple[str, ...] = ("tea", "tea", "milk"), **changes: Any) -> Story:
    """Box 2 stands on the carrier until ``FALLS_FROM_S``, then flies off to the right while it turns. ``changes``:
    fields of the story."""
    plan = replace(make_plan(plan_id, BOXES), articles=articles)
    scene = build_scene(plan, Simulation())
    history = _history(scene)
    story = Story(plan, scene, _outcome(scene, history), history, "mujoco", options=to_json(Simulation().model_dump()))
    return replace(story, **changes)


def standing_story(plan_id: str = "plan-1") -> Story:
    """A story of the same plan without the fall."""
    story = falling_story(plan_id)
    pos = np.where(np.isfinite(story.history.pos), story.scene.target, np.nan)
    quat = np.where(np.isfinite(story.history.quat), [1.0, 0.0, 0.0, 0.0], np.nan)
    history = replace(story.history, pos=pos, quat=quat)
    outcome = _outcome(story.scene, history)
    outcome.verdict, outcome.reason, outcome.culprit, outcome.first_sign_s = Verdict.STABLE, Reason.NONE, -1, np.nan
    outcome.boxes.dropped[:] = False
    outcome.boxes.drop_s[:] = np.nan
    return replace(story, outcome=outcome, history=history)


def shaken_story() -> Story:
    """A story in which the carrier is accelerated along +x with 0.5 g while box 2 falls."""
    story = falling_story()
    drive = Drive(Excitation("half-a-g", ACCELERATION, np.tile([4.905, 0.0, 0.0], (200, 1))))
    level = np.where(story.history.time_s >= FALLS_FROM_S, 4.905, 0.0)
    shaken = np.column_stack([level, np.zeros((len(level), 2))])
    return replace(story, drive=drive, history=replace(story.history, drive=shaken), values={"level_g": 0.5}, variant=3)


def long_story(n: int = 45, n_frames: int = 1200, pairs: int = 160) -> Story:
    """A large story of n boxes. All boxes tumble in the last quarter, and the contacts are noisy all the time."""
    rng = np.random.default_rng(7)
    plan = make_plan("long", [((200, 200, 100), (200 * (k % 5), 0, 100 * (k // 5)), 5.0) for k in range(n)])
    scene = build_scene(plan, Simulation())
    tumbling = n_frames // 4
    pos, quat = np.tile(scene.target, (n_frames, 1, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (n_frames, n, 1))
    pos[-tumbling:] += np.cumsum(rng.normal(0.0, 0.01, (tumbling, n, 3)), axis=0)
    quat[-tumbling:] += np.cumsum(rng.normal(0.0, 0.01, (tumbling, n, 4)), axis=0)
    n_placed = np.minimum(np.arange(n_frames) * n // (n_frames // 2) + 1, n).astype(np.int32)
    unplaced = n_placed[:, None] <= np.arange(n)
    pos[unplaced], quat[unplaced] = np.nan, np.nan
    bodies = np.sort(rng.integers(0, n, (pairs, 2)), axis=1).astype(np.int32)
    load = np.tile(rng.uniform(0.0, 500.0, (pairs, 3)), (n_frames, 1))
    contacts = Contacts(
        frame=np.repeat(np.arange(n_frames, dtype=np.int32), pairs),
        body=np.tile(bodies, (n_frames, 1)),
        point=np.tile(rng.uniform(0.0, 1.0, (pairs, 3)), (n_frames, 1)),
        normal=np.tile([0.0, 0.0, 1.0], (n_frames * pairs, 1)),
        force=load + rng.normal(0.0, 0.05, load.shape),
        distance=np.zeros(n_frames * pairs),
    )
    history = History(
        time_s=np.arange(n_frames) * FRAME_S,
        n_placed=n_placed,
        pos=pos,
        quat=quat,
        top_force_n=np.where(unplaced, np.nan, rng.uniform(0.0, 500.0, n) + rng.normal(0.0, 0.1, (n_frames, n))),
        carrier_pos=np.tile(scene.carrier.pos, (n_frames, 1)),
        carrier_quat=np.tile([1.0, 0.0, 0.0, 0.0], (n_frames, 1)),
        drive=np.zeros((n_frames, 3)),
        contacts=contacts,
    )
    return Story(plan, scene, _outcome(scene, history), history, "mujoco", options=to_json(Simulation().model_dump()))


def _history(scene: Scene) -> History:
    time_s = np.arange(round(END_S / FRAME_S) + 1) * FRAME_S
    n_placed = np.sum(time_s[:, None] >= np.array(PLACED_S) - 1e-9, axis=1).astype(np.int32)
    unplaced = n_placed[:, None] <= np.arange(scene.n_boxes)
    pos = np.tile(scene.target, (len(time_s), 1, 1))
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(time_s), scene.n_boxes, 1))
    fall_s = np.maximum(time_s - FALLS_FROM_S, 0.0)
    pos[:, FALLING] += np.column_stack([2.0 * fall_s, 0.0 * fall_s, -1.2 * fall_s**2])
    quat[:, FALLING] = np.column_stack(
        [np.cos(TURN_RAD_S * fall_s / 2), 0.0 * fall_s, np.sin(TURN_RAD_S * fall_s / 2), 0.0 * fall_s]
    )
    pos[unplaced], quat[unplaced] = np.nan, np.nan
    force = np.where(unplaced, np.nan, 0.0)
    force[n_placed > 1, 0] = 58.9
    return History(
        time_s=time_s,
        n_placed=n_placed,
        pos=pos,
        quat=quat,
        top_force_n=force,
        carrier_pos=np.tile(scene.carrier.pos, (len(time_s), 1)),
        carrier_quat=np.tile([1.0, 0.0, 0.0, 0.0], (len(time_s), 1)),
        drive=np.zeros((len(time_s), 3)),
        contacts=_contacts(n_placed),
    )


def _contacts(n_placed: Any) -> Contacts:
    """Contacts with the weight of box 1 on box 0 at four corners, and of both boxes on the carrier at one point."""
    rows: list[tuple[int, tuple[int, int], tuple[float, float, float], float]] = []
    for frame, placed in enumerate(n_placed):
        rows.append((frame, (CARRIER, 0), (0.2, 0.2, 0.0), 58.9 * min(placed, 2)))
        if placed > 1:
            rows += [(frame, (0, 1), (x, y, 0.2), 58.9 / 4) for x in (0.05, 0.35) for y in (0.05, 0.35)]
    frames, bodies, points, forces = zip(*rows, strict=True)
    up: FloatArray = np.array([0.0, 0.0, 1.0])
    return Contacts(
        frame=np.array(frames, dtype=np.int32),
        body=np.array(bodies, dtype=np.int32),
        point=np.array(points),
        normal=np.tile(up, (len(rows), 1)),
        force=np.array(forces)[:, None] * up,
        distance=np.zeros(len(rows)),
    )


def _outcome(scene: Scene, history: History) -> Outcome:
    n = scene.n_boxes
    dropped = np.arange(n) == FALLING
    boxes = BoxMetrics.measured(
        n,
        shift_m=history.pos[-1] - scene.target,
        max_tilt_deg=np.where(dropped, np.degrees(TURN_RAD_S * (END_S - FALLS_FROM_S)), 0.0),
        max_lin_acc=np.zeros(n),
        max_ang_acc=np.zeros(n),
        max_top_force_n=np.where(np.arange(n) == 0, 61.2, 0.0),
        rest_top_force_n=np.where(np.arange(n) == 0, 58.9, 0.0),
        dropped=dropped,
        drop_s=np.where(dropped, END_S, np.nan),
        pos=history.pos[-1],
        quat=history.quat[-1],
    )
    return Outcome(
        job=0,
        verdict=Verdict.UNSTABLE,
        reason=Reason.DROP,
        culprit=FALLING,
        first_sign_s=SIGN_S,
        n_boxes=n,
        n_placed=n,
        sim_time_s=END_S,
        n_steps=500,
        flags=Flag.EARLY_STOP,
        boxes=boxes,
    )
