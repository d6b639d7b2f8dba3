"""One step of mjx-warp compared with one step of C MuJoCo.

The tests compare accelerations, the next state, forces on tops of boxes, contacts, and iterations of the solver.
"""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import resources
from typing import Any

import mujoco
import numpy as np
import pytest

from petmjx.engines.mujoco.top_forces import top_forces
from petmjx.options.physics import PHYSICS, Cone, Physics
from petmjx.options.simulation import Simulation
from petmjx.world.mujoco_model import build_spec, geom_bodies
from petmjx.world.scene import Scene, build_scene

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.one_step import OneStep
from support.plans import Box, heap, on_boards
from support.worlds import make_plan

from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.mjx.padded_sizes import GRANULE
from petmjx.engines.mujoco.slip import SlipLaw
from petmjx.engines.warp import block_launch, block_sizes
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.compiled_programs import friction_damping
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import PANEL

set_up_warp()

pytestmark = pytest.mark.usefixtures("ranks_may_differ")

STEPS = (3, 15, 86, 95, 137, 153)
"""Numbers of steps in a run in which all boxes stand from the beginning and the last box tips. In these steps boxes
land, slide and fall. Steps in which a contact is about to slip or to part are not among them: there accelerations
depend ten times as much on the last digit of a pose."""

HEAP_STEPS = (14, 32, 53, 120)
"""Numbers of steps in a run of a heap, whose boxes land, tip and slide all the time. Steps in which a box is wedged
between others are not among them: there the solver's tolerance decides how well the forces on the box are known."""

SAME_ACCELERATION_M_S2 = 0.02
"""Tolerance of accelerations. Poses are rounded to float32, by 5e-8 m at 1 m. The stiffness of a contact multiplies
that error: 2,600 s⁻² of reference acceleration for each metre. Light boxes between heavy boxes multiply it by some ten.
The accelerations themselves are up to 60 m/s²."""

SAME_ACCELERATION = 3e-3
"""Relative tolerance of accelerations, for the light box. The light box spins with up to 60 rad/s² while it lands."""

SAME_VELOCITY_M_S = 1e-5
"""Tolerance of velocities, in addition to the tolerance of accelerations times the timestep."""

SAME_POSITION = 1e-6
"""Tolerance of positions in m, and of the parts of quaternions: float32 at 1 m."""

SAME_FORCE = 0.01
SAME_FORCE_N = 0.2
"""Relative and absolute tolerance of forces. The tolerances follow from the tolerance of accelerations, for boxes of up
to 10 kg."""

SAME_SLIDING_M_S2 = 0.5
"""Tolerance of accelerations where contacts slide. Both sides end their iteration when the reference acceleration of a
pressure is known to 0.1 m/s². The acceleration of a light box depends on that several times over."""

MORE_ITERATIONS = 4
"""By how many iterations a step of mjx-warp may exceed MuJoCo's step. mjx-warp stops at a bound on how much the cost
can still fall, instead of MuJoCo's two tests. The factor of mjx-warp in single precision costs one or two iterations
where contacts are stiff.

Other limits hold for steps in which MuJoCo needs more than ``MANY`` iterations. In such steps, many contacts slide, and
the number of iterations depends on the last digits: with another order of sums, 29 became 31. mjx-warp has forces of
friction as separate unknowns, so all these steps together need at most ``SLIDING_SHARE`` of MuJoCo's iterations. A
single step may need twice as many as MuJoCo's.
"""
MANY, SLIDING_SHARE = 15, 0.8


BRICKS: tuple[Box, ...] = (
    ((300, 200, 150), (0, 0, 0), 5.0),
    ((300, 200, 150), (300, 0, 0), 3.0),
    ((250, 200, 100), (170, 0, 150), 8.0),
    ((150, 150, 120), (230, 20, 250), 0.8),
    ((400, 180, 90), (320, 10, 250), 6.0),
)
"""Two rows of bricks. One light box is between heavy boxes. Another box leans over the edge and tips."""


