"""Reads Parquet files, and limits the memory that the content of a file may take."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from petmjx.common.safe_read import FREE_BYTES, MOST_BYTES, allowed_bytes, open_regular, regular_file, size
from petmjx.common.text import printable_name

_WIDTHS: Final = {"BOOLEAN": 1, "INT32": 4, "INT64": 8, "FLOAT": 4, "DOUBLE": 8, "BYTE_ARRAY": 8}
"""Type of values in a Parquet file → number of bytes that a value takes in memory. For a text, only its offset and its
length are counted."""

_ROWS: Final = 1 << 16
_FEW_ROWS: Final = 1 << 8
"""Numbers of rows that are read at a time. ``_FEW_ROWS`` is for files in which texts may be long although the file is
small, and ``_ROWS`` is for all other files."""

_PREFIXED: Final = "DELTA_BYTE_ARRAY"
"""Name of a Parquet encoding. With the encoding DELTA_BYTE_ARRAY, a file stores for each text the length of the prefix
that the text shares with the previous text, and the rest of the text. So a few stored bytes can stand for a long
text."""


def open_for_arrow(path: Path) -> pa.NativeFile:
    """Open a regular file as a stream of Arrow. Parquet files are never read through a stream of Python, for the
    following reason.

    Arrow reads Parquet in its own threads. A thread may free its buffers only after the table has been returned. To
    free a buffer that belongs to Python, the thread must get the lock of Python's interpreter. If the interpreter is
    shutting down at that moment, the process aborts ("terminate called without an active exception") or hangs:
    https://github.com/apache/arrow/issues/34314 and https://github.com/apache/arrow/issues/50482.

    Raises:
        OSError: the file cannot be read, or is not a regular file; ``strerror`` has the reason.
        ValueError: the name is impossible for a file, such as a name with a null character.
    """
    # Python checks the file first, since Arrow would wait for ever if the file were a FIFO. pa.OSFile accepts a name
    # that consists of any bytes. Other functions of Arrow read "s3:" as a scheme and "a=1" in a folder's name as a
    # column, and refuse names that are not UTF-8.
    with open_regular(path):
        return pa.OSFile(os.fsencode(regular_file(path)))


class OversizedFile(ValueError):
    """The content of a Parquet file would take much more memory than the size of the file justifies."""


def decoded_bytes(file: pq.ParquetFile, columns: Sequence[str] | None = None) -> int:
    """The smallest number of bytes that columns of a Parquet file can take in memory, according to the file's metadata.

    For a text, only its offset and its length are counted, because the length of a text is unknown until the text is
    read.

    Args:
        columns: names of the columns. If ``columns`` is None, all columns are counted.
    """
    metadata, chosen = file.metadata, None if columns is None else set(columns)
    n_bytes = 0
    for group in range(metadata.num_row_groups):
        rows = metadata.row_group(group)
        for index in range(metadata.num_columns):
            column = rows.column(index)
            if chosen is None or column.path_in_schema in chosen or column.path_in_schema.split(".")[0] in chosen:
                n_bytes += max(column.num_values, rows.num_rows) * _WIDTHS.get(column.physical_type, 16)
    return n_bytes


def read_within(
    stream: pa.NativeFile,
    columns: Sequence[str] | None = None,
    *,
    free: int = FREE_BYTES,
    most: int = MOST_BYTES,
    nested: bool = False,
) -> pa.Table:
    """Read columns of a Parquet file, but refuse a file whose columns would take too much memory. A few bytes in a file
    may stand for millions of rows, and a short code may stand for a long text in each row.

    Args:
        columns: names of the columns. If ``columns`` is None, all columns are read.
        free: memory that the columns may take whatever the size of the file, bytes.
        most: largest memory that the columns may take, even if the file is large, bytes.
        nested: whether columns may contain lists of numbers, and tables of numbers.

    Raises:
        OversizedFile: the columns would take more memory than allowed.
        ValueError: a column contains lists or tables that ``nested`` does not allow.
        pyarrow.ArrowException, OSError: the file is not a complete Parquet file.
    """
    allowed = allowed_bytes(stream.size(), free, most)
    with pq.ParquetFile(stream) as file:
        schema, metadata = file.schema_arrow, file.metadata
        needed = decoded_bytes(file, columns)
        if needed > allowed:
            raise OversizedFile(
                f"the {metadata.num_rows:,} rows would take {size(needed)}, too much for a file of this size"
            )
        names = schema.names if columns is None else list(columns)
        for name in names:
            kind = schema.field(name).type
            if pa.types.is_nested(kind) and not (nested and _is_of_numbers(kind)):
                raise ValueError(f"the column {printable_name(name)} holds lists or tables, which are not supported")
        texts = [name for name in names if _is_text(schema.field(name).type)]
        by_prefix = set(_columns_by_prefix(metadata))
        # Texts are read as dictionary codes, so that their lengths can be checked before they are decoded. Arrow cannot
        # read a column as codes if the file stores only the end of each text, after a prefix shared with another text.
        codes = [name for name in texts if name not in by_prefix]
        coded = pq.ParquetFile(stream, metadata=metadata, read_dictionary=codes)
        few = not by_prefix.isdisjoint(names)
        batches, long = [], 0
        for batch in coded.iter_batches(_FEW_ROWS if few else _ROWS, columns=names):
            long += sum(_length_of(batch.column(name)) for name in texts)
            if needed + long > allowed:
                raise OversizedFile(f"the texts would take more than {size(allowed)}, too much for a file of this size")
            batches.append(_decoded_columns(batch, schema))
        selected_schema = pa.schema([schema.field(name) for name in names], metadata=schema.metadata)
        return pa.Table.from_batches(batches, schema=selected_schema)


def _columns_by_prefix(metadata: pq.FileMetaData) -> Iterator[str]:
    for group in range(metadata.num_row_groups):
        for index in range(metadata.num_columns):
            column = metadata.row_group(group).column(index)
            if _PREFIXED in column.encodings:
                yield column.path_in_schema


def _is_of_numbers(kind: pa.DataType) -> bool:
    """Whether values are numbers, or lists or tables of numbers."""
    if pa.types.is_struct(kind):
        return all(_is_of_numbers(kind.field(index).type) for index in range(kind.num_fields))
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        return _is_of_numbers(kind.value_type)
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _is_text(kind: pa.DataType) -> bool:
    return bool(
        pa.types.is_string(kind)
        or pa.types.is_large_string(kind)
        or pa.types.is_binary(kind)
        or pa.types.is_large_binary(kind)
        or (pa.types.is_dictionary(kind) and _is_text(kind.value_type))
    )


def _length_of(coded: pa.Array) -> int:
    """Total number of bytes of the texts in a column. The column may hold dictionary codes instead of texts."""
    if not pa.types.is_dictionary(coded.type):
        return int(coded.nbytes)
    lengths = np.asarray(pc.binary_length(coded.dictionary).fill_null(0))
    codes = np.asarray(coded.indices.drop_null())
    return int(lengths[codes].sum(dtype=np.int64)) if len(codes) else 0


def _decoded_columns(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """The batch with the types that the columns have in the file: dictionary codes become texts."""
    fields = [schema.field(name) for name in batch.schema.names]
    arrays = [column.cast(field.type) for column, field in zip(batch.columns, fields, strict=True)]
    return pa.RecordBatch.from_arrays(arrays, schema=pa.schema(fields, metadata=schema.metadata))


def parquet_table(path: Path) -> pa.Table:
    """Read a whole Parquet file, but refuse a file that would take too much memory.

    Raises:
        OSError: the file cannot be read, or is not a regular file.
        pyarrow.ArrowException: the file is not a complete Parquet file.
        ValueError: no file can have this name, two columns have the same name, or the file would take too much memory.
    """
    with open_for_arrow(path) as stream:
        with pq.ParquetFile(stream) as file:
            names = file.schema_arrow.names
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"the column {printable_name(twice)} is repeated")
        return read_within(stream)


def parquet_rows(path: Path) -> Iterator[dict[str, Any]]:
    """The rows of a Parquet file, one by one. The limits and the errors are the same as in :func:`parquet_table`."""
    for batch in parquet_table(path).to_batches(_FEW_ROWS):
        yield from batch.to_pylist()
