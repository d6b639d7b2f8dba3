"""Starts Ray on this machine or joins a cluster, and then restores the settings of this process that Ray changed."""

from __future__ import annotations

import atexit
import ctypes
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
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from petmjx.common.checked_records import option
from petmjx.common.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.common.machine import cpu_threads, cuda_devices
from petmjx.common.text import one_line
from petmjx.engines.remote.worker_resources import Node
from petmjx.options.run_options import AUTO

LONGEST_TEMPORARY = 24
"""Largest length of the path of a folder for temporary files, bytes. Ray creates sockets below this folder, and the
path of a socket may have at most 107 bytes."""

REACH_S = 10.0
"""Longest time for reaching the head (the main machine) of a cluster, s."""

END_S = 5.0
"""Longest time that this process, when it ends, waits for Ray, s. Ray may take a minute to end, if a signal ended Ray's
processes while they were starting."""

_OF_RAY = ("RAY_", "PYTHONBREAKPOINT")
"""Prefixes of the environment variables that Ray sets when it starts."""

_HTTP2_SETTINGS = b"\x00\x00\x00\x04"
"""The first bytes of an empty HTTP/2 settings frame: three bytes of length, and the type."""

_HTTP2_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + _HTTP2_SETTINGS + bytes(5)
"""The first bytes that an HTTP/2 client sends: a fixed text, and an empty settings frame."""

_SIGACTION_BYTES = 1024
"""Size of a buffer that can hold C's ``struct sigaction`` on any system, bytes."""

_SKIPPED_LINES = "RAY_DEDUP_LOGS_SKIP_REGEX"
"""Ray's environment variable that suppresses lines of Ray's log. Ray reads the variable when the package is
imported."""


def import_ray() -> Any:
    """Import the package Ray. If this is the first import, Ray is kept from reporting dead workers on standard output,
    which is reserved for results.

    Raises:
        EngineUnavailable: Ray is not installed, or cannot be imported.
    """
    try:
        with _restored_process():
            os.environ[_SKIPPED_LINES] = "^"
            return importlib.import_module("ray")
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == "ray"
        reason = "Ray is not installed" if missing else one_line(error)
        raise EngineUnavailable(f"workers cannot run here: {reason}: pip install 'petmjx[ray]'") from error


@contextmanager
def _restored_process() -> Iterator[None]:
    """Restores what Ray changes in this process: environment variables, ``sys.excepthook`` and the level of Ray's
    logger."""
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


@contextmanager
def _restored_sigterm() -> Iterator[None]:
    """Restores the handler of SIGTERM. Ray's own handler prints a list of addresses when the process ends, or ends the
    process silently once Ray has ended. In Python, only the main thread may set handlers, and it may be busy reading
    plans. So ``_restored_sigterm`` calls C's ``sigaction``."""
    libc, saved_action = ctypes.CDLL(None), ctypes.create_string_buffer(_SIGACTION_BYTES)
    libc.sigaction(int(signal.SIGTERM), None, saved_action)
    try:
        yield
    finally:
        libc.sigaction(int(signal.SIGTERM), saved_action, None)


