"""The packer ``physical``: which packings its search finds, and which packing it chooses after the simulations."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from support.command_line import only_line, run, write
from support.outcomes import make_outcome
from support.packings import check_sound, orders, targets
from support.plan_files import order
from support.plans import make_plan, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.job_stream import JobStream
from petmjx.engines.protocol import takes_stream
from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.packers import beam_search as beam_module
from petmjx.packers import pack as pack_module
from petmjx.packers import pack_flow as flow_module
from petmjx.packers.balanced_packer import PREFERENCE_SETS, pack_balanced
from petmjx.packers.beam_search import search
from petmjx.packers.finalists import Evaluation, Finalist, choose, finalists, order_evaluation
from petmjx.packers.left_out_items import FALLS, NO_PLACE
from petmjx.packers.pack_flow import WorldsOfPlans, pack_physical
from petmjx.packers.packed_orders import PackedOrder
from petmjx.packers.packing_state import Packing
from petmjx.packers.physical_packer_options import PhysicalOptions
from petmjx.plans.order import TARGET_EXTENT_MM, Item, Order
from petmjx.plans.order_generator import draw_order
from petmjx.results.run_reader import RunResults
from petmjx.world.job import Job

CLEARANCE_MM = 7.0
DRAWN = draw_order(5, 2)
EXTENT = TARGET_EXTENT_MM[DRAWN.target]
JAM = Item("jam", "1", "", 400.0, 300.0, 200.0, 6.0)
FAST: dict[str, Any] = {"engine": "mujoco", "threads": 1}


@settings(max_examples=12, deadline=None)
@given(items=orders, extent=targets)
def test_what_is_found_is_sound_and_apart(items: list[Item], extent: tuple[int, int]) -> None:
    packing = search(items, extent, CLEARANCE_MM, width=2, branch=2)
    check_sound(packing.placed, items, extent, CLEARANCE_MM)
    assert packing == search(items, extent, CLEARANCE_MM, width=2, branch=2)


@settings(max_examples=25, deadline=None)
@given(items=orders, extent=targets)
def test_no_box_is_left_out_that_balanced_places(items: list[Item], extent: tuple[int, int]) -> None:
    """The search begins with the packing of ``balanced``, so its packings never have less volume."""
    greedy = pack_balanced(items, extent)
    packing = search(items, extent, 0.0, width=1, branch=2)
    assert sum(box.item.volume_m3 for box in packing.placed) >= sum(box.item.volume_m3 for box in greedy) - 1e-9


def test_the_search_packs_more_densely() -> None:
    """Packings of the search are at least a tenth lower than those of ``balanced``, for an order that makes a high
    pallet."""
    heights = [
        max(box.corner_mm[2] + box.item.height_mm for box in pack_balanced(DRAWN.items, EXTENT)),
        search(DRAWN.items, EXTENT, 0.0, width=1, branch=3).height_mm,
        search(DRAWN.items, EXTENT, 0.0, width=3, branch=3).height_mm,
    ]
    assert heights[1] < 0.9 * heights[0]
    assert heights[2] <= heights[1]


def test_packings_that_are_given_up_would_not_have_been_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    packing = search(DRAWN.items[:25], EXTENT, 3.0, width=2, branch=3)
    monkeypatch.setattr(beam_module, "_worst", lambda *arguments: float("inf"))
    assert search(DRAWN.items[:25], EXTENT, 3.0, width=2, branch=3) == packing


def test_large_orders_are_searched_in_larger_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    items, placed = DRAWN.items[:24], []
    step = beam_module._step

    def noted(ways: Any, *arguments: int) -> Any:
        placed.append(len(ways[0].packing.placed))
        return step(ways, *arguments)

    monkeypatch.setattr(beam_module, "_step", noted)
    monkeypatch.setattr(beam_module, "MOST_STEPS", 10)
    packing = search(items, EXTENT, 3.0, width=2, branch=2)
    assert placed == [0, 3, 6, 9, 12, 15, 18, 21, 24]
    check_sound(packing.placed, items, EXTENT, 3.0)


def test_a_copy_goes_its_own_way() -> None:
    packing = Packing(DRAWN.items, EXTENT, PREFERENCE_SETS[0])
    for _ in range(10):
        packing.put(packing.next()[0])
    before, twin, other = list(packing.placed), packing.copy(), packing.copy()
    other.put(other.next(3)[-1])
    assert other.fill()
    assert packing.placed == before
    assert packing.fill()
    assert twin.fill()
    assert packing.placed == twin.placed != other.placed
    assert (packing.top_mm, packing.moment_kg_mm) == (twin.top_mm, twin.moment_kg_mm)


def test_finalists_are_apart_by_their_clearances_and_the_densest_comes_first() -> None:
    packings = finalists(Order(DRAWN.target, DRAWN.items[:20]), PhysicalOptions(width=1, clearances_mm=(0.0, 20.0)))
    assert {candidate.clearance_mm for candidate in packings} == {0.0, 20.0}
    for packing in packings:
        check_sound(packing.placed, DRAWN.items[:20], EXTENT, packing.clearance_mm)
    assert packings[0].utilisation >= packings[1].utilisation


def test_where_clearances_leave_boxes_out_none_is_tried_too() -> None:
    half = replace(JAM, length_mm=1200.0, width_mm=400.0, height_mm=1900.0)
    packings = finalists(Order("euro-pallet", (half, half)), PhysicalOptions(clearances_mm=(5.0,)))
    assert [(packing.clearance_mm, len(packing.placed)) for packing in packings] == [(0.0, 2), (5.0, 1)]


# ---------------------------------------------------------------------- which packing is chosen

OPTIONS = PhysicalOptions(worlds=16, least_share=0.75)
ORDER = Order("euro-pallet", (JAM, JAM))


def finalist(utilisation: float, boxes: int = 2, clearance_mm: float = 3.0) -> Finalist:
    placed = finalists(ORDER, PhysicalOptions(width=1))[0].placed[:boxes]
    return Finalist(placed, clearance_mm, boxes * JAM.volume_m3, 200.0, utilisation)


def judged(utilisation: float, standing: int, boxes: int = 2, verdict: Verdict = Verdict.STABLE) -> Evaluation:
    return Evaluation(finalist(utilisation, boxes), make_plan("p", stack(boxes)), verdict, 16, standing)


THE_FULLEST_FALLS = (0.8, 16, 2, Verdict.UNSTABLE)


@pytest.mark.parametrize(
    ("packings", "maximise", "taken"),
    [
        ([(0.7, 11), (0.6, 12), (0.5, 16), THE_FULLEST_FALLS], "utilisation", 0.6),
        ([(0.7, 11), (0.6, 12), (0.5, 16), THE_FULLEST_FALLS], "share", 0.5),
        ([(0.9, 16, 1), (0.5, 12, 2)], "utilisation", 0.5),
        ([(0.7, 11), (0.6, 3), THE_FULLEST_FALLS], "utilisation", 0.7),
    ],
    ids=["the fullest that stands", "the surest", "more boxes are worth any utilisation", "none stands often enough"],
)
def test_one_packing_is_chosen(packings: list[tuple[Any, ...]], maximise: Any, taken: float) -> None:
    """A packing has a utilisation, how many of 16 worlds stand, and perhaps a number of boxes and a verdict."""
    evaluations = [judged(*packing) for packing in packings]
    assert choose(evaluations, OPTIONS.changed(maximise=maximise)).finalist.utilisation == taken


def tried(
    packings: list[Finalist],
    standing: dict[float, int],
    *,
    fall_first: bool = True,
    spare: Callable[[], bool] = lambda: False,
    **options: Any,
) -> tuple[PackedOrder, list[tuple[float, range]]]:
    """The packing that is chosen for an order, and the worlds that are requested for it.

    Args: packings: the candidates for the order. standing: utilisation of a packing → number of its 16 worlds that
    stand.
    """
    how = OPTIONS.changed(**options)
    asking, requests = order_evaluation("o", packings, how, spare), []
    try:
        while True:
            for trial, variants in next(asking):
                requests.append((trial.finalist.utilisation, variants))
                falls = 16 - standing[trial.finalist.utilisation]
                fallen = range(1, 1 + falls) if fall_first else range(17 - falls, 17)
                for variant in variants:
                    trial.take(variant, Verdict.UNSTABLE if variant in fallen else Verdict.STABLE)
    except StopIteration as end:
        return PackedOrder.of("o", ORDER, packings, end.value, how), requests


FEW, REST, ALL = range(5), range(5, 17), range(17)


def test_no_packing_is_simulated_that_would_not_be_taken() -> None:
    packings, standing = [finalist(0.7), finalist(0.6), finalist(0.5)], {0.7: 11, 0.6: 13, 0.5: 16}
    packed, requests = tried(packings, standing, fall_first=False)
    assert (packed.taken.finalist.utilisation, packed.good, packed.tried) == (0.6, True, 2)
    assert requests == [(0.7, FEW), (0.7, REST), (0.6, FEW), (0.6, REST)]
    packed, requests = tried(packings, standing, fall_first=False, maximise="share")
    assert (packed.taken.finalist.utilisation, packed.good, packed.tried) == (0.5, True, 3)
    assert requests == [(utilisation, worlds) for worlds in (FEW, REST) for utilisation in (0.7, 0.6, 0.5)]
    assert tried(packings[:1], {0.7: 12}, worlds=4, fall_first=False)[1] == [(0.7, FEW)]


def test_a_packing_that_cannot_be_good_any_more_is_given_up() -> None:
    """The first 4 of 16 worlds fall. A share of 0.8 can then no longer be reached, a share of 0.75 still can."""
    packings = [finalist(0.7), finalist(0.6), finalist(0.5)]
    packed, requests = tried(packings, {0.7: 3, 0.6: 16}, least_share=0.8)
    assert (packed.taken.finalist.utilisation, packed.taken.n_worlds, packed.tried) == (0.6, 16, 2)
    assert packed.n_simulated == 5 + 17
    assert requests == [(0.7, FEW), (0.6, FEW), (0.6, REST)]
    assert tried(packings, {0.7: 11, 0.6: 16})[1] == [(0.7, FEW), (0.7, REST), (0.6, FEW), (0.6, REST)]


def test_if_none_is_good_all_worlds_say_which_stands_most_often() -> None:
    packings, standing = [finalist(0.7), finalist(0.6), finalist(0.5)], {0.7: 9, 0.6: 10, 0.5: 2}
    packed, requests = tried(packings, standing, least_share=0.9)
    assert (packed.taken.finalist.utilisation, packed.taken.n_standing, packed.good) == (0.6, 10, False)
    assert requests == [
        *((utilisation, FEW) for utilisation in (0.7, 0.6, 0.5)),
        *((utilisation, REST) for utilisation in (0.7, 0.6, 0.5)),
    ]


def test_an_engine_with_room_simulates_what_may_not_be_needed() -> None:
    """The chosen packing, and the number of packings tried before it, are the same as without free capacity."""
    packings, standing = [finalist(0.7), finalist(0.6), finalist(0.5)], {0.7: 3, 0.6: 13, 0.5: 16}
    packed, requests = tried(packings, standing, spare=lambda: True)
    assert requests == [(utilisation, ALL) for utilisation in (0.7, 0.6, 0.5)]
    assert (packed.taken.finalist.utilisation, packed.tried, packed.n_simulated) == (0.6, 2, 51)
    answers = iter([False, True])
    packed, requests = tried(packings, standing, spare=lambda: next(answers))
    assert requests == [(0.7, FEW), (0.7, REST), (0.6, ALL), (0.5, ALL)]
    assert (packed.taken.finalist.utilisation, packed.tried, packed.n_simulated) == (0.6, 2, 51)
    assert tried(packings, standing, maximise="share", spare=lambda: True)[0].tried == 3


def test_it_says_what_is_left_out_and_why() -> None:
    fuller, less = finalist(0.7), finalist(0.6, boxes=1)
    packed, _ = tried([fuller, less], {0.7: 3, 0.6: 16})
    assert (packed.left_out.numbers, packed.why) == ((2,), FALLS)
    packed, _ = tried([less], {0.6: 16})
    assert (packed.left_out.numbers, packed.why) == ((2,), NO_PLACE)
    packed, requests = tried([], {})
    assert (packed.taken, packed.plan, packed.good, requests) == (None, None, False, [])
    assert packed.row()["boxes"] == 0
    assert tried([], {}, maximise="share")[1] == []


class SmallestFirst:
    """An engine that simulates the smallest of all pending plans first, including plans that are added later. Packings
    of two boxes do not stand."""

    name = "smallest-first"

    def __init__(self) -> None:
        self.boxes: list[int] = []
        self.jobs: list[Job] = []

    def run(self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Any = None) -> Iterator[Outcome]:
        stream, left, n_jobs = JobStream.of(jobs), dict[int, Job](), 0
        while True:
            new = stream.take(1000, wait=not left)
            left |= enumerate(new, n_jobs)
            n_jobs += len(new)
            if not left:
                return
            number = min(left, key=lambda job: (left[job].scene.n_boxes, job))
            job = left.pop(number)
            n = job.scene.n_boxes
            self.boxes.append(n)
            self.jobs.append(job)
            falls = {"reason": Reason.DROP, "culprit": n - 1, "first_sign_s": 0.5}
            outcome = make_outcome(n, Verdict.UNSTABLE, **falls) if n == 2 else make_outcome(n)
            yield replace(outcome, job=number)


class Streaming(SmallestFirst):
    """The same engine as one that takes a stream of jobs."""

    @takes_stream
    def run(self, jobs: Any, sim: Simulation, progress: Any = None) -> Iterator[Outcome]:
        yield from super().run(jobs, sim, progress)


@pytest.mark.parametrize("streams", [True, False])
def test_no_order_waits_for_another(monkeypatch: pytest.MonkeyPatch, streams: bool) -> None:
    """The packing of two boxes for the second order falls, so its packing of one box is tried next. If the engine takes
    jobs while it runs, worlds of the first order are still pending at that time."""
    large = Order(ORDER.target, (JAM,) * 3)
    three = finalists(large, PhysicalOptions(width=1))[:1]
    packings_by_order = {large: three, ORDER: [finalist(0.7), finalist(0.6, boxes=1)]}
    monkeypatch.setattr(flow_module, "finalists", lambda order, options: packings_by_order[order])
    engine = Streaming() if streams else SmallestFirst()
    packed = list(pack_physical([("a", large), ("b", ORDER)], OPTIONS, {"engine": engine}, workers=1))
    assert [(packed_order.order_id, len(packed_order.taken.finalist.placed)) for packed_order in packed] == [
        ("a", 3),
        ("b", 1),
    ]
    several = [2] * 5 + [1] * 17 + [3] * 17
    assert engine.boxes == (several if streams else [2] * 5 + [3] * 5 + [1] * 5 + [3] * 12 + [1] * 12)


def test_worlds_are_those_of_a_score() -> None:
    """The packer simulates the same worlds as a score, with and without errors. Worlds with errors end when a box is
    lost (tilted by more than 20°)."""
    plan = make_plan("p", 3)
    engine = SmallestFirst()
    petmjx.score([plan], confidence=4, engine=engine)
    worlds = [world.job for world in WorldsOfPlans(4, {"engine": engine}).of(plan, range(5))]
    assert [job.has_errors for job in worlds] == [False, True, True, True, True]
    for packer_job, other in zip(worlds, engine.jobs, strict=True):
        assert packer_job.has_errors == other.has_errors
        np.testing.assert_array_equal(packer_job.scene.start_pos, other.scene.start_pos)
    assert [job.has_errors for job in (world.job for world in WorldsOfPlans(0, {}).of(plan, [0]))] == [False]


# ---------------------------------------------------------------------- the packer as a whole


@pytest.fixture(scope="module")
def small_orders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of three orders: one whose boxes all fit, one with a box that is too tall, and one whose boxes have no
    place."""
    large = order(2, **{"length/mm": 1300})
    large["item_sequence"]["1"]["length/mm"] = 1300
    content = {"fits": order(5), "tall": order(3, **{"height/mm": 2500}), "none": large}
    path: Path = write(tmp_path_factory.mktemp("orders") / "orders.json", content)
    return path


