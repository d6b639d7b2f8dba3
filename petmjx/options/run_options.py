"""The options of a run (``RunOptions``): how and where the run is computed, and how its files are read and written.

Defaults, checks and descriptions are defined only here.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, complaint, shown_value, within
from petmjx.common.units import PLAN_UNITS, plan_units

AUTO: Final = "auto"

MOST_WORKERS: Final = 4096

ALL: Final = "all"
FAILED: Final = "failed"
"""Two values of the option ``RunOptions.record``. With ``all``, all plans are recorded; with ``failed``, only plans
that fail."""

WORLDS: Final = "worlds"
"""A value of the option ``RunOptions.keep``: keep only the tables with one row per world (one simulation of one plan),
not the tables with one row per box. The other value is ``ALL``."""

FRAME_INTERVAL_S: Final = 0.05
"""Default time between two frames of a recording, s. At 20 frames per second, a viewer can follow the motion of a
box."""


def _share(text: str | None) -> str | None:
    """Validator of the option ``shard``, which must have the form I/N with 1 ≤ I ≤ N. Leading zeros are removed."""
    if text is None:
        return None
    match = re.fullmatch(r"0*([0-9]{1,9})/0*([0-9]{1,9})", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise ValueError(f"must be I/N with 1 ≤ I ≤ N < 10⁹, such as 3/16, {shown_value(text)}")
    return f"{match[1]}/{match[2]}"


def _workers(value: Any) -> Any:
    """Validator of the option ``workers``: a whole number ≥ 1, or ``auto``. The command line passes the value of
    ``workers`` as text, even if it is a number."""
    number = int(value) if isinstance(value, str) and re.fullmatch(r"\d{1,9}", value) else value
    if number is None or (isinstance(number, str) and number == AUTO):
        return number
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= MOST_WORKERS:
        raise ValueError(f"must be {AUTO} or a whole number from 1 to {MOST_WORKERS:,}, {shown_value(value)}")
    return number


def _address(text: str | None) -> str | None:
    """Validator of the option ``ray``, which must be an address such as ``auto`` or HOST:PORT. Addresses for Ray's
    client mode are refused, because results cannot be streamed in this mode."""
    if text not in (None, AUTO) and ("://" in text or not re.fullmatch(r"\S+:\d{1,5}", text)):
        raise ValueError(
            f"must be HOST:PORT of a cluster's head, or auto for the cluster on this machine, {shown_value(text)}"
        )
    return text


def _units(text: str | None) -> str | None:
    """Validator of the option ``units``: the unit of lengths, the unit of masses, or both, such as "cm,g" or
    "cm/mm,kg"."""
    if text is None:
        return None
    try:
        plan_units(text)
    except ValueError as error:
        raise ValueError(f"{error}, {shown_value(text)}") from None
    return ",".join(name.strip() for name in text.split(","))


def _columns(value: Any) -> Any:
    """Validator of the option ``columns``: a mapping from roles to names of columns, or text such as "x=Pos X,y=Pos
    Y"."""
    if isinstance(value, str):
        pairs = [pair.partition("=") for pair in value.split(",") if pair.strip()]
        if not pairs or not all(role.strip() and middle and name.strip() for role, middle, name in pairs):
            raise ValueError(f"must be ROLE=NAME,…, such as x=Pos X,length=Länge, {shown_value(value)}")
        return {role.strip(): name.strip() for role, _, name in pairs}
    if isinstance(value, Mapping):
        return {str(role): str(name) for role, name in value.items()}
    return value


def _is_path(value: Any) -> Any:
    """Validator of paths: a path must not be empty, and must not contain a NUL character."""
    if value is not None and not isinstance(value, Path) and not (isinstance(value, str | PathLike) and str(value)):
        raise ValueError(f"must be a path, {shown_value(value)}")
    if "\0" in str(value):
        raise ValueError(f"must be a path without NUL characters, {shown_value(value)}")
    return value


File = Annotated[Path, BeforeValidator(_is_path)]
"""The type of options whose value is a path."""

Anchor = Literal[
    "corner", "centre", "base-centre", "far-corner", "top-centre",
    "corner-x", "corner-y", "corner-xy", "corner-z", "corner-xz", "corner-yz",
]  # fmt: skip
"""The point of a box to which the coordinates in a plan refer. ``far-corner`` is the corner with the largest x, y and
z. ``top-centre`` is the middle of the top, where a robot's suction gripper holds the box. ``corner-x`` is the corner
with the largest x and the smallest y and z, and so on."""


READING: Final = ("units", "anchor", "up", "sizes", "columns", "density", "items", "reading")
"""Names of the fields of ``RunOptions`` that determine how files of plans are read."""
OF_ORDERS: Final = ("units", "columns", "density", "items", "reading")
"""Names of the fields of ``RunOptions`` that determine how files of orders are read."""

_BY_FILE: Final = "detected"
_OR_BY_FILE: Final = "detected in files of other tools"


