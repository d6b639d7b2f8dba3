"""Collects labels in a separate process and stores them in files, while other processes pack."""

from __future__ import annotations

import time
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from labels import Labels, collect

from petmjx.common.processes import process_pool
from petmjx.packers.learned_packer import Policy


class Labeller:
    """Rounds of labels. A finished round has a file; missing rounds are collected.

    Args:
        out: folder of the files.
        how: arguments of ``collect`` that are the same for all rounds.
    """

    def __init__(self, out: Path, how: dict[str, Any]) -> None:
        self._out, self._how = out, how
        self._process: ProcessPoolExecutor | None = None
        self._coming: dict[int, Future[None]] = {}

    def begin(self, round_: int, policy: Policy) -> None:
        """Begin to collect the labels of a round in the background, if the round is missing.

        The policy of the round is stored, so that a resumed training uses the same policy.
        """
        kept = self._out / f"policy-{round_}.npz"
        if not kept.exists():
            policy.save(kept)
        if round_ in self._coming or self._path(round_).exists():
            return
        if self._process is None:
            self._process = process_pool(1)
        job = (round_, self._path(round_), kept, self._how)
        self._coming[round_] = self._process.submit(_write, *job)

    def labels(self, rounds: int, most_s: float) -> Labels:
        """All labels of the first ``rounds`` rounds. The call waits until they exist.

        Raises:
            TimeoutError: the labels do not exist after ``most_s`` seconds.
        """
        end = time.monotonic() + most_s
        parts = []
        for round_ in range(rounds):
            if round_ in self._coming:
                self._coming[round_].result(timeout=max(end - time.monotonic(), 0.0))
            with np.load(self._path(round_), allow_pickle=False) as file:
                parts.append(Labels(**dict(file)))
        return Labels.joined(parts)

    def close(self) -> None:
        """Stop the rounds that are being collected."""
        if self._process is not None:
            for process in list((self._process._processes or {}).values()):
                process.terminate()
            self._process.shutdown(wait=False, cancel_futures=True)

    def _path(self, round_: int) -> Path:
        return self._out / f"labels-{round_}.npz"


def _write(round_: int, path: Path, policy: Path, how: dict[str, Any]) -> None:
    begin = time.monotonic()
    labels = collect(round_=round_, policy=Policy.load(policy), **how)
    with path.with_suffix(".part").open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **labels.arrays)
    path.with_suffix(".part").replace(path)
    seconds = time.monotonic() - begin
    print(f"labels {round_}: {len(labels.stands)}, {labels.stands.mean():.4f} stand, {seconds:.0f} s", flush=True)
