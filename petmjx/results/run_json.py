"""Collects the entries of ``run.json`` while worlds are simulated."""

from __future__ import annotations

import platform
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any, Final

from petmjx.plans.order_checks import OrderCheck
from petmjx.plans.plan_set import Skipped
from petmjx.results.schema import SCHEMA_VERSION, Param
from petmjx.results.stored_order_checks import orders_block
from petmjx.results.world_counts import WorldCounts

RUNNING: Final = "running"
"""The status of a run that is still running, or that was killed."""


class RunInfo:
    """Collects the entries of ``run.json``, except for the list of files.

    Attributes:
        skipped: plans and files that are not simulated, each with the reason.
        warnings: warnings about the whole run, without repetitions.
        odd_plans: one line for each plan with boxes that overlap, float, or stand outside the carrier.
        timings: name of a time, such as ``wall_s`` → this time, s.
        earlier_s: timings of the earlier run that this run resumes. ``run.json`` gets the sums of ``timings`` and
            ``earlier_s``.
        head: entries whose values are known when the run begins.
    """

    def __init__(
        self,
        config: Mapping[str, Any],
        identity: Mapping[str, Any] | None,
        orders: OrderCheck | None,
        params: Sequence[Param],
        versions: Mapping[str, str],
        device: str,
        expected_worlds: int | None,
    ) -> None:
        self.skipped: list[Skipped] = []
        self.warnings: dict[str, None] = {}
        self.odd_plans: list[str] = []
        self.timings: dict[str, float] = {}
        self.earlier_s: dict[str, float] = {}
        self.status = RUNNING
        self.error: str | None = None
        self.orders = orders
        self._started = time.monotonic()
        self.head: dict[str, Any] = {
            "started": now(),
            "resumed": [],
            "config": dict(config),
            **({"identity": identity} if identity else {}),
            "versions": {"python": platform.python_version(), **versions},
            "device": device,
            "expected_worlds": expected_worlds,
            "params": [{"name": p.name, "unit": p.unit, "description": p.description} for p in params],
        }

    def skip(self, skipped: Skipped) -> None:
        """Record that a plan or a file is not simulated, and why."""
        self.skipped.append(skipped)

    def warn(self, message: str) -> None:
        """Record a warning about the whole run."""
        self.warnings[message] = None

    def entries(self, counts: WorldCounts) -> dict[str, Any]:
        """All entries of ``run.json`` with their present values, except the list of files.

        Args:
            counts: the numbers of worlds that have been written.
        """
        seconds = Counter(self.earlier_s)
        seconds.update({**self.timings, "wall_s": round(time.monotonic() - self._started, 3)})
        return {
            "schema_version": SCHEMA_VERSION,
            "status": self.status,
            **({"error": self.error} if self.error else {}),
            **self.head,
            "updated": now(),
            "counts": {
                **counts.as_json(),
                "skipped_plans": len(self.skipped),
                "odd_plans": len(self.odd_plans),
                **({"orders": asdict(self.orders.counts)} if self.orders else {}),
            },
            "timings": dict(seconds),
            "skipped": [_as_json(skipped) for skipped in self.skipped],
            "warnings": [*self.warnings, *self.odd_plans],
            **({"orders": orders_block(self.orders)} if self.orders else {}),
        }


def _as_json(skipped: Skipped) -> dict[str, Any]:
    entry = {"plan_id": skipped.plan_id or "", "source": skipped.source, "error": skipped.message}
    return entry if skipped.number is None else {**entry, "number": skipped.number}


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
