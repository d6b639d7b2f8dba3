"""Films of a story (the simulation of one plan), written frame by frame: GIF with Pillow, and MP4 (H.264) with the
ffmpeg of imageio-ffmpeg."""

from __future__ import annotations

import errno
import math
import os
import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story
from petmjx.common.errors import InputError
from petmjx.common.text import one_line
from petmjx.show.pictures.camera import framing
from petmjx.show.pictures.draw_story import Painter, PictureStyle, framed_points
from petmjx.show.pictures.overlay import Overlay
from petmjx.show.pictures.story_poses import poses_at

if TYPE_CHECKING:
    from PIL.Image import Image

HELD_S: Final = 2.0
"""Time for which a film shows its last frame, s."""

USUAL_LONGEST_S: Final = 20.0
"""Longest duration of a film if no speed is given, s. A film that would last longer in real time runs faster than real
time."""

MOST_FRAMED: Final = 400
"""Largest number of frames of the history that determine where the camera of a film stands. These frames are spread
evenly over the history."""

GIF_COLOURS: Final = 255
"""Number of colours in a GIF. The last of the 256 possible colours marks pixels that do not change."""


def film_times(story: Story, speed: float, fps: float) -> list[float]:
    """The times of a film's frames, s, from the first frame of the story to its last frame."""
    first, last = float(story.history.time_s[0]), float(story.history.time_s[-1])
    count = math.floor((last - first) * fps / speed + 1e-9)
    times = [first + number * speed / fps for number in range(count + 1)]
    return times if times[-1] >= last - 1e-9 else [*times, last]


def usual_speed(story: Story) -> float:
    """The smallest speed with which a film lasts at most ``USUAL_LONGEST_S``, as a whole multiple of real time."""
    lasts_s = float(story.history.time_s[-1] - story.history.time_s[0])
    return float(max(1, math.ceil(lasts_s / USUAL_LONGEST_S)))


def spread_times(story: Story) -> list[float]:
    """Times of a story, s, whose pictures together contain all colours of the film: some while boxes are placed, and
    some while boxes fall."""
    first, last = float(story.history.time_s[0]), float(story.history.time_s[-1])
    signs = [story.outcome.first_sign_s] if math.isfinite(story.outcome.first_sign_s) else []
    return sorted([first + share * (last - first) for share in (0.25, 0.5, 0.75, 1.0)] + signs)


def film_frames(look: PictureStyle, speed: float, times: list[float]) -> Iterator[Image]:
    """The pictures of a film at the given times, s. The camera does not move, and shows the whole story."""
    count = len(look.story.history.time_s)
    framed_numbers = {*range(0, count, math.ceil(count / MOST_FRAMED)), count - 1}
    overlay = Overlay(look, speed)
    camera = framing(framed_points(look.story, sorted(framed_numbers)), look.view, look.size, overlay.margins)
    with Painter(look) as painter:
        for time_s in times:
            poses = poses_at(look.story.history, time_s)
            yield overlay.on(painter.picture(poses, camera), poses, camera)


def palette_of(frames: Iterable[Image]) -> Image:
    """The palette of a GIF, made from some of its frames: 255 colours, of which one is white. The index 255, after
    these colours, marks pixels that do not change."""
    from PIL import Image

    sample_frames = list(frames)
    sheet = Image.new("RGB", (sample_frames[0].width, sum(frame.height for frame in sample_frames)))
    for number, frame in enumerate(sample_frames):
        sheet.paste(frame, (0, number * frame.height))
    palette = sheet.quantize(GIF_COLOURS)
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[np.abs(colours - 255).sum(axis=1).argmin()] = 255
    palette.putpalette(colours.ravel().tolist())
    return palette


def write_gif(frames: Iterator[Image], count: int, path: Path, palette: Image, fps: float) -> None:
    """Write a film of ``count`` frames that repeats. Each frame contains only the pixels that change, which keeps the
    file small.

    GIF stores durations of frames in hundredths of a second. The durations are rounded so that their sum is right.
    """
    from PIL import Image
    from PIL.GifImagePlugin import getdata, getheader

    previous: NDArray[np.uint8] | None = None
    shown = 0
    with path.open("wb") as file:
        for number, frame in enumerate(frames, start=1):
            pixels = _colour_indices(frame, palette)
            until = round(100 * number / fps) + (round(100 * HELD_S) if number == count else 0)
            wait, shown = 10 * (until - shown), until
            if previous is None:
                first = Image.fromarray(pixels)
                first.putpalette(palette.getpalette() or [])
                header, _ = getheader(first, info={"loop": 0})
                file.writelines(header)
                file.writelines(getdata(first, duration=wait, disposal=1))
            else:
                part, offset = _changes(previous, pixels)
                file.writelines(getdata(part, offset, duration=wait, disposal=1, transparency=GIF_COLOURS))
            previous = pixels
        file.write(b";")