@pytest.fixture(scope="module")
def packed(small_orders: Path) -> petmjx.Packed:
    return petmjx.pack(small_orders, worlds=4, **FAST)


def test_a_score_says_the_same_of_the_plans(packed: petmjx.Packed) -> None:
    results: RunResults = petmjx.score(packed.plans, confidence=4, **FAST)
    assert results.summary is not None
    rows = packed.orders.set_index("plan_id").loc[["fits", "tall"]]
    for column in ("verdict", "n_worlds", "n_standing", "share", "low", "high"):
        assert results.summary[column].tolist() == rows[column].tolist(), column
    assert rows["share"].tolist() == [1.0, 1.0]
    nothing = packed.orders.set_index("plan_id").loc["none"]
    assert (nothing["boxes"], nothing["left_out"], nothing["why"]) == (0, 2, NO_PLACE)


def test_plans_depend_on_the_order_alone(packed: petmjx.Packed, small_orders: Path, tmp_path: Path) -> None:
    again = petmjx.pack(small_orders, worlds=4, workers=2, **FAST)
    again.save(tmp_path / "again.json")
    packed.save(tmp_path / "first.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "first.json").read_bytes()
    assert list(json.loads((tmp_path / "first.json").read_text())) == ["fits", "tall"]
    read = petmjx.load_plans(tmp_path / "first.json")
    assert [plan.corner_mm.tolist() for plan in read] == [plan.corner_mm.tolist() for plan in packed.plans]
    assert repr(packed).startswith("Packed(3 orders, utilisation 0.")
    assert repr(packed).endswith(", 100.0 % of worlds with errors stand)")
    shown = packed._repr_html_()
    assert "fits" in shown
    assert "100.0" in shown


def test_without_worlds_only_exact_placement_counts() -> None:
    packed_orders = petmjx.pack(n=1, seed=4, width=1, branch=1, worlds=0, clearances_mm=[0], **FAST)
    assert "errors" not in repr(packed_orders)
    row, packing = packed_orders.orders.iloc[0], packed_orders.packed_orders[0].taken
    assert packing is not None
    assert (row["verdict"], row["n_worlds"], row["tried"], row["good"]) == ("stable", 0, 1, True)
    assert row["utilisation"] == pytest.approx(packing.finalist.utilisation)
    with pytest.warns(DeprecationWarning, match="Packed.each is now Packed.packed_orders"):
        assert packed_orders.each is packed_orders.packed_orders


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"worlds": 3}, "worlds must be 0, or from 4 to 100,000, got 3"),
        ({"clearances_mm": []}, "clearances_mm must be 1 to 16 different numbers"),
        ({"clearances_mm": [-1]}, "clearances_mm must be from 0 to 200 mm"),
        ({"maximise": "height"}, "maximise must be 'utilisation' or 'share'"),
        ({"confidence": 8}, "confidence: a packer has no such option; set the option worlds"),
        ({"out": "x"}, "out: a packer has no such option"),
        ({"worlds": 0, "errors": "confidence"}, "errors needs worlds > 0"),
        ({"worlds": 0, "maximise": "share"}, "maximise share needs worlds > 0"),
        ({"clearances_mm": [True]}, "clearances_mm must be a list of numbers"),
        ({"widht": 3}, "unknown option widht; did you mean width"),
        ({"n": 1, "orders": "orders.json"}, "n is the number of generated orders"),
    ],
)
def test_what_cannot_be_is_one_line(options: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line):
        petmjx.pack(**options)