def take_step(law: SlipLaw, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Take a step of C MuJoCo with the law of sliding contacts."""
    mujoco.mj_step1(model, data)
    law.step2(model, data)


def exact(scene: Scene, physics: Physics) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return C MuJoCo's model of the scene, and data in which all boxes stand at their places.

    Contacts come from the primitive collider that MJX has, too. The solver takes all bodies at once, without islands.
    """
    spec = build_spec(scene, physics)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD | mujoco.mjtDisableBit.mjDSBL_ISLAND
    model = spec.compile()
    data = mujoco.MjData(model)
    poses = data.qpos[7:].reshape(-1, 7)
    poses[:, :3], poses[:, 3:] = scene.frames(scene.start_pos, scene.start_quat), scene.start_quat
    return model, data


PLANS = {
    "bricks": (BRICKS, STEPS),
    "one box": (BRICKS[:1], STEPS[:3]),
    "heap": (heap(), HEAP_STEPS),
    "on boards": (BRICKS, STEPS),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("preset", ["pallet", "reference"])
def test_a_step_as_in_c(preset: str, name: str) -> None:
    physics = PHYSICS[preset].changed(slip_correction=False)  # the correction's excess is known to 0.1 m/s² only
    boxes, steps = PLANS[name]
    # boxes that fall to their places land on something
    scene = build_scene(make_plan(name, boxes), Simulation(physics={"name": preset, "falls_into_place": True}))
    if name == "on boards":
        scene = on_boards(scene)
    model, data = exact(scene, physics)
    step = OneStep(scene, physics)
    compared, many = 0, np.zeros(2)
    for at in range(max(steps) + 1):
        kernel_step = step(data) if at in steps else None
        take_step(SlipLaw(physics), model, data)
        # A contact that barely touches may exist in double precision and not in single precision.
        if kernel_step is None or kernel_step.contacts != data.ncon:
            continue
        compared += 1
        where = f"step {at}"
        assert not kernel_step.flags, where
        acceleration = data.qacc.reshape(-1, 6)
        allowed = SAME_ACCELERATION_M_S2 + SAME_ACCELERATION * np.abs(acceleration)
        assert (np.abs(kernel_step.qacc - acceleration) <= allowed).all(), where
        gained = physics.timestep_s * allowed + SAME_VELOCITY_M_S
        assert (np.abs(kernel_step.qvel - data.qvel.reshape(-1, 6)) <= gained).all(), where
        np.testing.assert_allclose(kernel_step.qpos, data.qpos.reshape(-1, 7), atol=SAME_POSITION, err_msg=where)
        bodies = geom_bodies(model, range(scene.n_boxes))
        forces = top_forces(data, bodies, scene.n_boxes, physics.cone is Cone.PYRAMIDAL)
        np.testing.assert_allclose(kernel_step.force, forces, rtol=SAME_FORCE, atol=SAME_FORCE_N, err_msg=where)
        iterations = int(data.solver_niter[0])
        if physics.cone is Cone.ELLIPTIC and iterations > MANY:
            many += np.array([kernel_step.iterations, iterations])
            assert kernel_step.iterations <= 2 * iterations, where
        else:
            assert kernel_step.iterations <= iterations + MORE_ITERATIONS, where
    assert compared >= len(steps) // 2
    assert many[0] <= SLIDING_SHARE * many[1]
    assert (many[1] > 0) == (preset == "pallet" and name in ("heap", "on boards"))


TILTS = {"edge, 3°": (3.0, 0.0), "edge, 45°": (45.0, 0.0), "corner": (45.0, np.degrees(np.arctan(0.5**0.5)))}


@pytest.mark.slow
def test_a_step_in_which_bricks_slide_and_tip_as_in_c() -> None:
    """Both sides solve the law of sliding contacts (petmjx/world/contact_laws.py) by iteration."""
    physics = PHYSICS["pallet"]
    scene = build_scene(make_plan("bricks", BRICKS), Simulation(physics={"falls_into_place": True}))
    model, data = exact(scene, physics)
    law, step, plain = SlipLaw(physics), OneStep(scene, physics), mujoco.MjData(model)
    errors, corrections = [], []
    for at in range(130):
        kernel_step = step(data) if at >= 100 else None
        plain.qpos, plain.qvel, plain.qacc_warmstart = data.qpos, data.qvel, data.qacc_warmstart
        take_step(law, model, data)
        if kernel_step is not None and kernel_step.contacts == data.ncon:
            mujoco.mj_step(model, plain)
            errors.append(np.abs(kernel_step.qacc - data.qacc.reshape(-1, 6)).max())
            corrections.append(np.abs(plain.qacc - data.qacc).max())
    assert len(errors) > 20
    assert np.median(errors) < SAME_SLIDING_M_S2 < 0.1 * np.median(corrections)


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", TILTS.values(), ids=list(TILTS))
def test_a_box_on_an_edge_or_a_corner_has_the_contacts_of_c(tilt_deg: tuple[float, float]) -> None:
    """The skin of a tilted box reaches further than the box by more than its own thickness.

    One box is on the floor and one on the carrier, which hangs in the air. The boxes are 11 µm above their support or
    20 µm deep in it.
    """
    physics = PHYSICS["pallet"]
    scene = build_scene(make_plan("two", BRICKS[:2]), Simulation())
    model, data = exact(scene, physics)
    step = OneStep(scene, "pallet")
    turn, axes = np.zeros(4), np.zeros(9)
    mujoco.mju_euler2Quat(turn, np.radians([*tilt_deg, 0.0]), "XYZ")
    mujoco.mju_quat2Mat(axes, turn)
    for gap_m in (1.1e-5, -2e-5):
        mujoco.mj_resetData(model, data)
        bodies = data.qpos.reshape(-1, 7)
        bodies[:, 3:] = (1.0, 0.0, 0.0, 0.0)
        bodies[0, :3] = (0.0, 0.0, 3.0)
        top = 3.0 + scene.carrier.half_size[0][2]
        reach = np.abs(axes.reshape(3, 3)[2]) @ scene.half_size.T
        bodies[1, :3], bodies[1, 3:] = (0.0, 4.0, scene.floor_z + reach[0] + gap_m), turn
        bodies[2, :3], bodies[2, 3:] = (0.0, 0.0, top + reach[1] + gap_m), turn
        kernel_step = step(data)
        take_step(SlipLaw(physics), model, data)
        assert kernel_step.contacts == data.ncon
        assert data.ncon >= 2 or (gap_m > 0 and tilt_deg == TILTS["edge, 3°"])
        acceleration = data.qacc.reshape(-1, 6)
        allowed = SAME_ACCELERATION_M_S2 + SAME_ACCELERATION * np.abs(acceleration)
        assert (np.abs(kernel_step.qacc - acceleration) <= allowed).all()


@pytest.mark.parametrize(
    ("changes", "damping"),
    [
        ({}, 2 / (0.999 * 0.004)),
        ({"timestep_s": 0.004}, 2 / (0.999 * 0.008)),  # at least two timesteps, as in MuJoCo
        ({"solreffriction": (-100.0, -300.0)}, 300 / 0.999),
        ({"solreffriction": (0.0, 0.0)}, 0.0),
        ({"cone": "pyramidal"}, 0.0),
    ],
)
def test_damping_of_friction_as_mujoco_has_it(changes: dict[str, Any], damping: float) -> None:
    assert friction_damping(PHYSICS["pallet"].changed(**changes)) == pytest.approx(damping)


def test_sizes_fit_tables_and_thread_blocks() -> None:
    """The size of blocks follows from the width of a table. The C++ code has room for the sums of 8 warps."""
    most = [size.most_boxes for size in block_sizes.SIZES]
    assert most == sorted(most)
    assert most[-1] == block_sizes.MAX_BOXES
    assert all(boxes % GRANULE == 0 for boxes in most)
    assert all(size.threads % 32 == 0 and 64 <= size.threads <= 256 for size in block_sizes.SIZES)
    assert [block_sizes.size_for(n).most_boxes for n in (1, most[0], most[0] + 1, block_sizes.MAX_BOXES)] == [
        *most[:1] * 2,
        *most[1:] * 2,
    ]


def test_compiler_errors_name_the_line_of_the_file() -> None:
    """Each line of C++ is in the source once, with the name of its file and its number there."""
    seen: dict[str, list[tuple[int, str]]] = {}
    name, number = "", 0
    for line in newton.source("newton.cu").splitlines():
        if match := re.fullmatch(r'#line (\d+) "(.+)"', line):
            number, name = int(match[1]), match[2]
        else:
            seen.setdefault(name, []).append((number, line))
            number += 1
    folder = resources.files("petmjx.engines.warp.solver")
    assert set(seen) == {file.name for file in folder.iterdir() if file.name.endswith((".cu", ".cuh"))}
    for name, lines in seen.items():
        text = folder.joinpath(name).read_text(encoding="utf-8")
        numbered_lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if not line.startswith("#include")]
        assert [pair for pair in lines if pair in numbered_lines] == numbered_lines, name
        assert all(line == "" for pair in lines if pair not in numbered_lines for line in pair[1:]), name


def test_a_changed_file_is_compiled_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    def digest() -> bytes:
        return block_launch.kernel(Launch.here(1)).module.get_module_hash(1)

    for name in ("_cpu_kernel", "_kernel_of_features"):  # no other test gets a kernel of the changed file
        monkeypatch.setattr(block_launch, name, getattr(block_launch, name).__wrapped__)
    plain = digest()
    assert digest() == plain
    text = newton.source("newton.cu")
    monkeypatch.setattr(newton, "source", lambda _: text + "// one more line\n")
    assert digest() != plain


@pytest.mark.slow
def test_shared_memory_of_any_size_gives_the_same_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shared memory holds a row of the factor if the row fits, and also the Hessian if both fit. Blocks on a CPU have
    no shared memory. On a CPU, two kernels are compared: one that has all features, and one that is compiled for the
    features of the run."""
    scene = build_scene(make_plan("heap", heap()), Simulation())
    model, data = exact(scene, PHYSICS["pallet"])
    mujoco.mj_step(model, data, HEAP_STEPS[-1])
    here = Launch.here(scene.n_boxes)
    one_tile, some_tiles, all_tiles = (replace(here, shared_words=tiles * PANEL**2) for tiles in (1, 24, 136))
    kernel_steps = []
    # these kernels run only for moments, and take half as long to compile without optimisation
    monkeypatch.setattr("warp.config.optimization_level", 0)
    for one in (one_tile, some_tiles, here) if here.shared_words else (here, all_tiles):
        monkeypatch.setattr(Launch, "here", lambda *_, one=one, **__: one)
        kernel_steps.append(OneStep(scene, "pallet")(data))
    for name, values in vars(kernel_steps[0]).items():
        for other in kernel_steps[1:]:
            np.testing.assert_array_equal(getattr(other, name), values, err_msg=name)
