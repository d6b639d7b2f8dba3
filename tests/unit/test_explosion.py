"""The explosion rule: large accelerations must last, and two boxes that land one after the other do not explode."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import pytest
from support.fake_stepper import fake_scene

from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import NEVER, upload_worlds
from petmjx.engines.mjx.world_state import State, fresh_state
from petmjx.engines.mujoco.explosion import Explosion
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

LANDING = 50
"""Steps that a box needs to land."""

Samples = Sequence[tuple[int, int, bool]]
"""For each sample: its step, the step of the last placement, and whether an acceleration is above its threshold."""


def on_mujoco(samples: Samples) -> bool:
    """Whether the rule of C MuJoCo finds an explosion at the last sample."""
    rule = Explosion(LANDING)
    return [rule.seen(*sample) for sample in samples][-1]


def on_mjx(samples: Samples) -> bool:
    """Whether the rules of the batched engines find an explosion at the last sample, in a world of one box at rest."""
    sim = Simulation(sample_interval_s=0.05, quiet={"landing_steps": LANDING})
    worlds = upload_worlds([Job(fake_scene(1.0))], 1, 1, {}, sim)
    start = fresh_state(worlds, all_placed=True, ends=jnp.full(1, NEVER, jnp.int32), rest_steps=1)
    rules = Rules(sim, build_timetable(sim, 1), capacity=1, driven=False)

    @jax.jit
    def after_step(state: State, acceleration: jax.Array) -> State:
        return rules.after_step(
            state, worlds, state.qpos, jnp.full((1, 1, 6), acceleration), jnp.zeros((1, 1)), jnp.zeros(1, bool)
        )

    state = start
    for step, placed_at, too_fast in samples:
        when = {"step": jnp.full(1, step, jnp.int32), "last_placed_at": jnp.full(1, placed_at, jnp.int32)}
        before = start._replace(violent_since=state.violent_since, **when)
        state = after_step(before, jnp.asarray(1000.0 if too_fast else 1.0))
    return bool(state.flags[0] & int(Flag.EXPLOSION))


@pytest.mark.parametrize("rule", [on_mujoco, on_mjx])
@pytest.mark.parametrize(
    ("samples", "explodes"),
    [
        pytest.param([(100, 0, True), (200, 0, True)], True, id="lasts"),
        pytest.param([(100, 0, True)], False, id="one sample"),
        pytest.param([(100, 0, True), (200, 0, False), (300, 0, True)], False, id="two strikes"),
        pytest.param([(100, 0, True), (200, 180, False), (300, 180, True)], False, id="two boxes that land"),
        pytest.param([(100, 0, True), (200, 180, True), (300, 180, True)], True, id="lasts beyond a placement"),
        pytest.param([(100, 0, True), (200, 180, True)], False, id="lasts until a placement"),
        pytest.param([(100, 90, True), (125, 90, True), (150, 90, True)], False, id="soon after a placement"),
    ],
)
def test_only_accelerations_that_last_are_an_explosion(
    rule: Callable[[Samples], bool], samples: Samples, explodes: bool
) -> None:
    assert rule(samples) == explodes
