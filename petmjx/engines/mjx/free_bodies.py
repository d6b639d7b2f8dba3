"""Free motion of released boxes on mjx-jax: steps of ``BatchRollout`` without the rules of a run."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.batch_step import PaddedModel
from petmjx.engines.mjx.host_to_device import let_go
from petmjx.engines.mjx.padded_sizes import padded_rows
from petmjx.engines.mjx.rollout import BatchRollout, Program
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.engines.mjx.world_state import State, second_axes
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies


def paths(bodies: FreeBodies, sim: Simulation, most: int) -> FloatArray:
    """See ``petmjx.engines.protocol.Engine.paths``. ``most``: largest number of worlds simulated at a time."""
    begins = range(0, len(bodies.scenes), most)
    return np.concatenate([_paths_of_batch(bodies.part(slice(begin, begin + most)), sim) for begin in begins])


def _paths_of_batch(bodies: FreeBodies, sim: Simulation) -> FloatArray:
    n, k, steps = len(bodies.scenes), bodies.n_boxes, bodies.steps
    poses = np.full((n, len(steps), k, 7), np.nan)
    rows, boards = padded_rows(n), len(bodies.scenes[0].carrier.half_size)
    worlds, state = let_go(bodies, sim, rows, k)
    if bodies.on_plane:
        worlds, boards = _without_carrier(worlds, boards), 0
    program = _program(sim, k, boards)
    memory = program.model.blank_memory(rows)
    n_steps = 0
    if steps[0] == 0:
        poses[:, 0] = bodies.pose
    while n_steps < steps[-1]:
        state, memory, trail = program.chunk(state, memory, worlds, jnp.zeros((1, 1, 3)))
        chunk = np.asarray(trail.pose, np.float64)[:, :n]
        (column,) = np.nonzero((steps > n_steps) & (steps <= n_steps + len(chunk)))
        poses[:, column] = chunk[steps[column] - n_steps - 1].swapaxes(0, 1)
        n_steps += len(chunk)
    return poses


def _without_carrier(worlds: Worlds, boards: int) -> Worlds:
    """The worlds without the shapes of their carriers. MJX would check each shape of a carrier in each step, even if no
    box is near."""
    of_shapes = [name for name, axis in second_axes(Worlds).items() if axis == "shape"]
    return worlds._replace(**{name: getattr(worlds, name)[:, boards:] for name in of_shapes})


class _NoRules(Rules):
    """Rules for ``BatchRollout`` that do nothing, so that boxes only move."""

    def park(self, state: State) -> State:
        """Do nothing, since no box waits in the air."""
        return state

    def after_step(self, state: State, *args: Any, **named: Any) -> State:
        """Leave worlds and their states unchanged."""
        return state


@functools.lru_cache(4)
def _program(sim: Simulation, k: int, boards: int) -> Program:
    model = PaddedModel(k, boards, sim, held=True)
    rules = _NoRules(sim, build_timetable(sim, k), k, driven=False)
    return Program(model, BatchRollout(rules, model).jitted())
