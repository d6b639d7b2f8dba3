"""Shared by tests of the MJX engines."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import pytest

from petmjx.engines.verdict import Outcome


@pytest.fixture
def ranks_may_differ() -> Iterator[None]:
    """For MJX, which broadcasts as NumPy does."""
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="session")
def crowd() -> dict[str, Outcome]:
    """Tiny worlds, all in one time slice, on mjx-warp: for tests that have Warp."""
    from support.tiny_worlds import in_one_slice

    return in_one_slice()
