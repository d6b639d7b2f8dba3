"""Tests of how petmjx compiles its JAX programs (petmjx/engines/mjx/jax_setup.py)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import pytest

from petmjx.engines.mjx import jax_setup
from petmjx.engines.mjx.jax_setup import GPU_COMPILER_OPTIONS, jit_between_slices


@pytest.fixture(autouse=True)
def options_of_another_backend() -> Iterator[None]:
    """Forget the options of the backend before and after a test, since they are computed once per process."""
    jax_setup._gpu_compiler_options.cache_clear()
    yield
    jax_setup._gpu_compiler_options.cache_clear()


@pytest.mark.parametrize(("backend", "expected"), [("gpu", GPU_COMPILER_OPTIONS), ("cpu", {})])
def test_programs_between_slices_are_compiled_without_graphs_on_a_gpu_alone(
    backend: str, expected: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled_with = []
    plain: Callable[..., Any] = jax.jit

    def jit(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
        compiled_with.append(options)
        return plain(function, **options)

    program = jit_between_slices(lambda x, *, times: x * times, static_argnames="times")
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    monkeypatch.setattr(jax, "jit", jit)
    assert program(2.0, times=3) == 6.0
    assert program(2.0, times=4) == 8.0
    assert [options for options in compiled_with if options] == [
        {"compiler_options": expected, "static_argnames": "times"}
    ]


def test_options_that_the_installed_jaxlib_does_not_have_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setitem(GPU_COMPILER_OPTIONS, "xla_gpu_no_such_option", "")
    assert "xla_gpu_no_such_option" not in jax_setup._gpu_compiler_options()
    assert jit_between_slices(lambda x: x + 1.0)(1.0) == 2.0