class RunOptions(CheckedRecord):
    """The options of how a run is computed: engine, threads, workers (processes), files and so on.

    Of the options of a run, only ``engine`` and ``world_timeout_s`` affect results. With a different ``engine``, the
    outcome of a plan may differ. ``world_timeout_s`` may end a simulation before it has an outcome; the verdict is then
    ``invalid``, for the reason ``timeout``.
    """

    engine: Annotated[Any, CliFlag("--engine")] = Field(
        AUTO,
        description="engine: mujoco: C MuJoCo on CPU threads; mjx-warp: kernels on a GPU; mjx-warp-cpu: the same "
        "kernels on CPU threads; mjx-jax: MJX in batches; auto: the engine that is expected to finish first; in "
        "Python also an engine of your own",
    )
    threads: Annotated[int | None, within(1, 4096), CliFlag("--threads", "N")] = Field(
        None,
        ge=1,
        description="number of CPU threads that the engines mujoco and mjx-warp-cpu use, or that each worker uses if "
        "there are workers; by default all",
    )
    lanes: Annotated[int | None, within(1, 1 << 20), CliFlag("--lanes", "N")] = Field(
        None,
        ge=1,
        description="number of worlds that are simulated at once: with mjx-warp one world per thread block, by "
        "default as many as fit on the device; with mjx-jax the worlds of one batch, by default up to 256 on a GPU, "
        "and one per thread on a CPU",
    )
    world_timeout_s: Annotated[float | None, within(0, 1e9), CliFlag("--world-timeout", "S")] = Field(
        None,
        gt=0,
        description="wall-clock time after which the simulation of a world ends, s (verdict invalid, reason timeout); "
        "engine mujoco only; by default 32 times the expected CPU time of the world (70 times if a hand or tines "
        "carry boxes), but at least 30 s in a static check and 300 s otherwise",
    )
    workers: Annotated[int | str | None, BeforeValidator(_workers), CliFlag("--workers", "N|auto")] = Field(
        None,
        description="run in this many worker processes with Ray (needs the extra 'ray' of petmjx): each worker has a "
        "share of the CPU threads, or a GPU, which up to four workers can share; auto: one worker for each GPU or, "
        "with mujoco, for each machine",
    )
    ray: Annotated[str | None, AfterValidator(_address), CliFlag("--ray", "ADDRESS")] = Field(
        None,
        description="run on the Ray cluster whose head is at HOST:PORT; auto: on the cluster on this machine. "
        "If the option workers is not given, workers=auto is used. By default, workers run on this machine, without a "
        "cluster",
    )
    limit: Annotated[int | None, within(1, 2**63 - 1), CliFlag("--limit", "N")] = Field(
        None, ge=1, description="number of plans that are used, from the first plan on; by default all"
    )
    units: Annotated[
        str | None, AfterValidator(_units), CliFlag("--units", "LENGTH,MASS", default=f"{PLAN_UNITS}; {_OR_BY_FILE}")
    ] = Field(
        None,
        description="unit of the lengths (mm, cm, dm, m, in or ft), unit of the masses (kg, g, lb or t), or both "
        "(cm,g) in the plans. If sizes and coordinates have different units, both are given: cm/mm means sizes in cm, "
        "coordinates in mm",
    )
    anchor: Annotated[Anchor | None, CliFlag("--anchor", "POINT", default=f"corner; {_OR_BY_FILE}")] = Field(
        None,
        description="point of a box that coordinates in the plans describe: corner: the corner with the smallest x, y "
        "and z; centre: its middle; base-centre: the centre of its base; far-corner: the corner with the largest x, y "
        "and z; top-centre: the centre of its top; corner-x, corner-xy and the like: the corner with the largest "
        "coordinates along the named axes and the smallest coordinates along the others",
    )
    up: Annotated[Literal["x", "y", "z", "-y", "-z"] | None, CliFlag("--up", "x|y|z|-y|-z", default=_BY_FILE)] = Field(
        None, description="the vertical axis of files of other tools; -y or -z: heights are counted downwards"
    )
    sizes: Annotated[Literal["placed", "item"] | None, CliFlag("--sizes", "placed|item", default=_BY_FILE)] = Field(
        None,
        description="whether sizes in files of other tools describe a box as it is placed (placed), or before it is "
        "turned (item)",
    )
    columns: Annotated[
        dict[str, str] | None, BeforeValidator(_columns), CliFlag("--columns", "ROLE=NAME,…", default=_BY_FILE)
    ] = Field(
        None,
        description="names of the columns in files of other tools, by role, such as x=Pos X,length=Länge; ROLE=-: no "
        "column has this role; in Python a dictionary",
    )
    density: Annotated[float | None, within(1, 20_000), CliFlag("--density", "KG/M3", default="300")] = Field(
        None, description="density of boxes without a weight in files of other tools, kg/m³"
    )
    items: Annotated[File | None, CliFlag("--items", "FILE")] = Field(
        None,
        description="file with the sizes and weights of items, for files of other tools that have only places, and "
        "for orders that have only articles",
    )
    reading: Annotated[File | None, CliFlag("--as", "FILE.toml")] = Field(
        None,
        description="file that 'petmjx info PLANS --write-as FILE' wrote: it tells how files of other tools are read",
    )
    articles: Annotated[File | None, CliFlag("--articles", "FILE")] = Field(
        None,
        description="table of articles or product groups, as for 'petmjx loads': it gives the boxes' centres of mass "
        "and materials; the materials determine the friction between boxes",
    )
    record: Annotated[str | tuple[str, ...] | None, CliFlag("--record", "failed|all|ID,…", "--record-plans")] = Field(
        None,
        description="worlds whose histories (motion, frame by frame) are kept: failed: the worlds that are not stable; "
        "all: all worlds; ids: the worlds of the plans with these ids. All other results stay the same; in Python "
        "also a list of ids",
    )
    record_interval_s: Annotated[float, within(0.0001, 3600), CliFlag("--record-interval", "S")] = Field(
        FRAME_INTERVAL_S, description="time between two frames of a history, s; each placement is a frame too"
    )
    record_details: Annotated[bool, CliFlag("--record-details")] = Field(
        False, description="record also accelerations, penetrations and contacts in histories; engine mujoco only"
    )
    force_intervals: Annotated[bool, CliFlag("--force-intervals")] = Field(
        False,
        description="also compute, for each box at rest, the smallest and the largest force on its top that balance "
        "and friction allow; this takes a tenth of a second or more per world; all other results stay the same",
    )
    keep: Annotated[Literal["all", "worlds"], CliFlag("--keep", "all|worlds")] = Field(
        "all",
        description="tables that are kept: all: all tables; worlds: only the table 'worlds'. In a large sweep, nearly "
        "all bytes are in the table 'boxes'; the results that are kept stay the same",
    )
    orders: Annotated[File | None, CliFlag("--orders", "FILE")] = Field(
        None,
        description="file of the orders from which the plans were packed, in any form (docs/plan-format.md#orders): "
        "the run then reports how many boxes the plans leave out, and how many orders have no plan; the verdicts stay "
        "the same",
    )
    strict: Annotated[bool, CliFlag("--strict")] = Field(
        False, description="stop at the first unusable plan instead of skipping it"
    )
    allow_large: Annotated[bool, CliFlag("--yes", short="-y")] = Field(
        False, description="allow more than a million worlds"
    )
    out: Annotated[File | None, CliFlag("--out", "DIR", "-o", default="petmjx-results/DATE-TIME")] = Field(
        None,
        description="folder for the results; in Python, results stay in memory if no folder is given",
    )
    overwrite: Annotated[bool, CliFlag("--overwrite")] = Field(
        False, description="replace the results that are already in the folder"
    )
    resume: Annotated[bool, CliFlag("--resume")] = Field(
        False,
        description="continue the run in the folder: simulate only the worlds that it lacks; begin a new run if the "
        "folder has none",
    )
    shard: Annotated[str | None, AfterValidator(_share), CliFlag("--shard", "I/N")] = Field(
        None,
        description="simulate only share number I of N shares of the plans; I counts from 1; 'petmjx merge' joins the "
        "results of the shares",
    )

    @model_validator(mode="after")
    def _folder_is_named(self) -> Self:
        if self.resume and self.out is None:
            raise complaint("needs the option out (the folder of the run to continue)", "resume")
        if self.resume and self.overwrite:
            raise complaint("contradicts overwrite: drop one of them", "resume")
        return self

    @model_validator(mode="after")
    def _details_of_something(self) -> Self:
        if self.record_details and self.record is None:
            raise complaint("needs the option record, which says what to record", "record_details")
        return self

    @model_validator(mode="after")
    def _kept_what_is_asked(self) -> Self:
        if self.force_intervals and not self.keeps_boxes:
            raise complaint(
                "adds columns to the table 'boxes', but the option keep leaves this table out", "force_intervals"
            )
        return self

    @property
    def keeps_boxes(self) -> bool:
        """Whether the results have a row for each box."""
        return self.keep != WORLDS

    @property
    def asked_workers(self) -> int | str | None:
        """The number of workers (processes) that the user has requested, or ``auto``. If the user names a Ray cluster
        but no number, the result is ``auto``. If the result is None, the whole run is computed in this process.
        """
        return AUTO if self.workers is None and self.ray is not None else self.workers

    def takes(self, plan_id: str) -> bool:
        """Whether a plan belongs to this run's shard (the share of the plans that this run simulates). The shard of a
        plan depends only on the plan's id, so all simulations of a plan are in the same shard."""
        if self.shard is None:
            return True
        share, shares = (int(number) for number in self.shard.split("/"))
        digest = hashlib.blake2b(plan_id.encode("utf-8", "backslashreplace"), digest_size=8).digest()
        return int.from_bytes(digest, "big") % shares == share - 1
