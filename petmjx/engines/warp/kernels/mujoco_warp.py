"""Functions of mujoco_warp, in the copy inside MJX, loaded without the packages around them.

``import mujoco.mjx`` takes 2 to 3 s, and the kernel needs only three files of mujoco_warp. So these three files are
executed under other module names, and import each other under the other names. Because the names differ, Warp keeps
these files apart from the modules of a later ``import mujoco.mjx``.
"""

from __future__ import annotations

import builtins
import importlib.util
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Final

import mujoco

_PACKAGE: Final = "mujoco.mjx.third_party.mujoco_warp._src"

_FOLDER: Final = Path(mujoco.__file__).parents[1].joinpath(*_PACKAGE.split("."))


def _import(
    name: str,
    globals: Mapping[str, object] | None = None,
    locals: Mapping[str, object] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    """As ``builtins.__import__``, but imports of mujoco_warp's files are resolved here."""
    if name == _PACKAGE:
        package = ModuleType(name)
        for member in fromlist or ():
            setattr(package, member, _load(member))
        return package
    if name.startswith(f"{_PACKAGE}."):
        return _load(name.removeprefix(f"{_PACKAGE}."))
    return builtins.__import__(name, globals, locals, fromlist or (), level)


def _load(name: str) -> ModuleType:
    """The module of a file of mujoco_warp. The file is executed only once per process."""
    own_name = f"{__name__}.{name}"
    if own_name in sys.modules:
        return sys.modules[own_name]
    spec = importlib.util.spec_from_file_location(own_name, _FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    vars(module)["__builtins__"] = {**vars(builtins), "__import__": _import}
    sys.modules[own_name] = module  # Warp looks here for the module of a function
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[own_name]
        raise
    return module


_colliders = _load("collision_primitive_core")

box_box = _colliders.box_box
plane_box = _colliders.plane_box
mat83f = _colliders.mat83f
vec8f = _colliders.vec8f
