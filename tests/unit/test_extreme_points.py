"""Tests of the candidate places on many pallets. The places depend neither on what happened to a pallet before, nor on
the other pallets that are computed together."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import numpy as np
import pytest

from petmjx.common.warp_setup import machine_code
from petmjx.loop import candidate_places
from petmjx.loop.box_tables import BoxTable
from petmjx.loop.candidate_places import Places, free_places
from petmjx.loop.placement_arguments import Placements
from petmjx.packers.candidate_points import Candidates

EXTENT_MM = (1200.0, 800.0)


def boxes(size_mm: np.ndarray, pallet: np.ndarray, corner_mm: np.ndarray | None = None) -> Placements:
    return Placements(size_mm, np.zeros_like(size_mm) if corner_mm is None else corner_mm, np.ones(len(pallet)), pallet)


def found_for(
    stock: BoxTable, request: Placements, grid: np.ndarray | None = None, highest_mm: float = 9000.0
) -> Places:
    return free_places(stock, request, EXTENT_MM, highest_mm, grid)


def assert_same(one: Places, other: Places) -> None:
    for mine, its in zip(one, other, strict=True):
        np.testing.assert_array_equal(mine, its)


def lively_stock(rng: np.random.Generator, n: int) -> BoxTable:
    """Pallets to which boxes were added and from which boxes were removed. For some pallets, places were computed in
    between; some pallets are copies of others."""
    stock = BoxTable(n)
    for step in range(12):
        rows = np.flatnonzero(rng.random(n) < 0.7)
        sizes = rng.uniform(100, 600, (len(rows), 3))
        spots = found_for(stock, boxes(sizes, rows))
        first = np.searchsorted(spots.row, np.arange(len(rows)))
        last = np.searchsorted(spots.row, np.arange(len(rows)), side="right")
        fits = np.flatnonzero(last > first)
        chosen = rng.integers(first[fits], last[fits])
        corners = spots.corner_mm[chosen]
        corners[:, :2] += rng.choice([0.0, 7.3], (len(fits), 2))  # some boxes are beside extreme points
        stock.add(boxes(sizes[fits], rows[fits], corners))
        if step % 3 == 2:
            some = rng.permutation(n)[: n // 3]
            stock.cut(some, np.maximum(stock.count[some] - rng.integers(1, 4, len(some)), 0))
            stock.copy(rng.integers(0, n, 2), np.array([0, 1]))
    return stock


def built_anew(stock: BoxTable, pallet: int) -> BoxTable:
    """A new pallet with the same boxes, for which no places were computed before."""
    one = BoxTable(1)
    for number in range(int(stock.count[pallet])):
        box = stock.box(np.array([pallet]), number)
        one.add(Placements(box.size_mm, box.corner_mm, box.mass_kg, np.zeros(1, np.int64)))
    return one


def test_places_of_a_pallet_depend_on_its_boxes_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, n = np.random.default_rng(5), 9
    stock = lively_stock(rng, n)
    assert stock.count.min() < stock.count.max() > 6
    pallet = np.repeat(rng.permutation(n), 2)
    request = boxes(rng.uniform(100, 600, (len(pallet), 3)), pallet)
    corners = np.indices((6, 4)).reshape(2, -1).T * 181.7
    for grid in (None, corners):
        together = found_for(stock, request, grid)
        for row in range(len(request)):
            alone = found_for(
                built_anew(stock, int(pallet[row])), boxes(request.size_mm[[row]], np.zeros(1, int)), grid
            )
            assert_same(alone._replace(row=alone.row + row, pallet=alone.pallet + pallet[row]), part(together, row))
        with monkeypatch.context() as patched:
            for name in ("_AT_ONCE", "_WORTH_A_THREAD"):
                patched.setattr(candidate_places, name, 500)  # the work is divided into many pieces, on threads
            assert_same(found_for(stock, request, grid), together)


def test_places_with_less_support_are_left_out() -> None:
    rng, n = np.random.default_rng(2), 7
    stock, request = lively_stock(rng, n), boxes(rng.uniform(100, 600, (n, 3)), np.arange(n))
    spots = found_for(stock, request)
    borne = spots.support >= 0.6
    assert 0 < borne.sum() < len(borne)
    some = free_places(stock, request, EXTENT_MM, 9000.0, least_support=0.6)
    assert_same(some, Places(*(values[borne] for values in spots)))


@pytest.fixture
def code_not_loaded() -> Iterator[None]:
    machine_code.cache_clear()
    yield
    machine_code.cache_clear()


@pytest.mark.usefixtures("code_not_loaded")
@pytest.mark.parametrize("gap_mm", [0.0, 6.0])
@pytest.mark.parametrize("at_once", [1024, 17])
def test_machine_code_finds_the_same_places_as_numpy(
    gap_mm: float, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = pytest.importorskip("petmjx.loop.compiled_places", reason="warp-lang is not installed (extra: warp)")
    monkeypatch.setattr(compiled, "_AT_ONCE", at_once)
    monkeypatch.setattr(compiled, "_WORTH_A_THREAD", 8)
    lowered_boxes, calls = compiled.lowered_boxes, []
    monkeypatch.setattr(compiled, "lowered_boxes", lambda *values: calls.append(lowered_boxes(*values)) or calls[-1])
    rng, n = np.random.default_rng(33401), 40
    stock = lively_stock(rng, n)
    pallet = np.repeat(rng.permutation(n), 2)
    for size_mm in (rng.uniform(100, 600, (len(pallet), 3)), rng.choice([200.0, 300.0], (len(pallet), 3))):
        spots, points = [], []
        for worth in (len(pallet) + 1, len(pallet)):
            monkeypatch.setattr(candidate_places, "_WORTH_COMPILING", worth)
            request, pallets = boxes(size_mm, pallet), copy.deepcopy(stock)
            pallets.find_points(np.arange(n), gap_mm + 1)  # so that the points of all boxes are found in the next line
            limits = {"least_support": 0.6, "gap_mm": gap_mm, "hulls": False}
            spots.append(free_places(pallets, request, EXTENT_MM, 1800.0, **limits))
            points.append(pallets.find_points(np.arange(n), gap_mm).of(np.arange(n)))
        by_numpy, by_code = spots
        assert len(by_numpy.row) > n
        np.testing.assert_array_equal(*points)
        for numpy_values, values in zip(by_numpy[:4], by_code[:4], strict=True):
            np.testing.assert_array_equal(values, numpy_values)
    assert len(calls) == 2


@pytest.mark.usefixtures("code_not_loaded")
def test_numpy_finds_the_places_if_warp_cannot_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = pytest.importorskip("petmjx.loop.compiled_places", reason="warp-lang is not installed (extra: warp)")
    rng, n = np.random.default_rng(33402), 8
    stock, request = lively_stock(rng, n), boxes(rng.uniform(100, 600, (n, 3)), np.arange(n))
    by_numpy = free_places(stock, request, EXTENT_MM, 1800.0, hulls=False)
    tried = []
    monkeypatch.setattr(compiled.wp, "load_module", lambda *_, **__: tried.append(1) or 1 / 0)
    monkeypatch.setattr(candidate_places, "_WORTH_COMPILING", 1)
    assert_same(free_places(stock, request, EXTENT_MM, 1800.0, hulls=False)[:4], by_numpy[:4])
    assert tried


def part(spots: Places, row: int) -> Places:
    which = spots.row == row
    assert which.any()
    return Places(*(values[which] for values in spots))


def test_what_bears_a_box() -> None:
    stock, one = BoxTable(1), np.zeros(1, np.int64)
    for x in (0.0, 400.0):
        stock.add(boxes(np.array([[400.0, 300.0, 200.0]]), one, np.array([[x, 0.0, 0.0]])))
    spots = found_for(stock, boxes(np.array([[600.0, 500.0, 100.0]]), one))
    assert spots.corner_mm.tolist() == [[0, 300, 0], [400, 300, 0], [0, 0, 200], [400, 0, 200]]
    assert spots.support.tolist() == [1, 1, 0.6, 0.4]
    assert spots.centred is not None
    assert spots.centred.tolist() == [True, True, True, True]
    high = found_for(stock, boxes(np.array([[600.0, 600.0, 1400.0]]), one), highest_mm=1500.0)
    assert high.corner_mm.tolist() == []  # the box is too high to be on other boxes, and too long to be behind them


@pytest.mark.parametrize("gap_mm", [0.0, 6.0])
def test_places_with_free_space_are_those_of_the_packers(gap_mm: float) -> None:
    """Places with free space between boxes are those of the packers. In the table of the packer ``balanced``, bases and
    target include the free space."""
    rng, size = np.random.default_rng(3), np.array([[380.0, 290.0, 200.0], [290.0, 380.0, 200.0]])
    table = Candidates(size[:, :2] + gap_mm, size[:, 2], (1200.0 + gap_mm, 800.0 + gap_mm), 12)
    stock = BoxTable(1)
    for _ in range(12):
        places = free_places(stock, boxes(size, np.zeros(2, int)), EXTENT_MM, 9000.0, gap_mm=gap_mm)
        ours = {(row, *corner) for row, corner in zip(places.row.tolist(), places.corner_mm.tolist(), strict=True)}
        point, shape = np.nonzero(table._inside)
        theirs = np.column_stack([shape, table.points[point], table.z[point, shape]])
        assert ours == set(map(tuple, theirs.tolist()))
        at = int(rng.integers(len(point)))
        chosen = boxes(size[shape[at : at + 1]], np.zeros(1, int), theirs[at : at + 1, 1:])
        table.place(int(point[at]), int(shape[at]))
        stock.add(chosen)


def test_free_space_bears_nothing() -> None:
    """Free space carries nothing. A box on two boxes with a gap of 6 mm is supported except above the gap. A box that
    ends above the gap is supported by one box only."""
    stock, one = BoxTable(1), np.zeros(1, int)
    for x in (0.0, 306.0):
        stock.add(boxes(np.array([[300.0, 400.0, 200.0]]), one, np.array([[x, 0.0, 0.0]])))
    grid = np.array([[0.0, 0.0], [303.0, 0.0]])
    places = free_places(stock, boxes(np.array([[500.0, 400.0, 100.0]]), one), EXTENT_MM, 9000.0, grid, gap_mm=6.0)
    np.testing.assert_allclose(places.support, [1 - 6 / 500, 300 / 500])
    assert places.corner_mm[:, 2].tolist() == [200.0, 200.0]
    assert places.centred is not None
    assert places.centred.tolist() == [True, True]