class _LocalRay:
    """An instance of Ray that this process starts or joins, and the thread that starts and ends this instance.

    Ray is not started in the main thread, where it would replace the handler of SIGTERM and turn exceptions of signal
    handlers into a bare KeyboardInterrupt. The thread lives as long as Ray, since Ray's processes end with this thread.

    Args:
        address: address of the head of a cluster. If ``address`` is None, a new Ray is started that uses only this
            machine.
    """

    def __init__(self, ray: Any, address: str | None) -> None:
        self.address, self.users = address, 0
        self._ray = ray
        self._folder: Path | None = None
        """Folder for Ray's temporary files, if Ray uses only this machine."""
        self._started: Future[None] = Future()
        self._enough = threading.Event()
        self._thread = threading.Thread(target=self._live, name="petmjx-ray", daemon=True)
        self._thread.start()

    def wait_until_started(self) -> None:
        """Wait until Ray has started. If the wait is interrupted, Ray ends after it has started.

        Raises:
            InputError: there is no cluster at the address.
            EngineUnavailable: Ray cannot start.
        """
        try:
            self._started.result()
        except BaseException:
            self.end()
            raise

    def end(self) -> None:
        """Tell the thread of this instance to stop Ray, or to leave the cluster, as soon as Ray has started. This
        method returns at once."""
        self._enough.set()

    def wait_until_ended(self) -> None:
        """Wait until Ray has ended."""
        self._thread.join()

    def _live(self) -> None:
        # If the process ends from now on, the exit function below waits for Ray. Ray registered its own exit function
        # earlier, so Ray's function runs later.
        atexit.register(self._end_with_process)
        try:
            self._start()
        except BaseException as error:
            self._started.set_exception(error)
        else:
            self._started.set_result(None)
            self._enough.wait()
            with _restored_process(), _restored_sigterm():
                _end_monitor()
                self._ray.shutdown()
        self._remove_folder()
        atexit.unregister(self._end_with_process)

    def _remove_folder(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _end_with_process(self) -> None:
        self.end()
        with suppress(KeyboardInterrupt):
            self._thread.join(END_S)
        if self._thread.is_alive():  # Ray has not ended in time. Ray's processes end with this process.
            atexit.unregister(self._ray.shutdown)  # This function would also wait for Ray.
            self._remove_folder()

    def _start(self) -> None:
        init_options: dict[str, Any] = {"log_to_driver": False, "configure_logging": False}
        if self.address is None:
            temporary = tempfile.gettempdir()
            short = len(os.fsencode(temporary)) <= LONGEST_TEMPORARY
            self._folder = Path(tempfile.mkdtemp(prefix="petmjx-ray-", dir=temporary if short else "/tmp"))
            init_options |= {"address": "local", "num_cpus": cpu_threads(), "num_gpus": len(cuda_devices())}
            init_options |= {"include_dashboard": False, "_temp_dir": str(self._folder)}
        else:
            _check_reachable(self.address)
            init_options |= {"address": self.address}
        with _restored_process(), _restored_sigterm(), warnings.catch_warnings():
            # JAX warns about every fork; Ray's forks are harmless, since each is followed by an exec
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
            os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
            logging.getLogger("ray").setLevel(logging.CRITICAL)
            try:
                self._ray.init(**init_options)
            except Exception as error:
                if isinstance(error, ConnectionError) and self.address == AUTO:
                    raise InputError("ray: no cluster on this machine; name a cluster's head (HOST:PORT)") from error
                if isinstance(error, ConnectionError) and self.address is not None:
                    hint = "if the cluster requires a token, set RAY_AUTH_MODE=token"
                    raise InputError(f"ray: no cluster at {self.address} ({one_line(error)}; {hint})") from error
                raise EngineUnavailable(f"workers cannot run here: Ray does not start: {one_line(error)}") from error


def _end_monitor() -> None:
    """Kill Ray's monitor, if this process started it. (The monitor adds machines to a cluster.) Ray itself would ask
    the monitor to end, get no answer, and wait for a second."""
    with suppress(Exception):  # Ray does not document this interface; if it fails, the end of Ray takes a second longer
        importlib.import_module("ray._private.worker")._global_node.kill_monitor(check_alive=False)


def _check_reachable(address: str) -> None:
    """Raise InputError if no head of a cluster listens at the address. Ray itself would try to connect for ever, and no
    signal would stop it. A head uses HTTP/2 (RFC 9113), so it answers an empty settings frame with its own settings."""
    host, _, port = address.rpartition(":")
    if address == AUTO:
        return
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=REACH_S) as connection:
            if os.environ.get("RAY_USE_TLS", "0") not in ("", "0"):
                return
            connection.sendall(_HTTP2_HELLO)
            answer = connection.makefile("rb").read(len(_HTTP2_SETTINGS))
    except TimeoutError as error:
        raise InputError(f"ray: no cluster at {address} (no answer within {REACH_S:g} s)") from error
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(f"ray: no cluster at {address} ({one_line(error)})") from error
    if answer[3:] != _HTTP2_SETTINGS[3:]:
        raise InputError(f"ray: no cluster at {address} (it is not the head of a Ray cluster)")


class Cluster:
    """Ray's cluster, as one run uses it. Ray allows one cluster per process, so the runs of a process share it. The
    cluster ends when the last run has left it (``leave``).

    If the program that uses petmjx has already started Ray, this Ray is used and is not ended.

    Args:
        address: address of the head of a cluster (HOST:PORT, or ``auto`` for a cluster on this machine). If ``address``
            is None, a new cluster is started that uses only this machine.

    Raises:
        EngineUnavailable: Ray is not installed or cannot start.
        InputError: there is no cluster at the address, or this process already uses another cluster.
    """

    _lock = threading.Lock()
    _latest: _LocalRay | None = None
    """The instance of Ray that this process started or joined last. If no run uses this instance, it is ending."""

    def __init__(self, address: str | None = None) -> None:
        cls = Cluster
        with cls._lock:
            if cls._latest is not None and not cls._latest.users:
                cls._latest.wait_until_ended()
                cls._latest = None
            # Only one thread at a time imports Ray. During its import, Ray changes settings of the process, which
            # ``import_ray`` restores: a second import at the same time would take Ray's settings for the process's own.
            self.ray = import_ray()
            if not self.ray.is_initialized():
                cls._latest = _LocalRay(self.ray, address)
                cls._latest.wait_until_started()
            elif address not in (None, AUTO, self.ray.get_runtime_context().gcs_address):
                raise InputError(f"ray: this process is already in another cluster, so it cannot join {address}")
            self._ours, self._uses = cls._latest, True
            if self._ours is not None:
                self._ours.users += 1

    @property
    def nodes(self) -> list[Node]:
        """The machines of the cluster that are alive."""
        resources = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        return [Node(int(resource.get("CPU", 0)), int(resource.get("GPU", 0))) for resource in resources]

    def check(self) -> None:
        """Raise PetmjxError if this process started Ray and Ray is dead, since nothing would start Ray again. A cluster
        that this process joined is not checked, since its machines may return."""
        if self._uses and self._ours is not None and self._ours.address is None and not self.nodes:
            raise PetmjxError(
                "Ray died on this machine (out of memory?); finished work is kept, continue with "
                f"{option('--resume', 'True')}"
            )

    def leave(self) -> None:
        """Stop using the cluster. Returns at once. If no other run of this process uses the cluster, it takes one or
        two seconds to end."""
        with Cluster._lock:
            uses, self._uses = self._uses, False
            if uses and self._ours is not None:
                self._ours.users -= 1
                if not self._ours.users:
                    self._ours.end()

    def close(self) -> None:
        """Stop using the cluster. If this was the last user, wait until the cluster has ended."""
        self.leave()
        if self._ours is not None and not self._ours.users:
            self._ours.wait_until_ended()
