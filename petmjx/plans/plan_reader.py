"""Reads packing plans (``load_plans``): files of all formats become validated plans.

Each unusable plan, entry or file is reported in one line. Modules that read tables load Arrow, so they are imported
only if a table is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from petmjx.common.argument_checks import flag_of, integer_of, list_of, number_of, path_of
from petmjx.common.checked_records import option, reason, shown_value
from petmjx.common.errors import InputError
from petmjx.common.safe_read import regular_file
from petmjx.common.text import count_text, first_names, printable, printable_id, printable_name
from petmjx.options.run_options import Anchor, RunOptions
from petmjx.plans.convention_checks import warn, with_conventions
from petmjx.plans.file_formats import (
    PLAN_SUFFIXES,
    NoBoxes,
    NoGeometry,
    SupportsArrow,
    is_csv,
    is_of_other_tools,
    is_parquet,
    looks_like_json,
    looks_like_own_json,
    looks_like_table,
)
from petmjx.plans.input_conventions import USUAL_CONVENTIONS, InputConventions
from petmjx.plans.json_reader import MalformedPlans, read_text_bytes, scan_plans, unpacked_bytes
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, ReadEntry, decode_entries, read_entry
from petmjx.plans.plan_fields import LONGEST_NAME, UnreadFields, joined_names
from petmjx.plans.plan_set import PlanSet, Skipped

if TYPE_CHECKING:
    from petmjx.plans.known_forms import BoxSource
    from petmjx.plans.placement_table import Table, TableError
    from petmjx.plans.readings import Reading

DEFAULT_MAX_BOXES: Final = 512
"""Default limit for the boxes of a plan: twelve times BED-BPP's mean of 43, and twice the largest known plan of other
packers. The model of a plan with this number of boxes declares 132,000 pairs of geoms on C MuJoCo."""

MOST_LINES: Final = 100_000
"""Largest number of unusable entries of a file that are listed one by one. Further entries are only counted."""
REPEATED: Final = "repeated plan id"
FRAME: Final = "data frame"
OBJECT: Final = "python"
"""Names in messages: ``FRAME`` stands for a data frame, ``OBJECT`` for any other Python object."""
_MOSTLY_OWN: Final = 4
"""If a table has more than this number of petmjx's own column names, but no sizes or places, petmjx's own reader
reports the error (``_likelier``)."""
OPTIONS_OF_OTHERS: Final = (
    ("up", "--up"), ("sizes", "--sizes"), ("columns", "--columns"), ("density", "--density"), ("items", "--items"),
    ("reading", "--as"),
)  # fmt: skip
"""Options that apply only to files of other tools: name of the field, and flag of the command line."""


def load_plans(
    paths: str | PathLike[str] | Sequence[str | PathLike[str]] | SupportsArrow,
    *,
    limit: int | None = None,
    strict: bool = False,
    max_boxes: int = DEFAULT_MAX_BOXES,
    carrier_extent_mm: tuple[float, float] | None = None,
    units: str | None = None,
    anchor: Anchor | None = None,
    up: Literal["x", "y", "z", "-y", "-z"] | None = None,
    sizes: Literal["placed", "item"] | None = None,
    columns: Mapping[str, str] | str | None = None,
    density: float | None = None,
    items: str | PathLike[str] | None = None,
    reading: Reading | str | PathLike[str] | None = None,
) -> PlanSet:
    """Read and validate packing plans.

    A ``PlanWarning`` is issued if plans appear to follow another convention, such as coordinates of centres. A
    ``PlanWarning`` is also issued for each file of another tool; it states how the file was read.

    Args:
        paths: a file, a folder, or several of them; or a table of placements, as a pandas data frame or any object with
            Arrow's stream interface; or boxes in another tool's form: py3dbp's packer or bins, a NumPy array, nested
            dictionaries. Files are BED-BPP's JSON, CSV (``*.csv``, ``*.tsv``) or Parquet, or files of other tools: JSON
            with boxes anywhere, tables of any locale, sheets (.xlsx, .ods), arrays (.npy, .npz), MJCF. JSON and text
            may be gzipped. A file may have at most 4 GiB; devices and FIFOs are not read. If a path is a folder, all
            files of known kinds directly in it are read, sorted by name.
        limit: number of good plans after which reading stops.
        strict: whether to raise an error instead of skipping anything.
        max_boxes: largest number of boxes. Plans with more boxes are skipped.
        carrier_extent_mm: extent of the carrier along x and y. Boxes that reach beyond this extent are reported as
            outside. None: the extent of the plan's boxes.
        units: unit of lengths (mm, cm, dm, m, in or ft) and unit of masses (kg, g, lb or t) in the plans, such as
            "cm,g". None: mm and kg; in files of other tools, the most plausible units.
        anchor: the point of a box that the plans' coordinates describe: ``corner`` (front-left-bottom), ``centre``,
            ``base-centre``, ``far-corner`` (with the largest x, y and z), ``top-centre``, ``corner-x`` (with the
            largest x only) and the like. None: the corner; in files of other tools, the most plausible point.
        up: the vertical axis in files of other tools; "-y" or "-z": heights are counted downwards; None: the most
            plausible axis. ``up`` and all arguments after it apply only to files of other tools.
        sizes: ``placed``: sizes of boxes as placed; ``item``: sizes before boxes are turned.
        columns: role (``length``, ``x``, ``weight`` …, see docs/plan-format.md) → name of its column; "-": no column
            has the role.
        density: density of boxes that have no weight, kg/m³; None: 300.
        items: file with the sizes and weights of items, for files that contain only places.
        reading: how a file was read earlier: ``PlanSet.readings``, or a file that ``petmjx info --write-as`` wrote.

    Returns:
        The good plans. Bad plans, damaged parts and unusable files are in ``skipped``. If several plans have the same
        id, only the first good one is used.

    Raises:
        InputError: a path does not exist, a folder has no files of plans, a data frame lacks columns, or an argument is
            invalid. If ``strict`` is True, a plan that would otherwise be skipped also raises the error.
    """
    if limit is not None:
        integer_of(limit, "limit", 1)
    flag_of(strict, "strict")
    integer_of(max_boxes, "max_boxes", 1)
    if carrier_extent_mm is not None:
        if len(list_of(carrier_extent_mm, "carrier_extent_mm", object, "numbers")) != 2:
            raise InputError(f"carrier_extent_mm must be two numbers, {shown_value(carrier_extent_mm)}")
        for length in carrier_extent_mm:
            number_of(length, "carrier_extent_mm", 0)
    reading_file, chosen_reading = (
        (reading, None) if reading is None or isinstance(reading, str | PathLike) else (None, reading)
    )
    options = RunOptions(
        limit=limit, strict=strict, units=units, anchor=anchor, up=up, sizes=sizes, columns=columns, density=density,
        items=items, reading=reading_file,
    )  # fmt: skip
    plan_set = read_plans(paths, options, max_boxes=max_boxes, extent_mm=carrier_extent_mm, reading=chosen_reading)
    warn(plan_set.conventions)
    return plan_set


def read_plans(
    paths: Any,
    options: RunOptions,
    *,
    max_boxes: int = DEFAULT_MAX_BOXES,
    extent_mm: tuple[float, float] | None,
    reading: Reading | None = None,
) -> PlanSet:
    """Like :func:`load_plans`, but without a Python warning.

    Args:
        options: the options ``limit`` and ``strict``, and the options that ``petmjx.options.run_options.READING``
            names.
        reading: how files of other tools are read; None: as the options state.
    """
    given = InputConventions.checked(options.units, options.anchor)
    if options.reading is not None:
        from petmjx.plans.readings import read_reading

        read_reading(options.reading)  # read here, so that a wrong argument is reported once, not for each file
    loading = _PlanLoader(options, given, max_boxes, extent_mm, reading)
    if is_box_object(paths) or isinstance(paths, SupportsArrow):
        loading.read_object(paths)
        return loading.done()
    several = [paths] if isinstance(paths, (str, PathLike)) else list_of(paths, "plans", object, "paths")
    for file in _list_files([path_of(path, "plans") for path in several]):
        loading.read_file(file)
        if loading.full:
            break
    return loading.done()


def read_json_plans(
    source: str, text: bytearray, options: RunOptions, extent_mm: tuple[float, float] | None
) -> tuple[PlanSet, UnreadFields]:
    """Read a text in BED-BPP's form. A text in another form is skipped.

    Args:
        source: name of the file in messages.
        extent_mm: see :func:`load_plans`.

    Returns:
        The plans, and the counts of the fields that petmjx ignores. ``PlanSet.notes`` does not mention the ignored
        fields.

    Raises:
        InputError: a plan is unusable, and ``strict`` does not allow it to be skipped.
    """
    given = InputConventions.checked(options.units, options.anchor)
    loading = _PlanLoader(options, given, DEFAULT_MAX_BOXES, extent_mm, None)
    loading.read_json_text(source, text)
    return with_conventions(loading.found, extent_mm), loading.unread


def idle_options(options: RunOptions, own_files: Sequence[str]) -> Iterator[str]:
    """A note about options for files of other tools, if files in petmjx's own form were read. ``own_files``: names of
    these files."""
    names = [option(flag, python=name) for name, flag in OPTIONS_OF_OTHERS if getattr(options, name) is not None]
    if names and own_files:
        verb = "has" if len(names) == 1 else "have"
        forms = "it is" if len(own_files) == 1 else "they are"
        yield (
            f"{joined_names(names)} {verb} no effect on {first_names(own_files, 2)}, since {forms} in petmjx's own "
            "form, with z upwards"
        )


def is_box_object(value: Any) -> bool:
    """Whether a Python object may contain boxes in another tool's form: dictionaries, an array, py3dbp's objects."""
    if isinstance(value, list | tuple):
        return bool(value) and (isinstance(value[0], Mapping) or is_box_object(value[0]))
    if isinstance(value, str | PathLike | SupportsArrow | Plan | PlanSet):
        return False
    of_packer = isinstance(getattr(value, "bins", None), list) or isinstance(getattr(value, "items", None), list)
    return isinstance(value, Mapping | np.ndarray) or of_packer


def _list_files(paths: list[Path]) -> list[Path]:
    """The files of all paths, in the order in which the files are read. All paths are checked before any file is read,
    so that a typing error is reported at once."""
    if not paths:
        raise InputError("no plan files were given")
    files: list[Path] = []
    for path in paths:
        try:
            if not path.exists():
                raise InputError(f"{printable(str(path))}: no such file or folder")
            if not path.is_dir():
                if (run := _run_around(path)) is not None:
                    raise InputError(
                        f"{printable(str(path))}: belongs to a run: name the run's folder, {printable(str(run))}"
                    )
                files.append(path)
                continue
            if _is_run(path):
                advice = "'petmjx convert' writes its plans to a file"
                raise InputError(f"{printable(str(path))}: the folder of a run, not of plans: {advice}")
            members = plan_files_in(path)
        except (OSError, ValueError) as error:
            raise InputError(f"{printable(str(path))}: cannot be read ({reason(error)})") from error
        if not members:
            raise InputError(f"{printable(str(path))}: the folder holds no .json, .csv or .parquet files")
        files.extend(members)
    return files


def _is_run(folder: Path) -> bool:
    return (folder / "run.json").is_file() and (folder / "worlds").is_dir()


def _run_around(file: Path) -> Path | None:
    """The folder of the run to which a file belongs, by its name; None if it belongs to no run."""
    if file.name == "run.json" and _is_run(file.parent):
        return file.parent
    is_part = re.fullmatch(r"part-\d+\.parquet", file.name) is not None and file.parent.name != "placements"
    if is_part and _is_run(file.parent.parent):
        return file.parent.parent
    return None


def plan_files_in(folder: Path) -> list[Path]:
    """The files of plans directly in a folder, recognised by their names, sorted by name. Raises OSError."""
    return sorted(
        member
        for member in folder.iterdir()
        if member.name.lower().endswith(PLAN_SUFFIXES) and not member.name.startswith(".") and not member.is_dir()
    )


@dataclass
class _PlanLoader:
    """The state of one call of `load_plans`: the plans found so far, and the ids in use.

    Attributes:
        found: the plans, skipped entries and notes found so far.
        source_of: plan id → name of its file.
        names: name → the same name, kept so that equal names share one string.
        unread: counts of the fields that petmjx ignores.
        unlisted: number of unusable entries of the current file that are counted but not listed.
        most_skipped: largest number of entries of ``found.skipped`` while the current file is read. Further unusable
            entries are only counted.
    """

    options: RunOptions
    given: InputConventions
    max_boxes: int
    carrier_extent_mm: tuple[float, float] | None
    reading: Reading | None
    found: PlanSet = field(default_factory=PlanSet)
    source_of: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    unread: UnreadFields = field(default_factory=UnreadFields)
    unlisted: int = 0
    n_plans: int = 0
    """Number of usable and unusable plans that were read so far."""
    most_skipped: int = MOST_LINES
    own_files: dict[str, None] = field(default_factory=dict)
    """The files in petmjx's own form."""

    @property
    def full(self) -> bool:
        limit = self.options.limit
        return limit is not None and len(self.found.plans) >= limit

    def done(self) -> PlanSet:
        """The result, once all files have been read."""
        self.found.notes.extend(self.unread.notes())
        plan_set = with_conventions(self.found, self.carrier_extent_mm)
        return replace(plan_set, conventions=[*idle_options(self.options, list(self.own_files)), *plan_set.conventions])

    def read_file(self, path: Path) -> None:
        source = printable(str(path))
        self.unlisted, self.most_skipped = 0, len(self.found.skipped) + MOST_LINES
        try:
            if is_parquet(path):
                from petmjx.plans.table_files import parquet_frame, read_parquet

                def boxes() -> list[BoxSource]:
                    from petmjx.plans.data_frames import sources_of_frame  # tables in petmjx's form do not need it

                    return sources_of_frame(parquet_frame(path))

                foreign = partial(self._read_foreign, source, boxes)
                self._skip_file(source, self._table_fault(source, partial(read_parquet, path), foreign))
            else:
                self._read_bytes(source, path)
        except (OSError, ValueError) as error:
            self._skip(source, None, f"{source}: cannot be read ({reason(error)})")
        self._count_unlisted(source)

    def read_json_text(self, source: str, text: bytearray) -> None:
        """Read a text in BED-BPP's form. A text in another form is skipped."""
        if not looks_like_own_json(text):
            self._skip(source, None, f"{source}: is not in BED-BPP's form")
            return
        self._read_own_json(source, text, damaged=False)
        self._count_unlisted(source)

    def read_object(self, value: Any) -> None:
        """Read a table of placements, or boxes from Python objects in another tool's form.

        Raises:
            InputError: the table lacks columns, or the object contains no plans.
        """
        if isinstance(value, SupportsArrow):
            from petmjx.plans.data_frames import sources_of_frame
            from petmjx.plans.table_files import frame_table

            source, foreign = FRAME, partial(self._read_foreign, FRAME, partial(sources_of_frame, value))
            fault = self._table_fault(FRAME, partial(frame_table, value), foreign)
        else:
            from petmjx.plans.python_objects_and_py3dbp import sources_of_object

            source, fault = OBJECT, self._read_foreign(OBJECT, partial(sources_of_object, value))
        if fault is not None:
            raise InputError(f"{source}: {fault}") from None
        self._count_unlisted(source)

    def _read_foreign_file(self, source: str, path: Path, data: bytes | bytearray) -> InputError | None:
        """Read a file of another tool. Returns an error if the file cannot be read, else None."""
        from petmjx.plans.foreign_formats import sources_of_bytes

        return self._read_foreign(source, partial(sources_of_bytes, data, path), path)

    def _read_foreign(
        self, source: str, find_boxes: Callable[[], Sequence[BoxSource]], path: Path | None = None
    ) -> InputError | None:
        """Read a file or object in another tool's form. If two readings tie, the user is asked which one is right,
        provided that the caller can ask (``CHOOSER``). Returns an error if there are no plans, or if the form can be
        read in two ways; else None.

        Args:
            find_boxes: function that returns the lists of boxes in the file or object.
            path: the file; None: an object.
        """
        from petmjx.plans.foreign_plans import plans_of_sources
        from petmjx.plans.readings import CHOOSER, AmbiguousFile, wishes_of

        try:
            boxes = find_boxes()
            wishes = wishes_of(self.options, self.carrier_extent_mm, self.reading, self.max_boxes)
            try:
                plans = plans_of_sources(boxes, path, source, wishes, self.options.items)
            except AmbiguousFile as error:
                chooser = CHOOSER.get()
                chosen = None if chooser is None else chooser(source, error)
                if chosen is None:
                    raise
                wishes = wishes_of(self.options, self.carrier_extent_mm, chosen, self.max_boxes)
                plans = plans_of_sources(boxes, path, source, wishes, self.options.items)
            self.found.readings[source] = plans.reading
            for refused in plans.refused:
                self._skip(source, refused.plan_id, refused.message)
            if plans.table is not None:
                self._take_table(source, plans.table, USUAL_CONVENTIONS)
        except InputError as error:
            if self.options.strict and str(error).startswith(f"{source}: "):  # the error is about one plan or row
                raise
            return error
        return None

    def _read_bytes(self, source: str, path: Path) -> None:
        """Read a file that is not Parquet: JSON or CSV, or a text, sheet or array of another tool. The file may be
        gzipped."""
        data, fault = read_text_bytes(path)
        if fault is not None and not data:
            content, packing_fault = unpacked_bytes(path)
            if packing_fault is None and is_of_other_tools(content):
                error = self._read_foreign_file(source, path, content)
                fault = None if error is None else str(error)
            if fault is not None:
                self._skip(source, None, f"{source}: {fault}")
            return
        if fault is not None:
            self._skip(source, None, f"{source}: {fault}")
        # A pipe's name has no suffix, so the content shows whether the data are a table.
        if is_csv(path) or (regular_file(path) != path and looks_like_table(data)):
            if looks_like_json(data):
                self._skip(source, None, f"{source}: is JSON, but is read as JSON only if its name ends in .json")
                return
            from petmjx.plans.table_files import parse_csv

            read = partial(parse_csv, data, cut_off=fault is not None)
            foreign = None if fault is not None else partial(self._read_foreign_file, source, path, data)
            self._skip_file(source, self._table_fault(source, read, foreign))
        else:
            self._read_json(source, path, data, damaged=fault is not None)

    def _table_fault(
        self, source: str, read: Callable[[], Table], otherwise: Callable[[], InputError | None] | None
    ) -> InputError | None:
        """Read a table. Returns an error if the table cannot be read, else None.

        Args:
            otherwise: function that reads the table as a table of another tool, if it has none of petmjx's forms. The
                function returns an error if it could not read the table, else None.
        """
        from petmjx.plans.placement_table import TableError

        try:
            table = read()
        except TableError as error:
            fault = error if otherwise is None or error.is_own else otherwise()
            return None if fault is None else _likelier(error, fault)
        self.own_files[source] = None
        self._take_table(source, table, self.given)
        return None

    def _take_table(self, source: str, table: Table, given: InputConventions) -> None:
        """Add the plans of a table of placements."""
        from petmjx.plans.placement_table import RefusedPlan, table_plans

        if not len(table.numbers) and not table.lost:
            self._skip(source, None, f"{source}: holds no plan")
        self.unread.update(dict.fromkeys(table.unread, len(table.numbers)))
        with closing(table_plans(table, source, self.max_boxes, self.found.notes, given)) as plans:
            for plan in plans:
                if isinstance(plan, RefusedPlan):
                    self._skip(source, plan.plan_id, plan.message)
                else:
                    self._keep(Plan(**plan))
                if self.full:
                    break

    def _read_json(self, source: str, path: Path, data: bytearray, damaged: bool) -> None:
        """Read the plans of a text in BED-BPP's form or in the form of another tool.

        Args:
            damaged: whether the text is known to be damaged JSON. If ``damaged`` is True, the plans before the damage
                are kept.
        """
        if not (damaged or looks_like_own_json(data)):
            fault = self._read_foreign_file(source, path, data)
            if not isinstance(fault, NoBoxes) or data.lstrip().startswith(b"["):
                self._skip_file(source, fault)
                return
        # the reader of BED-BPP's JSON also reports the error about a text that is no list and has no list of boxes
        self._read_own_json(source, data, damaged)

    def _read_own_json(self, source: str, data: bytearray, damaged: bool, *, is_plain: bool = False) -> None:
        """Read the plans of a text in BED-BPP's form. If the text turns out not to be JSON, its plans are removed
        again.

        Args:
            damaged: see :meth:`_read_json`.
            is_plain: whether comments, and commas behind last values, have already been removed.
        """
        n_good, n_skipped = len(self.found.plans), len(self.found.skipped)
        n_plans, unread = self.n_plans, self.unread.copy()
        options = DecoderOptions(source, self.max_boxes, self.given, self.names, self.unread)
        entries: Iterable[ReadEntry] | None = None
        if self.options.limit is None and not damaged:
            entries = decode_entries(data, options)
        if not entries:
            has_json_name = source.lower().endswith((".json", ".json.gz"))
            if not damaged and (kind := _kind_of_text(data, has_json_name)) is not None:
                self._skip(source, None, f"{source}: {kind}")
                return
            entries = (read_entry(entry, options) for entry in scan_plans(data))
        self.own_files[source] = None
        n_entries, orders = 0, []
        try:
            for entry in entries:
                n_entries += 1
                if entry.fault is not None:
                    self._skip(source, entry.plan_id, entry.fault)
                elif entry.plan is not None:
                    self._keep(entry.plan)
                else:
                    orders.append(entry.plan_id)
                if self.full:
                    break
        except MalformedPlans as error:
            if not damaged:
                for plan in self.found.plans[n_good:]:
                    del self.source_of[plan.plan_id], self.found.numbers[plan.plan_id]
                del self.found.plans[n_good:], self.found.skipped[n_skipped:]
                self.n_plans, self.unread, self.unlisted = n_plans, unread, 0
                from petmjx.plans.foreign_formats import plain_json

                if not is_plain and (plain := plain_json(data)) is not None:
                    self._read_own_json(source, plain, damaged=False, is_plain=True)
                else:
                    self._skip_file(source, error)
                return
        if n_entries == 0 and not damaged:
            self._skip(source, None, f"{source}: holds no plan")
        if orders:
            self._skip(source, None, _orders_message(source, orders))

    def _count_unlisted(self, source: str) -> None:
        if self.unlisted:
            count_words = count_text(self.unlisted, "more entry is", "more entries are")
            self.found.skipped.append(Skipped(source, None, f"{source}: {count_words} unusable"))

    def _keep(self, plan: Plan) -> None:
        """Add a good plan, unless its id is already used."""
        source, plan_id = plan.source, plan.plan_id
        first_source = self.source_of.get(plan_id)
        if first_source is not None:
            place_text = "in this file" if first_source == source else f"in {first_source}"
            self._skip(
                source, plan_id, f"{source}: plan {printable_name(plan_id)}: {REPEATED}, first used {place_text}"
            )
            return
        self.source_of[plan_id] = source
        self.found.plans.append(plan)
        self.found.numbers[plan_id] = self.n_plans
        self.n_plans += 1

    def _skip_file(self, source: str, fault: InputError | None) -> None:
        """Skip a file that has a fault; do nothing if ``fault`` is None."""
        if fault is not None:
            self._skip(source, None, f"{source}: {fault}", fault)

    def _skip(self, source: str, plan_id: str | None, message: str, cause: Exception | None = None) -> None:
        if self.options.strict:
            raise InputError(message) from cause
        number = None if plan_id is None else self.n_plans
        self.n_plans += plan_id is not None
        if len(self.found.skipped) >= self.most_skipped:
            self.unlisted += 1
            return
        if plan_id is not None:
            plan_id = printable(plan_id) if len(plan_id) <= LONGEST_NAME else printable_name(plan_id)
        self.found.skipped.append(Skipped(source, plan_id, message, number))


