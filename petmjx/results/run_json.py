"""The file ``run.json``: collects its entries while worlds are simulated (``RunInfo``), writes them, and checks them
before petmjx uses them. The file may have been edited, or copied from elsewhere."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from petmjx.common.checked_records import describe
from petmjx.common.errors import InputError
from petmjx.plans.order_checks import OrderCheck, OrderCounts
from petmjx.plans.plan_set import Skipped
from petmjx.results.result_files import DIGEST_BYTES, write_text
from petmjx.results.run_folder import RUN_FILE, TABLES
from petmjx.results.schema import SCHEMA_VERSION, Param
from petmjx.results.stored_order_checks import orders_block
from petmjx.results.to_json import to_json
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


TableName = Annotated[str, Field(pattern=rf"^({'|'.join(TABLES)})$")]
PartName = Annotated[str, Field(pattern=r"^part-[0-9]{5,12}\.parquet$")]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
Share = Annotated[str, Field(pattern=r"^[1-9][0-9]{0,8}/[1-9][0-9]{0,8}$")]


class _PartialRecord(BaseModel):
    """Base class for records in ``run.json``. A record may have further entries, which petmjx ignores."""

    model_config = ConfigDict(strict=True, extra="ignore")


_NEWER_FIELDS: Final = ("resized", "matched_by_size")
"""Fields of ``OrderCounts`` that the files of petmjx 0.2 lack. The value of a missing field is 0."""

_ORDER_FIELDS: Final[dict[str, Any]] = {
    name: (kind, 0 if name in _NEWER_FIELDS else ...) for name, kind in get_type_hints(OrderCounts).items()
}
_OrderCounts = create_model("_OrderCounts", __base__=_PartialRecord, **_ORDER_FIELDS)
"""Checks that an entry of ``run.json`` has all fields of ``OrderCounts``."""


class _Counts(_PartialRecord):
    worlds: int
    odd_plans: int = 0
    orders: _OrderCounts | None = None


class _Param(_PartialRecord):
    name: str
    unit: str
    description: str


class _Skipped(_PartialRecord):
    source: str
    plan_id: str | None = None
    error: str = ""
    number: int | None = None


class _Identity(_PartialRecord):
    command: str
    shard: Share | None = None


class _Orders(_PartialRecord):
    file: str
    digest: str
    plans: list[str]
    without_plan: list[str]
    unusable: list[str]


class RunFile(_PartialRecord):
    """The entries of ``run.json`` that petmjx reads."""

    status: str = ""
    started: str = ""
    resumed: list[str] = []
    config: dict[str, Any] = {}
    identity: _Identity = Field(default=_Identity(command=""))
    versions: dict[str, str] = {}
    device: str = ""
    expected_worlds: int | None = None
    params: list[_Param] = []
    counts: _Counts = Field(default=_Counts(worlds=0))
    timings: dict[str, float] = {}
    skipped: list[_Skipped] = []
    warnings: list[str] = []
    orders: _Orders | None = None
    """The comparison of the plans with orders. Runs without orders lack this entry and the entry ``counts.orders``."""
    parts: dict[TableName, dict[PartName, Digest]]
    """Table → name of a file → digest (hash) of the file, for all files that belong to the run."""
    digest: Digest | None = None
    """Hash of all entries of ``run.json`` except ``digest`` itself."""


_OPTIONAL: Final = ("orders", "digest")


def run_digest(info: Mapping[str, Any]) -> str:
    """Hash of all entries of a ``run.json`` except the entry ``digest``. The digest does not depend on the order of the
    entries or on white space."""
    other_entries = {name: value for name, value in info.items() if name != "digest"}
    text = json.dumps(other_entries, sort_keys=True, ensure_ascii=True)
    return hashlib.blake2b(text.encode(), digest_size=DIGEST_BYTES).hexdigest()


def write_run_file(info: Mapping[str, Any], folder: Path) -> None:
    """Write the entries of a run and their digest into ``run.json``. Raises OSError."""
    entries = to_json(info)
    entries["digest"] = run_digest(entries)
    write_text(json.dumps(entries, indent=2, ensure_ascii=False, allow_nan=False) + "\n", folder / RUN_FILE)


def check_run_file(info: Mapping[str, Any], file: Path) -> None:
    """Check those entries that a ``run.json`` has; the check accepts a file in which entries are missing.

    Raises:
        InputError: an entry is wrong, as in "DIR/run.json: counts.worlds must be a whole number, got None".
    """
    try:
        read = RunFile.model_validate(info)
    except ValidationError as error:
        raise InputError(f"{file}: damaged: {describe(error)}") from None
    if (read.orders is None) != (read.counts.orders is None):
        raise InputError(f"{file}: damaged: {'counts.orders' if read.orders else 'orders'} is missing")
    if read.digest is not None and read.digest != run_digest(info):
        raise InputError(
            f"{file}: damaged: it differs from what the run wrote (if you changed it on purpose, delete its entry "
            "'digest')"
        )


def check_whole(info: Mapping[str, Any], file: Path) -> None:
    """Check that no entry is missing, so that the run can be resumed or merged.

    Raises:
        InputError: an entry is missing, as in "DIR/run.json: damaged: timings is missing".
    """
    for name in RunFile.model_fields:
        if name not in info and name not in _OPTIONAL:
            raise InputError(f"{file}: damaged: {name} is missing")
