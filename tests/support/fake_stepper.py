"""A stepper without physics, for tests of rules and batches. Every event in its worlds can be computed by hand.

The mass of a box determines its motion after its placement:

* the box trembles (too fast to be quiet) for ``mass`` steps, and is then at rest;
* with a mass of ``FALLS_KG`` or more, the box falls by 10 mm per step;
* if the mass has a remainder of half a kilogram, the box sways: from its first step to its last step of trembling, it
  is 30 mm from its place;
* the force on its top is its age, 1 N per step, so the force at rest tells when the box was placed;
* the carrier's excitation moves the box along x and y, by 1 µm per step for each newton or m/s².

The age of a box is stored in its warm-start acceleration. So the age of a box is lost unless states are passed on
completely.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from petmjx.engines.job_stream import JobStream
from petmjx.engines.mjx.batch_step import Memory, PaddedModel, StepResult
from petmjx.engines.mjx.engine import MjxJaxEngine
from petmjx.engines.mjx.padded_template import CARRIER_BODY, FIRST_BOX_BODY
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.carriers import Carrier
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import Scene
from support.plans import make_scene

FALLS_KG = 1000.0
FALL_M = 0.01
TREMBLE_M_S = 0.1
SWAYS_KG, SWAY_M = 0.5, 0.03
CREEP_M = 1e-6

CARRIER_KG = PHYSICS["pallet"].carrier_mass_kg


class FakeModel(NamedTuple):
    """The fields of a model from which overrides are made."""

    geom_size: jax.Array
    geom_rbound: jax.Array
    geom_aabb: jax.Array
    body_pos: jax.Array
    body_quat: jax.Array


class FakeStepper(PaddedModel):
    """Takes steps without MJX."""

    def __init__(self, capacity: int, *, held: bool) -> None:
        self.capacity, self.held = capacity, held
        self.carrier, self.bodies = CARRIER_BODY, FIRST_BOX_BODY + capacity
        bodies = self.bodies
        self.model = FakeModel(
            jnp.zeros((bodies, 3)),
            jnp.zeros(bodies),
            jnp.zeros((bodies, 6)),
            jnp.zeros((bodies, 3)),
            jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (bodies, 1)),
        )

    def blank_memory(self, worlds: int) -> Memory:
        return Memory(jnp.zeros((worlds, 1)))

    def step(
        self,
        fields: dict[str, jax.Array],
        inputs: dict[str, jax.Array],
        memory: Memory,
        faces: None = None,
        landing: None = None,
    ) -> StepResult:
        n, c, k = len(inputs["qpos"]), self.capacity, self.capacity + (not self.held)
        mass = fields["body_mass"][:, FIRST_BOX_BODY:]
        pose = inputs["qpos"].reshape(n, k, 7)
        warm = inputs["qacc_warmstart"].reshape(n, k, 6).at[:, -c:, 0].add(1.0)
        age = warm[:, -c:, 0]
        vel = jnp.zeros((n, k, 6)).at[:, -c:, 0].set(jnp.where(age < mass, TREMBLE_M_S, 0.0))
        push = inputs["xfrc_applied"][:, CARRIER_BODY, :2]
        if self.held:
            push = push - fields["opt.gravity"][:, :2]
        pose = pose.at[:, -c:, :2].add(CREEP_M * push[:, None])
        pose = pose.at[:, -c:, 2].add(jnp.where(mass >= FALLS_KG, -FALL_M, 0.0))
        sways = jnp.where(mass % 1.0 == SWAYS_KG, SWAY_M, 0.0)
        pose = pose.at[:, -c:, 1].add(sways * ((age == 1.0).astype(jnp.float32) - (age == jnp.ceil(mass))))
        flat = (n, -1)
        still = jnp.zeros((n, 6 * k))
        none = jnp.zeros(len(age), jnp.int32)
        return StepResult(pose.reshape(flat), vel.reshape(flat), still, warm.reshape(flat), memory, age, none)


class FakeEngine(MjxJaxEngine):
    """The batches and rules of mjx-jax with the fake stepper."""

    name = "fake"

    def make_model(self, capacity: int, boards: int, sim: Simulation, *, held: bool, pausing: bool) -> PaddedModel:
        return FakeStepper(capacity, held=held)


def fake_scene(*masses: float) -> Scene:
    """A scene with boxes side by side, at rest at their places, with these masses in kg."""
    boxes = [((200.0, 200.0, 200.0), (300.0 * k, 0.0, 0.0), mass) for k, mass in enumerate(masses)]
    return make_scene(boxes, Simulation(size_reduction_mm=0, carrier=Carrier.EURO_PALLET))


def in_order(outcomes: Iterator[Outcome]) -> list[Outcome]:
    """The outcomes sorted by job. Each job must have exactly one outcome."""
    listed = sorted(outcomes, key=lambda outcome: outcome.job)
    assert [outcome.job for outcome in listed] == list(range(len(listed)))
    return listed


def run_all(
    engine: Engine, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
) -> list[Outcome]:
    """The outcomes of all jobs, in the order of the jobs."""
    count = jobs.ready if isinstance(jobs, JobStream) else len(jobs)
    outcomes = in_order(engine.run(jobs, sim, progress))  # type: ignore[arg-type]  # a stream for engines that take one
    assert len(outcomes) == count
    return outcomes


def assert_same(outcome: Outcome, expected: Outcome, relative: float = 0.0, absolute: float = 0.0) -> None:
    """Check that verdict, times and all metrics of two worlds are equal."""
    for name in ("verdict", "reason", "culprit", "n_boxes", "n_placed", "n_steps", "sim_time_s"):
        assert getattr(outcome, name) == getattr(expected, name), name
    np.testing.assert_equal(outcome.first_sign_s, expected.first_sign_s)
    for name, values in vars(expected.boxes).items():
        np.testing.assert_allclose(
            getattr(outcome.boxes, name), values, rtol=relative, atol=absolute, equal_nan=True, err_msg=name
        )
