"""The compiled programs of mjx-warp, which the process keeps. A later call with the same options compiles nothing."""

from __future__ import annotations

import functools
import threading
import time
from threading import Lock
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp
from jaxtyping import Array, Int

from petmjx.engines.contact_penetration import stiffened
from petmjx.engines.mjx.padded_template import LINE_SEARCH_ITERATIONS, MAX_ITERATIONS
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import Timetable, build_timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds
from petmjx.engines.mjx.world_state import State, of_flat
from petmjx.engines.protocol import Progress
from petmjx.engines.subprocess.kernel_builds import KernelBuilds
from petmjx.engines.warp.block_launch import Features, Launch, launch_device, load_kernels
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import USUAL_SIZES
from petmjx.engines.warp.kernel_launcher import KernelLauncher
from petmjx.engines.warp.small_world_blocks import small_world_queues
from petmjx.engines.warp.tail_blocks import tail_queues
from petmjx.options.physics import Cone, Physics
from petmjx.options.simulation import SOFT_START_STEPS, Check, Schedule, Simulation
from petmjx.world.contact_laws import MOST_IMPEDANCE, kinetic_share, lasts_steps, slack_m_s2
from petmjx.world.film import spring_rate_1_s
from petmjx.world.hand import lowering_rate_1_s, rate_1_s, stuck_steps

TOLERANCE = 1e-8
"""Tolerance of the solver: MuJoCo's default. The solver can reach this tolerance, since forces and residuals have
double precision."""

READ_COUNTS = ("steps", "iterations", "contacts")
"""The counts that the CPU reads after each time slice (one call of the kernels). Fetching an array may require a wait
for Python's global interpreter lock. So the CPU fetches a single array: the statuses of all worlds, followed by these
counts."""


def friction_damping(physics: Physics) -> float:
    """Damping of friction, 1/s, by MuJoCo's formula (MuJoCo's documentation, "Modeling", "Solver parameters"). 0 means
    the same damping as along the normal of a contact."""
    if not physics.has_own_friction:
        return 0.0
    time_s, damping = physics.solreffriction
    high = min(physics.solimp[1], MOST_IMPEDANCE)
    return -damping / high if time_s < 0 else 2.0 / (high * max(time_s, 2 * physics.timestep_s))


def contact_constants(sim: Simulation, timetable: Timetable) -> dict[str, Any]:
    """The subset of a run's kernel constants whose values differ for worlds with stiffer contacts
    (``contact_penetration.stiffened``)."""
    return {
        "solref": wp.vec2(*sim.physics.solref),
        "solimp": wp.vec3(*sim.physics.solimp),
        "friction_damping": friction_damping(sim.physics),
        "slip_slack": slack_m_s2(sim.physics),
        "quiet_steps": sim.quiet.steps,
        "due_steps": timetable.due_steps,
        "due": wp.array(timetable.due, dtype=int, device=launch_device()),
    }


def constants(sim: Simulation, timetable: Timetable) -> dict[str, Any]:
    """The constants of a run for the kernels: the fields of ``world_arrays.Model``, except those of a block pool."""
    physics, quiet = sim.physics, sim.quiet
    device = launch_device()
    return {
        **contact_constants(sim, timetable),
        "timestep": physics.timestep_s,
        "gravity": physics.gravity_m_s2,
        "skin": physics.skin_m,
        "carrier_skin": physics.carrier_skin_m,
        "pyramidal": int(physics.cone is Cone.PYRAMIDAL),
        "kinetic_share": kinetic_share(physics),
        "impratio_invsqrt": physics.impratio**-0.5,
        "tolerance": sim.solver_tolerance or TOLERANCE,
        # the limit is the same as in MuJoCo, since a world that takes many iterations delays no other world
        "iterations": sim.solver_iterations or MAX_ITERATIONS,
        "ls_iterations": LINE_SEARCH_ITERATIONS,
        "fixed": int(sim.schedule is Schedule.FIXED),
        "waits_for_rest": int(sim.waits_for_rest),
        "extends": int(sim.waits_for_rest and sim.total_time_factor is None),
        "early_stop": int(sim.early_stop),
        "soft_start": SOFT_START_STEPS,
        "sample_every": timetable.sample_every,
        "rest_steps": timetable.rest_steps,
        "still_steps": timetable.still_steps,
        "longest_steps": timetable.longest_steps,
        "static_end": timetable.static_end if sim.check is Check.STATIC else NEVER,
        **sim.thresholds.model_dump(),
        "quiet_speed": quiet.quiet_m_s,
        "slow_speed": quiet.slow_m_s,
        "slowing": quiet.slowing,
        "still_speed": quiet.still_m_s,
        "tremble_share": quiet.tremble_share,
        "tremble_looks": quiet.tremble_looks,
        "landing_steps": quiet.landing_steps,
        "poll_steps": quiet.poll_steps,
        "hand_rate": rate_1_s(physics.timestep_s),
        "lowering_rate": lowering_rate_1_s(physics.timestep_s),
        "stuck_steps": stuck_steps(physics.timestep_s),
        "film_rate": spring_rate_1_s(physics.timestep_s),
        "landing_time": physics.landing_s,
        "landing_lasts": lasts_steps(sim),
        "restitution": physics.restitution,
        "longest": wp.array(timetable.longest, dtype=int, device=device),
        "settled": wp.array(timetable.settled, dtype=int, device=device),
        "settled_nominally": wp.array(timetable.settled_nominally, dtype=int, device=device),
    }


