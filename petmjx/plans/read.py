"""BED-BPP packing plans: from files to validated plans, with one line about each unusable part."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Final

from petmjx.checked import reason
from petmjx.errors import InputError
from petmjx.plans.plan import PlanSet, Skipped
from petmjx.plans.scan import Damage, describe, scan_plans
from petmjx.plans.validate import PlanError, parse_plan
from petmjx.plans.warnings import check_layout
from petmjx.text import printable, shown

DEFAULT_MAX_BOXES: Final = 256
"""Boxes of the largest plan that is taken by default: six times BED-BPP's mean of 43. A world of 256 boxes has 1,542
degrees of freedom, and its dense Hessian takes 10 MB in float32. Beyond that, batches make no sense."""

_GZIP_MAGIC: Final = b"\x1f\x8b\x08"
_GZIP_CHUNK: Final = 1 << 16
_WBITS_GZIP: Final = 31
_UTF16_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")
_SUFFIXES: Final = (".json", ".json.gz")


def load_plans(
    paths: str | PathLike[str] | Sequence[str | PathLike[str]],
    *,
    limit: int | None = None,
    strict: bool = False,
    max_boxes: int = DEFAULT_MAX_BOXES,
    carrier_extent_mm: tuple[float, float] | None = None,
) -> PlanSet:
    """Read and validate packing plans.

    Args:
        paths: a file, a folder, or several of them. Files are JSON, plain or gzipped (the content decides, not the
            name). Of a folder all ``*.json`` and ``*.json.gz`` directly in it are read, sorted by name.
        limit: stop after this many good plans.
        strict: raise at the first thing that would be skipped.
        max_boxes: plans with more boxes are skipped.
        carrier_extent_mm: x–y extent within which boxes are not reported as outside; None: the plan's footprint.

    Returns:
        The good plans. Bad plans, damaged spots and unusable files are in ``skipped``. Of plans with the same id the
        first good one is kept.

    Raises:
        InputError: a path does not exist, a folder has no plan files, or an option makes no sense. With ``strict``
            also if anything would be skipped.
    """
    if limit is not None and limit < 1:
        raise InputError(f"limit must be at least 1, got {limit}")
    if max_boxes < 1:
        raise InputError(f"max_boxes must be at least 1, got {max_boxes}")
    given = [paths] if isinstance(paths, (str, PathLike)) else list(paths)
    loading = _Loading(limit, strict, max_boxes, carrier_extent_mm)
    for file in _list_files([Path(path) for path in given]):
        loading.read_file(file)
        if loading.full:
            break
    return loading.found


def _list_files(paths: list[Path]) -> list[Path]:
    """Files in the order of reading. All paths are checked first, so that a typing error is found at once."""
    if not paths:
        raise InputError("no plan files were given")
    files: list[Path] = []
    for path in paths:
        try:
            if not path.exists():
                raise InputError(f"{printable(str(path))}: no such file or folder")
            if not path.is_dir():
                files.append(path)
                continue
            members = sorted(
                member
                for member in path.iterdir()
                if member.name.lower().endswith(_SUFFIXES) and not member.name.startswith(".") and not member.is_dir()
            )
        except (OSError, ValueError) as error:
            raise InputError(f"{printable(str(path))}: cannot be read ({reason(error)})") from error
        if not members:
            raise InputError(f"{printable(str(path))}: the folder holds no .json or .json.gz files")
        files.extend(members)
    return files


@dataclass
class _Loading:
    """The state of one `load_plans`: what was found, and which ids are in use."""

    limit: int | None
    strict: bool
    max_boxes: int
    carrier_extent_mm: tuple[float, float] | None
    found: PlanSet = field(default_factory=PlanSet)
    source_of: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)

    @property
    def full(self) -> bool:
        return self.limit is not None and len(self.found.plans) >= self.limit

    def read_file(self, path: Path) -> None:
        source = printable(str(path))
        try:
            text, fault = _read_text(path)
        except OSError as error:
            self._skip(source, None, f"{source}: cannot be read ({reason(error)})")
            return
        if fault is not None:
            self._skip(source, None, f"{source}: {fault}")
            if not text:
                return
        n_entries = 0
        order_ids: list[str] = []
        for entry in scan_plans(text):
            n_entries += 1
            if isinstance(entry, Damage):
                self._skip(source, entry.plan_id, describe(source, entry))
            elif isinstance(entry.value, dict) and "item_sequence" in entry.value:
                order_ids.append(entry.plan_id)
            else:
                self._take(source, entry.plan_id, entry.value)
            if self.full:
                break
        if n_entries == 0:
            self._skip(source, None, f"{source}: holds no plan")
        if order_ids:
            self._skip(source, None, _orders_message(source, order_ids))

    def _take(self, source: str, plan_id: str, value: object) -> None:
        try:
            plan = parse_plan(plan_id, source, value, self.max_boxes, self.names)
        except PlanError as error:
            self._skip(source, plan_id, str(error), error)
            return
        first_source = self.source_of.get(plan_id)
        if first_source is not None:
            where = "in this file" if first_source == source else f"in {first_source}"
            self._skip(source, plan_id, f"{source}: plan {shown(plan_id)}: repeated plan id, first used {where}")
            return
        self.source_of[plan_id] = source
        self.found.plans.append(plan)
        warnings = check_layout(plan_id, source, plan.corner_mm, plan.size_mm, self.carrier_extent_mm)
        if warnings.any:
            self.found.warnings.append(warnings)

    def _skip(self, source: str, plan_id: str | None, message: str, cause: Exception | None = None) -> None:
        if self.strict:
            raise InputError(message) from cause
        plan_id = None if plan_id is None else printable(plan_id)
        self.found.skipped.append(Skipped(source, plan_id, message))


def _orders_message(source: str, order_ids: list[str]) -> str:
    first = shown(order_ids[0])
    what = f"{first} is an order" if len(order_ids) == 1 else f"{len(order_ids)} entries ({first}, …) are orders"
    return (
        f"{source}: {what} (item_sequence), not packing plans: an order does not say where boxes go; "
        f"pack it first: petmjx samples --orders {source} -o plans.json"
    )


def _read_text(path: Path) -> tuple[str, str | None]:
    """A file's text, and what is wrong with the whole file (None: nothing).

    Bytes that are not UTF-8 become lone surrogates. The JSON around them is still read, and a plan with such a name
    is refused with its name.
    """
    data = path.read_bytes()
    fault = None
    if data.startswith(_GZIP_MAGIC) and data[3:4] < b"\x20":  # no reserved flag is set (RFC 1952)
        data, fault = _gunzip(data)
    if data.startswith(_UTF16_MARKS) and b"\0" in data[2:4]:
        return "", "is UTF-16 text; plans must be UTF-8"
    return data.decode("utf-8-sig", "surrogateescape"), fault


def _gunzip(data: bytes) -> tuple[bytes, str | None]:
    """Unpack a gzip stream (one or more members) as far as it is undamaged; also say what is wrong, or None."""
    view = memoryview(data)
    parts: list[bytes] = []
    position = 0
    while position < len(view):
        inflate = zlib.decompressobj(wbits=_WBITS_GZIP)
        while not inflate.eof:
            chunk = view[position : position + _GZIP_CHUNK]
            if not chunk:
                return b"".join(parts), "the gzip data is cut off; plans up to there are read"
            before = inflate.copy()
            try:
                parts.append(inflate.decompress(chunk))
            except zlib.error as error:
                parts.extend(_inflate_bytewise(before, chunk))
                return b"".join(parts), f"the gzip data is damaged ({error}); plans up to there are read"
            position += len(chunk) - len(inflate.unused_data)
        if not any(view[position:]):
            break  # gzip members may be followed by padding
    return b"".join(parts), None


def _inflate_bytewise(inflate: zlib._Decompress, chunk: memoryview) -> Iterator[bytes]:
    """The undamaged beginning of a chunk, byte by byte: a call that fails on the whole chunk returns nothing."""
    for position in range(len(chunk)):
        try:
            yield inflate.decompress(chunk[position : position + 1])
        except zlib.error:
            return
