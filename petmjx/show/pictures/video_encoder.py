"""Encodes films in H.264 by writing frames into the ffmpeg of imageio-ffmpeg.

The writer of imageio-ffmpeg starts ffmpeg with a function that runs between fork and exec, which is unsafe with
threads. If JAX is loaded, as after a run on a GPU, it warns of a deadlock. So ffmpeg is started here, without such a
function.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile


@contextmanager
def h264_encoder(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[bytes], None]]:
    """A context with a function that takes the frames of a film, in order. At its end the file is complete.

    Args:
        path: the file to write; an existing one is replaced.
        size: width and height, px; both even.
        fps: frames per second.

    Yields:
        A function of one frame's bytes: rows from above, red, green and blue of each pixel.

    Raises:
        RuntimeError: ffmpeg is missing or failed; the message is its last line.
        OSError: it cannot be started.
    """
    import imageio_ffmpeg

    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-",
        "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-preset", "medium", "-movflags", "+faststart",
        f"file:{path}",  # a name such as "a:b.mp4" would be read as a protocol
    ]  # fmt: skip
    with TemporaryFile() as error_output:
        # a new session, so that Ctrl-C only reaches petmjx, which then ends ffmpeg
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
            pass  # ffmpeg reports the reason
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
    """ffmpeg ended before the film did."""
