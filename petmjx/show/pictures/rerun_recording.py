"""A story as a recording for rerun's viewer (https://rerun.io): boxes, carrier, contact forces, and curves over
time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.analysis.story import Story
from petmjx.analysis.story_in_words import box_name, events
from petmjx.common.text import printable
from petmjx.show.pictures.box_colours import CARRIER, FIRST, Colouring
from petmjx.show.pictures.draw_story import forces_of_pairs, newtons_per_m
from petmjx.show.pictures.story_poses import Poses, poses_of_frame, shift_mm, tilts_deg
from petmjx.world.history import History

TIMELINE: Final = "time"


def write_recording(story: Story, colours: Colouring, path: Path) -> None:
    """Write all frames of a story. A box is labelled with its name; the label of the first box to fail also states that
    it fails first."""
    import rerun as rr

    recording = rr.RecordingStream("petmjx", recording_id=f"{printable(story.plan.plan_id)} {story.variant}")
    recording.save(path)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    scale = None if story.history.contacts is None else newtons_per_m(story)
    for frame in range(len(story.history.time_s)):
        poses = poses_of_frame(story.history, frame)
        recording.set_time(TIMELINE, duration=poses.time_s)
        recording.log("pallet/boxes", _boxes(rr, story, colours, poses))
        for name, boards in _carrier(rr, story, poses):
            recording.log(name, boards)
        if scale is not None:
            recording.log("pallet/forces", _forces(rr, story.history, poses, scale))
        for name, value in _curves(story, poses).items():
            recording.log(f"curves/{name}", rr.Scalars(value))
    for event in events(story):
        recording.set_time(TIMELINE, duration=event.time_s)
        recording.log("events", rr.TextLog(event.what))
    recording.flush()
    recording.disconnect()


def _boxes(rr: Any, story: Story, colours: Colouring, poses: Poses) -> Any:
    names = [box_name(story, box) for box in range(poses.n_placed)]
    if 0 <= story.outcome.culprit < poses.n_placed:
        names[story.outcome.culprit] += ", first to fail"
    return rr.Boxes3D(
        centers=poses.pos,
        half_sizes=story.scene.half_size[: poses.n_placed],
        quaternions=_as_xyzw(poses.quat),
        colors=colours.of(poses),
        labels=names,
        show_labels=False,
        fill_mode="solid",
    )


def _carrier(rr: Any, story: Story, poses: Poses) -> Iterator[tuple[str, Any]]:
    """The boards of the carrier, and its walls. Walls are drawn as wire frames, since solid walls would hide boxes."""
    carrier = story.scene.carrier
    centers, _, half_sizes = carrier.shapes_at(poses.carrier_pos, poses.carrier_quat)
    boards, walls = slice(carrier.n_boards), slice(carrier.n_boards, None)
    for name, rows, fill_mode in (("carrier", boards, "solid"), ("walls", walls, "majorwireframe")):
        if len(centers[rows]):
            yield (
                f"pallet/{name}",
                rr.Boxes3D(
                    centers=centers[rows],
                    half_sizes=half_sizes[rows],
                    quaternions=_as_xyzw(np.tile(poses.carrier_quat, (len(centers[rows]), 1))),
                    colors=[CARRIER],
                    fill_mode=fill_mode,
                ),
            )


def _forces(rr: Any, history: History, poses: Poses, scale: float) -> Any:
    forces = [] if history.contacts is None else forces_of_pairs(history.contacts, poses)
    origins = np.array([place - force / scale for place, force in forces]).reshape(-1, 3)
    vectors = np.array([force / scale for _, force in forces]).reshape(-1, 3)
    return rr.Arrows3D(origins=origins, vectors=vectors, colors=[FIRST])


def _curves(story: Story, poses: Poses) -> dict[str, float]:
    """The values of the curves at one time: name of the curve → largest value over all placed boxes."""
    forces = np.nan_to_num(story.history.top_force_n[poses.frame, : poses.n_placed])
    return {
        "largest_shift_mm": float(shift_mm(story, poses).max(initial=0.0)),
        "largest_tilt_deg": float(tilts_deg(poses).max(initial=0.0)),
        "largest_top_force_n": float(forces.max(initial=0.0)),
    }


def _as_xyzw(quat: Any) -> Any:
    """(k, 4) quaternions (x, y, z, w), as rerun needs them, given quaternions (w, x, y, z)."""
    return np.roll(quat, -1, axis=1)
