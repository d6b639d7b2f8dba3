"""Imports ``mujoco.mjx`` without its message and, in the command ``petmjx``, without Warp.

If Warp is not installed, MJX prints a message to standard output (MuJoCo 3.17: in ``mujoco/mjx/warp/__init__.py``). The
engine mjx-jax does not need Warp, and a program may read standard output as JSON.

If Warp is installed, MJX imports Warp with all its kernels. Importing Warp with its kernels takes 1.7 s of the 2.7 s
that the import of MJX takes. A process that runs only the command ``petmjx`` does not need these kernels. In other
processes, the user's code might use MJX with Warp later.
"""

from __future__ import annotations

import importlib
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

from petmjx.common.processes import is_command

_PRINTS = "mujoco.mjx.warp"
_WARP = ("warp", "mujoco.mjx.third_party.mujoco_warp")


class _SilentLoader(SourceFileLoader):
    """Imports a module in which ``print`` does nothing during the import."""

    def exec_module(self, module: ModuleType) -> None:
        module.__dict__["print"] = lambda *_, **__: None
        try:
            super().exec_module(module)
        finally:
            del module.__dict__["print"]


class _SilentFinder(MetaPathFinder):
    """An import finder for a single module: the module that prints the message. ``hides_warp``: whether Warp counts as
    not installed.
    """

    def __init__(self, hides_warp: bool) -> None:
        self._hides_warp = hides_warp

    def find_spec(self, fullname: str, path: Any, target: ModuleType | None = None) -> ModuleSpec | None:
        if self._hides_warp and fullname in _WARP:
            raise ModuleNotFoundError(fullname)
        # importlib passes a list of folders or an iterable of a private type, so ``path`` is declared as Any
        spec = PathFinder.find_spec(fullname, path) if fullname == _PRINTS else None
        if spec is None or not isinstance(spec.loader, SourceFileLoader):
            return None
        spec.loader = _SilentLoader(fullname, spec.loader.path)
        return spec


def _import_mjx() -> Any:
    finder = _SilentFinder(is_command() and "warp" not in sys.modules)
    sys.meta_path.insert(0, finder)
    try:
        return importlib.import_module("mujoco.mjx")
    finally:
        sys.meta_path.remove(finder)


mjx = _import_mjx()