class Programs:
    """The compiled XLA programs that simulate a time slice, one for each size of the tables. The programs hold the
    constants of a run on the device, but no states. So any number of runs and threads can call them at the same time.

    Args:
        pools: block pools, as returned by ``BlockPools.of``.
        slice_ns: length of a time slice, ns.
    """

    def __init__(self, sim: Simulation, timetable: Timetable, pools: tuple[BlockPool, ...], slice_ns: int) -> None:
        values = {pool.stiff for pool in pools if pool.stiff is not None}
        of_stiff: dict[float | None, Any] = {
            stiff: contact_constants(options, build_timetable(options, timetable.most_boxes))
            for stiff in values
            for options in [stiffened(sim, stiff)]
        }
        self.launcher = KernelLauncher(constants(sim, timetable), pools, slice_ns, of_stiff)
        self._few = next((pool for pool in pools if pool.least), None)
        self._last = next((pool for pool in pools if pool.last), None)
        self._rules = Rules(sim, timetable, max(pool.n_boxes for pool in pools), driven=True)
        self._advancing = jax.jit(self._advance, donate_argnums=(0, 1))
        self._compiled: dict[tuple[tuple[int, ...], ...], Any] = {}

    def compiled(self, arguments: tuple[Any, ...], progress: Progress) -> Any:
        """The program that simulates a time slice (``_advance``), compiled for arguments of these sizes. The compile
        time is added to ``progress``."""
        table, _, _, profiles, order, frames = arguments
        sizes = table.qpos.shape, profiles.shape, order.shape, frames["of"].shape
        if sizes in self._compiled:
            return self._compiled[sizes]
        begin, progress.message = time.perf_counter(), "compiling"
        with _COMPILING:  # if another thread is compiling kernels in advance, this call waits for that thread
            if sizes not in self._compiled:
                self.launcher.load()
                self._compiled[sizes] = self._advancing.lower(*arguments).compile()
                progress.compile_s += time.perf_counter() - begin
            return self._compiled[sizes]

    def _advance(
        self,
        table: State,
        workspace: jax.Array,
        worlds: Worlds,
        profiles: Array,
        order: Int[Array, "queue world"],
        frames: dict[str, jax.Array],
    ) -> tuple[State, jax.Array, Int[Array, " word"], dict[str, jax.Array], dict[str, jax.Array]]:
        """Simulate a time slice. Returns the states, the workspace, the array that the CPU fetches (the statuses of
        all worlds, then ``READ_COUNTS``), the frames, and the counts."""
        table = self._rules.begin_drives(table, worlds)
        if self._few:
            order = small_world_queues(self._few, order, table.placed, table.running)
        if self._last:
            order = tail_queues(self._last, order, table.steps_done, table.running, self.launcher.blocks)
        flat_worlds = worlds.flat() | {"profiles": profiles, "order": order}
        after, workspace, frames, counts = self.launcher(flat_worlds, table.flat(), workspace, frames)
        table = of_flat(after)
        # The status is copied, since the next slice reuses the table's memory.
        readback = jnp.concatenate([table.status, *(counts[name] for name in READ_COUNTS)])
        return table, workspace, readback, frames, counts


_COMPILING = Lock()
"""A lock that is held while a program is compiled. Warp does not promise that two threads may load the same kernel at
once."""


def load_usual_kernels(sim: Simulation, builds: KernelBuilds | None = None) -> bool:
    """Before the plans are known, compile the kernels that most runs with these options need, or load them from Warp's
    cache. Plans with compliant boxes, stretch film, or many boxes need other kernels. Returns True if the kernels are
    loaded; they are then in the cache, too. Without a GPU, or when the program is ending, nothing is loaded, and the
    result is False.

    Args:
        builds: processes that compile these kernels. The cache has the kernels when the processes have answered.
    """
    if not launch_device().is_cuda:
        return False
    features = Features(hands=not sim.placing.appears, lands=sim.physics.has_landings)
    with _COMPILING:
        for _ in builds.answers() if builds is not None else ():
            pass
        if not threading.main_thread().is_alive():
            return False  # the process is ending, and needs no kernels any more
        load_kernels([Launch.of(size, features) for size in USUAL_SIZES])
    return True


MOST_KEPT = 16
"""Number of ``Programs`` objects that are kept. A score with further attempts needs up to four ``Programs`` objects.
The largest of these objects takes 16 MB."""


programs = functools.lru_cache(MOST_KEPT)(Programs)
"""The programs of a run. They are kept for later calls with the same options, block pools, slice length and timetable
object."""
