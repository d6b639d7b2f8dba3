"""Runs of mjx-warp: time slices in which every world of a group goes on, and the outcomes of those that end."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import jax
import numpy as np
import warp as wp
from jaxtyping import Array, Int
from numpy.typing import NDArray

from petmjx.config import SOFT_START_STEPS, Check, Cone, Physics, Schedule, Simulation
from petmjx.engines.batch.rules import Rules
from petmjx.engines.batch.state import NEVER, Metrics, State, Status, Worlds
from petmjx.engines.batch.template import LINE_SEARCH_ITERATIONS, MAX_ITERATIONS
from petmjx.engines.batch.timetable import Timetable
from petmjx.engines.warp.frames import room_for
from petmjx.engines.warp.group import Group, Run
from petmjx.engines.warp.march import SLICE_NS, Fleet, March
from petmjx.world.contact import MOST_IMPEDANCE
from petmjx.world.placing import lowering_rate_1_s, rate_1_s, stuck_steps
from petmjx.world.release import MOST_FOLLOWED_M

TOLERANCE = 1e-8
"""MuJoCo's default. It can be reached, since forces and residuals are double precision."""

DRIVEN_ITERATIONS = 7
"""Most iterations of the solver in a drive. Where a whole pallet slides and collapses it takes 20 and more for the last
digits of accelerations. Of 1,600 worlds of EUMOS's grid 1,598 have the verdict of ``mujoco``, which takes as many as it
needs. What the limit costs and gains: docs/performance.md, "Sliding contacts"."""


def friction_damping(physics: Physics) -> float:
    """Damping of friction, 1/s, as MuJoCo has it (its documentation, "Modeling", "Solver parameters"); 0 if it is that
    of contacts."""
    if not physics.has_own_friction:
        return 0.0
    time_s, damping = physics.solreffriction
    high = min(physics.solimp[1], MOST_IMPEDANCE)
    return -damping / high if time_s < 0 else 2.0 / (high * max(time_s, 2 * physics.timestep_s))


def constants(sim: Simulation, timetable: Timetable) -> dict[str, Any]:
    """What the kernels need to know of a run: the fields of ``records.Model`` but for those of a fleet."""
    physics, limits, quiet = sim.physics, sim.thresholds, sim.quiet
    return {
        "timestep": physics.timestep_s,
        "gravity": physics.gravity_m_s2,
        "solref": wp.vec2(*physics.solref),
        "solimp": wp.vec3(*physics.solimp),
        "skin": physics.skin_m,
        "carrier_skin": physics.carrier_skin_m,
        "pyramidal": int(physics.cone is Cone.PYRAMIDAL),
        "friction_damping": friction_damping(physics),
        "impratio_invsqrt": physics.impratio**-0.5,
        "tolerance": sim.solver_tolerance or TOLERANCE,
        "iterations": sim.solver_iterations or MAX_ITERATIONS,  # a world that needs many holds up no other
        "driven_iterations": sim.solver_iterations or DRIVEN_ITERATIONS,
        "ls_iterations": LINE_SEARCH_ITERATIONS,
        "fixed": int(sim.schedule is Schedule.FIXED),
        "waits_for_rest": int(sim.waits_for_rest),
        "extends": int(sim.waits_for_rest and sim.total_time_factor is None),
        "early_stop": int(sim.early_stop),
        "soft_start": SOFT_START_STEPS,
        "sample_every": timetable.sample_every,
        "rest_steps": timetable.rest_steps,
        "still_steps": timetable.still_steps,
        "due_steps": timetable.due_steps,
        "longest_steps": timetable.longest_steps,
        "static_end": timetable.static_end if sim.check is Check.STATIC else NEVER,
        "shift": limits.shift_m,
        "shift_floor": limits.shift_floor_m,
        "tilt": limits.tilt_deg,
        "drop_z": limits.drop_hull_z_m,
        "linear_acceleration": limits.lin_acc_m_s2,
        "angular_acceleration": limits.ang_acc_rad_s2,
        "quiet_speed": quiet.quiet_m_s,
        "slow_speed": quiet.slow_m_s,
        "slowing": quiet.slowing,
        "still_speed": quiet.still_m_s,
        "most_followed": MOST_FOLLOWED_M,
        "quiet_steps": quiet.steps,
        "min_steps": quiet.min_steps,
        "poll_steps": quiet.poll_steps,
        "hand_rate": rate_1_s(physics.timestep_s),
        "lowering_rate": lowering_rate_1_s(physics.timestep_s),
        "stuck_steps": stuck_steps(physics.timestep_s),
        "due": wp.array(timetable.due, dtype=int),
        "longest": wp.array(timetable.longest, dtype=int),
        "settled": wp.array(timetable.settled, dtype=int),
        "settled_nominally": wp.array(timetable.settled_nominally, dtype=int),
    }


