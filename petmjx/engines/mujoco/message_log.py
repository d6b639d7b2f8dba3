"""Keeps MuJoCo's messages out of the terminal and out of files."""

from __future__ import annotations

import threading
from typing import Final

import mujoco


class QuietMujoco:
    """While a run is active, MuJoCo does not print, and does not write MUJOCO_LOG.TXT into the current folder.

    petmjx reads MuJoCo's warnings (bad numbers, full buffers) from MuJoCo's data instead, and turns them into flags in
    the results. MuJoCo's setting applies to the whole process. The first active run changes the setting, and the end of
    the last active run restores it.
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
