"""Streams of random numbers for worlds. A stream depends only on the identity of its world, never on when or where the
world is simulated."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class WorldKey:
    """The identity of a world. The world's random numbers depend only on this identity.

    ``replicate`` is the number of the repetition among worlds with the same parameters. Worlds that differ only in the
    profile, or in the profile's level or direction, have the same replicate number. Therefore worlds with different
    profiles have the same placement, and can be compared in pairs.
    """

    seed: int
    plan_id: str
    replicate: int = 0

    def rng(self, purpose: str) -> np.random.Generator:
        """The generator for a purpose, such as "size" or "yaw". Each purpose has a generator of its own, so that a new
        axis in a sweep does not change the random numbers of other axes.

        The generator is Philox (Salmon et al., SC'11), which is counter-based. The generator's 128-bit key is the
        BLAKE2b hash of the world's identity and the purpose. So the random numbers are the same on every platform and
        engine, and in every batch and order.
        """
        return np.random.Generator(np.random.Philox(key=int.from_bytes(self._digest(purpose), "little")))

    def _digest(self, purpose: str) -> bytes:
        identity = f"{self.seed}\x1f{self.replicate}\x1f{purpose}\x1f{self.plan_id}".encode()
        return hashlib.blake2b(identity, digest_size=16).digest()


def rngs(keys: Iterable[WorldKey], purpose: str) -> Iterator[np.random.Generator]:
    """Yields one generator of random numbers for each key, all for the same purpose. A generator is valid until the
    next generator is requested: a single generator is reset for each key, which takes a quarter of the time of making a
    new generator."""
    bits = np.random.Philox(key=0)
    generator, fresh = np.random.Generator(bits), bits.state
    for key in keys:
        fresh["state"]["key"] = np.frombuffer(key._digest(purpose), "<u8")
        bits.state = fresh
        yield generator
