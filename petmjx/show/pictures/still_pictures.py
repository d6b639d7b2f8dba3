"""Single pictures of a story, and the style that all pictures of one call of ``petmjx.draw`` share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from petmjx.analysis.story import Story
from petmjx.show.pictures.box_colours import Colouring
from petmjx.show.pictures.camera import Camera, Margins, View, framing
from petmjx.show.pictures.draw_story import Painter, framed_points
from petmjx.show.pictures.overlay import Overlay
from petmjx.show.pictures.story_poses import poses_of_frame

if TYPE_CHECKING:
    from PIL.Image import Image

FINER: Final = 2
"""Factor by which single pictures are drawn larger and then reduced, which makes edges smooth. Pictures of more than
``_LARGE_PX`` pixels are drawn at their own size."""

_LARGE_PX: Final = 3_000_000


@dataclass(frozen=True, eq=False)
class PictureStyle:
    """How the pictures of a story look.

    Attributes:
        colours: colours of the boxes.
        view: direction from the pallet to the camera.
        size: width and height of a picture, px.
        newtons_per_m: force per length of the arrows for contact forces. If ``newtons_per_m`` is None, no arrows are
            drawn.
    """

    colours: Colouring
    view: View
    size: tuple[int, int]
    newtons_per_m: float | None = None

    @property
    def arrows(self) -> str:
        """The line of text that explains the arrows; "" if there are no arrows."""
        return "" if self.newtons_per_m is None else f"arrows: contact forces, 0.1 m for {self.newtons_per_m / 10:g} N"

    def line_px(self, finer: int = 1) -> float:
        """Width of boxes' edges, px, in a picture that is drawn larger by the factor ``finer``."""
        return finer * max(1.0, min(self.size) / 600)


def draw_frames(story: Story, look: PictureStyle, frames: list[int], camera: Camera) -> list[Image]:
    """Pictures of the given frames, as seen by a camera, without any text."""
    from PIL import Image

    width, height = look.size
    finer = FINER if width * height < _LARGE_PX else 1
    large = camera.scaled(finer)
    pictures = []
    with Painter(look.colours, (finer * width, finer * height), look.line_px(finer), look.newtons_per_m) as painter:
        for frame in frames:
            image = Image.fromarray(painter.picture(poses_of_frame(story.history, frame), large))
            pictures.append(image if finer == 1 else image.resize(look.size, Image.Resampling.BOX))
    return pictures


def frame_camera(story: Story, look: PictureStyle, frames: list[int], margins: Margins) -> Camera:
    """The camera that shows the boxes of the given frames as large as possible."""
    return framing(framed_points(story, frames), look.view, look.size, margins)


def write_still(story: Story, look: PictureStyle, frame: int, path: Path) -> None:
    """Write the picture of one frame, with its texts, as a PNG file."""
    import numpy as np

    overlay = Overlay(look.colours, look.size, arrows=look.arrows)
    camera = frame_camera(story, look, [frame], overlay.margins)
    (image,) = draw_frames(story, look, [frame], camera)
    overlay.on(np.asarray(image), poses_of_frame(story.history, frame), camera).save(path, format="PNG", optimize=True)
