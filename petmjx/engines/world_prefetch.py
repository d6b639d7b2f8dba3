"""``WorldPrefetch``: the thread that makes the worlds of a run before the engine needs them, and the limits on how many
worlds wait."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any, Final, Generic

from petmjx.engines.job_stream import JobStream
from petmjx.engines.world_results import AnyWorld

PENDING_BOXES: Final = 1 << 20
"""The thread that makes worlds pauses while the waiting jobs have at least this number of boxes in total. The scenes of
this number of boxes take 130 MB."""

PENDING_BOXES_GPU: Final = 1 << 17
"""The number that replaces ``PENDING_BOXES`` if a GPU takes the jobs, about the boxes of 3,000 plans of 43 boxes. With
a larger number, the first time slice of the GPU would begin later. Until then, the thread that makes worlds and the
thread that loads them onto the GPU take turns, since both need Python's global lock."""

PAUSE_S: Final = 0.02
"""Interval at which the paused thread checks whether it may make worlds again, s."""


class WorldPrefetch(Generic[AnyWorld]):
    """A thread that makes worlds before the engine needs them.

    Args:
        deliver: function that puts a world's job into the stream. ``deliver`` waits while the stream is full, and
            returns False if the stream is closed.
        has_room: function that returns False while too many worlds wait for further attempts or for the fallback
            engine. While ``has_room`` returns False, the thread pauses.
    """

    def __init__(
        self,
        worlds: Iterable[AnyWorld],
        deliver: Callable[[AnyWorld], bool],
        stream: JobStream[Any],
        has_room: Callable[[], bool],
    ) -> None:
        self._worlds, self._deliver, self._stream, self._has_room = worlds, deliver, stream, has_room
        self._error: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="petmjx-source", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def raise_error(self) -> None:
        """Raise the exception that the making of worlds raised, if any."""
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Stop making worlds, and wait until the thread has ended."""
        self._stop.set()
        self._stream.close()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            for world in self._worlds:
                if not self._deliver(world) or self._stop.is_set():
                    return
                if not self._has_room():
                    self._stream.pause()
                    while not self._has_room() and not self._stop.wait(PAUSE_S):
                        pass
                    self._stream.pause(False)
        except BaseException as error:
            self._error = error
        finally:
            self._stream.close()
