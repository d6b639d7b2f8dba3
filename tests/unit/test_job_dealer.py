"""Tests of the distribution of jobs to workers: how many jobs workers hold, the death of a worker, and the number of
workers that fit on nodes. Ray itself is not used."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from support.fake_stepper import fake_scene

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.units import FloatArray
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.expected_work import CREEPING, DISPLACED_COST
from petmjx.engines.remote.job_dealer import MOST_JOBS, MOST_ON_DEVICE, JobDealer, WorkerJobs
from petmjx.engines.remote.worker_resources import Node, WorkerResources, threads_beside, worker_resources
from petmjx.options.simulation import Simulation
from petmjx.world.job import Drive, Excitation, Job

LEAST, BEGIN = 512, 1600


def dealer_of(costs: Iterable[float], least: int | None = None, begin_with: int = 1, **options: bool) -> JobDealer:
    dealer = JobDealer(least, begin_with)
    for job, cost in enumerate(costs):
        dealer.add(job, cost, **options)
    return dealer


def ready(*threads: int) -> list[WorkerJobs]:
    return [WorkerJobs(count, ready=True) for count in threads]


def finish(dealer: JobDealer, worker: WorkerJobs, jobs: Iterable[int] | None = None) -> None:
    for job in [*worker.costs] if jobs is None else [*jobs]:
        dealer.answered(worker, job)


def dead(dealer: JobDealer, worker: WorkerJobs) -> list[int]:
    """The jobs that are given up after the death of a worker. Another worker replaces the dead worker."""
    given_up = dealer.died(worker)
    vars(worker).update(vars(WorkerJobs(worker.threads, ready=True)))
    return given_up


def simulated_s(costs: FloatArray, workers: int) -> float:
    """Time until the last of the workers has finished, s. Each has one thread and takes its jobs in the order in which
    it got them."""
    dealer, workers = dealer_of(costs), ready(*[1] * workers)
    now, ends = 0.0, list[tuple[float, int]]()
    while dealer.unanswered:
        dealer.deal(workers, more_come=False)
        busy = {index for _, index in ends}
        for index, worker in enumerate(workers):
            if index not in busy and worker.costs:
                heapq.heappush(ends, (now + next(iter(worker.costs.values())), index))
        now, index = heapq.heappop(ends)
        finish(dealer, workers[index], [next(iter(workers[index].costs))])
    return now


def test_threads_get_the_longest_jobs_first_and_hold_fewer_towards_the_end() -> None:
    costs = np.random.default_rng(33359).lognormal(size=1000)
    dealer, (worker,) = dealer_of(costs), ready(2)
    order, held = [], []
    while dealer.unanswered:
        order += dealer.deal([worker], more_come=False).get(0, [])
        held.append(len(worker.costs))
        finish(dealer, worker, [next(iter(worker.costs))])
    assert order == np.argsort(-costs, kind="stable").tolist()
    assert 2 * MOST_JOBS < max(held) <= 4 * MOST_JOBS
    assert held[-2:] == [2, 1]


@pytest.mark.parametrize("workers", [2, 7, 32])
def test_all_workers_end_together(workers: int) -> None:
    costs = np.random.default_rng(33360).lognormal(size=1000)
    assert simulated_s(costs, workers) < 1.02 * max(costs.sum() / workers, costs.max())
    assert simulated_s(np.ones(workers), workers) == 1


def test_threads_hold_a_reserve_only_while_there_is_plenty() -> None:
    for jobs, held in ((100, [25, 25]), (8, [1, 1])):
        workers = ready(1, 1)
        dealer_of(np.ones(jobs)).deal(workers, more_come=False)
        assert [len(worker.costs) for worker in workers] == held


@pytest.mark.parametrize(
    ("jobs", "workers", "held"),
    [
        (20_006, 2, [MOST_ON_DEVICE, MOST_ON_DEVICE]),
        (16_000, 2, [8000, 8000]),
        (700, 4, [350, 350, 0, 0]),  # so few worlds that only two devices are used
        (100, 4, [100, 0, 0, 0]),
    ],
)
def test_devices_share_all_jobs(jobs: int, workers: int, held: list[int]) -> None:
    costs, workers = np.random.default_rng(33361).permutation(np.linspace(1.0, 1.5, jobs)), ready(*[1] * workers)
    dealt = dealer_of(costs, LEAST, BEGIN).deal(workers, more_come=False)
    assert [len(worker.costs) for worker in workers] == pytest.approx(held, abs=1)
    for numbers in dealt.values():
        assert np.all(np.diff(costs[numbers]) <= 0)
    busy = [worker for worker in workers if worker.costs]
    times = [sum(worker.costs.values()) for worker in busy]
    assert np.ptp(times) <= 1.5
    # each device has the same mix of short and long jobs
    assert np.ptp([np.median([*worker.costs.values()]) for worker in busy]) < 0.01


def test_devices_begin_one_after_another_while_jobs_come() -> None:
    dealer, workers = dealer_of(np.ones(BEGIN - 1), LEAST, BEGIN), ready(1, 1)
    assert dealer.deal(workers, more_come=True) == {}
    n_dealt = []
    for added in (1, BEGIN - 1, 1, 100):
        for job in range(added):
            dealer.add(10_000 + 10_000 * len(n_dealt) + job, 1.0)
        n_dealt.append({index: len(jobs) for index, jobs in dealer.deal(workers, more_come=True).items()})
    assert n_dealt == [{0: BEGIN}, {}, {1: BEGIN}, {0: 50, 1: 50}]


def test_jobs_are_kept_for_a_device_that_is_starting_but_not_for_ever() -> None:
    dealer, workers = dealer_of(np.ones(8000), LEAST, BEGIN), ready(1, 1)
    workers[1].ready = False
    dealer.deal(workers, more_come=False)
    assert len(workers[0].costs) == 4000
    finish(dealer, workers[0], range(2000))
    dealer.deal(workers, more_come=False)
    assert len(workers[0].costs) == 3000  # and as many wait
    while dealer.unanswered:
        finish(dealer, workers[0])
        dealer.deal(workers, more_come=False)
        assert workers[0].costs or not dealer.unanswered
    assert not workers[1].begun


def test_further_jobs_go_to_the_device_that_has_less_to_do() -> None:
    dealer, workers = dealer_of(np.ones(6000), LEAST, BEGIN), ready(1, 1)
    dealer.deal(workers, more_come=False)
    finish(dealer, workers[0], [*workers[0].costs][:1000])
    for job in range(6000, 6500):
        dealer.add(job, 1.0)
    assert {index: len(jobs) for index, jobs in dealer.deal(workers, more_come=False).items()} == {0: 500}


def test_jobs_that_start_from_a_state_come_first() -> None:
    dealer = dealer_of([5.0, 9.0], least=1)
    dealer.add(2, 1.0, starts=True)
    assert dealer.deal(ready(1), more_come=False) == {0: [2, 1, 0]}


def test_only_unanswered_jobs_of_a_dead_worker_are_dealt_again() -> None:
    dealer, (worker,) = dealer_of([3.0, 1.0, 2.0], least=1), ready(1)
    assert dealer.deal([worker], more_come=False) == {0: [0, 2, 1]}
    dealer.answered(worker, 2)
    assert dead(dealer, worker) == []
    assert dealer.deal([worker], more_come=False) == {0: [0, 1]}
    with pytest.raises(KeyError):
        dealer.answered(worker, 2)


def test_jobs_of_a_worker_that_dies_as_it_starts_are_not_to_blame() -> None:
    dealer, (worker,) = dealer_of(np.ones(5), least=1), ready(1)
    dealer.add(5, 1.0, deadly=True)
    for _ in range(4):
        assert dealer.deal([worker], more_come=False) == {0: [0, 1, 2, 3, 4]}
        dealer.put_back(worker)
        worker.costs = {}
    dealer.deal([worker], more_come=False)
    finish(dealer, worker)
    for _ in range(2):
        assert dealer.deal([worker], more_come=False) == {0: [5]}
        assert worker.suspects == 1
        dealer.put_back(worker)
        vars(worker).update(vars(WorkerJobs(ready=True)))


@pytest.mark.parametrize("least", [None, 1])
def test_a_job_that_workers_die_of_is_given_up_and_no_other(least: int | None) -> None:
    dealer, workers, deadly = dealer_of(np.ones(100), least), ready(1, 1), 37
    deaths, given_up = 0, list[int]()
    while dealer.unanswered:
        dealer.deal(workers, more_come=False)
        for worker in workers:
            if deadly in worker.costs:
                deaths += 1
                assert not given_up
                alone = worker.suspects == 1
                given_up += dead(dealer, worker)
                assert bool(given_up) == alone
            else:
                finish(dealer, worker)
    assert given_up == [deadly]
    assert 3 <= deaths <= 4


@pytest.mark.parametrize("least", [None, 1, 50])
@pytest.mark.parametrize("seed", [33354, 33355, 33356])
def test_whatever_happens_each_job_has_one_outcome_or_was_alone_in_a_worker_that_died(
    seed: int, least: int | None
) -> None:
    """While jobs come, workers start, simulate some of their jobs, and die: at random, or because of one of three
    deadly jobs."""
    rng = np.random.default_rng(seed)
    dealer, workers = JobDealer(least, begin_with=20), [WorkerJobs(threads) for threads in (1, 2, 3)]
    deadly, coming, n_jobs = {int(job) for job in rng.integers(0, 300, 3)}, True, 0
    outcomes, given_up, turns = list[int](), list[int](), 0
    while coming or dealer.unanswered:
        turns += 1
        assert turns < 10_000
        for _ in range(int(rng.integers(0, 30)) if coming else 0):
            dealer.add(n_jobs, rng.lognormal(), starts=bool(rng.random() < 0.3))
            n_jobs += 1
        coming = n_jobs < 300
        for index, jobs in dealer.deal(workers, more_come=coming).items():
            assert workers[index].ready
            assert set(jobs) <= set(workers[index].costs)
        held = [job for worker in workers for job in worker.costs]
        assert len(held) == len(set(held))
        for worker in workers:
            if not worker.ready:
                worker.ready = bool(rng.random() < 0.3)
            elif (deadly & worker.costs.keys() and rng.random() < 0.3) or rng.random() < 0.01:
                alone = len(worker.costs) == worker.suspects == 1
                lost = dead(dealer, worker)
                assert len(lost) <= alone
                given_up += lost
                worker.ready = False
            else:
                ended = [job for job in worker.costs if job not in deadly and rng.random() < 0.2]
                outcomes += ended
                finish(dealer, worker, ended)
    assert sorted([*outcomes, *given_up]) == list(range(n_jobs))
    assert deadly <= set(given_up)


def test_suspects_wait_for_a_worker_of_their_own() -> None:
    dealer, workers = dealer_of(np.ones(6), least=1), ready(1, 1)
    dealer.deal(workers, more_come=False)
    first = [*workers[0].costs]
    finish(dealer, workers[1], [*workers[1].costs][:2])
    dead(dealer, workers[0])
    assert dealer.deal(workers[:1], more_come=False) == {0: first}
    dead(dealer, workers[0])
    assert dealer.deal(workers[1:], more_come=False) == {}  # the other worker holds a job
    assert dealer.deal(workers[:1], more_come=True) == {}
    finish(dealer, workers[1])
    pieces = dealer.deal(workers, more_come=False)
    assert [len(jobs) for jobs in pieces.values()] == [2, 1]
    assert sorted(job for jobs in pieces.values() for job in jobs) == sorted(first)
    dealer.add(6, 1.0)
    assert dealer.deal(workers, more_come=False) == {}
    # one of two suspects has an outcome: the other one was not alone, so it gets another chance
    finish(dealer, workers[0], [pieces[0][0]])
    assert dead(dealer, workers[0]) == []
    assert dealer.deal(workers[:1], more_come=False) == {0: [6]}
    finish(dealer, workers[0])
    assert dealer.deal(workers[:1], more_come=False) == {0: [pieces[0][1]]}
    assert dead(dealer, workers[0]) == [pieces[0][1]]


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
        ("mujoco", "auto", None, [WorkerResources(8), WorkerResources(4)]),
        ("mujoco", "auto", 3, [WorkerResources(3)] * 3),
        ("mujoco", 2, None, [WorkerResources(4)] * 2),  # only one worker with 6 CPUs would fit on each node
        ("mujoco", 3, None, [WorkerResources(4)] * 3),
        ("mujoco", 12, None, [WorkerResources(1)] * 12),
        ("mujoco", 2, 1, [WorkerResources(1)] * 2),
        ("mjx-warp", "auto", None, [WorkerResources(1, 1)] * 2),
        ("mjx-jax", 1, None, [WorkerResources(1, 1)]),
        ("mjx-warp", 4, None, [WorkerResources(1, 0.5)] * 4),
        ("mjx-warp", 6, None, [WorkerResources(1, 0.3333)] * 6),  # Ray rounds shares to ten-thousandths
    ],
)
def test_what_workers_take(
    engine: str, workers: int | str, threads: int | None, expected: list[WorkerResources]
) -> None:
    assert worker_resources(engine, NODES, workers, threads) == expected


def test_workers_that_share_a_gpu_have_a_cpu_each() -> None:
    nodes = [Node(4, 1), Node(5, 2)]  # four workers would have room on any two of the three GPUs
    assert worker_resources("mjx-jax", nodes, 3) == [WorkerResources(1, 1)] * 3
    with pytest.raises(
        InputError, match="workers: the machines with GPUs have too few CPUs for 9 workers with 1 CPU each; "
    ):
        worker_resources("mjx-jax", nodes, 9)


def test_a_device_engine_without_gpus() -> None:
    assert worker_resources("mjx-jax", [Node(4)], "auto") == [WorkerResources(4)]
    assert worker_resources("mjx-jax", [Node(4)], 2) == [WorkerResources(2)] * 2
    with pytest.raises(EngineUnavailable, match="mjx-warp cannot run here: there are 4 CPUs and 0 GPUs"):
        worker_resources("mjx-warp", [Node(4)], "auto")


@pytest.mark.parametrize(
    ("engine", "workers", "threads", "line"),
    [
        ("mujoco", 13, None, "workers: no room for 13 workers of 1 CPU; there are 12 CPUs and 2 GPUs on 3 nodes"),
        ("mujoco", 2, 5, "workers: no room for 2 workers of 5 CPUs; there are"),
        ("mujoco", "auto", 9, "workers: no room for a worker of 9 CPUs; there are"),
        ("mjx-warp", 5, None, "workers: 5 workers cannot share 2 GPUs evenly, 4 can; there are"),
        ("mjx-warp", 9, None, "workers: at most 4 workers share a GPU, so there is no room for 9; there are"),
    ],
)
def test_more_workers_than_there_is_room_for(engine: str, workers: int | str, threads: int | None, line: str) -> None:
    with pytest.raises(InputError, match=line):
        worker_resources(engine, NODES, workers, threads)


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
