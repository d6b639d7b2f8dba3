"""Model templates of open worlds (worlds that grow box by box). A template is compiled once, then filled with boxes.

Compiling a model of 30 boxes takes 2 ms, as long as ten steps, while trying a place for a box takes only a few dozen
steps. All numbers of a filled model that influence a step are the same as in the model that MuJoCo would compile.
"""

from __future__ import annotations

import copy
import threading
from collections import OrderedDict, deque
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.options.physics import Cone, Physics
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.mujoco_model import build_spec, contact_values
from petmjx.world.scene import Scene

_SOLVER = {Solver.NEWTON: mujoco.mjtSolver.mjSOL_NEWTON, Solver.CG: mujoco.mjtSolver.mjSOL_CG}

MOST_KEPT: Final = 64
"""Number of templates that are kept: the most recently used ones. A template of 31 boxes takes 0.2 MB, and each filled
model with its data takes 0.7 MB."""

MOST_SPARE: Final = 16
"""Number of unused models with data that a template keeps for the next worlds: one per thread on most machines."""


class ModelInstance(NamedTuple):
    """The MuJoCo model of a world, with its data."""

    model: mujoco.MjModel
    data: mujoco.MjData


def set_options(model: mujoco.MjModel, sim: Simulation) -> None:
    """Set the options of a model that ``Simulation.physics`` does not contain: the solver and its limits, and switches
    of MuJoCo."""
    model.opt.solver = _SOLVER[sim.solver]
    if sim.solver_iterations is not None:
        model.opt.iterations = sim.solver_iterations
    if sim.solver_tolerance is not None:
        model.opt.tolerance = sim.solver_tolerance
    # MuJoCo would silently reset a world that diverges, but petmjx must notice the divergence.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if sim.physics.cone is Cone.ELLIPTIC:
        # A pallet is one island (a group of bodies connected by contacts), and searching for islands would take 10 % of
        # the time. With pyramidal cones, MuJoCo still searches for islands: the solver's tolerance is relative to each
        # island, and the creep in the preset `reference` depends on this tolerance.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND


class Templates:
    """Model templates, one for each number of boxes and carrier. Several threads may use these templates."""

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._lock = threading.Lock()
        self._by_key: OrderedDict[tuple[object, ...], _Template] = OrderedDict()

    @classmethod
    def of(cls, sim: Simulation) -> Templates | None:
        """The templates for these options; None if models must be compiled. Models must be compiled if boxes have no
        skin (contact margin), since MuJoCo then computes the inertia of the boxes. With pyramidal cones, models must
        also be compiled, since boxes that wait are then part of the model."""
        physics = sim.physics
        return cls(sim) if physics.has_own_friction and physics.skin_m > 0 else None

    def fits(self, scene: Scene) -> bool:
        """Whether all boxes of the scene are rigid and have one shape each. Templates exist only for scenes of this
        kind."""
        return scene.stiffness is None and not scene.pieces

    def filled(self, scene: Scene, order: NDArray[np.intp]) -> ModelInstance:
        """A model with the first boxes of a scene, and data in the initial state.

        Args:
            order: (n,) numbers of the model's boxes in the scene, in the order of the model's bodies.
        """
        key = _key(scene, len(order))
        with self._lock:
            template = self._by_key.get(key)
            if template is not None:
                self._by_key.move_to_end(key)
        if template is None:
            template = _Template(scene, self._sim, len(order))
            with self._lock:
                self._by_key[key] = template
                if len(self._by_key) > MOST_KEPT:
                    self._by_key.popitem(last=False)
        return template.filled(scene, order)

    def give_back(self, filled: ModelInstance, scene: Scene, count: int) -> None:
        """Take back a model and its data that no world uses any more, for use in the next world."""
        with self._lock:
            template = self._by_key.get(_key(scene, count))
        if template is not None:
            template.give_back(filled)


def _key(scene: Scene, count: int) -> tuple[object, ...]:
    """The key of a template: the properties that are equal in all models of this template."""
    carrier = scene.carrier
    arrays = (carrier.pos, carrier.half_size, carrier.shape_pos, carrier.inertia_box)
    return (count, carrier.mass, scene.floor_z, *(values.tobytes() for values in arrays))


class _Template:
    """A compiled model, and unused copies of it."""

    def __init__(self, scene: Scene, sim: Simulation, count: int) -> None:
        self._physics: Physics = sim.physics
        self._count = count
        self._model = build_spec(scene, sim.physics, n_boxes=count).compile()
        set_options(self._model, sim)
        self._spare: deque[ModelInstance] = deque(maxlen=MOST_SPARE)
        model = self._model
        self._first_body = model.nbody - count
        self._first_geom = model.ngeom - count
        self._joints = model.jnt_qposadr[model.body_jntadr[self._first_body :]] if count else np.zeros(0, np.intp)

    def filled(self, scene: Scene, order: NDArray[np.intp]) -> ModelInstance:
        try:
            model, data = self._spare.pop()
        except IndexError:
            model = copy.copy(self._model)
            data = mujoco.MjData(model)
        self._fill(model, scene, order)
        mujoco.mj_setConst(model, data)
        # The terms are added in the order of MuJoCo's compiler, so that the sum is the same to the last digit: the
        # solver's tolerance is relative to it.
        model.stat.meaninertia = sum(model.dof_M0.tolist()) / model.nv
        mujoco.mj_resetData(model, data)
        return ModelInstance(model, data)

    def give_back(self, filled: ModelInstance) -> None:
        self._spare.append(filled)

    def _fill(self, model: mujoco.MjModel, scene: Scene, order: NDArray[np.intp]) -> None:
        """Write all values that depend on boxes and friction into the model. MuJoCo computes the model's other values
        from these."""
        physics, body, geom = self._physics, self._first_body, self._first_geom
        model.opt.gravity[:] = (0.0, 0.0, -physics.gravity_m_s2)
        half = scene.half_size[order] + physics.skin_m
        frames = scene.frames(scene.start_pos, scene.start_quat)[order]
        model.body_pos[body:], model.body_quat[body:] = frames, scene.start_quat[order]
        rows = self._joints[:, None]
        model.qpos0[rows + np.arange(3)] = frames
        model.qpos0[rows + np.arange(3, 7)] = scene.start_quat[order]
        mass = scene.mass[order]
        squares = scene.inertia_boxes[1:][order] ** 2
        model.body_mass[body:] = mass
        model.body_inertia[body:] = mass[:, None] / 3 * (squares.sum(axis=1, keepdims=True) - squares)
        model.geom_size[geom:] = half
        model.geom_pos[geom:] = scene.middle[order]
        model.geom_aabb[geom:, 3:] = half
        model.geom_rbound[geom:] = np.sqrt((half**2).sum(axis=1))
        self._fill_pairs(model, scene, order)

    def _fill_pairs(self, model: mujoco.MjModel, scene: Scene, order: NDArray[np.intp]) -> None:
        """Write the values of contacts, as ``petmjx.world.mujoco_model`` declares them."""
        boards = len(scene.carrier.half_size)
        shapes = scene.shapes
        geoms = np.concatenate([np.arange(boards), boards + order])
        friction = np.vstack([scene.floor_friction, shapes.friction[geoms]])
        surface = np.concatenate([[0], shapes.surface[geoms]])
        model.geom_friction[:] = friction
        values = contact_values(self._physics, scene.pairs, friction, surface, model.pair_geom1, model.pair_geom2)
        for name, rows in values.items():
            getattr(model, f"pair_{name}")[:] = rows
