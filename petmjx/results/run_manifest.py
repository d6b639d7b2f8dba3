"""The manifest of a run: the settings and plans that determine its results, and the differences of two manifests."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name, shortened_text
from petmjx.options.run_options import ALL
from petmjx.options.simulation import Simulation
from petmjx.plans.order_checks import PlanOrderCounts
from petmjx.results.plan_digests import PlanRecord
from petmjx.results.run_folder import RUN_FILE
from petmjx.results.run_json import check_whole
from petmjx.results.schema import plans_schema
from petmjx.results.table_parts import Parts

MOST_NAMED: Final = 4
"""Largest number of differences that a message names. If there are more differences, the message states how many it
does not name."""


def _arrow_column(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Texts or numbers as an Arrow array. ``pyarrow.array`` makes the same array, but would first load pandas, which
    would delay the first world of a run."""
    if None in values:
        return pa.array(values, kind)
    if kind != pa.string():
        # ``kind.to_pandas_dtype()`` would load pandas in some versions of pyarrow
        dtype = np.dtype(f"{'f' if pa.types.is_floating(kind) else 'i'}{kind.byte_width}")
        return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(np.array(values, dtype))])
    texts = [text.encode() for text in values]
    ends = np.cumsum([0, *(len(text) for text in texts)])
    if ends[-1] > np.iinfo(np.int32).max:
        return pa.array(values, kind)
    return pa.StringArray.from_buffers(len(texts), pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(b"".join(texts)))


@dataclass(frozen=True, eq=False)
class Manifest:
    """The identity of a run. Two runs with the same identity have the same results.

    Attributes:
        settings: command, simulation, sweep, engine and shard, as values that JSON can hold.
        plans: plan id → record, for all plans in the order of the input, including the plans of other shards.
        placements: function that makes the table ``placements`` of the run's plans. If ``placements`` is None, the run
            has no such table.
    """

    settings: Mapping[str, Any]
    plans: Mapping[str, PlanRecord]
    placements: Callable[[], pa.Table | None] = lambda: None

    @property
    def identity(self) -> dict[str, Any]:
        """The identity of the run as it is written into ``run.json``. The digest of all plans does not depend on the
        order of the plans."""
        lines = "\n".join(f"{record.digest} {plan_id!r}" for plan_id, record in sorted(self.plans.items()))
        digest = hashlib.blake2b(lines.encode("utf-8", "backslashreplace"), digest_size=16).hexdigest()
        return {**self.settings, "plans": {"count": len(self.plans), "digest": digest}}

    def table(self, ordered: Mapping[str, PlanOrderCounts] | None = None) -> pa.Table:
        """Make the table ``plans``.

        Args:
            ordered: plan id → counts from the comparison of the plan with its order. If ``ordered`` is None, there are
                no columns about orders.
        """
        columns: dict[str, Sequence[Any]] = {
            "plan_id": list(self.plans),
            **{name: [getattr(record, name) for record in self.plans.values()] for name in PlanRecord._fields},
        }
        if ordered is not None:
            rows = [ordered.get(plan_id) for plan_id in self.plans]
            columns |= {name: [row and getattr(row, name) for row in rows] for name in PlanOrderCounts._fields}
        schema = plans_schema(ordered is not None)
        arrays = [_arrow_column(columns[column.name], column.type) for column in schema]
        return pa.Table.from_arrays(arrays, schema=schema)

    @classmethod
    def read(cls, parts: Parts, info: Mapping[str, Any]) -> Manifest:
        """Read the manifest of a run from its tables and its ``run.json``.

        Raises:
            InputError: the run has no manifest, or the manifest is damaged.
        """
        if "identity" not in info or not parts.files("plans"):
            raise InputError(f"{parts.folder}: the run does not list its plans")
        check_whole(info, parts.folder / RUN_FILE)
        plans: dict[str, PlanRecord] = {}
        for table in parts.table("plans", ("plan_id", *PlanRecord._fields)):
            columns = table.to_pydict()
            records = zip(*(columns[name] for name in PlanRecord._fields), strict=True)
            plans |= zip(columns["plan_id"], map(PlanRecord._make, records), strict=True)
        return cls({name: value for name, value in info["identity"].items() if name != "plans"}, plans)

    def difference_from(self, earlier: Manifest, without: Sequence[str] = ()) -> str:
        """The differences from an earlier manifest, in one line; "" if there are none.

        Args:
            without: names of the settings that are not compared.
        """
        was, now = _settings_of_command(earlier.settings), _settings_of_command(self.settings)
        differences = [
            f"{path} is {_setting_text(after)}, was {_setting_text(before)}"
            for path, before, after in differing_settings(was, now)
            if path not in without
        ]
        differences += self._plan_differences(earlier)
        more_words = [f"{len(differences) - MOST_NAMED} more"] if len(differences) > MOST_NAMED else []
        return "; ".join([*differences[:MOST_NAMED], *more_words])

    def _plan_differences(self, earlier: Manifest) -> Iterator[str]:
        for plan_id, record in self.plans.items():
            if plan_id in earlier.plans and earlier.plans[plan_id].digest != record.digest:
                yield f"plan {printable_name(plan_id)} differs"
        new = len(self.plans.keys() - earlier.plans.keys())
        n_removed = len(earlier.plans.keys() - self.plans.keys())
        if new:
            yield f"{count_text(new, 'plan')} more"
        if n_removed:
            yield f"{count_text(n_removed, 'plan')} fewer"


