"""Starts Ray on this machine or joins a cluster, and leaves the process as it was."""

from __future__ import annotations

import importlib
import logging
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from petmjx.basics.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.basics.machine import cpu_threads, cuda_devices
from petmjx.basics.text import one_line
from petmjx.engines.workers.places import Node
from petmjx.options.run_options import AUTO

LONGEST_TEMPORARY = 24
"""Longest name of a folder for temporary files, bytes. Below it Ray makes sockets, whose names may have 107."""

REACH_S = 10.0
"""Longest time to reach the head of a cluster, s."""

_OF_RAY = ("RAY_", "PYTHONBREAKPOINT")
"""Environment variables that Ray sets while it starts."""

_HTTP2_SETTINGS = b"\x00\x00\x00\x04"
"""The beginning of a frame of settings: three bytes of length and its type."""

_HTTP2_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + _HTTP2_SETTINGS + bytes(5)
"""What a client says first, with an empty frame of settings."""

_SKIPPED_LINES = "RAY_DEDUP_LOGS_SKIP_REGEX"
"""Ray's variable for lines that it does not print; it is read when the package is imported."""


def import_ray() -> Any:
    """The package Ray. Imported here first, it does not tell of workers that died on standard output, where only
    results belong.

    Raises:
        EngineUnavailable: it is not installed, or cannot be imported.
    """
    try:
        with _left_as_it_was():
            os.environ[_SKIPPED_LINES] = "^"
            return importlib.import_module("ray")
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == "ray"
        why = "Ray is not installed" if missing else one_line(error)
        raise EngineUnavailable(f"workers cannot run here: {why}: pip install 'petmjx[ray]'") from error


@contextmanager
def _left_as_it_was() -> Iterator[None]:
    """Takes back what Ray changes in the process: variables, ``sys.excepthook``, the level of its logger."""
    environment = {name: value for name, value in os.environ.items() if name.startswith(_OF_RAY)}
    hook, logger = sys.excepthook, logging.getLogger("ray")
    level = logger.level
    try:
        yield
    finally:
        for name in [name for name in os.environ if name.startswith(_OF_RAY)]:
            del os.environ[name]
        os.environ.update(environment)
        sys.excepthook = hook
        logger.setLevel(level)


@dataclass
class _Ours:
    """A Ray that this process has started or joined.

    Attributes:
        thread: starts and ends it. In the main thread Ray would take over SIGTERM, and turn what a handler of signals
            raises into a bare KeyboardInterrupt. The thread lives as long as Ray: with it Ray's processes die.
        folder: its temporary files, if it runs on this machine alone.
    """

    ray: Any
    address: str | None
    thread: ThreadPoolExecutor
    folder: Path | None = None
    users: int = 0

    def start(self) -> None:
        """Start Ray or join the cluster; in the thread.

        Raises:
            InputError: there is no cluster.
            EngineUnavailable: Ray does not start.
        """
        how: dict[str, Any] = {"log_to_driver": False, "configure_logging": False}
        if self.address is None:
            temporary = tempfile.gettempdir()
            short = len(os.fsencode(temporary)) <= LONGEST_TEMPORARY
            self.folder = Path(tempfile.mkdtemp(prefix="petmjx-ray-", dir=temporary if short else "/tmp"))
            how |= {"address": "local", "num_cpus": cpu_threads(), "num_gpus": len(cuda_devices())}
            how |= {"include_dashboard": False, "_temp_dir": str(self.folder)}
        else:
            _check_reachable(self.address)
            how |= {"address": self.address}
        with _left_as_it_was(), warnings.catch_warnings():
            # JAX warns of every fork once it has started; Ray's are followed by an exec
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
            os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
            logging.getLogger("ray").setLevel(logging.CRITICAL)
            try:
                self.ray.init(**how)
            except Exception as error:
                self._remove_folder()
                if isinstance(error, ConnectionError) and self.address == AUTO:
                    raise InputError("ray: no cluster on this machine: name its head (HOST:PORT)") from error
                if isinstance(error, ConnectionError) and self.address is not None:
                    hint = "a cluster that wants a token needs RAY_AUTH_MODE=token"
                    raise InputError(f"ray: no cluster at {self.address} ({one_line(error)}; {hint})") from error
                raise EngineUnavailable(f"workers cannot run here: Ray does not start: {one_line(error)}") from error

    def end(self) -> None:
        """Stop Ray or leave the cluster; in the thread."""
        with _left_as_it_was():
            self.ray.shutdown()
        self._remove_folder()

    def _remove_folder(self) -> None:
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


