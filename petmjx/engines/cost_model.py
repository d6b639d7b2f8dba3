"""The cost model: expected times of runs, for ``auto`` and for all estimates of time. The expected steps are those of
petmjx/engines/expected_work.py.

On a CPU thread, a step of a pallet at rest takes one iteration of Newton's method. The cost of a step grows somewhat
faster than the number of boxes. While boxes land or slide, a step takes more iterations. An iteration is expensive if
boxes stand on several other boxes, since this ties the columns of a pallet into one system of equations. So the
additional cost of a landing grows with the square of the number of standing boxes, and with the number of ties
(supports of a box beyond its first support). If each box stands on only one other, as in a block of columns, landings
cost next to nothing.

On a device, too, the cost of a step of a full stack grows with the square of the number of boxes. But a plan with more
boxes is at rest in a larger share of its steps, so the cost of a whole run grows more slowly than that of a step. At
the end of a run, and of each round of a search, the device is nearly idle until the longest worlds end. In runs of a
few hundred worlds, the wait for the longest worlds takes most of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.expected_work import (
    CARRIED_COST,
    DISPLACED_COST,
    DRIVEN_SWAY,
    FALL_BOXES,
    FALL_STEPS,
    SOFT_STARTS,
    WayOfPlacing,
    Work,
    expected_drive_steps,
)
from petmjx.options.simulation import Check, Simulation
from petmjx.world.job import Job

JAX_POWER, WARP_POWER = 2.0, 1.0
"""Over whole runs, the cost of a step grows with the number of boxes: to the power ``JAX_POWER`` on ``mjx-jax``, and to
the power ``WARP_POWER`` on ``mjx-warp``. On ``mjx-warp``, steps at rest are cheap, and plans with more boxes are at
rest in a larger share of their steps. While n boxes are placed one by one, the cost of a step on ``mjx-warp`` is the
mean of the costs with 1, 2, …, n boxes. This mean is about 1 / (``WARP_POWER`` + 1) of the cost with n boxes. On
``mjx-jax``, all boxes are in the model from the beginning, so every step has the full cost."""

DRIVE_TAIL_STEPS = 1150
"""At the end of a run on a device, only the longest drives are still simulated. The time for this end is computed for a
drive with this number of steps, whatever the length of the profile: after some drives, boxes creep for a long time."""

TAIL_WORLDS = 5
"""The longest of n worlds on a device takes ``Costs.gpu_tail_s`` · ln(1 + n / ``TAIL_WORLDS``) times the mean world's
work. The lengths of worlds have an exponential tail, so the largest length grows with the logarithm of n."""

REST_POWER = 1.25
"""The cost of a step at rest on a CPU thread grows with this power of the number of standing boxes."""

SHAKEN_STEPS = 700
"""A drive is expected to have at most this number of steps in which boxes slide or fall. EUMOS's profile has fewer
steps than this number. A profile that tilts the carrier has 2,970 steps, and boxes are at rest in most of them. A drive
that shakes boxes for many seconds takes up to ten times as long as expected."""

GENTLE_COST = 0.25
"""Additional cost of a step of a gentle drive, divided by the additional cost of a step of a stronger drive. The
acceleration of a gentle drive is at most ``STEADY_G``. In most of its steps, boxes neither slide nor fall. In
measurements on ``mujoco`` with EUMOS's profile and 10 to 45 boxes, the additional cost of drives of 0.1 to 0.3 g was 10
to 25 % of the additional cost of drives of 0.4 to 0.8 g."""

STATIC_FALL_BOXES = 12
"""A fall in a static check of n boxes costs n / ``STATIC_FALL_BOXES`` times as much as a fall while boxes are placed
one by one, since all boxes may fall. Static checks took 1 to 1.4 times as long as placing the boxes one by one for
plans of 24 boxes, and 1.6 to 5 times as long for generated plans of 41 boxes."""

BOARDS_COST = 1.35
"""Cost of a step on a carrier of boards, or between walls, relative to a slab. Scores, drives and searches of 5 to 60
boxes took 1.2 to 1.7 times as long on epal-1, on gma-48x40 and in a gitterbox."""

FAILING_POWER = 2.5
"""The time of a world with errors grows with this power of the share of boxes that are placed before one fails. The
number of steps grows with this share, and the time of a step grows with the number of standing boxes."""

LONG_PLACEMENT, LONG_DRIVE = 3.0, 2.5
"""A world is long if its placement takes more than ``LONG_PLACEMENT`` times as many steps as a placement whose boxes
stand, or if its drive takes more than ``LONG_DRIVE`` times the expected steps. The rest window does not count. A
placement of fewer than ``FALL_STEPS`` steps is never long. So worlds of few boxes that fall are not long, although they
take 400 to 650 steps, while worlds of few boxes that stand take only 165 to 210."""


@dataclass(frozen=True)
class ThreadCosts:
    """Measured costs of an engine on one CPU thread.

    Attributes:
        rest_s: a step of a world of n boxes at rest takes ``rest_s`` · n^``REST_POWER`` seconds.
        overhead_s: additional time of any step, s.
        landing_s: while one box lands on n standing boxes, steps take ``landing_s`` · n² seconds more in total, if
            ``Work.coupling`` is 1.
        static_s: while all n boxes of a static check land, steps take ``static_s`` · n² seconds more in total, if
            ``Work.coupling`` is 1.
        shaken_s: each of the first ``SHAKEN_STEPS`` steps of a drive of n boxes takes ``shaken_s`` · n^``shaken_power``
            seconds more.
        shaken_power: see ``shaken_s``. In the drives of 3 to 205 boxes that were measured on each engine, the power is
            2 on ``mujoco``, and 1.75 in the kernels.
        fall_s: additional time of a fall while boxes are placed one by one, until a box has dropped, s. The time of a
            fall hardly depends on the number of boxes. The time of a single fall varies from a tenth of this value to
            ten times this value.
        jammed: cost of a placement by hand with errors, in which boxes jam, relative to a placement without errors.
        hand_s: additional time of a step of a placement by hand, s.
        film_s: additional time of each of the first ``SHAKEN_STEPS`` steps of a drive in film, s per box.
        give_s: additional time of a step, s per compliant box.
        driven_s: additional time of a step of a drive, s, because contacts slide, and the forces on the tops of boxes
            are summed in each step.
        board_s: additional time of a step of a placement on a carrier of boards, s per box, because all pairs of boxes
            and boards are checked.
    """

    rest_s: float
    overhead_s: float
    landing_s: float
    static_s: float
    shaken_s: float
    shaken_power: float
    fall_s: float
    jammed: float
    hand_s: float = 0.0
    film_s: float = 0.0
    give_s: float = 0.0
    driven_s: float = 0.0
    board_s: float = 0.0

    def slowed(self, factor: float) -> ThreadCosts:
        """The costs on a CPU thread that takes ``factor`` times as long."""
        times = {name: factor * value for name, value in vars(self).items() if name.endswith("_s")}
        return replace(self, **times)

    def seconds(self, work: Work, threads: int) -> float:
        """Expected time of a run whose worlds are divided among threads, s. The result is at least the time of the
        world that takes longest.
        """
        placing = [
            (way.count, self.placing_s(work, way, work.share_before_failure(way, FAILING_POWER)))
            for way in work.ways
            if way.count
        ]
        driving_s = self.driving_s(work)
        plans_s = sum((count * placing_s for count, placing_s in placing), work.shaken * driving_s)
        longest_s = np.max([placing_s for _, placing_s in placing], axis=0) + np.where(work.shaken > 0, driving_s, 0.0)
        return max(float(plans_s.sum()) / threads, float(longest_s.max()))

    def placing_s(
        self, work: Work, way: WayOfPlacing | None = None, placed_share: FloatArray | float = 1.0
    ) -> FloatArray:
        """(n,) time of one placement of each plan, s.

        Args:
            way: how boxes are placed. If ``way`` is None, boxes are placed as planned.
            placed_share: share of the boxes that are placed before a box fails because of errors
                (``Work.share_before_failure``). If the share is 1, no box fails.
        """
        way = way or work.ways[0]
        share = work.share * placed_share
        boxes = np.asarray(work.boxes, dtype=float) * share
        one_by_one = work.sim.check is Check.ONE_BY_ONE
        # if boxes are placed one by one, the number of standing boxes grows from 1 to n, so costs are sums over 1…n
        standing = 0.5 if one_by_one else 1.0
        step_s = self.rest_s * boxes**REST_POWER / (REST_POWER + 1 if one_by_one else 1) + self.overhead_s
        step_s = step_s + standing * self.give_s * work.compliant * share + self.hand_s * way.is_carried
        landings_s = self.landing_s * boxes**3 / 3 if one_by_one else self.static_s * boxes**2
        placed_s = step_s * (SOFT_STARTS + way.steps * share * work._placing_steps) + work.coupling * landings_s
        fallen = np.minimum(boxes + FALL_BOXES, np.asarray(work.boxes, dtype=float))
        fall_s = self.fall_s * (1.0 if one_by_one else boxes / STATIC_FALL_BOXES) * (work.fall_steps > 0)
        falling_s = way.falls * (work.fall_steps * (self.rest_s * fallen**REST_POWER + self.overhead_s) + fall_s)
        if way.has_errors:
            placed_s = placed_s * (self.jammed if way.is_carried else _displaced_cost(work.coupling))
        placing_s = placed_s + falling_s
        if work.on_boards:
            steps = SOFT_STARTS + placed_share * work.placement_steps(way)
            placing_s = BOARDS_COST * (placing_s + standing * self.board_s * steps * np.asarray(work.boxes))
        return np.asarray(placing_s)

    def driving_s(self, work: Work, steps: FloatArray | float | None = None) -> FloatArray:
        """(n,) time of one drive of each plan, s. ``steps``: number of steps of the drive; if None, the number follows
        from ``work.drive_steps`` and ``work.sway_steps``."""
        steps = work.drive_steps + DRIVEN_SWAY * work.sway_steps if steps is None else steps
        n = np.asarray(work.boxes, dtype=float)
        step_s = self.rest_s * n**REST_POWER + self.overhead_s + self.driven_s
        step_s = step_s + self.give_s * work.compliant
        strong = 1 - np.asarray(work.gentle) * (1 - GENTLE_COST)
        shaken_s = self.shaken_s * n**self.shaken_power + self.film_s * np.asarray(work.filmed) * n
        shaken_s = strong * shaken_s * np.minimum(steps, SHAKEN_STEPS)
        return np.asarray((step_s * steps + shaken_s) * (BOARDS_COST if work.on_boards else 1.0))


@dataclass(frozen=True)
class Costs:
    """Measured costs of the engines, as detailed as ``auto`` and estimates of time need them.

    Attributes:
        mujoco, kernel: costs of ``mujoco`` and of ``mjx-warp-cpu`` on one CPU thread.
        kernel_start_s: time to start ``mjx-warp-cpu``, including compilation, s.
        kernel_load_s: time to start ``mjx-warp-cpu`` if an earlier run has compiled the kernel, s.
        jax_step_s: on ``mjx-jax`` on a CPU, a step of one world of n boxes takes ``jax_step_s`` · n² seconds. On two
            cores, a world of 40 boxes takes 57 steps per second.
        gpu_step_s: on a device, a step of ``full_worlds`` worlds of n boxes each takes ``gpu_step_s`` ·
            n^``WARP_POWER`` seconds.
        full_worlds: number of worlds that fill the device.
        gpu_tail_s: at the end of n worlds, the longest worlds leave the device nearly idle for ``gpu_tail_s`` · w ·
            ln(1 + n / ``TAIL_WORLDS``) seconds, where w is the work of a world (``Work.placing``, ``Work.driving``).
        host_s: time that the host spends on a world of a run on a device, s.
        gpu_start_s: time to start the device engine, including compilation, s.
        gpu_load_s: time to start the device engine if an earlier run has compiled the kernels, s.
    """

    mujoco: ThreadCosts = ThreadCosts(
        rest_s=1.3e-6,
        overhead_s=2.2e-5,
        landing_s=2.6e-6,
        static_s=1e-4,
        shaken_s=1.5e-6,
        shaken_power=2.0,
        fall_s=0.45,
        jammed=1.45,
        hand_s=9e-5,
        film_s=2.6e-5,
        give_s=3e-5,
        driven_s=3.5e-5,
    )
    kernel: ThreadCosts = ThreadCosts(
        rest_s=4e-7,
        overhead_s=3.8e-6,
        landing_s=9e-7,
        static_s=2e-5,
        shaken_s=1.1e-7,
        shaken_power=1.75,
        fall_s=0.05,
        jammed=1.3,
        hand_s=1e-6,
        film_s=2e-6,
        give_s=1.2e-6,
        board_s=4.5e-6,
    )
    kernel_start_s: float = 6.0
    kernel_load_s: float = 0.8
    jax_step_s: float = 1.1e-5
    gpu_step_s: float = 1.45e-6
    full_worlds: int = 264
    gpu_tail_s: float = 6e-6
    host_s: float = 2e-4
    gpu_start_s: float = 17.0
    gpu_load_s: float = 0.8

    def slowed(self, factor: float) -> Costs:
        """The costs on a machine whose CPU threads take ``factor`` times as long. The factor does not change the costs
        of GPUs.
        """
        return replace(
            self,
            mujoco=self.mujoco.slowed(factor),
            kernel=self.kernel.slowed(factor),
            kernel_start_s=factor * self.kernel_start_s,
            kernel_load_s=factor * self.kernel_load_s,
            jax_step_s=factor * self.jax_step_s,
        )

    def seconds(self, work: Work, threads: int, gpus: int = 1) -> dict[str, float]:
        """Name of an engine → expected time of the run if its worlds are divided among threads or GPUs, s. For
        ``mjx-jax``, the value is the time on a CPU."""
        n_plans = len(work.boxes)
        if not n_plans:
            starts = {"mjx-warp": self.gpu_start_s, "mjx-warp-cpu": self.kernel_start_s}
            return {"mujoco": 0.0, "mjx-jax": 0.0} | starts
        placements = work.on_device
        jax_placing, jax_driving = work.placing(JAX_POWER, grows=False), work.driving(JAX_POWER, work.drive_steps)
        placing, driving = work.placing(WARP_POWER, grows=True), work.driving(WARP_POWER, work.drive_steps)
        placed, driven = float(placing.mean()), float(driving.mean())
        device_s = self._phase_s(n_plans * work.placements / gpus, placements / work.placements * placed, placed)
        creeping = float(work.driving(WARP_POWER, DRIVE_TAIL_STEPS).mean())
        device_s += self._phase_s(float(work.shaken.sum()) / gpus, driven, creeping, work.rounds)
        return {
            "mujoco": self.mujoco.seconds(work, threads),
            "mjx-warp-cpu": self.kernel_start_s + self.kernel.seconds(work, threads),
            "mjx-jax": self.jax_step_s * float((placements * jax_placing + work.shaken * jax_driving).sum()),
            "mjx-warp": self.gpu_start_s + device_s,
        }

    def of_jobs(self, jobs: Sequence[Job], sim: Simulation, costs: ThreadCosts | None = None) -> FloatArray:
        """(n,) expected time of each job on one CPU thread, s. ``costs``: costs of the engine. If ``costs`` is None,
        the costs of ``mujoco`` are used."""
        costs = costs or self.mujoco
        work, drive_steps = _expected_work(jobs, sim)
        placing_s = _of_placements(jobs, *(costs.placing_s(work, way) for way in work.ways))
        return placing_s + costs.driving_s(work, drive_steps)

    def of_jobs_on_device(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) expected time of each job in a thread block of ``mjx-warp``; the unit is one step of one box."""
        work, drive_steps = _expected_work(jobs, sim)
        placing = _of_placements(jobs, 1.0, DISPLACED_COST, CARRIED_COST) * work.placing(WARP_POWER, grows=True)
        return np.asarray(placing + work.driving(WARP_POWER, drive_steps))

    def long_steps(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) for each job, the number of steps above which its world counts as long (``LONG_PLACEMENT``,
        ``LONG_DRIVE``). The number depends neither on the machine nor on the other jobs."""
        steps = np.full(len(jobs), float(seconds_to_steps(sim.rest_window_s, sim.physics.timestep_s)))
        # ``_expected_work`` counts a drive for every job if any job settles, so jobs that settle get a separate call
        for settles in (False, True):
            rows = [row for row, job in enumerate(jobs) if job.settles is settles]
            some = [jobs[row] for row in rows]
            work, drive_steps = _expected_work(some, sim)
            placing = _of_placements(some, *(work.placement_steps(way) for way in work.ways))
            if sim.check is Check.ONE_BY_ONE:  # each box waits for a quiet pallet, even if ``interval_s`` is short
                placing = np.where(placing > 0, np.maximum(placing, sim.quiet.steps * np.array(work.boxes)), 0.0)
            long_placement = np.where(placing > 0, np.maximum(LONG_PLACEMENT * placing, FALL_STEPS), 0.0)
            steps[rows] += long_placement + LONG_DRIVE * drive_steps
        return steps

    def _phase_s(self, worlds: float, work: float, tail_work: float, rounds: int = 1) -> float:
        """Time of a phase of many worlds on the device, s. The time includes the end of each round of the phase, when
        only a few worlds still run.

        Args:
            work: work of the mean world.
            tail_work: like ``work``, but only with the factors that affect the time of the longest worlds.
            rounds: number of rounds, each of which begins when the round before it has ended.
        """
        if not worlds:
            return 0.0
        full_s = worlds * (self.gpu_step_s * work / self.full_worlds + self.host_s)
        return full_s + rounds * self.gpu_tail_s * tail_work * float(np.log1p(worlds / rounds / TAIL_WORLDS))


def _displaced_cost(coupling: FloatArray) -> FloatArray:
    """(n,) cost of a placement whose boxes appear at places with errors, relative to a placement without errors. With
    errors, boxes that stand on several others lose some of these supports, and rock. On ``mujoco`` and on
    ``mjx-warp-cpu``, the measured relative cost is 1.6 for generated plans, and 2.6 to 3 for a third-party plan."""
    return 1.3 + 1.9 * coupling


def _expected_work(jobs: Sequence[Job], sim: Simulation) -> tuple[Work, FloatArray]:
    """The work of all jobs if all boxes are placed as planned; and (n,) the number of steps of each job's drive."""
    drive_steps = np.array([expected_drive_steps(job.drive, sim) if job.drive else 0.0 for job in jobs])
    work = Work(sim, [job.scene.n_boxes for job in jobs], drives=int(any(job.settles for job in jobs)))
    return work, drive_steps


