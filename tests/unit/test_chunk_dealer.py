"""Tests of the distribution of jobs in chunks to workers: the chunks, the death of a worker, and the number of workers
that fit on nodes. Ray itself is not used."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

import numpy as np
import pytest
from support.fake_stepper import fake_scene

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.units import FloatArray
from petmjx.engines.cost_model import CREEPING, DISPLACED_COST, MEASURED
from petmjx.engines.remote.chunk_dealer import MOST_JOBS, Chunk, Deal
from petmjx.engines.remote.worker_resources import Node, Place, places, threads_beside
from petmjx.options.simulation import Simulation
from petmjx.world.job import Drive, Excitation, Job


def taken(deal: Deal) -> list[Chunk]:
    return list(iter(lambda: deal.take(idle=True), None))


def finish(deal: Deal, chunk: Chunk) -> None:
    for job in chunk.jobs:
        deal.answered(job)


def simulated_s(costs: FloatArray, slots: int) -> float:
    """Time until the last slot has finished, s. A slot takes its next chunk when it has simulated its present chunk."""
    deal = Deal(costs, slots)
    busy = [(0.0, slot) for slot in range(slots)]
    end = 0.0
    while busy:
        now, slot = heapq.heappop(busy)
        chunk = deal.take(idle=True)
        if chunk is not None:
            finish(deal, chunk)
            heapq.heappush(busy, (now + float(costs[list(chunk.jobs)].sum()), slot))
        end = max(end, now)
    assert not deal.unanswered
    return end


def test_chunks_come_longest_first_and_shrink_to_single_jobs() -> None:
    costs = np.random.default_rng(0).lognormal(size=1000)
    chunks = taken(Deal(costs, slots=8))
    order = [job for chunk in chunks for job in chunk.jobs]
    assert order == np.argsort(-costs, kind="stable").tolist()
    sizes = [len(chunk.jobs) for chunk in chunks]
    assert max(sizes) <= MOST_JOBS
    assert set(sizes[-10:]) == {1}
    assert len(sizes) < 300


@pytest.mark.parametrize("slots", [2, 7, 32])
def test_all_slots_end_together(slots: int) -> None:
    costs = np.random.default_rng(1).lognormal(size=1000)
    assert simulated_s(costs, slots) < 1.02 * max(costs.sum() / slots, costs.max())
    assert simulated_s(np.ones(slots), slots) == 1


def test_slots_hold_a_reserve_only_while_there_is_plenty() -> None:
    assert Deal(np.ones(100), slots=2).plenty
    assert not Deal(np.ones(8), slots=2).plenty
    assert not Deal(np.ones(100), slots=2, group=10).plenty


@pytest.mark.parametrize(
    ("jobs", "slots", "sizes"),
    [
        (20_006, 2, [5002, 5002, 5001, 5001]),
        (20_006, 1, [6669, 6669, 6668]),
        (16_384, 2, [8192, 8192]),
        (8_192, 2, [4096, 4096]),
        (700, 4, [350, 350]),  # so few worlds that only two devices are used
        (100, 4, [100]),
    ],
)
def test_batches_are_as_few_as_keep_all_devices_busy(jobs: int, slots: int, sizes: list[int]) -> None:
    costs = np.arange(float(jobs))
    chunks = taken(Deal(costs, slots, group=8192, least=512))
    assert [len(chunk.jobs) for chunk in chunks] == sizes
    assert sorted(itertools.chain(*(chunk.jobs for chunk in chunks))) == list(range(jobs))
    means = [costs[list(chunk.jobs)].mean() for chunk in chunks]
    assert np.ptp(means) <= len(chunks)  # each chunk has the same mix of short and long jobs
    assert all(np.all(np.diff(costs[list(chunk.jobs)]) < 0) for chunk in chunks)


def test_only_unanswered_jobs_of_a_dead_worker_are_dealt_again() -> None:
    deal = Deal(np.array([3.0, 1.0, 2.0]), slots=1, group=10)
    chunk = deal.take(idle=True)
    assert chunk == Chunk((0, 2, 1))
    deal.answered(2)
    assert deal.died([chunk]) == []
    assert deal.take(idle=False) == Chunk((0, 1))
    with pytest.raises(KeyError):
        deal.answered(2)


def test_jobs_of_a_worker_that_dies_as_it_starts_are_not_to_blame() -> None:
    deal = Deal(np.ones(6), slots=1, group=4, deadly=[5])
    for _ in range(4):
        chunk = deal.take(idle=True)
        assert chunk is not None
        assert len(chunk.jobs) > 1
        deal.put_back([chunk])
    pieces = taken(deal)
    assert sorted(job for piece in pieces for job in piece.jobs) == list(range(6))
    assert [piece.alone for piece in pieces] == [False] * (len(pieces) - 1) + [True]
    deal.put_back([pieces[-1]])
    assert deal.take(idle=True) == Chunk((5,), alone=True)


@pytest.mark.parametrize("group", [None, 100])
def test_a_job_that_workers_die_of_is_given_up_and_no_other(group: int | None) -> None:
    deal, deadly = Deal(np.ones(100), slots=2, group=group), 37
    deaths = 0
    while deal.unanswered:
        chunk = deal.take(idle=True)
        assert chunk is not None
        if deadly not in chunk.jobs:
            finish(deal, chunk)
            continue
        deaths += 1
        given_up = deal.died([chunk])
        assert given_up == ([deadly] if chunk == Chunk((deadly,), alone=True) else [])
    assert 3 <= deaths <= 4


def test_suspects_wait_for_a_worker_of_their_own() -> None:
    deal = Deal(np.ones(6), slots=1, group=4)
    first, second = deal.take(True), deal.take(True)
    assert first is not None
    assert second is not None
    deal.died([first])
    again = deal.take(False)
    assert again == first
    deal.died([again])
    finish(deal, second)
    assert deal.take(idle=False) is None
    pieces = taken(deal)
    assert [len(piece.jobs) for piece in pieces] == [2, 1]
    assert all(piece.alone for piece in pieces)
    assert taken(Deal(np.ones(3), 1, deadly=[1])) == [Chunk((0,)), Chunk((2,)), Chunk((1,), alone=True)]


@pytest.mark.parametrize("costs", [MEASURED.of_jobs, MEASURED.of_jobs_on_device])
def test_placements_take_longer_with_more_boxes_with_errors_and_before_a_drive(
    costs: Callable[[list[Job], Simulation], FloatArray],
) -> None:
    scene, sim = fake_scene(1.0, 10.0, 20.0), Simulation()
    drive = Drive(Excitation("shake", "force", np.zeros((500, 3))))
    displaced = Job(scene, has_errors=True)
    jobs = [Job(fake_scene(1.0)), Job(scene), displaced, Job(scene, drive=drive), Job(scene, drive=drive, start="it")]
    one, two, with_errors, placed_and_driven, driven = costs(jobs, sim).tolist()
    assert one < two < min(placed_and_driven, with_errors)
    assert placed_and_driven == pytest.approx(two + driven)


def test_on_a_device_placements_with_errors_take_longer_by_their_factor() -> None:
    scene = fake_scene(1.0, 10.0, 20.0)
    without, with_errors = MEASURED.of_jobs_on_device([Job(scene), Job(scene, has_errors=True)], Simulation()).tolist()
    assert with_errors == pytest.approx(DISPLACED_COST * without)


def test_a_drive_that_shakes_a_pallet_down_is_over_sooner() -> None:
    """A hard drive (shaking) soon makes a pallet fall, which ends the job. A few gentle drives take long, and it is not
    known which, so gentle drives come first. Drives of the same plan stay together."""
    scene = fake_scene(1.0, 10.0, 20.0)
    shake = Excitation("shake", "acceleration", np.tile([3.0, 4.0, 9.0], (500, 1)))
    assert shake.peak_g == pytest.approx(5.0 / 9.81, rel=1e-3)
    assert Excitation("push", "force", shake.samples).peak_g == pytest.approx(5.0)
    scales = (0.1, 0.5, 1.0, -2.0)
    jobs = [Job(scene, drive=Drive(shake, scale), start="a state") for scale in scales]
    gentle, steady, hard, harder = MEASURED.of_jobs(jobs, Simulation()).tolist()
    assert gentle == steady > hard == harder
    assert len(set(MEASURED.of_jobs(jobs, Simulation(schedule="fixed")).tolist())) == 1


def test_on_a_device_gentle_drives_of_small_pallets_begin_before_hard_ones_of_large_pallets() -> None:
    """With twice as many boxes, a step takes twice as long on a device, but four times as long on a CPU. So the order
    of jobs is different."""
    shake = Excitation("shake", "acceleration", np.tile([9.81, 0.0, 0.0], (200, 1)))
    small, large = fake_scene(*[1.0] * 40), fake_scene(*[1.0] * 60)
    pairs = [(small, 0.2), (large, 1.0)]
    jobs = [Job(scene, drive=Drive(shake, scale), start="a state") for scene, scale in pairs]
    gentle, hard = MEASURED.of_jobs_on_device(jobs, Simulation()).tolist()
    assert gentle == pytest.approx(CREEPING * 40 / 60 * hard)
    assert gentle > hard
    gentle, hard = MEASURED.of_jobs(jobs, Simulation()).tolist()
    assert gentle < hard


NODES = (Node(8, 2), Node(4, 0), Node(0, 0))


@pytest.mark.parametrize(
    ("engine", "workers", "threads", "expected"),
    [
        ("mujoco", "auto", None, [Place(8, 0, 8), Place(4, 0, 4)]),
        ("mujoco", "auto", 3, [Place(3, 0, 3)] * 3),
        ("mujoco", 2, None, [Place(4, 0, 4)] * 2),  # only one worker with 6 CPUs would fit on each node
        ("mujoco", 3, None, [Place(4, 0, 4)] * 3),
        ("mujoco", 12, None, [Place(1, 0, 1)] * 12),
        ("mujoco", 2, 1, [Place(1, 0, 1)] * 2),
        ("mjx-warp", "auto", None, [Place(1, 1)] * 2),
        ("mjx-jax", 1, None, [Place(1, 1)]),
        ("mjx-warp", 4, None, [Place(1, 0.5)] * 4),
        ("mjx-warp", 6, None, [Place(1, 0.3333)] * 6),  # Ray rounds shares to ten-thousandths
    ],
)
def test_what_workers_take(engine: str, workers: int | str, threads: int | None, expected: list[Place]) -> None:
    assert places(engine, NODES, workers, threads) == expected


def test_workers_that_share_a_gpu_have_a_cpu_each() -> None:
    nodes = [Node(4, 1), Node(5, 2)]  # four workers would have room on any two of the three GPUs
    assert places("mjx-jax", nodes, 3) == [Place(1, 1)] * 3
    with pytest.raises(InputError, match="workers: no room for 9 workers of 1 CPU beside the GPUs; there are 9 CPUs"):
        places("mjx-jax", nodes, 9)


def test_a_device_engine_without_gpus() -> None:
    assert places("mjx-jax", [Node(4)], "auto") == [Place(4)]
    assert places("mjx-jax", [Node(4)], 2) == [Place(2)] * 2
    with pytest.raises(EngineUnavailable, match="mjx-warp cannot run here: there are 4 CPUs and 0 GPUs"):
        places("mjx-warp", [Node(4)], "auto")


@pytest.mark.parametrize(
    ("engine", "workers", "threads", "line"),
    [
        ("mujoco", 13, None, "workers: no room for 13 workers of 1 CPU; there are 12 CPUs and 2 GPUs on 3 nodes"),
        ("mujoco", 2, 5, "workers: no room for 2 workers of 5 CPUs; there are"),
        ("mujoco", "auto", 9, "workers: no room for a worker of 9 CPUs; there are"),
        ("mjx-warp", 5, None, "workers: 5 cannot share 2 GPUs evenly, 4 can; there are"),
        ("mjx-warp", 9, None, "workers: at most 4 share a GPU, so 9 have no room; there are"),
    ],
)
def test_more_workers_than_there_is_room_for(engine: str, workers: int | str, threads: int | None, line: str) -> None:
    with pytest.raises(InputError, match=line):
        places(engine, NODES, workers, threads)


@pytest.mark.parametrize(
    ("nodes", "workers", "threads"),
    [
        ([Node(32, 2)], 2, 16),
        ([Node(32, 2)], 1, 32),
        ([Node(16, 1)], 4, 4),
        ([Node(0), Node(4), Node(64, 2)], 2, 32),  # a head node, a node without GPUs, and a node with two GPUs
        ([Node(16, 2)] * 4, 8, 8),
        ([Node(16, 2), Node(12, 4)], 6, 3),
    ],
)
def test_workers_with_gpus_share_the_threads_of_their_own_machine(
    nodes: list[Node], workers: int, threads: int
) -> None:
    assert threads_beside(nodes, workers) == threads