def _likelier(own: TableError, other: InputError) -> InputError:
    """The error to report for a table that could be read neither as a table of petmjx nor as one of another tool.

    Usually, the error of the reader for other tools is reported, such as a bad cell or two possible readings. The error
    of petmjx's own reader names the missing columns. It is reported only if the other reader finds no boxes at all, or
    if that reader finds no sizes or places and the table has more than ``_MOSTLY_OWN`` of petmjx's column names.
    """
    lacks_columns = isinstance(other, NoBoxes) or (own.n_known > _MOSTLY_OWN and isinstance(other, NoGeometry))
    return own if lacks_columns else other


def _kind_of_text(data: bytearray, named: bool) -> str | None:
    """The error text for a text that does not begin like JSON; None for JSON, including damaged JSON.

    Args:
        named: whether the file has the name of a JSON file. If ``named`` is True, any text that does not look like a
            table is taken for damaged JSON.
    """
    if looks_like_table(data):
        return "looks like a table, but is read as a table only if its name ends in .csv or .tsv"
    first = data[: 1 << 16].split(b"\n", 1)[0].strip().lower()
    begins_so = not first or first[:1] in b'{["-0123456789' or first.startswith((b"true", b"false", b"null"))
    if named or begins_so:
        return None
    if b"\0" in data[: 1 << 12]:
        return "is no text: plans are JSON, or tables in CSV or Parquet"
    return "is text, but petmjx finds neither lists of boxes nor a table of boxes in it"


def _orders_message(source: str, order_ids: Sequence[str]) -> str:
    first, n_orders = printable_id(order_ids[0]), len(order_ids)
    content = f"{first} is an order" if n_orders == 1 else f"{n_orders} entries ({first}, …) are orders"
    return (
        f"{source}: {content} (item_sequence), not packing plans: an order does not say where boxes go; "
        f"pack it first: petmjx samples --orders {source} -o plans.json"
    )