def _of_placements(
    jobs: Sequence[Job], planned: FloatArray | float, displaced: FloatArray | float, carried: FloatArray | float
) -> FloatArray:
    """(n,) for each job, one of three values: ``planned`` if boxes appear at their places without errors, ``displaced``
    if they appear with errors, and ``carried`` if they are carried. The value is 0 for jobs that start from a state and
    so have no placement."""
    carries = np.array([job.scene.placing.carries for job in jobs], dtype=bool)
    has_errors = np.array([job.has_errors for job in jobs], dtype=bool)
    starts = np.array([job.start is not None for job in jobs], dtype=bool)
    return np.where(starts, 0.0, np.where(carries, carried, np.where(has_errors, displaced, planned)))


MEASURED = Costs()
"""The measured costs. The times expected from these costs agree with the records of runs within a factor of two. The
records are the lines ``estimates`` of benchmarks/results/cpu-0.3.jsonl and h200-0.3.jsonl, and the records of
tests/unit/test_engine_choice.py. Tests compare the model with all these records.

The costs of CPU threads were measured with one thread on a machine of two virtual EPYC cores. Other programs kept these
cores busy, so the thread took 1.7 to 2.5 times as long as on an idle core (petmjx/engines/machine_speed.py). The plans
were generated plans of 5 to 80 boxes, blocks of up to 120 boxes, and third-party plans of 45 to 140 boxes. The runs
were scores and static checks on several carriers, with all ways of placing, both schedules and both physics; scores
with confidence; and ready-made sweeps and chains. The cost of film was fitted to drives of 8, 22 and 40 boxes, and the
cost of a step with compliant boxes to plans of 16 to 24 boxes.

On C MuJoCo, the time of a single fall varies from a tenth of the mean to ten times the mean. So estimates for a few
plans that fall are less exact. The estimates do not include the time for simulating worlds again with smaller
timesteps.

The costs of devices were fitted to records of one H100 and one H200. The times do not include start and compilation.
The runs were: 10, 300, 3,000 and 10,003 generated plans; 300 plans that fall; and 2,000 and 4,000 generated plans with
the fixed schedule. With ``confidence`` 16, the runs were: 100, 500 and 1,000 plans whose boxes appear at their places,
and 100 plans whose boxes are carried by hand. Further runs were: 128,000 and a million worlds of 12 boxes with
placement errors, the profile of EUMOS for 20 plans, and searches of EUMOS's levels for 30 plans. ``mjx-warp`` compiles
for 13 to 23 s (0.1 to 1.6 s if an earlier run has compiled the kernels)."""
