"""Reads the folder of a run into pandas data frames. A single world can be read without the other worlds.
petmjx.results.run_folder describes the layout of the folder.
"""

from __future__ import annotations

import json
import math
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from petmjx.common.argument_checks import path_of
from petmjx.common.checked_records import option, reason
from petmjx.common.errors import InputError, PetmjxError
from petmjx.common.safe_read import read_regular
from petmjx.common.text import count_text
from petmjx.engines.metrics import BoxMetrics, box_metrics, world_metrics
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.carriers import Carrier, OwnCarrier
from petmjx.options.run_options import WORLDS
from petmjx.options.simulation import Simulation
from petmjx.options.walls import Walls
from petmjx.plans.json_reader import json_fault
from petmjx.plans.order_checks import PlanOrderCounts
from petmjx.plans.plan import Plan
from petmjx.results.notebook_tables import worlds_as_html
from petmjx.results.run_folder import MOST_RUN_FILE_BYTES, RUN_FILE
from petmjx.results.run_json import check_run_file, write_run_file
from petmjx.results.schema import RANK, check_version, data_frame, placements_schema, plans_schema, schemas
from petmjx.results.stored_plans import PLACEMENTS, placements_table
from petmjx.results.table_parts import LISTED, MemoryParts, Parts
from petmjx.results.world_ranks import PlanOrder, frame_in_order

if TYPE_CHECKING:
    import pandas as pd

_NAMES_WORLDS: Final = {"histories": "frames", "frames": "frames", "contacts": "frames"}
"""Name of a table → name of the table that is searched to find the file with a given world. Files of these two tables
with the same number hold the same worlds. For a table that is not listed here, ``worlds`` is searched."""


def world_row(run: RunResults, plan_id: str, variant: int) -> dict[str, Any] | None:
    """The row of a world in the table ``worlds``, as a dict: column → value. Null becomes None. The result is None if
    the run does not have this world."""
    rows = rows_of(run, "worlds", plan_id, variant)
    return None if rows is None else dict(rows.to_pylist()[0])


def read_outcome(run: RunResults, plan_id: str, variant: int) -> Outcome | None:
    """The outcome of a world, made from the rows of the world in the tables; None if the run does not have this world.

    Values of boxes that were never placed are NaN. Measured values have the precision of the table ``boxes``.
    """
    row = world_row(run, plan_id, variant)
    boxes = rows_of(run, "boxes", plan_id, variant)
    if row is None or boxes is None:
        return None
    table = boxes.sort_by("box")
    values: dict[str, Any] = {}
    for metric in box_metrics():
        column_names = [name for name in metric.columns if name in table.column_names]
        columns = [table[name].to_numpy().astype(np.float64) for name in column_names] or [np.full(len(table), np.nan)]
        values[metric.attribute] = np.stack(columns, axis=1) if len(columns) > 1 else columns[0]
    values["dropped"] = values["dropped"] > 0
    cells: dict[str, Any] = {name: row[name] for name in ("n_boxes", "n_placed", "solver", "attempt")}
    for of_world in world_metrics():
        value = row.get(of_world.name)  # a run of an earlier version may lack the column
        nothing = -1 if of_world.numbers else math.nan
        cells[of_world.name] = nothing if value is None else value
    return Outcome(
        job=0,
        verdict=Verdict(row["verdict"]),
        reason=Reason(row["reason"]),
        culprit=-1 if row["culprit"] is None else row["culprit"],
        flags=Flag(row["flags"]),
        boxes=BoxMetrics(**values),
        **cells,
    )


def rows_of(run: RunResults, table: str, plan_id: str, variant: int) -> pa.Table | None:
    """The rows of one world in a table of a run; None if the table has no rows of this world.

    Raises:
        InputError: a part is damaged or missing.
    """
    of_table = {file.name: file for file in run.parts.files(table)}
    for file in run.parts.files(_NAMES_WORLDS.get(table, "worlds")):
        if len(_rows_of_one_world(run.parts.read(file, ("plan_id", "variant")), plan_id, variant)):
            table_file = of_table.get(file.name)  # files with the same number hold the same worlds
            rows = None if table_file is None else _rows_of_one_world(run.parts.read(table_file), plan_id, variant)
            return rows if rows is not None and len(rows) else None
    return None


