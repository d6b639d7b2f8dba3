"""Parquet files are read within limits of memory, since a file of a few kilobytes may unpack to gigabytes of rows or
texts."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.outcomes import make_outcome, make_plan

import petmjx
from petmjx.common.errors import InputError
from petmjx.common.parquet_files import open_for_arrow, read_within
from petmjx.plans.articles import read_articles
from petmjx.results.result_files import digest_of
from petmjx.results.run_writer import RunWriter

MOST_MB = 320
"""Largest amount of memory that Arrow may use at any time, MB. Each of these files would take 1 to 60 GB if it were
read as a whole. ``prefix.parquet`` takes 300 MB: it has two columns of 90 MB each, and rows are copied while they are
looked at."""

NUMBERS = ("sequence", "length_mm", "width_mm", "height_mm", "weight_kg", "x_mm", "y_mm", "z_mm", "strength_n")


def repeated(text: str, rows: int) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), [text])


@pytest.fixture(scope="module")
def bombs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bombs")
    chunk, n_chunks = 1_000_000, 8
    ones = pa.array(np.ones(chunk))
    rows = pa.table({"plan_id": repeated("p", chunk), "article": repeated("a", chunk), **dict.fromkeys(NUMBERS, ones)})
    with pq.ParquetWriter(folder / "rows.parquet", rows.schema, compression="zstd") as writer:
        for _ in range(n_chunks):
            writer.write_table(rows)
    few = 100_000
    numbers = dict.fromkeys(NUMBERS, pa.array(np.ones(few, np.int8)))
    for name in ("plan_id", "article"):
        texts = {"plan_id": repeated("p", few), "article": repeated("a", few), name: repeated("y" * 60_000, few)}
        pq.write_table(pa.table({**texts, **numbers}), folder / f"{name}.parquet", compression="zstd")
        pq.write_table(
            pa.table({**texts, **numbers}), folder / f"{name}-plain.parquet", compression="zstd", store_schema=False
        )
    prefixed = pa.array(["z" * 60_000 + str(row) for row in range(1500)])
    pq.write_table(
        pa.table({"plan_id": prefixed, "article": prefixed, **dict.fromkeys(NUMBERS, pa.array(np.ones(1500)))}),
        folder / "prefix.parquet", use_dictionary=False, compression="zstd", compression_level=1,
        column_encoding=dict.fromkeys(("plan_id", "article"), "DELTA_BYTE_ARRAY"),
    )  # fmt: skip
    assert all(file.stat().st_size < 2 << 20 for file in folder.iterdir())
    return folder


READ = """
import sys
from pathlib import Path
import pyarrow
import petmjx
from petmjx.common.errors import InputError
from petmjx.loop.episode_orders import Orders
from petmjx.plans.articles import read_articles
for file in sorted(Path(sys.argv[1]).glob("*.parquet")):
    print("plans", petmjx.load_plans(file).skipped[0].message)
    for read in (read_articles, Orders):
        try:
            read(file)
            print("READ", file)
        except InputError as error:
            print(read.__name__, error)
print(pyarrow.default_memory_pool().max_memory() >> 20)
"""


def test_what_would_take_gigabytes_is_refused_in_a_few_hundred_megabytes(bombs: Path) -> None:
    done = subprocess.run([sys.executable, "-c", READ, bombs], capture_output=True, text=True, check=True)
    *lines, peak = done.stdout.splitlines()
    assert len(lines) == 3 * 6
    for line in lines:
        assert "too much for a file of this size" in line, line
    assert "the 8,000,000 rows would take" in done.stdout
    assert int(peak) < MOST_MB


def test_parts_of_runs_too(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}) as run:
        run.add(make_plan("p"), 0, "fixed", make_outcome())
    part = tmp_path / "worlds" / "part-00000.parquet"
    one = pq.read_table(part).take(np.zeros(200_000, np.int64))
    with pq.ParquetWriter(part, one.schema, compression="zstd") as writer:
        for _ in range(8):
            writer.write_table(one)
    _list_again(tmp_path, part)
    with pytest.raises(InputError, match=r"the 1,600,000 rows would take \d+ MiB, too much for a file"):
        petmjx.load_run(tmp_path).worlds  # noqa: B018
    # each text is below the limit, but all texts together are not
    with pq.ParquetWriter(part, one.schema, compression="zstd") as writer:
        for _ in range(4):
            writer.write_table(one)
    for number in (0, 1):
        other = part.with_name(f"part-0000{number}.parquet")
        if number:
            shutil.copy(part, other)
        _list_again(tmp_path, other)
    error = r"worlds: the rows of the table would take \d+ MiB, too much for files of this size"
    with pytest.raises(InputError, match=error):
        petmjx.load_run(tmp_path).worlds  # noqa: B018


def _list_again(folder: Path, part: Path) -> None:
    """List a part in run.json again with its present digest, as an attacker could who knows how runs list their
    parts."""
    file = folder / "run.json"
    info = json.loads(file.read_text())
    with part.open("rb") as stream:
        info["parts"][part.parent.name][part.name] = digest_of(stream)
    info.pop("digest", None)
    file.write_text(json.dumps(info))


def test_what_is_read_is_what_is_there(tmp_path: Path) -> None:
    """Several row groups, several encodings, dictionary codes, and a selection of columns."""
    rng = np.random.default_rng(5)
    n = 70_000
    table = pa.table(
        {
            "text": pa.array([None if k % 7 == 0 else f"x{k % 11}" for k in range(n)]),
            "large": pa.array([f"x{k}" for k in range(n)], pa.large_string()),
            "bytes": pa.array([b"\xff%d" % (k % 5) for k in range(n)]),
            "coded": pa.array(["a", "b"] * (n // 2)).dictionary_encode(),
            "number": rng.random(n),
            "whole": np.arange(n),
        },
    ).replace_schema_metadata({"said": "kept"})
    settings = [{}, {"use_dictionary": False}, {"row_group_size": 999}, {"store_schema": False}]
    settings.append({"use_dictionary": False, "column_encoding": {"text": "DELTA_BYTE_ARRAY"}})
    for options in settings:
        pq.write_table(table, tmp_path / "t.parquet", **options)
        for columns in (None, ["whole", "coded", "text"]):
            with open_for_arrow(tmp_path / "t.parquet") as stream:
                read = read_within(stream, columns)
            plain = pq.read_table(tmp_path / "t.parquet", columns=columns)
            assert read.equals(plain)
            assert read.schema.equals(plain.schema, check_metadata=True)


def test_a_large_honest_file_is_read(tmp_path: Path) -> None:
    """A million rows take 80 MB, more than the 64 MiB that are always allowed. The file has a hundredth of this
    size."""
    rng = np.random.default_rng(1)
    n = 1_000_000
    table = pa.table({name: rng.integers(1, 4000, n).astype(np.float64) for name in NUMBERS[:8]})
    pq.write_table(table, tmp_path / "t.parquet", compression="zstd")
    with open_for_arrow(tmp_path / "t.parquet") as stream:
        assert read_within(stream).num_rows == n


def test_articles_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.plans.articles.MOST_ARTICLES", 3)
    pq.write_table(pa.table({"article": list("abcd"), "strength_n": [1.0] * 4}), tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"a\.parquet: has more than 3 articles"):
        read_articles(tmp_path / "a.parquet")
