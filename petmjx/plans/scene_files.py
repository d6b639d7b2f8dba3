"""Boxes in scenes: MuJoCo (MJCF), three.js (``Object3D.toJSON``) and glTF. In three.js and glTF, poses are relative to
the object around a box.

Sources of the forms: three.js' JSON object scene format 4 (github.com/mrdoob/three.js/wiki); glTF 2.0
(registry.khronos.org/glTF/specs/2.0).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import blanked, count_text, first_names
from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.known_forms import GLTF, SCENE, THREE_JS, BoxSource
from petmjx.plans.nested_fields import flattened
from petmjx.plans.raw_tables import MOST_ROWS, BoxList, RawTable
from petmjx.plans.turn_columns import bad_member, matrix_of, rotations_of_quaternions

_DEEPEST: Final = 50
"""Largest depth of nested objects that is read."""
_SIZES: Final = ("size_x", "size_y", "size_z")


_NO_NUMBER: Final = re.compile(
    r"""\s(mass|density|size|pos|quat|euler)\s{0,9}=\s{0,9}(?:"\s{0,9}"|'\s{0,9}'|["'][^"'<>]{0,200}?\b(nan)\b)""",
    re.IGNORECASE,
)
"""An attribute without a value, or with a value that is not a number."""
_COMMENT: Final = re.compile(r"<!--.*?-->", re.DOTALL)
_NO_BOX: Final = re.compile(r"pallet|palette|carrier|floor|ground|table|deck|wall|robot|gripper", re.IGNORECASE)
"""Words in the names of bodies and meshes. A body or mesh with such a word is not taken for a box."""


def source_of_scene(text: str) -> BoxSource:
    """The boxes of a MuJoCo scene: the free bodies whose only colliding geom is a box. If no free body is a box, bodies
    without joints are taken. Bodies that are named as pallets are ignored. MuJoCo itself parses the text.

    Raises:
        InputError: MuJoCo cannot parse the text, a free body is not a single box, or there are no boxes.
    """
    import mujoco  # MuJoCo itself interprets all of MJCF: defaults, angles, densities

    plain = _COMMENT.sub(lambda comment: blanked(comment[0]), text)
    # MuJoCo would treat attributes without a number as if they were not given, so they are refused here
    if (bad := _NO_NUMBER.search(plain)) is not None:
        fault = "must be finite, got nan" if bad[2] else "is missing"
        raise InputError(f"line {1 + text.count(chr(10), 0, bad.start(1))}: {bad[1]} {fault}")
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
    if all(_NO_BOX.search(model.body(body).name) for body in free_bodies):
        # no free body is a box: in the model of a whole load, boxes may be bodies without joints
        jointless = [body for body in range(1, model.nbody) if model.body_jntnum[body] == 0]
        free_bodies |= {body for body in jointless if model.body_geomnum[body]}
    for body in sorted(free_bodies):
        name = model.body(body).name or f"body {body}"
        shapes = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
        solid = [shape for shape in shapes if model.geom_contype[shape] or model.geom_conaffinity[shape]] or list(
            shapes
        )
        if _NO_BOX.search(name):
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
        notes.append(f"left out: {count_text(pallets, 'body', 'bodies')} named as a pallet or floor")
    table = RawTable(("name", "size_x", "size_y", "size_z", "matrix", "mass"), rows, places)
    axis = int(np.argmin(model.opt.gravity))  # gravity points downwards
    up = "xyz"[axis] if model.opt.gravity[axis] < 0 else SCENE.up
    return BoxSource(BoxList(table), replace(SCENE, up=up), tuple(notes))


def is_three_js(value: Any) -> bool:
    """Whether a JSON value is a scene of three.js."""
    return (
        isinstance(value, Mapping)
        and isinstance(value.get("object"), Mapping)
        and "type" in value["object"]
        and isinstance(value.get("geometries"), list)
    )


def is_gltf(value: Any) -> bool:
    """Whether a JSON value is a scene in glTF."""
    return (
        isinstance(value, Mapping)
        and isinstance(value.get("asset"), Mapping)
        and isinstance(value.get("nodes"), list)
        and "version" in value["asset"]
    )


class _Scene:
    """Collects the boxes of a scene while the objects of the scene are visited."""

    def __init__(self) -> None:
        self.boxes: list[dict[str, Any]] = []
        self.places: list[str] = []
        self.n_pallets = self.n_others = 0

    def add(self, node: Mapping[str, Any], place: str, pose: FloatArray, size: Sequence[Any] | None, more: Any) -> None:
        """Add an object with a mesh.

        Args:
            pose: (4, 4) matrix of the box's pose; the origin is the middle of the box.
            size: sizes of the box before its matrix scales it; None: the mesh is no box.
            more: further fields of the object, such as its weight.
        """
        name = str(node.get("name") or "")
        if size is None:
            self.n_others += 1
        elif _NO_BOX.search(name):
            self.n_pallets += 1
        else:
            further = flattened(more) if isinstance(more, Mapping) else {}
            sizes = dict(zip(_SIZES, size, strict=True))
            self.boxes.append({"name": name, **sizes, "matrix": pose.tolist(), **further})
            self.places.append(place)
            if len(self.boxes) > MOST_ROWS:
                raise InputError(f"has more than {MOST_ROWS:,} boxes")

    def source(self, form: Any) -> BoxSource:
        """The boxes that were collected, with notes about the meshes that were left out.

        Raises:
            InputError: the scene has no boxes.
        """
        if not self.boxes:
            raise InputError(f"is {form.name} in which no mesh is a box")
        header = tuple(dict.fromkeys(name for box in self.boxes for name in box))
        rows = [tuple(box.get(name) for name in header) for box in self.boxes]
        notes = []
        if self.n_pallets:
            notes.append(f"left out: {count_text(self.n_pallets, 'mesh', 'meshes')} named as a pallet or floor")
        if self.n_others:
            notes.append(f"left out: {count_text(self.n_others, 'mesh that is no box', 'meshes that are no boxes')}")
        return BoxSource(BoxList(RawTable(header, rows, self.places)), form, tuple(notes))


def source_of_three_js(value: Mapping[str, Any]) -> BoxSource:
    """The boxes of a three.js scene: meshes, also instanced ones, whose geometry is a box.

    Raises:
        InputError: the matrix of an object is not a list of 16 numbers, or no mesh is a box.
    """
    geometries = {geometry.get("uuid"): geometry for geometry in value["geometries"] if isinstance(geometry, Mapping)}
    scene = _Scene()
    for node, place, pose in _three_js_objects(value["object"], "object", np.eye(4), 0):
        if not str(node.get("type", "")).endswith("Mesh"):
            continue
        geometry = geometries.get(node.get("geometry"), {})
        is_box = str(geometry.get("type", "")).startswith("Box")
        size = [geometry.get(side, 1) for side in ("width", "height", "depth")] if is_box else None
        for number, instance_pose in enumerate(_instances(node, place)):
            at = place if "instanceMatrix" not in node else f"{place}.instanceMatrix[{number}]"
            scene.add(node, at, pose @ instance_pose, size, node.get("userData"))
    return scene.source(THREE_JS)


def _three_js_objects(
    node: Mapping[str, Any], place: str, around: FloatArray, depth: int
) -> Iterator[tuple[Mapping[str, Any], str, FloatArray]]:
    """Yield (object, path, (4, 4) matrix) for an object and all objects inside it."""
    pose = around @ _matrix_in(node, place)
    yield node, place, pose
    children = node.get("children")
    for number, child in enumerate(children if isinstance(children, list) and depth < _DEEPEST else ()):
        if isinstance(child, Mapping):
            yield from _three_js_objects(child, f"{place}.children[{number}]", pose, depth + 1)


def _matrix_in(node: Mapping[str, Any], place: str) -> FloatArray:
    """(4, 4) matrix of an object relative to the object around it.

    Raises:
        InputError: the matrix is not a list of 16 numbers.
    """
    listed = node.get("matrix")
    if listed is None:
        return np.eye(4)
    matrix = matrix_of(listed)
    if matrix is None or matrix.shape != (4, 4):
        name = f" ({node['name']})" if node.get("name") else ""
        raise InputError(f"{place}{name}: matrix must be 16 numbers{bad_member(listed)}")
    return matrix


def _instances(node: Mapping[str, Any], place: str) -> list[FloatArray]:
    """(4, 4) matrices of the instances of a mesh, relative to the mesh; the unit matrix if it has no instances."""
    instances = node.get("instanceMatrix")
    if not isinstance(instances, Mapping):
        return [np.eye(4)]
    numbers = instances.get("array")
    listed = numbers if isinstance(numbers, list) else []
    count = min(int(node.get("count", len(listed) // 16)), len(listed) // 16)
    return [_matrix_in({"matrix": listed[16 * k : 16 * k + 16]}, f"{place}.instanceMatrix[{k}]") for k in range(count)]


def source_of_gltf(value: Mapping[str, Any]) -> BoxSource:
    """The boxes of a glTF scene: nodes with a mesh. The extents of a mesh are the extents of its positions, as its
    accessor gives them; if the accessor gives none, the mesh is a unit cube.

    Raises:
        InputError: the pose of a node is damaged, or no node has a mesh.
    """
    nodes = value["nodes"]
    inner = {child for node in nodes if isinstance(node, Mapping) for child in node.get("children") or ()}
    scene = _Scene()
    open_nodes = [(index, np.eye(4), 0) for index in reversed(range(len(nodes))) if index not in inner]
    while open_nodes:
        index, around, depth = open_nodes.pop()
        node = nodes[index] if isinstance(index, int) and 0 <= index < len(nodes) else None
        if not isinstance(node, Mapping):
            continue
        place = f"nodes[{index}]"
        pose = around @ _gltf_pose(node, place)
        if "mesh" in node:
            low, high = _extents(value, node["mesh"])
            middle = np.eye(4)
            middle[:3, 3] = (low + high) / 2
            scene.add(node, place, pose @ middle, (high - low).tolist(), node.get("extras"))
        if depth < _DEEPEST:
            open_nodes += [(child, pose, depth + 1) for child in reversed(node.get("children") or ())]
    return scene.source(GLTF)


def _gltf_pose(node: Mapping[str, Any], place: str) -> FloatArray:
    """(4, 4) matrix of a node relative to the node around it.

    Raises:
        InputError: a number of the pose is bad.
    """
    if "matrix" in node:
        return _matrix_in(node, place)
    pose = np.eye(4)
    parts = []
    for field, usual in (("translation", (0, 0, 0)), ("rotation", (0, 0, 0, 1)), ("scale", (1, 1, 1))):
        numbers = [cell_number(cell) for cell in node.get(field, usual)]
        if len(numbers) != len(usual) or any(number is None or not math.isfinite(number.value) for number in numbers):
            name = f" ({node['name']})" if node.get("name") else ""
            bad = bad_member(node.get(field, usual))
            raise InputError(f"{place}{name}: {field} must be {len(usual)} numbers{bad}")
        parts.append(np.array([number.value for number in numbers if number is not None]))
    translation, rotation, scale = parts
    pose[:3, :3] = rotations_of_quaternions(rotation[None, [3, 0, 1, 2]])[0] * scale
    pose[:3, 3] = translation
    return pose


def _extents(value: Mapping[str, Any], mesh: Any) -> tuple[FloatArray, FloatArray]:
    """The smallest and the largest coordinates of a mesh; those of a unit cube if the file does not give them."""
    cube = np.full(3, -0.5), np.full(3, 0.5)
    try:
        accessors = [
            value["accessors"][primitive["attributes"]["POSITION"]] for primitive in value["meshes"][mesh]["primitives"]
        ]
        low = np.min([accessor["min"] for accessor in accessors], axis=0).astype(float)
        high = np.max([accessor["max"] for accessor in accessors], axis=0).astype(float)
    except (KeyError, IndexError, TypeError, ValueError):
        return cube
    return (low, high) if low.shape == high.shape == (3,) and bool((high > low).all()) else cube
