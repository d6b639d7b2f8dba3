"""A scene's model as text, and with boxes as flex bodies."""

from __future__ import annotations

import mujoco

from petmjx.options.physics import Physics
from petmjx.world.model import BOX_COLOURS, HeldCarrier, add_boxes, build_spec
from petmjx.world.scene import Scene
from petmjx.world.soft import add_soft_box, check_soft, set_for_soft, soft_friction

_MEMORY_BYTES = 1 << 24
"""For each box: faces of points have up to a hundred contacts each. The system gives what is used."""


def soft_spec(
    scene: Scene, physics: Physics, held_carrier: HeldCarrier | None = None, n_boxes: int | None = None
) -> mujoco.MjSpec:
    """As ``petmjx.world.model.build_spec``, with soft boxes as flex bodies: 27 bodies each instead of one.

    Raises:
        InputError: as ``check_soft``.
    """
    check_soft(scene)
    count = scene.n_boxes if n_boxes is None else n_boxes
    spec, frictions = build_spec(scene, physics, held_carrier, n_boxes=0), soft_friction(scene)
    rigid: list[int] = []
    for box in range(count):
        if scene.soft is not None and scene.soft[box]:
            sliding, *others = scene.friction[box].tolist()
            sliding = float(frictions.of_boxes[box])
            rgba = BOX_COLOURS[box % len(BOX_COLOURS)]
            add_soft_box(spec, scene, physics, box, (sliding, others[0], others[1]), rgba)
        else:
            add_boxes(spec, scene, physics, [box], before=rigid, held=held_carrier is not None)
            rigid.append(box)
    set_for_soft(spec, scene, physics, frictions)
    spec.memory = _MEMORY_BYTES * (1 + count)
    return spec


def to_mjcf(scene: Scene, physics: Physics) -> str:
    """The scene as MJCF text for MuJoCo's viewer, with every box at its release pose."""
    spec = build_spec(scene, physics) if scene.soft is None else soft_spec(scene, physics)
    spec.modelname = "petmjx"
    spec.worldbody.add_light(pos=[0.0, 0.0, 4.0], dir=[0.0, 0.0, -1.0])
    spec.compile()
    return str(spec.to_xml())
