"""Scripts and styles of pages. Files of ``petmjx/show/pages/static`` are joined into one script and one style sheet.

Script files are ES modules, so that editors, linters and Node understand them. But modules within one file cannot
import each other. So each module becomes a function that is called once and returns the module's exports.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from importlib.resources import files
from typing import Final

_IMPORT: Final = re.compile(r'^import (\{[^}]*\}|\* as \w+) from "\./(\w+)\.js";$', flags=re.MULTILINE)
_EXPORT: Final = re.compile(r"^export (?=(?:async function|function|const|class) )", flags=re.MULTILINE)
_EXPORTED: Final = re.compile(r"^export (?:async function|function|const|class) (\w+)", flags=re.MULTILINE)


@functools.cache
def static_text(name: str) -> str:
    """The text of a file in ``petmjx/show/pages/static``."""
    return files("petmjx.show.pages").joinpath("static", name).read_text(encoding="utf-8")


def joined_modules(entry: str) -> str:
    """The text of one module that contains a module and all modules that it imports. The exports of ``viewer.js``, for
    example, are then in the object ``viewer_js``.

    Raises:
        ValueError: modules import each other; or an import or export has a form other than ``import {a, b} from
            "./c.js";``, ``import * as c from "./c.js";`` and ``export function``, ``async function``, ``class`` or
            ``const``.
    """
    texts: dict[str, str] = {}
    _gather(entry.removesuffix(".js"), texts, ())
    return "\n".join(texts.values())


def _gather(name: str, texts: dict[str, str], trail: tuple[str, ...]) -> None:
    """Add a module to ``texts``, after the modules that it imports."""
    if name in trail:
        raise ValueError(f"modules import each other: {' → '.join((*trail, name))}")
    if name in texts:
        return
    text = static_text(f"{name}.js")
    for _, imported in _IMPORT.findall(text):
        _gather(imported, texts, (*trail, name))
    body = _EXPORT.sub("", _IMPORT.sub(_object_import, text))
    if left := re.search(r"^(?:import|export)\b.*", body, flags=re.MULTILINE):
        raise ValueError(f"{name}.js: {left[0]!r} cannot be joined")
    texts[name] = f"const {name}_js = (() => {{\n{body}return {{ {', '.join(_EXPORTED.findall(text))} }};\n}})();\n"


def _object_import(imported: re.Match[str]) -> str:
    """The statement that replaces an import: it reads names from the object with the module's exports."""
    return f"const {imported[1].removeprefix('* as ')} = {imported[2]}_js;"


def joined_styles(names: Sequence[str]) -> str:
    """The text of several style sheets, in order."""
    return "\n".join(static_text(name) for name in names)
