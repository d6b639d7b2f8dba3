"""Parquet files are always opened by Arrow itself, whatever their names are: if Arrow reads from a Python stream, the
process may abort."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.plans import make_plan

import petmjx
from petmjx.common.errors import InputError, PlanWarning
from petmjx.common.parquet_files import parquet_table
from petmjx.loop.episode_orders import Orders
from petmjx.plans.articles import read_articles
from petmjx.plans.plan_writer import plans_table
from petmjx.results.table_parts import open_part

NAMES = ("plans.parquet", "s3:plans.parquet", "a=1.parquet", os.fsdecode(b"\xff.parquet"))


def read_orders(path: Path) -> int:
    with pytest.warns(PlanWarning, match="not used: sequence|not used: .*x_mm"):
        return sum(len(boxes) for boxes in Orders(path).some(9))


def read_part(path: Path) -> int:
    with open_part(path) as part:
        rows: int = part.read().num_rows
    return rows


READERS: dict[str, Callable[[Path], int]] = {
    "plans": lambda path: sum(plan.n_boxes for plan in petmjx.load_plans(path).plans),
    "articles": lambda path: len(read_articles(path).by_article),
    "orders": read_orders,
    "results": read_part,
}


def table_of(reader: str) -> pa.Table:
    """A table with two articles, or with two boxes of a plan, which can also be read as an order or as results."""
    if reader == "articles":
        return pa.table({"article": ["a", "b"], "strength_n": [1.0, 2.0]})
    return plans_table([make_plan("p", 2)])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reader", READERS)
def test_arrow_reads_by_itself(reader: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / name).open("wb") as stream:
        pq.write_table(table_of(reader), stream)
    sources: list[type] = []

    class Watched(pq.ParquetFile):  # type: ignore[misc]
        def __init__(self, source: Any, **options: Any) -> None:
            sources.append(type(source))
            super().__init__(source, **options)

    monkeypatch.setattr(pq, "ParquetFile", Watched)
    assert READERS[reader](tmp_path / name) == 2
    assert set(sources) == {pa.OSFile}


def test_a_repeated_column_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(pa.Table.from_arrays([pa.array(["x"]), pa.array([1.0])], names=["article", "article"]), path)
    with pytest.raises(ValueError, match="the column article is repeated"):
        parquet_table(path)
    for read in (read_articles, Orders):
        with pytest.raises(InputError, match=r"a\.parquet: cannot be read.*: the column article is repeated"):
            read(path)
