"""What a run is: the settings and plans that its results depend on, and how two runs differ in them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from petmjx.errors import InputError
from petmjx.plans.ordered import Ordered
from petmjx.plans.plan import Plan
from petmjx.results.files import RUN_FILE, part_files, part_name, write_table
from petmjx.results.plain import plain
from petmjx.results.reader import read_part
from petmjx.results.run_file import check_whole
from petmjx.results.schema import plans_schema
from petmjx.text import counted, printable, shortened, shown

DIGEST_BYTES: Final = 8
"""Of one plan's digest; 2^64 values make two of a million plans equal by chance once in 30 million such runs."""

MOST_NAMED: Final = 4
"""Differences that a message names; of more it says how many there are."""


def plan_digest(plan: Plan) -> str:
    """Hexadecimal digest (BLAKE2b) of everything in a plan that reaches the results."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    digest.update(repr((plan.plan_id, plan.item_ids, plan.articles)).encode("utf-8", "backslashreplace"))
    for values in (plan.size_mm, plan.corner_mm, plan.mass_kg, plan.sequence):
        digest.update(values.tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Manifest:
    """The identity of a run. Two runs of one identity have the same results.

    Attributes:
        settings: JSON-like: command, simulation, sweep, engine, shard.
        plans: plan id → (digest, source); all plans, also those of other shards.
    """

    settings: Mapping[str, Any]
    plans: Mapping[str, tuple[str, str]]

    @classmethod
    def of(cls, settings: Mapping[str, Any], plans: Sequence[Plan]) -> Manifest:
        """The manifest of a run of these plans."""
        return cls(plain(settings), {plan.plan_id: (plan_digest(plan), plan.source) for plan in plans})

    @property
    def identity(self) -> dict[str, Any]:
        """As it stands in ``run.json``. The digest does not depend on the order of plans."""
        lines = "\n".join(f"{digest} {plan_id!r}" for plan_id, (digest, _) in sorted(self.plans.items()))
        digest = hashlib.blake2b(lines.encode("utf-8", "backslashreplace"), digest_size=16).hexdigest()
        return {**self.settings, "plans": {"count": len(self.plans), "digest": digest}}

    def write(self, folder: Path, ordered: Mapping[str, Ordered] | None = None) -> None:
        """Write the table ``plans``; an old one is replaced.

        Args:
            ordered: plan id → how it compares with its order; None: no columns about orders.
        """
        columns: dict[str, Sequence[Any]] = {
            "plan_id": list(self.plans),
            "digest": [digest for digest, _ in self.plans.values()],
            "source": [source for _, source in self.plans.values()],
        }
        if ordered is not None:
            rows = [ordered.get(plan_id) for plan_id in self.plans]
            columns |= {name: [row and getattr(row, name) for row in rows] for name in Ordered._fields}
        schema = plans_schema(ordered is not None)
        arrays = [pa.array(columns[column.name], column.type) for column in schema]
        write_table(pa.Table.from_arrays(arrays, schema=schema), folder / "plans" / part_name(0))

    @classmethod
    def read(cls, folder: Path, info: Mapping[str, Any]) -> Manifest:
        """The manifest of the run in a folder.

        Raises:
            InputError: it has none (of petmjx before 0.2), or it is damaged.
        """
        files = part_files(folder, "plans")
        if "identity" not in info or not files:
            raise InputError(f"{folder}: the run does not say what it is of (written by petmjx before 0.2)")
        check_whole(info, folder / RUN_FILE)
        tables = [read_part(file, plans_schema().names).to_pydict() for file in files]
        plans = {
            plan_id: (digest, source)
            for table in tables
            for plan_id, digest, source in zip(table["plan_id"], table["digest"], table["source"], strict=True)
        }
        return cls({name: value for name, value in info["identity"].items() if name != "plans"}, plans)

    def difference_from(self, earlier: Manifest, without: Sequence[str] = ()) -> str:
        """What differs from another manifest, in a line; empty where nothing does.

        Args:
            without: settings that may differ.
        """
        settings = {name: value for name, value in _as_asked(self.settings).items() if name not in without}
        found = [*_setting_differences(_as_asked(earlier.settings), settings, ""), *self._plan_differences(earlier)]
        found = [each for each in found if each.partition(" ")[0] not in without]
        more = [f"{len(found) - MOST_NAMED} more"] if len(found) > MOST_NAMED else []
        return "; ".join([*found[:MOST_NAMED], *more])

    def _plan_differences(self, earlier: Manifest) -> Iterator[str]:
        for plan_id, (digest, _) in self.plans.items():
            if plan_id in earlier.plans and earlier.plans[plan_id][0] != digest:
                yield f"plan {shown(plan_id)} differs"
        new = len(self.plans.keys() - earlier.plans.keys())
        gone = len(earlier.plans.keys() - self.plans.keys())
        if new:
            yield f"{counted(new, 'plan')} more"
        if gone:
            yield f"{counted(gone, 'plan')} fewer"


_NOTHING: Final = object()


def _as_asked(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Settings with the names of the command: the sweep of a score is its number of worlds and its errors."""
    sweep = settings.get("sweep")
    if settings.get("command") != "score" or not isinstance(sweep, Mapping):
        return settings
    errors = {name: value for name, value in sweep.items() if name != "replicates"}
    others = {name: value for name, value in settings.items() if name != "sweep"}
    return {**others, "confidence": sweep.get("replicates"), "errors": errors}


def _setting_differences(was: Any, now: Any, path: str) -> Iterator[str]:
    """ "simulation.schedule is fixed, was adaptive", for every value that differs."""
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for name in dict.fromkeys((*was, *now)):
            if name == "errors" and not path and not (name in was and name in now):
                continue  # only one of them has confidence, which is said
            inner = f"{path}.{name}" if path else str(name)
            yield from _setting_differences(was.get(name, _NOTHING), now.get(name, _NOTHING), inner)
    elif was != now:
        yield f"{path} is {_said(now)}, was {_said(was)}"


def _said(value: Any) -> str:
    if value is _NOTHING or value is None:
        return "none"
    return shortened(printable(str(value)))
