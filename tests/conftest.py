"""Shared by all tests: JAX on the CPU, strict about ranks, and quick to compile; GPU tests skip without CUDA."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
from pathlib import Path

import pytest

# Before anything imports jax. Tests mostly compile, and run little of what they compile.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
if os.environ.get("PETMJX_TEST_GPU") != "1":
    os.environ["JAX_PLATFORMS"] = "cpu"
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_optimization_level" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_optimization_level=1".strip()


@functools.cache
def why_no_cuda() -> str:
    """Why GPU tests cannot run here; empty where they can."""
    if os.environ.get("PETMJX_TEST_GPU") != "1":
        return "GPU tests run with PETMJX_TEST_GPU=1 on a machine with CUDA"
    if shutil.which("nvidia-smi") is None:
        return "no CUDA device: nvidia-smi is not installed"
    listing = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, check=False)
    return "" if "GPU" in listing.stdout else "no CUDA device: nvidia-smi lists none"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("gpu") and (reason := why_no_cuda()):
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root folder."""
    return Path(__file__).resolve().parent.parent
