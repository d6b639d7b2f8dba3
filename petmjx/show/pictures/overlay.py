"""Texts in a picture (the plan and its verdict, the time, the legend), and the outline of the first box to fail."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story
from petmjx.analysis.story_in_words import headline
from petmjx.common.convex_hull import convex_hull
from petmjx.common.text import count_text, printable, three_digits
from petmjx.common.units import FloatArray
from petmjx.show.pages.palette import Rgb
from petmjx.show.pictures.box_colours import FIRST, Scale, ramp_colours
from petmjx.show.pictures.camera import Camera, Margins
from petmjx.show.pictures.draw_story import LEAST_LEVEL_G, PictureStyle
from petmjx.show.pictures.story_poses import Poses, shaking_g
from petmjx.world.rotation import corners, rotations

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

INK: Final = (30, 30, 30)
FAINT: Final = (95, 95, 95)

LINE: Final = 1.6
"""Height of a line in the legend, as a multiple of the text size."""

_LEAST_FONT_PX: Final = 10


class Overlay:
    """Draws texts, and an outline around the first box to fail, onto pictures of one size.

    Args:
        speed: speed of a film, as a multiple of real time; None for a single picture.
    """

    def __init__(self, look: PictureStyle, speed: float | None = None) -> None:
        self.story, self.colours, self.arrows = look.story, look.colours, look.arrows
        self.width, self.height = look.size
        self.pace = "" if speed in (None, 1.0) else f"  ×{speed:g}"
        self.text_px = max(_LEAST_FONT_PX, round(min(self.height, 1.2 * self.width) / 38))

    @property
    def margins(self) -> Margins:
        """The strips at the top and the bottom of the picture that texts need, and small margins at the sides."""
        lines = (1 if self.arrows else 0) + (len(self._lines_of_names()) if self.colours.names else 1)
        em = self.text_px / self.height
        return Margins(left=0.05, right=0.05, top=min(5.6 * em, 0.45), bottom=min((1.5 + LINE * lines) * em, 0.45))

    def on(self, pixels: NDArray[np.uint8], poses: Poses, camera: Camera) -> Image:
        """The picture with all texts and the outline."""
        from PIL import Image, ImageDraw

        image = Image.fromarray(pixels)
        pen = ImageDraw.Draw(image)
        self._outline(image, poses, camera)
        self._head(pen, poses)
        self._legend(image, pen)
        return image

    def _head(self, pen: ImageDraw, poses: Poses) -> None:
        em = self.text_px
        room = self.width - 2 * em
        bold, plain = font(round(1.15 * em), bold=True), font(em)
        pen.text((em, 0.7 * em), fitted_text(self.story.name, bold, room), fill=INK, font=bold)
        failed = self.story.outcome.culprit >= 0
        line = fitted_text(printable(headline(self.story)), plain, room)
        pen.text((em, 2.2 * em), line, fill=_rgb_bytes(FIRST) if failed else FAINT, font=plain)
        now = f"{poses.time_s:.2f} s{self.pace}   {state_in_words(self.story, poses)}"
        pen.text((em, 3.6 * em), now, fill=INK, font=plain)

    def _outline(self, image: Image, poses: Poses, camera: Camera) -> None:
        """Draw an outline around the first box to fail, even if other boxes hide this box. The outline is drawn larger
        and then reduced, because Pillow draws jagged lines."""
        from PIL import Image, ImageDraw

        outline = first_outline(self.story, poses, camera)
        if outline is None:
            return
        fine, wide = 3, max(2.0, self.text_px / 7)
        low = np.floor(np.clip(outline.min(axis=0) - 2 * wide, 0, image.size)).astype(int)
        high = np.ceil(np.clip(outline.max(axis=0) + 2 * wide, 0, image.size)).astype(int)
        if (high <= low).any():
            return
        wide_px, high_px = (int(part) for part in high - low)
        mask = Image.new("L", (fine * wide_px, fine * high_px))
        points = [tuple(point) for point in fine * (np.vstack((outline, outline[:2])) - low)]
        ImageDraw.Draw(mask).line(points, fill=255, width=round(fine * wide), joint="curve")
        reduced = mask.resize((wide_px, high_px), Image.Resampling.BOX)
        image.paste(_rgb_bytes(FIRST), (int(low[0]), int(low[1])), reduced)

    def _legend(self, image: Image, pen: ImageDraw) -> None:
        em, plain = self.text_px, font(self.text_px)
        bottom = self.height - 0.9 * em
        if self.arrows:
            pen.text((em, bottom - em), fitted_text(self.arrows, plain, self.width - em), fill=FAINT, font=plain)
            bottom -= LINE * em
        if self.colours.scale is not None:
            self._bar(image, pen, self.colours.scale, bottom - em)
        elif self.colours.names:
            self._swatches(pen, bottom)
        else:
            pen.text((em, bottom - em), fitted_text(self.colours.note, plain, self.width - em), fill=FAINT, font=plain)

    def _bar(self, image: Image, pen: ImageDraw, scale: Scale, top: float) -> None:
        from PIL import Image

        em, plain = self.text_px, font(self.text_px)
        length = round(min(14 * em, self.width / 3))
        ramp = ramp_colours(np.linspace(0.0, 1.0, length))
        stripe = np.tile(np.round(255 * ramp).astype(np.uint8), (em, 1, 1))
        low, high = scale_ends(scale)
        left = em + plain.getlength(low) + 0.4 * em
        pen.text((em, top), low, fill=INK, font=plain)
        image.paste(Image.fromarray(stripe), (round(left), round(top + 0.12 * em)))
        after = left + length + 0.4 * em
        pen.text((after, top), fitted_text(f"{high}   {scale.label}", plain, self.width - after), fill=INK, font=plain)

    def _swatches(self, pen: ImageDraw, bottom: float) -> None:
        """Draw the names in the legend with their colours. The lower edge of the last line is at ``bottom``, px."""
        em, plain = self.text_px, font(self.text_px)
        lines = self._lines_of_names()
        for row, entries in enumerate(lines):
            top = bottom - em - (len(lines) - 1 - row) * LINE * em
            for text, rgb, left in entries:
                square = (left, top + 0.12 * em, left + em, top + 1.12 * em)
                inside, edge = ((255, 255, 255), _rgb_bytes(rgb)) if self.colours.outlined else (_rgb_bytes(rgb), INK)
                pen.rectangle(square, fill=inside, outline=edge, width=max(1, em // 10))
                pen.text((left + 1.4 * em, top), text, fill=INK, font=plain)

    def _lines_of_names(self) -> list[list[tuple[str, Rgb, float]]]:
        """(name, colour, left end in px) of each name in the legend, for each line of the legend."""
        em, plain = self.text_px, font(self.text_px)
        lines: list[list[tuple[str, Rgb, float]]] = [[]]
        left = float(em)
        for name, rgb in self.colours.names:
            text = fitted_text(printable(name), plain, self.width - 4 * em)
            needed = plain.getlength(text) + 2.6 * em
            if left + needed > self.width and lines[-1]:
                lines.append([])
                left = float(em)
            lines[-1].append((text, rgb, left))
            left += needed
        return lines


def state_in_words(story: Story, poses: Poses) -> str:
    """Text such as "3 of 8 boxes", or "8 of 8 boxes, shaken by 0.50 g" while something shakes the carrier."""
    level = float(np.linalg.norm(shaking_g(story, poses)))
    shaken = f", shaken by {level:.2f} g" if level > LEAST_LEVEL_G else ""
    return f"{poses.n_placed} of {count_text(story.plan.n_boxes, 'box', 'boxes')}{shaken}"


def scale_ends(scale: Scale) -> tuple[str, str]:
    """The values at the two ends of a scale of colours, as text."""
    return three_digits(scale.low), ("≥ " if scale.open_end else "") + three_digits(scale.high)


def first_outline(story: Story, poses: Poses, camera: Camera) -> FloatArray | None:
    """(k, 2) corners of the outline of the first box to fail, px. The result is None if no box failed, or if the box
    that fails first is not yet placed in the frame with these poses."""
    box = story.outcome.culprit
    if not 0 <= box < poses.n_placed:
        return None
    alone = slice(box, box + 1)
    points = corners(poses.pos[alone], rotations(poses.quat[alone]), story.scene.half_size[alone])[0]
    if not ((points - camera.pos) @ camera.forward > 0).all():  # a point is behind the camera, or NaN
        return None
    return np.array(convex_hull([(x, y) for x, y in camera.project(points).tolist()]))


@functools.cache
def font(size_px: int, bold: bool = False) -> Any:
    """The font DejaVu Sans, which is part of matplotlib."""
    import matplotlib
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size_px)


def fitted_text(text: str, face: Any, room_px: float) -> str:
    """A text that is at most ``room_px`` wide. A wider text is shortened in its middle."""
    if face.getlength(text) <= room_px:
        return text
    for n_characters in range(len(text) - 1, 0, -1):
        short = f"{text[: (n_characters + 1) // 2]}…{text[len(text) - n_characters // 2 :]}"
        if face.getlength(short) <= room_px:
            return short
    return "…"


def _rgb_bytes(rgb: Rgb) -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in rgb)
    return red, green, blue
