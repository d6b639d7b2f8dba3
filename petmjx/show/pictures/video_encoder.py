"""Encodes films in H.264 with the ffmpeg of imageio-ffmpeg.

When imageio-ffmpeg starts ffmpeg, it runs a Python function between fork and exec. A Python function between fork and
exec is unsafe if the process has threads: after a run on a GPU, JAX warns of a deadlock. So this module starts ffmpeg
itself, without any function between fork and exec.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile


@contextmanager
def h264_encoder(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[bytes], None]]:
    """A context that yields a function, which writes the frames of a film, one after another. When the context ends,
    the file is complete.

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
