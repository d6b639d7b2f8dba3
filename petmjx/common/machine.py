"""The hardware and software of this machine: CPU threads, CUDA devices, package versions.

Importing this module does not import JAX. Functions that need JAX import it themselves.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import importlib.util
import os
import platform
import sys
import threading
from pathlib import Path
from typing import Any

from petmjx.common.compile_caches import why_no_folder
from petmjx.common.text import count_text
from petmjx.version import __version__

PACKAGES = ("mujoco", "mujoco-mjx", "jax", "jaxlib", "warp-lang", "numpy", "pandas", "pyarrow")
"""Packages whose versions are stored with every result, in addition to the version of petmjx."""

_NAME_BYTES = 128

_ATTRIBUTES = (75, 76, 97)
"""Numbers of attributes in CUDA's driver (``CUdevice_attribute``): the major and the minor compute capability, and the
largest shared memory that a thread block can request."""

_PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
_STARTING_JAX = threading.Lock()


def cpu_threads() -> int:
    """Number of threads that this process may run at the same time. If the operating system restricts processes to
    certain CPUs (CPU affinity), only these CPUs are counted."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def own_environment() -> dict[str, str]:
    """Environment variables with which another Python interpreter imports the same modules as this interpreter."""
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    # With PYTHONSAFEPATH, no file in the current folder hides a module.
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}


@functools.cache
def cpu_name() -> str:
    """The name of the processor, or the processor's architecture if the system does not know the name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


@functools.cache
def cuda_devices() -> tuple[str, ...]:
    """Names of the CUDA devices according to the driver. Asking the driver takes milliseconds and allocates no device
    memory."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return ()
    count = ctypes.c_int(0)
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0:
        return ()
    names = []
    for ordinal in range(count.value):
        device = ctypes.c_int(0)
        name = ctypes.create_string_buffer(_NAME_BYTES)
        if driver.cuDeviceGet(ctypes.byref(device), ordinal) == 0:
            driver.cuDeviceGetName(name, _NAME_BYTES, device)
        names.append(name.value.decode(errors="replace") or "unknown CUDA device")
    return tuple(names)


@functools.cache
def cuda_limits() -> tuple[int, int] | None:
    """Two numbers of the first CUDA device: its compute capability times ten, such as 90, and the largest shared memory
    of a thread block, bytes. The result is None if there is no device, or if the driver does not answer."""
    if not cuda_devices():
        return None
    driver, device = ctypes.CDLL("libcuda.so.1"), ctypes.c_int(0)
    values = [ctypes.c_int(0) for _ in _ATTRIBUTES]
    if driver.cuDeviceGet(ctypes.byref(device), 0) != 0:
        return None
    for value, attribute in zip(values, _ATTRIBUTES, strict=True):
        if driver.cuDeviceGetAttribute(ctypes.byref(value), attribute, device) != 0:
            return None
    major, minor, shared_bytes = (value.value for value in values)
    return 10 * major + minor, shared_bytes


def jax_devices(platform: str | None = None) -> list[Any]:
    """JAX's devices. JAX is started in a way that leaves device memory for Warp.

    When JAX first searches for its devices, XLA reserves three quarters of a GPU's memory unless an environment
    variable forbids it. petmjx sets this variable only while JAX lists the devices. If the user has set the variable,
    its value stays.

    Args:
        platform: one of JAX's platforms, such as "cuda". If ``platform`` is None, JAX chooses the platform.

    Raises:
        RuntimeError: JAX has no device of this platform.
    """
    import jax

    with _STARTING_JAX:
        unset = _PREALLOCATE not in os.environ
        if unset:
            os.environ[_PREALLOCATE] = "false"
        try:
            devices: list[Any] = jax.devices(platform)
        finally:
            if unset:
                del os.environ[_PREALLOCATE]
    return devices


def package_versions() -> dict[str, str]:
    """Name of a package → its version, for petmjx and for all installed packages among ``PACKAGES``. The results of
    simulations depend on these versions."""
    return dict(_package_versions())


@functools.cache
def _package_versions() -> dict[str, str]:
    # petmjx's version comes from the code, since the metadata of an editable installation may be outdated
    versions = {"petmjx": __version__}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def device_name(engine: str, threads: int | None = None) -> str:
    """The name of the device on which an engine simulates.

    Args:
        threads: number of threads that an engine on the CPU uses. If ``threads`` is None, the engine uses all threads.
    """
    if engine == "mjx-warp" and cuda_devices():
        return cuda_devices()[0]
    if engine == "mjx-jax":
        device = jax_devices()[0]
        return device.device_kind if device.platform != "cpu" else f"{cpu_name()} (jax on {device.platform})"
    return f"{cpu_name()}, {count_text(threads or cpu_threads(), 'thread')}"


def why_no_warp_at_once() -> str | None:
    """The reason why the engine mjx-warp cannot run on this machine, as far as this can be found out without importing
    JAX. Importing JAX would take seconds.

    The result is None if no reason was found.
    """
    if not cuda_devices():
        return "no CUDA device (or no driver) on this machine"
    if importlib.util.find_spec("warp") is None:
        return "Warp is not installed: pip install 'petmjx[cuda]'"
    return why_no_folder("warp")


def why_no_warp() -> str | None:
    """The reason why the engine mjx-warp cannot run on this machine; None if it can. JAX is imported only if there is a
    CUDA device and Warp is installed."""
    if problem := why_no_warp_at_once():
        return problem
    try:
        jax_devices("cuda")
    except RuntimeError as error:
        return f"jax sees no CUDA device: {' '.join(str(error).split())}; pip install 'petmjx[cuda]'"
    return None


def why_no_warp_on_cpu() -> str | None:
    """The reason why the engine mjx-warp-cpu cannot run on this machine; None if no reason was found. (The engine also
    cannot run if JAX uses a GPU in this process, which is not checked here.)"""
    if importlib.util.find_spec("warp") is None:
        return "Warp is not installed: pip install 'petmjx[warp]'"
    return why_no_folder("warp")