def test_the_command_says_what_it_made(
    small_orders: Path, packed: petmjx.Packed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, fast = tmp_path / "plans.json", ("--engine", "mujoco", "--threads", "1", "--workers", "1")
    how = ("samples", "--orders", small_orders, "--packer", "physical", "-o", out, "--overwrite", *fast)
    assert run(*how, "--worlds", "4") == 0
    packed.save(tmp_path / "same.json")
    assert out.read_bytes() == (tmp_path / "same.json").read_bytes()
    assert capsys.readouterr().out.splitlines() == [
        f"order tall: 1 of 3 boxes is left out: item 2: {NO_PLACE}",
        f"order none: 2 of 2 boxes are left out: items 1, 2: {NO_PLACE}",
        f"2 plans in {out}; 3 boxes of 2 orders left out",
        f"utilisation {packed.orders['utilisation'].mean():.3f}; 2 stand if placed exactly; "
        "100.0 % of worlds with errors stand",
    ]
    assert run(*how, "--clearances", "3,x") == 2
    assert "--clearances must be numbers separated by commas, got '3,x'" in only_line(capsys.readouterr().err)
    assert run("samples", "-n", "1", "--width", "3", "-o", out, "--overwrite") == 2
    assert "--width needs the packer 'physical'" in only_line(capsys.readouterr().err)


@pytest.mark.parametrize(
    ("gpu", "kernel", "engine"),
    [(None, None, "mjx-warp"), ("no GPU", None, "mjx-warp-cpu"), ("no GPU", "no Warp", "mujoco")],
)
def test_one_engine_judges_all_orders(
    monkeypatch: pytest.MonkeyPatch, gpu: str | None, kernel: str | None, engine: str
) -> None:
    monkeypatch.setattr(pack_module, "why_no_warp", lambda: gpu)
    monkeypatch.setattr(pack_module, "why_no_warp_on_cpu", lambda: kernel)
    assert pack_module.fastest() == engine
