"""Boxes in MuJoCo scenes (MJCF)."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names
from petmjx.plans.box_list import BoxList
from petmjx.plans.known_forms import SCENE, BoxSource
from petmjx.plans.raw_tables import RawTable

NO_BOX: Final = re.compile(r"pallet|palette|carrier|floor|ground|table|deck|wall|robot|gripper", re.IGNORECASE)
"""Words in the names of bodies and meshes. A body or mesh with such a word is not taken for a box."""


def source_of_scene(text: str) -> BoxSource:
    """The boxes of a MuJoCo scene: free bodies whose only colliding geom is a box; bodies without joints if no box is
    free. MuJoCo itself parses the text.

    Raises:
        InputError: MuJoCo cannot parse the text, a free body is not a single box, or there are no boxes. Bodies that
            are named as pallets are ignored.
    """
    import mujoco  # MuJoCo itself interprets all of MJCF: defaults, angles, densities

    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        text = " ".join(str(error).split())
        number = re.search(r"[Ll]ine(?: number)?[ =](\d+)", text)
        line = "" if number is None else f"line {number[1]}: "
        raise InputError(f"{line}is a MuJoCo scene that MuJoCo refuses: {text}") from None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rows, places, pallets = [], [], 0
    other_bodies: list[str] = []
    free_bodies = {
        int(model.jnt_bodyid[joint])
        for joint in range(model.njnt)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    }
    if all(NO_BOX.search(model.body(body).name) for body in free_bodies):
        # boxes without joints, as in a model of a whole load
        jointless = [body for body in range(1, model.nbody) if model.body_jntnum[body] == 0]
        free_bodies |= {body for body in jointless if model.body_geomnum[body]}
    for body in sorted(free_bodies):
        name = model.body(body).name or f"body {body}"
        shapes = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
        solid = [shape for shape in shapes if model.geom_contype[shape] or model.geom_conaffinity[shape]] or list(
            shapes
        )
        if NO_BOX.search(name):
            pallets += 1
            continue
        if len(solid) != 1 or model.geom_type[solid[0]] != mujoco.mjtGeom.mjGEOM_BOX:
            other_bodies.append(name)
            continue
        shape = solid[0]
        size = 2 * model.geom_size[shape]
        matrix = np.eye(4)
        matrix[:3, :3] = data.geom_xmat[shape].reshape(3, 3)
        matrix[:3, 3] = data.geom_xpos[shape]
        rows.append((name, *map(float, size), matrix.tolist(), float(model.body_mass[body])))
        places.append(f"body {name}")
    if other_bodies:
        raise InputError(
            f"is a MuJoCo scene in which these free bodies are not single boxes: {first_names(other_bodies)}"
        )
    if not rows:
        raise InputError("is a MuJoCo scene in which no free body consists of exactly one box geom")
    notes = []
    if pallets:
        notes.append(f"{count_text(pallets, 'body', 'bodies')} named as a pallet or floor left out")
    table = RawTable(("name", "size_x", "size_y", "size_z", "matrix", "mass"), rows, places)
    return BoxSource(BoxList(table, "", ("",) * len(rows)), SCENE, tuple(notes))