class Slice(NamedTuple):
    """What a time slice gives beside states, when it has ended. ``began``: when the host began it, s."""

    began: float
    status: Int[Array, " world"]
    frames: dict[str, jax.Array]
    counts: dict[str, jax.Array]


class Rollout:
    """Programs and buffers of a run, and its time slices that are under way, in their order.

    Args:
        fleets: those for the largest worlds first.
        slice_ns: time of a call of the kernels, ns.
    """

    def __init__(self, run: Run, fleets: Sequence[Fleet], slice_ns: int = SLICE_NS) -> None:
        self.march = March(constants(run.sim, run.timetable), fleets, slice_ns)
        self.rules = Rules(run.sim, run.timetable, max(fleet.n_boxes for fleet in fleets), driven=True)
        self.workspace = self.march.workspace().block_until_ready()
        self._advancing = jax.jit(self._advance, donate_argnums=(0, 1))
        self._programs: dict[tuple[int, ...], Any] = {}
        self._slices: deque[Slice] = deque()
        self._last_end = 0.0

    @property
    def under_way(self) -> int:
        """Slices that have begun and were not waited for."""
        return len(self._slices)

    def start(self, group: Group, order: Int[Array, "queue world"]) -> None:
        """Begin a time slice for all worlds of a group that run: behind those that are under way."""
        blocks = self.march.blocks
        if group.frames is None or (len(group.frames["of"]) < blocks and not group.recorder.idle):
            group.frames = room_for(group, blocks)
        arguments = (group.table, self.workspace, group.worlds, group.profiles, order, group.frames)
        shapes = (*order.shape, *group.profiles.shape, len(group.frames["of"]))
        if shapes not in self._programs:
            begin, progress = time.perf_counter(), group.run.progress
            progress.message = "compiling"
            self.march.load()
            self._programs[shapes] = self._advancing.lower(*arguments).compile()
            progress.compile_s += time.perf_counter() - begin
        began = time.perf_counter()
        group.table, self.workspace, status, frames, counts = self._programs[shapes](*arguments)
        self._slices.append(Slice(began, status, frames, counts))

    def keep_under_way(self, count: int, group: Group, order: Int[Array, "queue world"]) -> None:
        """Begin slices until so many are under way."""
        while self.under_way < count:
            self.start(group, order)

    def finish(self, group: Group) -> None:
        """Wait for all slices that are under way."""
        while self.under_way:
            self.wait(group)

    def close(self) -> None:
        """Wait for slices that are under way, and free the workspace."""
        while self._slices:
            with suppress(jax.errors.JaxRuntimeError):  # it may be because of this error that it is closed
                self._slices.popleft().status.block_until_ready()
        if not self.workspace.is_deleted():
            with suppress(jax.errors.JaxRuntimeError):
                self.workspace.block_until_ready()
            self.workspace.delete()

    def wait(self, group: Group) -> tuple[NDArray[np.int32], Slice]:
        """Statuses of a group's worlds after the first slice under way, and that slice, which has ended."""
        ended = self._slices.popleft()
        status = np.array(ended.status)[: len(group.jobs)]
        self._last_end, began = time.perf_counter(), max(ended.began, self._last_end)
        progress = group.run.progress
        counts = jax.device_get(ended.counts)  # whole: to pick an element on the device takes longer than all of them
        steps, iterations, contacts = (int(counts[name][0]) for name in ("steps", "iterations", "contacts"))
        running = int((status == Status.RUNNING).sum())
        progress.message = f"{running} worlds to go"
        progress.world_steps += steps
        extra = progress.extra
        sums = {"seconds": self._last_end - began, "steps": steps, "iterations": iterations}
        for what, amount in sums.items():
            extra[f"march {what}"] = extra.get(f"march {what}", 0) + amount
        extra["march lanes"] = max(extra.get("march lanes", 0), self.march.blocks)
        extra["march contacts"] = max(extra.get("march contacts", 0), contacts)
        return status, ended

    def _advance(
        self,
        table: State,
        workspace: jax.Array,
        worlds: Worlds,
        profiles: Array,
        order: Int[Array, "queue world"],
        frames: dict[str, jax.Array],
    ) -> tuple[State, jax.Array, Int[Array, " world"], dict[str, jax.Array], dict[str, jax.Array]]:
        """A time slice. Returns states, workspace, a copy of the statuses, frames, and counts."""
        table = self.rules.begin_drives(table, worlds)
        flat = table._asdict()
        flat |= flat.pop("metrics")._asdict()
        flat_worlds = worlds._asdict() | {"profiles": profiles, "order": order}
        after, workspace, frames, counts = self.march(flat_worlds, flat, workspace, frames)
        metrics = Metrics(**{name: after.pop(name) for name in Metrics._fields})
        table = State(**after, metrics=metrics)
        return table, workspace, table.status + 0, frames, counts
