"""One step of mjx-warp against C MuJoCo's: accelerations, next state, forces on top; and lane by lane alike."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import resources
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from petmjx.config import PHYSICS, Physics, Simulation, Solver
from petmjx.world.model import build_spec
from petmjx.world.scene import Scene, build_scene

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.worlds import make_plan

from petmjx.engines.batch.setup import set_up_warp
from petmjx.engines.batch.template import override_fields, padded_template
from petmjx.engines.warp import newton
from petmjx.engines.warp.engine import friction_damping
from petmjx.engines.warp.step import PalletStepper

set_up_warp()

LANES = 2
STEPS = (3, 10, 40, 100, 160, 220)
"""Steps into a run in which all boxes stand at once and the last one tips: landing, sliding, falling."""

SAME_ACCELERATION_M_S2 = 0.02
"""Poses go to float32, 5e-8 m at 1 m: times a contact's stiffness (2,600 s⁻² of reference acceleration for each metre)
and a factor of some ten for light boxes between heavy ones. Accelerations themselves are up to 60 m/s²."""

SAME_ACCELERATION = 3e-3
"""The same, of the light box that spins with up to 60 rad/s² while it lands."""

SAME_VELOCITY_M_S = 1e-5
"""Beside what the accelerations' tolerance makes in a step."""

SAME_POSITION = 1e-6
"""m, and for quaternions their parts: float32 at 1 m."""


@pytest.fixture(autouse=True)
def _ranks_may_differ() -> Iterator[None]:
    with jax.numpy_rank_promotion("allow"):
        yield


BRICKS = (
    ((300, 200, 150), (0, 0, 0), 5.0),
    ((300, 200, 150), (300, 0, 0), 3.0),
    ((250, 200, 100), (170, 0, 150), 8.0),
    ((150, 150, 120), (230, 20, 250), 0.8),
    ((400, 180, 90), (320, 10, 250), 6.0),
)
"""Two rows of bricks, a light box between heavy ones, and one that leans over the edge and tips."""


def exact(scene: Scene, physics: Physics) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """C's model of the scene, all boxes standing where they are put; boxes meet by MJX's primitive collider."""
    spec = build_spec(scene, physics)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    model = spec.compile()
    data = mujoco.MjData(model)
    poses = data.qpos[7:].reshape(-1, 7)
    poses[:, :3], poses[:, 3:] = scene.start_pos, scene.start_quat
    return model, data


def stepper_of(physics: Physics) -> PalletStepper:
    template = padded_template(
        len(BRICKS),
        physics,
        held=False,
        solver=Solver.NEWTON,
        tolerance=1e-8,
        iterations=100,
        native_ccd=False,
    )
    return PalletStepper(template, LANES, 400, 100, friction_damping(physics))


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["pallet", "reference"])
def test_accelerations_velocities_and_iterations_as_in_c(preset: str) -> None:
    physics = PHYSICS[preset]
    scene = build_scene(make_plan("bricks", BRICKS), Simulation(physics=preset))
    model, data = exact(scene, physics)
    stepper = stepper_of(physics)

    def lanes(values: Any) -> jax.Array:
        return jnp.repeat(jnp.asarray(np.asarray(values, np.float32))[None], LANES, axis=0)

    fields = override_fields(
        lanes(scene.half_size),
        lanes(scene.mass),
        lanes(scene.carrier_half_size),
        lanes(scene.carrier_mass),
        lanes([scene.floor_friction, scene.carrier_friction, scene.box_friction]),
        stepper.model,
        held=False,
    )
    fields["opt.gravity"] = lanes([0.0, 0.0, -physics.gravity_m_s2])
    step = jax.jit(lambda inputs: stepper.step(fields, inputs, stepper.scratch()))
    compared = 0
    for at in range(max(STEPS) + 1):
        before = {"qpos": data.qpos, "qvel": data.qvel, "qacc_warmstart": data.qacc_warmstart}
        inputs = {name: lanes(values) for name, values in before.items()}
        mujoco.mj_step(model, data)
        if at not in STEPS:
            continue
        inputs["xfrc_applied"] = jnp.zeros((LANES, model.nbody, 6))
        found = step(inputs)
        assert not np.asarray(found.overflow).any()
        np.testing.assert_array_equal(found.qacc[0], found.qacc[1])
        # A contact that barely touches may be there in double precision and not in single.
        if int(found.contacts[0]) != data.ncon:
            continue
        compared += 1
        np.testing.assert_allclose(
            found.qacc[0], data.qacc, rtol=SAME_ACCELERATION, atol=SAME_ACCELERATION_M_S2, err_msg=f"step {at}"
        )
        gained = physics.timestep_s * (SAME_ACCELERATION_M_S2 + SAME_ACCELERATION * np.abs(data.qacc))
        assert (np.abs(found.qvel[0] - data.qvel) <= gained + SAME_VELOCITY_M_S).all(), f"step {at}"
        np.testing.assert_allclose(found.qpos[0], data.qpos, atol=SAME_POSITION, err_msg=f"step {at}")
        # A bound on what is left to gain replaces MuJoCo's two tests, and a factor in single precision costs an
        # iteration or two where contacts are stiff.
        assert abs(int(found.iterations[0]) - int(data.solver_niter[0])) <= 4
    assert compared >= 3


