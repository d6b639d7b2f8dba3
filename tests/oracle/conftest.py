"""Fixtures that tests of the MJX engines share."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import pytest

from petmjx.engines.verdict import Outcome


@pytest.fixture
def ranks_may_differ() -> Iterator[None]:
    """Let JAX broadcast arrays of different rank as NumPy does, as MJX needs it."""
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="module")
def few_spare_worlds() -> Iterator[None]:
    """States of ``petmjx.jax`` keep few settled worlds in addition to those of their pallets. Opening the usual 64
    takes half a second for each state."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("petmjx.jax.host_pallets.SPARE_WORLDS", 4)
        yield


@pytest.fixture(scope="session")
def crowd() -> dict[str, Outcome]:
    """Outcomes of the tiny worlds on mjx-warp, all simulated in one time slice (one launch of the kernel).

    For tests that have Warp.
    """
    from support.tiny_worlds import in_one_slice

    return in_one_slice()