def _check_reachable(address: str) -> None:
    """Raises InputError if no head listens there: Ray itself would ask again and again without an end, and no signal
    would end it. A head speaks HTTP/2 (RFC 9113): to an empty frame of settings it answers with its own."""
    host, _, port = address.rpartition(":")
    if address == AUTO:
        return
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=REACH_S) as there:
            if os.environ.get("RAY_USE_TLS", "0") not in ("", "0"):
                return
            there.sendall(_HTTP2_HELLO)
            answer = there.makefile("rb").read(len(_HTTP2_SETTINGS))
    except TimeoutError as error:
        raise InputError(f"ray: no cluster at {address} (no answer within {REACH_S:g} s)") from error
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(f"ray: no cluster at {address} ({one_line(error)})") from error
    if answer[3:] != _HTTP2_SETTINGS[3:]:
        raise InputError(f"ray: no cluster at {address} (it is not the head of a Ray cluster)")


class Cluster:
    """A user of the cluster of this process: Ray has one a process. The last user to close it ends it.

    Where the caller's own program has started Ray, that cluster is used and stays.

    Args:
        address: of the cluster's head (HOST:PORT, or ``auto`` for the one on this machine); None: a new one of this
            machine alone.

    Raises:
        EngineUnavailable: Ray is not installed or does not start.
        InputError: there is no cluster, or this process uses another one.
    """

    _lock = threading.Lock()
    _ours: _Ours | None = None

    def __init__(self, address: str | None = None) -> None:
        self.ray = import_ray()
        cls = Cluster
        with cls._lock:
            if not self.ray.is_initialized():
                cls._ours = _started(self.ray, address)
            elif address not in (None, AUTO, self.ray.get_runtime_context().gcs_address):
                raise InputError(f"ray: this process is in another cluster already, {address} cannot be joined")
            self._used = cls._ours
            if self._used is not None:
                self._used.users += 1

    @property
    def nodes(self) -> list[Node]:
        """The machines of the cluster that are alive."""
        resources = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        return [Node(int(each.get("CPU", 0)), int(each.get("GPU", 0))) for each in resources]

    def check(self) -> None:
        """Raises PetmjxError if the Ray that this process has started is dead: nothing starts it again. The machines of
        a cluster may come back."""
        if self._used is not None and self._used.address is None and not self.nodes:
            raise PetmjxError(
                "Ray died on this machine (out of memory?); finished work is kept, continue with --resume"
            )

    def close(self) -> None:
        """This user needs it no more."""
        used, self._used = self._used, None
        if used is None:
            return
        with Cluster._lock:
            used.users -= 1
            if used.users == 0:
                Cluster._ours = None
                used.thread.submit(used.end).result()
                used.thread.shutdown()


def _started(ray: Any, address: str | None) -> _Ours:
    ours = _Ours(ray, address, ThreadPoolExecutor(1, thread_name_prefix="petmjx-ray"))
    starting = ours.thread.submit(ours.start)
    try:
        starting.result()
    except BaseException:
        if not starting.done():  # interrupted; the thread goes on
            ours.thread.submit(ours.end)
        ours.thread.shutdown(wait=False)
        raise
    finally:
        _take_back_sigterm()
    return ours


def _take_back_sigterm() -> None:
    """Put Python's own handler back: Ray's native code has one that ends the process with a list of addresses.

    Only the main thread can do it. A program that starts runs in other threads keeps Ray's.
    """
    handler = signal.getsignal(signal.SIGTERM)
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)