@pytest.mark.parametrize(
    ("changes", "damping"),
    [
        ({}, 2 / (0.999 * 0.004)),
        ({"timestep_s": 0.004}, 2 / (0.999 * 0.008)),  # MuJoCo takes two timesteps at least
        ({"solreffriction": (-100.0, -300.0)}, 300 / 0.999),
        ({"solreffriction": (0.0, 0.0)}, 0.0),
        ({"cone": "pyramidal"}, 0.0),
    ],
)
def test_damping_of_friction_as_mujoco_has_it(changes: dict[str, Any], damping: float) -> None:
    assert friction_damping(PHYSICS["pallet"].changed(**changes)) == pytest.approx(damping)


def test_compiler_errors_name_the_line_of_the_file() -> None:
    """Every line of C++ is there once, under the name and number that its file has."""
    seen: dict[str, list[tuple[int, str]]] = {}
    name, number = "", 0
    for line in newton.source("newton.cu").splitlines():
        if match := re.fullmatch(r'#line (\d+) "(.+)"', line):
            number, name = int(match[1]), match[2]
        else:
            seen.setdefault(name, []).append((number, line))
            number += 1
    assert set(seen) == {"newton.cu", "block.cuh", "cholesky.cuh", "contact.cuh"}
    for name, lines in seen.items():
        text = resources.files("petmjx.engines.warp").joinpath(name).read_text(encoding="utf-8")
        whole = [(n, line) for n, line in enumerate(text.splitlines(), 1) if not line.startswith("#include")]
        assert [pair for pair in lines if pair in whole] == whole, name
        assert all(line == "" for pair in lines if pair not in whole for line in pair[1:]), name


def test_a_changed_file_is_compiled_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = newton.solver.__wrapped__(1, 1).module.get_module_hash(1)
    assert newton.solver.__wrapped__(1, 1).module.get_module_hash(1) == plain
    text = newton.source("newton.cu")
    monkeypatch.setattr(newton, "source", lambda _: text + "// one more line\n")
    assert newton.solver.__wrapped__(1, 1).module.get_module_hash(1) != plain


def test_more_bodies_than_the_solver_has_room_for_are_refused() -> None:
    template = padded_template(
        300, PHYSICS["pallet"], held=False, solver=Solver.NEWTON, tolerance=1e-8, iterations=1, native_ccd=False
    )
    with pytest.raises(ValueError, match="301 bodies"):
        PalletStepper(template, 1, pool=1, room=1)