_NOTHING: Final = object()


def _settings_of_command(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Rename settings to the names that the command uses. For a score, two entries replace the entry ``sweep``, namely
    ``confidence`` (the number of worlds with errors per plan) and ``errors``. Entries that ``run.json`` may lack get
    their defaults."""
    settings = {"force_intervals": False, "keep": ALL, **settings}
    if isinstance(simulation := settings.get("simulation"), Mapping):
        settings["simulation"] = with_later_options(simulation)
    sweep = settings.get("sweep")
    if settings.get("command") != "score" or not isinstance(sweep, Mapping):
        return settings
    errors = {name: value for name, value in sweep.items() if name != "replicates"}
    other_settings = {name: value for name, value in settings.items() if name != "sweep"}
    return {**other_settings, "confidence": sweep.get("replicates"), "errors": errors}


CHANGED_RESULTS: Final = frozenset(
    {
        "landing_pairs",
        "longest_wait_s",
        "placing",
        "physics.falls_into_place",
        "physics.impratio",
        "physics.landing_s",
        "physics.restitution",
        "physics.skin_m",
        "physics.slip_correction",
        "physics.solreffriction",
        "quiet.landing_steps",
        "quiet.quiet_m_s",
        "quiet.slow_m_s",
        "quiet.slowing",
        "quiet.steps",
        "quiet.still_m_s",
        "quiet.still_steps",
        "quiet.tremble_share",
        "quiet.tremble_steps",
    }
)
"""Options that came with a default that changed results. Versions of petmjx without such an option had other results
than later versions with the option's default."""


def with_later_options(simulation: Mapping[str, Any]) -> Mapping[str, Any]:
    """The options of a simulation from ``run.json``. Options that an earlier version of petmjx did not have get their
    defaults, except the options in ``CHANGED_RESULTS``."""
    try:
        complete = Simulation.read(simulation)
    except InputError:  # the run has an option or a value that this version does not have, and a message will name it
        complete = Simulation()
    with_defaults: Mapping[str, Any] = _with_defaults(simulation, complete.model_dump(mode="json"))
    return with_defaults


def _with_defaults(values: Any, complete: Any, path: str = "") -> Any:
    """The same values, and those that only ``complete`` has, except the values of ``CHANGED_RESULTS``."""
    if isinstance(values, Mapping) and isinstance(complete, Mapping):
        later = {
            name: {} if isinstance(value, Mapping) else value
            for name, value in complete.items()
            if name not in values and f"{path}{name}" not in CHANGED_RESULTS
        }
        return {
            name: _with_defaults(value, complete.get(name), f"{path}{name}.")
            for name, value in {**values, **later}.items()
        }
    if _are_tables(values) and _are_tables(complete) and len(values) == len(complete):
        return [_with_defaults(*tables, path) for tables in zip(values, complete, strict=True)]
    return values


def differing_settings(was: Any, now: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield every setting that differs: its name, such as "simulation.schedule", its value in ``was``, and its value in
    ``now``. A value is None if the setting is missing."""
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for name in dict.fromkeys((*was, *now)):
            if name == "errors" and not path and not (name in was and name in now):
                # If only one run has the setting ``errors``, the runs also differ in ``confidence``. Only
                # ``confidence`` is listed.
                continue
            inner = f"{path}.{name}" if path else str(name)
            yield from differing_settings(was.get(name, _NOTHING), now.get(name, _NOTHING), inner)
    elif _are_tables(was) and _are_tables(now) and len(was) == len(now):
        for number, (before, after) in enumerate(zip(was, now, strict=True)):
            yield from differing_settings(before, after, f"{path}[{number}]")
    elif was != now:
        yield path, None if was is _NOTHING else was, None if now is _NOTHING else now


def _are_tables(value: Any) -> bool:
    """Whether a value is a list of tables (mappings), such as the boards of a carrier."""
    return isinstance(value, list) and all(isinstance(entry, Mapping) for entry in value)


def _setting_text(value: Any) -> str:
    if value is None:
        return "none"
    if _are_tables(value) and value:
        return count_text(len(value), "table")
    if isinstance(value, Mapping) and "name" in value:
        return printable_name(str(value["name"]))
    return shortened_text(printable(str(value)))