def boxes_of_worlds(run: RunResults, worlds: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """The rows of some worlds in the table ``boxes`` of a run. The parts of the table are read one after another, so
    only one part is in memory at a time.

    Args:
        worlds: data frame with the columns ``plan_id`` and ``variant``, one row per world.
        columns: names of the columns to read.

    Raises:
        InputError: a part is damaged or missing.
    """
    plan_ids = pa.array(worlds["plan_id"].unique(), pa.string())

    def keys(plan_id: pa.Array, variant: pa.Array) -> NDArray[np.int64]:
        place = np.asarray(pc.fill_null(pc.index_in(plan_id, value_set=plan_ids), -1), dtype=np.int64)
        return np.where(place < 0, -1, (place << 32) + np.asarray(variant, dtype=np.int64))

    world_keys = keys(pa.array(worlds["plan_id"], pa.string()), pa.array(worlds["variant"], pa.int32()))
    part_rows = []
    for file in run.parts.files("boxes"):
        part = run.parts.read(file, ("plan_id", "variant"))
        rows = np.flatnonzero(np.isin(keys(part["plan_id"], part["variant"]), world_keys))
        if len(rows):
            part_rows.append(run.parts.read(file, columns).take(rows))
    schema = schemas()["boxes"]
    none = schema.empty_table().select([name for name in columns if name in schema.names])
    return data_frame(pa.concat_tables(part_rows or [none], promote_options="default"))


def _rows_of_one_world(part: pa.Table, plan_id: str, variant: int) -> pa.Table:
    """The rows of one world in a part of a table."""
    return part.filter(pc.and_(pc.equal(part["plan_id"], plan_id), pc.equal(part["variant"], variant)))


FINISHED: Final = "finished"
"""The status of a run that ended normally."""


@dataclass(frozen=True, eq=False)
class RunResults:
    """The results of a run. Each table is read when it is first used.

    Attributes:
        parts: the files of the tables. Callers that need only some columns of a table read the columns through
            ``parts``.
        info: the entries of ``run.json``.
        plans_in_memory: plan id → plan, for plans that exist only as objects in memory.
    """

    parts: Parts
    info: dict[str, Any]
    plans_in_memory: Mapping[str, Plan] = field(default_factory=dict)

    def __repr__(self) -> str:
        counts = self.info.get("counts", {})
        noun = "world" if self._varied else "plan"
        verdicts = ", ".join(f"{counts.get(verdict.value, 0):,} {verdict.value}" for verdict in Verdict)
        status = self.unfinished or FINISHED
        return f"RunResults({self.where}: {count_text(counts.get('worlds', 0), noun)}, {verdicts}; {status})"

    def _repr_html_(self) -> str:
        """HTML for notebooks: one line about the run, and the rows of its first worlds."""
        return worlds_as_html(repr(self), self.worlds)

    @property
    def where(self) -> str:
        """The path of the run's folder as text, or "in memory" if the run has no folder."""
        return "in memory" if isinstance(self.parts, MemoryParts) else str(self.path)

    @property
    def unfinished(self) -> str | None:
        """The status of a run that did not finish, such as ``interrupted``: some of its worlds are missing. If the run
        finished, the result is None."""
        status = str(self.info.get("status", "unknown"))
        return None if status == FINISHED else status

    @property
    def carrier(self) -> Carrier | OwnCarrier:
        """The carrier on which the run's boxes stand. If ``run.json`` names no carrier that petmjx knows, the result is
        ``footprint``."""
        return self._carrying.carrier

    @property
    def walls(self) -> Walls:
        """The walls that the run's options set. The carrier itself may have further walls."""
        return self._carrying.walls

    @property
    def _carrying(self) -> Simulation:
        """Simulation options with the carrier and the walls of the run. All other options have their defaults."""
        settings = self.info.get("config", {}).get("simulation", {})
        try:
            return Simulation.read({"carrier": settings["carrier"], "walls": settings.get("walls", {})})
        except (InputError, KeyError, TypeError, AttributeError):
            return Simulation()

    def doubts(self, name: str) -> list[str]:
        """A list with one warning if the run is not finished, otherwise an empty list. ``name``: name of the run in the
        warning."""
        return [f"{name} is not finished ({self.unfinished})"] if self.unfinished else []

    @cached_property
    def path(self) -> Path:
        """The run's folder. If the results are in memory, they are first written to a temporary folder, which is
        deleted together with this object.

        Raises:
            PetmjxError: the temporary folder cannot be written.
        """
        if not isinstance(self.parts, MemoryParts):
            return self.parts.folder
        try:
            temporary = tempfile.TemporaryDirectory(prefix="petmjx-")
            weakref.finalize(self, temporary.cleanup)
            folder = Path(temporary.name)
            written = self.parts.save(folder)
            if self.plans_in_memory and (placements := placements_table(self.plans_in_memory.values())) is not None:
                written = written.replaced(PLACEMENTS, placements)
            write_run_file(self.info | {LISTED: written.digests}, folder)
        except OSError as error:
            raise PetmjxError(f"{tempfile.gettempdir()}: cannot write results: {error.strerror or error}") from error
        self.info.update(read_info(folder))
        return folder

    @cached_property
    def worlds(self) -> pd.DataFrame:
        """One row per world, in the order of the input. ``culprit`` is a nullable integer. In all other columns,
        missing numbers are NaN.

        In a score without ``confidence``, the index of the data frame is the number of the plan, so
        ``worlds.verdict[k]`` is the verdict of plan k. If ``worlds.verdict[k]`` raises KeyError, plan k was skipped,
        belongs to another shard, or was not simulated.
        """
        frame = frame_in_order(self.parts, "worlds")
        frame["culprit"] = frame["culprit"].astype("Int32")
        if not self._varied:
            frame.index = PlanOrder.of(self.parts).index(frame["plan_id"])
        return frame

    @cached_property
    def skipped(self) -> pd.DataFrame:
        """Plans and files that were not simulated, and the reasons. The columns are ``number``, ``plan_id``, ``source``
        and ``error``. ``number`` is the number of the plan as in ``plans``; it is null for an entry that is not a plan,
        such as a damaged file."""
        columns = ["number", "plan_id", "source", "error"]
        import pandas as pd  # imported here because a run does not need pandas before it has ended

        frame = pd.DataFrame(self.info.get("skipped", []), columns=columns)
        return frame.astype({"number": "Int32"} | dict.fromkeys(columns[1:], "str"))

    @cached_property
    def boxes(self) -> pd.DataFrame:
        """One row per box of each world, in packing order.

        Raises:
            InputError: the run did not keep the table ``boxes``.
        """
        if not self.keeps_boxes:
            kept = option(f"--keep {WORLDS}", python=f'keep="{WORLDS}"')
            raise InputError(f"{self.where}: the run was made with {kept}, so it has no table `boxes`")
        return frame_in_order(self.parts, "boxes")

    @property
    def boxes_if_kept(self) -> pd.DataFrame:
        """The table ``boxes``, which has no rows if the run did not keep the table."""
        return self.boxes if self.keeps_boxes else frame_in_order(self.parts, "boxes")

    @property
    def keeps_boxes(self) -> bool:
        """Whether the run kept the table ``boxes``."""
        return bool(self.info.get("config", {}).get("keep") != WORLDS)

    @cached_property
    def attempts(self) -> pd.DataFrame:
        """One row per attempt (simulation of a world), for worlds that needed more than one attempt. In most runs,
        every world needs only one attempt."""
        return frame_in_order(self.parts, "attempts")

    @cached_property
    def histories(self) -> pd.DataFrame:
        """One row per frame and placed box of each recorded world. The table of a run without the option ``record`` has
        no rows."""
        return frame_in_order(self.parts, "histories")

    @cached_property
    def frames(self) -> pd.DataFrame:
        """One row per frame of each recorded world: the state of the carrier and of its drive (the prescribed
        motion)."""
        return frame_in_order(self.parts, "frames")

    @cached_property
    def contacts(self) -> pd.DataFrame:
        """One row per contact of each frame, for worlds that were recorded with details."""
        return frame_in_order(self.parts, "contacts")

    @cached_property
    def plans(self) -> pd.DataFrame:
        """One row per plan in the order of the input, including the plans of other shards. Missing counts are null."""
        parts = self.parts.table("plans")
        frame: pd.DataFrame = pa.concat_tables(parts or [plans_schema().empty_table()]).to_pandas()
        return frame.astype({name: "Int32" for name in frame.columns if name in ("number", *PlanOrderCounts._fields)})

    @cached_property
    def placements(self) -> pd.DataFrame:
        """One row per box of the simulated plans, with all fields of the plan. If the results are only in memory, this
        table has no rows, since the plans are still in memory or in the files from which they were read."""
        parts = self.parts.table(PLACEMENTS)
        frame: pd.DataFrame = pa.concat_tables(parts or [placements_schema().empty_table()]).to_pandas()
        return frame

    @cached_property
    def summary(self) -> pd.DataFrame | None:
        """The table ``summary``: the answers of a sweep, of a score with confidence, or of a chain. For other runs,
        there is no such table, and the result is None."""
        parts = self.parts.table("summary")
        return pa.concat_tables(parts).to_pandas() if parts else None

    def units(self, table: str) -> dict[str, str]:
        """The units of a table: column → unit. The unit is ``""`` for text and ``"1"`` for counts. The mapping is empty
        if the table is missing."""
        files = self.parts.files(table)
        schema = self.parts.read(files[0]).schema if files else pa.schema([])
        return {
            column.name: (column.metadata or {}).get(b"unit", b"").decode() for column in schema if column.name != RANK
        }

    @property
    def _varied(self) -> bool:
        """Whether the run may have simulated a plan in several worlds."""
        config = self.info.get("config", {})
        return config.get("command") == "sweep" or "sweep" in config


RunSource = RunResults | str | PathLike[str]
"""A run, or its folder."""


def load_run(path: str | PathLike[str], plans_in_memory: Mapping[str, Plan] | None = None) -> RunResults:
    """Open the folder of a run.

    Args:
        plans_in_memory: plan id → plan, for plans of the run that are in no file.

    Raises:
        InputError: the folder has no run, ``run.json`` cannot be read, or a newer petmjx wrote the results. If a part
            of a table is damaged or missing, the same error is raised later, when the table is read.
    """
    folder = path_of(path, "path")
    info = read_info(folder)
    return RunResults(Parts.of(folder, info), info, plans_in_memory or {})


def opened_run(run: RunSource) -> RunResults:
    """The run, opened by :func:`load_run` if it is a folder."""
    return run if isinstance(run, RunResults) else load_run(run)


def read_info(folder: Path) -> dict[str, Any]:
    """The entries of ``run.json``.

    Raises:
        InputError: the folder has no run, ``run.json`` is unreadable or damaged, or a newer petmjx wrote the results.
    """
    file = folder / RUN_FILE
    try:
        info = json.loads(read_regular(file, MOST_RUN_FILE_BYTES).decode())
    except (FileNotFoundError, NotADirectoryError):
        fault = "not a folder" if folder.exists() else "no such folder"
        fault = "no run of petmjx there (it has no run.json)" if folder.is_dir() else fault
        raise InputError(f"{folder}: {fault}") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {reason(error)}") from error
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise InputError(f"{file}: damaged: not JSON at {place} ({json_fault(error)})") from error
    except (ValueError, RecursionError) as error:
        fault = "not UTF-8 text" if isinstance(error, UnicodeDecodeError) else "not JSON"
        raise InputError(f"{file}: damaged: {fault}") from error
    if not isinstance(info, dict) or not isinstance(info.get("schema_version"), int):
        raise InputError(f"{file}: not written by petmjx (it names no schema_version)")
    check_version(file, info["schema_version"])
    if LISTED not in info:
        raise InputError(
            f"{file}: written by petmjx before 0.2, which did not list a run's files: simulate the plans again"
        )
    check_run_file(info, file)
    return info


def is_chain(info: Mapping[str, Any]) -> bool:
    """Whether a run simulated a transport chain. ``info``: the content of its ``run.json``."""
    return info.get("config", {}).get("chain") is not None


def split_warnings(info: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Split the warnings of a ``run.json`` into two lists: warnings about the whole run, and one line for each plan
    with oddly placed boxes. The lines about plans come last in ``run.json``."""
    warnings = list(info.get("warnings", []))
    first_odd = len(warnings) - info.get("counts", {}).get("odd_plans", len(warnings))
    return warnings[:first_odd], warnings[first_odd:]
