"""Single pictures of a story."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from petmjx.show.pictures.camera import Camera, Margins, framing
from petmjx.show.pictures.draw_story import Painter, PictureStyle, framed_points
from petmjx.show.pictures.overlay import Overlay
from petmjx.show.pictures.story_poses import poses_of_frame

if TYPE_CHECKING:
    from PIL.Image import Image

FINER: Final = 2
"""Factor by which single pictures are drawn larger and then reduced, which makes edges smooth. Pictures of more than
``_LARGE_PX`` pixels are drawn at their own size."""

_LARGE_PX: Final = 3_000_000


def draw_frames(look: PictureStyle, frames: list[int], camera: Camera) -> list[Image]:
    """Pictures of the given frames, as seen by a camera, without any text."""
    from PIL import Image

    width, height = look.size
    finer = FINER if width * height < _LARGE_PX else 1
    large = camera.scaled(finer)
    pictures = []
    with Painter(look, finer) as painter:
        for frame in frames:
            image = Image.fromarray(painter.picture(poses_of_frame(look.story.history, frame), large))
            pictures.append(image if finer == 1 else image.resize(look.size, Image.Resampling.BOX))
    return pictures


def frame_camera(look: PictureStyle, frames: list[int], margins: Margins) -> Camera:
    """The camera that shows the boxes of the given frames as large as possible."""
    return framing(framed_points(look.story, frames), look.view, look.size, margins)


def write_still(look: PictureStyle, frame: int, path: Path) -> None:
    """Write the picture of one frame, with its texts, as a PNG file."""
    import numpy as np

    overlay = Overlay(look)
    camera = frame_camera(look, [frame], overlay.margins)
    (image,) = draw_frames(look, [frame], camera)
    poses = poses_of_frame(look.story.history, frame)
    overlay.on(np.asarray(image), poses, camera).save(path, format="PNG", optimize=True)
