"""Keeps MuJoCo's messages off the terminal and out of files."""

from __future__ import annotations

import threading
from typing import Final

import mujoco


class QuietMujoco:
    """Stops MuJoCo from printing, and from writing MUJOCO_LOG.TXT into the current folder, while a run is active.

    MuJoCo's messages (bad numbers, full buffers) are read from its data instead, and become flags in the results. This
    setting applies to the whole process. The first run changes the setting, and the last run restores it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._runs = 0
        self._before: mujoco.MjLogConfig | None = None

    def __enter__(self) -> None:
        with self._lock:
            if self._runs == 0:
                self._before = mujoco.MjLogConfig.get()
                silent = mujoco.MjLogConfig.get()
                silent.logto_console = False
                silent.logto_file = False
                mujoco.MjLogConfig.set(silent)
            self._runs += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._runs -= 1
            if self._runs == 0:
                mujoco.MjLogConfig.set(self._before)


QUIET_MUJOCO: Final = QuietMujoco()
