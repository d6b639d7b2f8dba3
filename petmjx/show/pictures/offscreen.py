"""MuJoCo's renderer without a window: it receives geoms and returns pixels.

``mujoco.Renderer`` uses the OpenGL library that was chosen when mujoco was first imported. But engines import mujoco
long before any picture is drawn. So this module makes an OpenGL context when a picture is drawn. The library is EGL,
unless ``MUJOCO_GL`` names another library.
"""

from __future__ import annotations

import importlib
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.show.pages.palette import Rgb
from petmjx.show.pictures.camera import TANGENT, Camera

CONTEXTS: Final = ("egl", "osmesa", "glfw")
"""Possible values of ``MUJOCO_GL`` on Linux."""

SAMPLES: Final = 4
"""Samples per pixel. Several samples per pixel prevent jagged edges."""

_ADVICE: Final = (
    "install EGL and a driver (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri), "
    "or set MUJOCO_GL=osmesa (libosmesa6), or MUJOCO_GL=glfw where there is a display"
)

_LIGHTS: Final = (
    # (direction, ambient, diffuse) of each light. With these lights, top faces have their true colour, and side faces
    # are darker by different amounts.
    ((0.0, 0.0, -1.0), 0.46, 0.54),
    ((-0.25, 1.0, 0.0), 0.0, 0.36),
    ((-1.0, -0.35, 0.0), 0.0, 0.24),
    ((1.0, 0.1, 0.0), 0.0, 0.18),
    ((0.1, -1.0, 0.0), 0.0, 0.3),
)


class Canvas:
    """Draws pictures of one size, one after another. Use this object in a ``with`` statement, in one thread.

    Args:
        size: width and height of a picture, px.
        line_px: width of boxes' edges, px.
        most_geoms: largest number of geoms in a picture.

    Raises:
        InputError: this machine has no OpenGL that can draw without a display.
    """

    def __init__(self, size: tuple[int, int], line_px: float, most_geoms: int) -> None:
        self.width, self.height = size
        self._gl = _gl_context(size)
        try:
            model = _studio(size, line_px)
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
            self._scene = mujoco.MjvScene(model, maxgeom=most_geoms)
        except Exception as error:
            self._gl.free()
            raise InputError(
                f"OpenGL cannot draw {size[0]} × {size[1]} pixels on this machine ({one_line(error)}): {_ADVICE}"
            ) from error
        self._scene.flags[:] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 1
        self._scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
        for number, (direction, ambient, diffuse) in enumerate(_LIGHTS):
            _shine(self._scene.lights[number], direction, ambient, diffuse)
        self._scene.nlight = len(_LIGHTS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.free()
        self._gl.free()

    def begin(self, camera: Camera) -> None:
        """Begin an empty picture as seen by a camera."""
        self._scene.ngeom = 0
        near, far = camera.depth_m
        for eye in self._scene.camera:
            eye.pos[:], eye.up[:], eye.forward[:] = camera.pos, camera.up, camera.forward
            eye.frustum_near, eye.frustum_far = max(near / 2, 0.01), 4 * far + 20
            eye.frustum_top = eye.frustum_near * TANGENT
            eye.frustum_bottom, eye.frustum_center, eye.frustum_width = -eye.frustum_top, 0.0, 0.0

    def box(self, half_size: FloatArray, pos: FloatArray, turned: FloatArray, rgb: Rgb, alpha: float = 1.0) -> Any:
        """Add a box with half extents (3,), m, a centre (3,), m, and a (3, 3) matrix ``turned``, usually a rotation."""
        return self._geom(mujoco.mjtGeom.mjGEOM_BOX, half_size, pos, turned, (*rgb, alpha))

    def edges(self, half_size: FloatArray, pos: FloatArray, turned: FloatArray, rgb: Rgb) -> None:
        """Add the twelve edges of a box, which is given as in ``box``."""
        self._geom(mujoco.mjtGeom.mjGEOM_LINEBOX, half_size, pos, turned, (*rgb, 1.0)).emission = 1.0

    def arrow(self, start: FloatArray, end: FloatArray, width_m: float, rgb: Rgb) -> None:
        """Add an arrow from ``start`` (3,) to ``end`` (3,), m."""
        geom = self._geom(mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), start, np.eye(3), (*rgb, 1.0))
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, width_m, start, end)

    def pixels(self) -> NDArray[np.uint8]:
        """(height, width, 3) the picture, from its upper left corner."""
        view = mujoco.MjrRect(0, 0, self.width, self.height)
        picture = np.empty((self.height, self.width, 3), dtype=np.uint8)
        self._gl.make_current()
        mujoco.mjr_render(view, self._scene, self._context)
        mujoco.mjr_readPixels(picture, None, view, self._context)
        return picture[::-1]

    def _geom(
        self, kind: mujoco.mjtGeom, size: FloatArray, pos: FloatArray, turned: FloatArray, rgba: tuple[float, ...]
    ) -> Any:
        if self._scene.ngeom >= self._scene.maxgeom:
            raise ValueError(f"more than {self._scene.maxgeom} geoms in a picture")
        geom = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, pos, np.ascontiguousarray(turned).ravel(), np.array(rgba, np.float32))
        geom.specular = geom.shininess = geom.emission = geom.reflectance = 0.0
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        self._scene.ngeom += 1
        return geom


def why_no_pictures() -> str:
    """Why this machine cannot draw pictures; "" if it can."""
    try:
        with Canvas((16, 16), 1.0, 1):
            return ""
    except InputError as error:
        return str(error)


def _gl_context(size: tuple[int, int]) -> Any:
    """An OpenGL context that is current in this thread."""
    name = os.environ.get("MUJOCO_GL", "").strip().lower() or "egl"
    if name not in CONTEXTS:
        raise InputError(f"MUJOCO_GL={name}: pictures are drawn with one of {', '.join(CONTEXTS)}; unset it for egl")
    try:
        with _same_pyopengl_platform(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW warns of problems that also raise an error
            context = importlib.import_module(f"mujoco.{name}").GLContext(*size)
        context.make_current()
    except Exception as error:  # PyOpenGL and drivers may raise almost any exception
        raise InputError(f"OpenGL cannot draw without a display here ({name}: {one_line(error)}): {_ADVICE}") from error
    return context


@contextmanager
def _same_pyopengl_platform() -> Iterator[None]:
    """A context in which the variable ``PYOPENGL_PLATFORM`` may change: its value is restored at the end."""
    before = os.environ.get("PYOPENGL_PLATFORM")
    try:
        yield
    finally:
        os.environ.pop("PYOPENGL_PLATFORM", None)
        if before is not None:
            os.environ["PYOPENGL_PLATFORM"] = before


def _studio(size: tuple[int, int], line_px: float) -> Any:
    """A MuJoCo model without bodies. The model only has what the renderer needs: the size of pictures, the width of
    lines, the number of samples per pixel, and a white sky."""
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.global_.linewidth = line_px
    spec.visual.quality.offsamples = SAMPLES
    spec.stat.extent = 1.0
    white = {name: [1.0, 1.0, 1.0] for name in ("rgb1", "rgb2")}
    kind, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=kind, builtin=flat, width=8, height=8, **white)
    return spec.compile()


def _shine(light: Any, direction: tuple[float, float, float], ambient: float, diffuse: float) -> None:
    """Set up a light that shines from far away."""
    light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    light.dir[:] = np.array(direction) / np.linalg.norm(direction)
    light.ambient[:], light.diffuse[:], light.specular[:] = ambient, diffuse, 0.0
    light.attenuation[:] = (1.0, 0.0, 0.0)
    light.castshadow = light.headlight = 0
