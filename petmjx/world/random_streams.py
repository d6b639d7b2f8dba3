"""Random streams of worlds. A stream depends only on the identity of its world, never on when or where the world is
simulated."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class WorldKey:
    """The identity of a world. The world's random numbers depend on nothing else.

    ``replicate`` counts repetitions of the same parameters. Worlds that differ only in their profile, its level or its
    direction have the same replicate number. So they also have the same placement, and can be compared in pairs.
    """

    seed: int
    plan_id: str
    replicate: int = 0

    def rng(self, purpose: str) -> np.random.Generator:
        """A separate generator for each purpose ("size", "yaw", …), so that a new axis in a sweep does not change the
        numbers of other axes.

        Philox (Salmon et al., SC'11) is counter-based: its 128-bit key is the BLAKE2b hash of the world's identity. The
        key is the same on every platform and engine, and in every batch and order.
        """
        return np.random.Generator(np.random.Philox(key=int.from_bytes(self._digest(purpose), "little")))

    def _digest(self, purpose: str) -> bytes:
        identity = f"{self.seed}\x1f{self.replicate}\x1f{purpose}\x1f{self.plan_id}".encode()
        return hashlib.blake2b(identity, digest_size=16).digest()


def rngs(keys: Iterable[WorldKey], purpose: str) -> Iterator[np.random.Generator]:
    """For each key, its generator for a purpose, valid until the next one is requested. A single generator is reset for
    each key, which takes a quarter of the time of making a new one."""
    bits = np.random.Philox(key=0)
    generator, fresh = np.random.Generator(bits), bits.state
    for key in keys:
        fresh["state"]["key"] = np.frombuffer(key._digest(purpose), "<u8")
        bits.state = fresh
        yield generator