def write_mp4(frames: Iterator[Image], path: Path, size: tuple[int, int], fps: float) -> None:
    """Write a film in H.264, which all browsers and office programs can play. The width and the height must be even.

    Raises:
        InputError: the encoder is missing or fails.
    """
    try:
        with h264_encoder(path, size, fps) as add:
            for frame in frames:
                pixels = frame.tobytes()
                add(pixels)
            for _ in range(round(HELD_S * fps)):
                add(pixels)
    except (RuntimeError, OSError) as error:
        full = os.strerror(errno.ENOSPC)  # ffmpeg is a process of its own, and reports a full disk in its output
        fault = f"cannot be written: {full}" if full in str(error) else f"the film cannot be encoded: {one_line(error)}"
        raise InputError(f"{path}: {fault}") from error


@contextmanager
def h264_encoder(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[bytes], None]]:
    """A context that yields a function, which writes the next frame of a film. When the context ends, the file is
    complete.

    imageio-ffmpeg itself would start ffmpeg with a Python function between fork and exec. A Python function between
    fork and exec is unsafe if the process has threads: after a run on a GPU, JAX warns of a deadlock. So petmjx itself
    starts ffmpeg, without a Python function between fork and exec.

    Args:
        path: the file to write. An existing file is replaced.
        size: width and height of the frames, px. Width and height must be even.
        fps: frames per second.

    Yields:
        A function that accepts the bytes of one frame: rows from the top, with red, green and blue for each pixel.

    Raises:
        RuntimeError: ffmpeg is missing or failed. The message is the last line of ffmpeg's output.
        OSError: ffmpeg cannot be started.
    """
    import imageio_ffmpeg

    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-",
        "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-preset", "medium", "-movflags", "+faststart",
        f"file:{path}",  # otherwise "a:b.mp4" would be read as a protocol
    ]  # fmt: skip
    with TemporaryFile() as error_output:
        # ffmpeg runs in a new session, so that Ctrl-C reaches only petmjx, which then ends ffmpeg
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=error_output, start_new_session=True
        )
        frames = process.stdin
        assert frames is not None

        def add(frame: bytes) -> None:
            try:
                frames.write(frame)
            except BrokenPipeError:
                raise _EncoderExit from None

        try:
            yield add
        except _EncoderExit:
            pass  # ffmpeg's output contains the reason
        except BaseException:
            process.kill()
            raise
        finally:
            with suppress(BrokenPipeError):
                frames.close()
            process.wait()
        if process.returncode:
            error_output.seek(0)
            lines = error_output.read().decode(errors="replace").splitlines()
            raise RuntimeError(next((line for line in reversed(lines) if line.strip()), "ffmpeg gave up"))


class _EncoderExit(Exception):
    """Raised if ffmpeg exited before the film was complete."""


def _colour_indices(frame: Image, palette: Image) -> NDArray[np.uint8]:
    """(height, width) for each pixel, the index of its colour in the palette. White pixels get exactly white, since
    Pillow would choose a similar colour."""
    from PIL import Image

    indices = np.array(frame.quantize(palette=palette, dither=Image.Dither.NONE), dtype=np.uint8)
    whitest = int(np.array(palette.getpalette()).reshape(-1, 3).sum(axis=1).argmax())
    indices[(np.asarray(frame) == 255).all(axis=2)] = whitest
    return indices


def _changes(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> tuple[Image, tuple[int, int]]:
    """The smallest rectangle of a picture that contains all changed pixels, and its position (x, y). In the rectangle,
    unchanged pixels are transparent."""
    from PIL import Image

    changed = before != after
    rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        rows = columns = np.zeros(1, dtype=np.intp)
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    part = Image.fromarray(np.where(changed[box], after[box], GIF_COLOURS).astype(np.uint8))
    return part, (int(columns[0]), int(rows[0]))
