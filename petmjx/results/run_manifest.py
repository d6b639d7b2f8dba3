"""The manifest of a run: the settings and plans that determine its results, and the differences of two manifests."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name, shortened_text
from petmjx.common.units import mm_to_m
from petmjx.options.run_options import ALL
from petmjx.options.walls import Walls
from petmjx.plans.order_matching import PlanOrderCounts
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import SPARSE
from petmjx.results.run_file import check_whole
from petmjx.results.run_folder import RUN_FILE
from petmjx.results.run_tables import Parts
from petmjx.results.schema import plans_schema

DIGEST_BYTES: Final = 8
"""Length of the digest of a plan, bytes. A digest of 8 bytes has 2^64 possible values. In a run of a million plans, the
probability that two different plans have the same digest is one in 30 million."""

MOST_NAMED: Final = 4
"""Largest number of differences that a message names. If there are more differences, the message states how many it
does not name."""


def plan_digest(plan: Plan) -> str:
    """Hexadecimal digest (BLAKE2b) of everything in a plan that affects the results."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    digest.update(repr((plan.plan_id, plan.item_ids, plan.articles)).encode("utf-8", "backslashreplace"))
    for values in (plan.size_mm, plan.corner_mm, plan.mass_kg, plan.sequence):
        digest.update(values.tobytes())
    if plan.materials:
        digest.update(repr(plan.materials).encode("utf-8", "backslashreplace"))
    if plan.mass_center_mm is not None:
        digest.update(plan.mass_center_mm.tobytes())
    for name, field in SPARSE.items():
        if field.reaches_results and (values := getattr(plan, name)) is not None:
            digest.update(name.encode() + values.tobytes())
    if plan.kinds:
        digest.update(repr(("kinds", plan.kinds)).encode())
    return digest.hexdigest()


class PlanRecord(NamedTuple):
    """What a run stores about one plan, besides its placements.

    Attributes:
        digest: digest of everything in the plan that affects the results.
        source: file from which the plan was read.
        volume_m3: total volume of the plan's boxes, m³.
        extent_x_m, extent_y_m: extents of the bounding box of all boxes, m.
        height_m: height of the top of the highest box above the carrier, m.
        number: position of the plan in the input, where skipped plans also have a position; None if the position is
            unknown.
    """

    digest: str
    source: str
    volume_m3: float
    extent_x_m: float
    extent_y_m: float
    height_m: float
    number: int | None = None


def records_of(plans: Sequence[Plan], numbers: Mapping[str, int] | None = None) -> dict[str, PlanRecord]:
    """Plan id → record of the plan, in the order of the input.

    Args:
        numbers: plan id → position of the plan in the input; None if no plan was skipped.
    """
    if not plans:
        return {}
    numbers = numbers or {plan.plan_id: number for number, plan in enumerate(plans)}
    ends = np.cumsum([plan.n_boxes for plan in plans])
    begins = [0, *ends.tolist()[:-1]]
    size, low = (mm_to_m(np.concatenate([getattr(plan, name) for plan in plans])) for name in ("size_mm", "corner_mm"))
    high = low + size
    highest = np.maximum.reduceat(high, begins)
    extent = (highest - np.minimum.reduceat(low, begins)).tolist()
    volume_of_box = size.prod(axis=1)
    return {
        plan.plan_id: PlanRecord(
            plan_digest(plan),
            plan.source,
            # a separate sum for each plan, because ``reduceat`` adds in another order and rounds differently
            float(volume_of_box[begin:end].sum()),
            extent_x,
            extent_y,
            height,
            numbers.get(plan.plan_id),
        )
        for plan, begin, end, (extent_x, extent_y, _), height in zip(
            plans, begins, ends.tolist(), extent, highest[:, 2].tolist(), strict=True
        )
    }


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
        settings["simulation"] = _with_later_fields(simulation)
    sweep = settings.get("sweep")
    if settings.get("command") != "score" or not isinstance(sweep, Mapping):
        return settings
    errors = {name: value for name, value in sweep.items() if name != "replicates"}
    other_settings = {name: value for name, value in settings.items() if name != "sweep"}
    return {**other_settings, "confidence": sweep.get("replicates"), "errors": errors}


def _with_later_fields(simulation: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a simulation from ``run.json``. Fields that earlier versions of petmjx did not write are added;
    each added field has the value that changes nothing."""
    walls = Walls().model_dump(mode="json")
    later = {"walls": walls, **simulation}
    if isinstance(carrier := later.get("carrier"), Mapping):
        later["carrier"] = {"walls": walls, **carrier}
    pairs = later.get("friction_pairs", [])
    if _are_tables(pairs):
        later["friction_pairs"] = [{"kinetic": None, **pair} for pair in pairs]
    return later


def differing_settings(was: Any, now: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield every setting that differs: its name, such as "simulation.schedule", its value in ``was``, and its value in
    ``now``. A value is None if the setting is missing."""
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for name in dict.fromkeys((*was, *now)):
            if name == "errors" and not path and not (name in was and name in now):
                continue  # one run lacks ``errors``, so the setting ``confidence`` differs and is reported
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
