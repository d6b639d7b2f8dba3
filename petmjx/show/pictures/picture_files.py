"""``petmjx.draw``: draws a story (the simulation of one plan) into files. The suffix of a file determines its kind."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from petmjx.analysis.story import Story
from petmjx.common.argument_checks import path_of
from petmjx.common.atomic_write import atomic_write, check_writable
from petmjx.common.errors import InputError
from petmjx.common.text import one_line, printable
from petmjx.show.figures.figure_style import kind_of
from petmjx.show.pictures.box_colours import colouring
from petmjx.show.pictures.camera import view_of
from petmjx.show.pictures.picture_options import GIF_SIZE, MP4_SIZE, PANEL_SIZE, STILL_SIZE, PictureOptions, size_of
from petmjx.show.pictures.story_poses import moments

if TYPE_CHECKING:
    from PIL.Image import Image

Progress = Callable[[int, int], None]
"""A function that is called with the number of finished frames of a film, and the number of all its frames."""

KINDS: Final = ("png", "pdf", "svg", "gif", "mp4", "html", "rrd")
"""Suffixes of the files into which a story can be drawn."""

_NEEDS: Final = {
    **dict.fromkeys(("png", "pdf", "svg", "gif"), ("show", ("PIL", "matplotlib", "OpenGL"))),
    "mp4": ("show", ("PIL", "matplotlib", "OpenGL", "imageio_ffmpeg")),
    "html": ("show", ()),
    "rrd": ("rerun", ("rerun",)),
}
"""Kind of file → petmjx's extra that must be installed (``pip install 'petmjx[show]'``), and modules of this extra that
are needed."""


def draw(story: Story, *files: str | os.PathLike[str], progress: Progress | None = None, **options: Any) -> list[Path]:
    """Draw a story: pictures (``.png``; rows of them also as ``.pdf`` and ``.svg``), films (``.gif``, ``.mp4``), a page
    (``.html``), or a recording for rerun's viewer (``.rrd``). No display is needed.

    ``petmjx.draw(petmjx.tell("s0-000016"), "collapse.png", "collapse.mp4", colour="shift", view="front")``

    Args:
        story: the story, from ``petmjx.tell``.
        files: paths to write. The suffix determines the format. Existing files are replaced. A file appears only when
            it is complete.
        progress: function that is called while films are drawn, with the number of finished frames and of all frames.
        options: fields of ``PictureOptions``: at, view, size, colour, arrows, speed, fps.

    Returns:
        The paths of the files.

    Raises:
        InputError: a suffix or option is unknown, a moment is outside the story, a file cannot be written, or a library
            is missing.
    """
    look = PictureOptions(**options)
    paths = [path_of(file, "files") for file in files]
    check_files(paths)
    for path in paths:
        with atomic_write(path) as temporary:
            _WRITERS[kind_of(path, KINDS)](story, temporary, look, progress)
    return paths


def check_files(paths: Sequence[Path]) -> None:
    """Check that files can be drawn and written. Call this function before the simulation, which may take long.

    Raises:
        InputError: a path cannot be written, or libraries for a kind of file are missing.
    """
    for path in paths:
        if missing := _missing(kind_of(path, KINDS)):
            raise InputError(f"{printable(str(path))}: {missing}")
        check_writable(path)
    if len({path.absolute() for path in paths}) < len(paths):
        raise InputError("the same file is named twice")


def why_nothing_is_drawn() -> str:
    """Why this machine cannot draw pictures and films; "" if it can."""
    if missing := _missing("png"):
        return missing
    try:
        from petmjx.show.pictures.offscreen import why_no_pictures
    except Exception as error:  # importing mujoco fails if the library that MUJOCO_GL names does not work
        return f"MUJOCO_GL={os.environ.get('MUJOCO_GL', '')} does not work here ({one_line(error)}): unset it"
    return why_no_pictures()


def _missing(kind: str) -> str:
    """A line about modules that are missing for a kind of file, and how to install them; "" if none is missing."""
    extra, modules = _NEEDS[kind]
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    return f"needs {', '.join(missing)}, not installed: pip install 'petmjx[{extra}]'" if missing else ""


def check_drawing(paths: Sequence[Path]) -> None:
    """Check that files can be drawn and written, as ``check_files`` does. For pictures and films, also check that
    OpenGL works.

    Raises:
        InputError: a check of ``check_files`` fails, or there is no OpenGL that can draw without a display.
    """
    check_files(paths)
    drawn = [path for path in paths if "OpenGL" in _NEEDS[kind_of(path, KINDS)][1]]
    if drawn and (reason := why_nothing_is_drawn()):
        raise InputError(f"{printable(str(drawn[0]))}: {reason}")


def _write_pictures(story: Story, path: Path, options: PictureOptions, progress: Progress | None) -> None:
    """Write a single picture, or a figure with several pictures in a row. PDF and SVG files are always figures."""
    from petmjx.show.pictures.figure_row import write_figure
    from petmjx.show.pictures.still_pictures import write_still

    kind, chosen_moments = kind_of(path, KINDS), moments(story, options.at)
    if kind == "png" and len(chosen_moments) == 1:
        write_still(_look(story, options, STILL_SIZE), chosen_moments[0].frame, path)
    else:
        write_figure(_look(story, options, PANEL_SIZE), chosen_moments, path, kind)


def _write_film(story: Story, path: Path, options: PictureOptions, progress: Progress | None) -> None:
    from petmjx.show.pictures import animation

    kind = kind_of(path, KINDS)
    look = _look(story, options, GIF_SIZE if kind == "gif" else MP4_SIZE)
    speed = options.speed or animation.usual_speed(story)
    times = animation.film_times(story, speed, options.fps)

    def frames() -> Iterator[Image]:
        for done, frame in enumerate(animation.film_frames(look, speed, times), start=1):
            yield frame
            if progress is not None:
                progress(done, len(times))

    if kind == "gif":
        palette = animation.palette_of(animation.film_frames(look, speed, animation.spread_times(story)))
        animation.write_gif(frames(), len(times), path, palette, options.fps)
    else:
        width, height = look.size
        look = replace(look, size=(width - width % 2, height - height % 2))  # H.264 needs even sides
        animation.write_mp4(frames(), path, look.size, options.fps)


def _look(story: Story, options: PictureOptions, usual_size: tuple[int, int]) -> Any:
    from petmjx.show.pictures.draw_story import PictureStyle, newtons_per_m

    size = usual_size if options.size is None else size_of(options.size)
    scale = newtons_per_m(story) if options.arrows else None
    return PictureStyle(colouring(story, options.colour), view_of(options.view), size, scale)


def _write_recording(story: Story, path: Path, options: PictureOptions, progress: Progress | None) -> None:
    from petmjx.show.pictures.rerun_recording import write_recording

    write_recording(story, colouring(story, options.colour), path)


def _write_page(story: Story, path: Path, options: PictureOptions, progress: Progress | None) -> None:
    from petmjx.show.pages.story_page import story_page

    path.write_text(story_page(story), encoding="utf-8")


_WRITERS: Final = {
    **dict.fromkeys(("png", "pdf", "svg"), _write_pictures),
    **dict.fromkeys(("gif", "mp4"), _write_film),
    "html": _write_page,
    "rrd": _write_recording,
}
