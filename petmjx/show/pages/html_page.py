"""Makes one offline HTML page from its parts.

The page contains its styles, scripts and data. Styles and scripts are files in ``petmjx/show/pages/static``. Script
files are ES modules, so that editors, linters and Node understand them.

The page's content security policy forbids the page to request anything else. Texts from plans never become markup:
:func:`escaped_html` escapes them in HTML, :func:`page` escapes them in data, and scripts write them as text.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any, Final

from petmjx.common.text import printable
from petmjx.results.to_json import to_json

_IMPORT: Final = re.compile(r'^import (\{[^}]*\}|\* as \w+) from "\./(\w+)\.js";$', flags=re.MULTILINE)
_EXPORT: Final = re.compile(r"^export (?=(?:async function|function|const|class) )", flags=re.MULTILINE)
_EXPORTED: Final = re.compile(r"^export (?:async function|function|const|class) (\w+)", flags=re.MULTILINE)

_BLOCK_NAME: Final = re.compile(r"[a-z][a-z0-9-]*")


@functools.cache
def static_text(name: str) -> str:
    """The text of a file in ``petmjx/show/pages/static``."""
    return files("petmjx.show.pages").joinpath("static", name).read_text(encoding="utf-8")


def escaped_html(value: object) -> str:
    """A value as text that can be used within HTML, or within a quoted attribute."""
    return html.escape(printable(str(value)))


def filled_template(template: str, **parts: str) -> str:
    """The text of a file in ``petmjx/show/pages/static``, in which names such as ``$title`` are replaced by ``parts``.
    Parts are markup, so the caller must have escaped plain text in them."""
    return Template(static_text(template)).substitute(parts)


def page(
    title: str,
    body: str,
    *,
    script: str,
    styles: Sequence[str] = (),
    info: Mapping[str, Any] | None = None,
    blocks: Mapping[str, str] | None = None,
) -> str:
    """A page as one file.

    The content security policy allows only this script and this style sheet, identified by their hashes, and images
    inside the page. So ``body`` must have no ``style`` attributes and no event handlers; use classes and SVG attributes
    instead.

    Args:
        body: content of the page, as markup.
        script: name of the script's main module in ``petmjx/show/pages/static``. Modules that the main module imports
            are included. If the page has no script, ``script`` is "".
        styles: names of style sheets in the same folder, added after ``base.css``.
        info: plain values, which the script reads with ``readInfo()``.
        blocks: name → arrays, as text from :func:`petmjx.show.pages.page_arrays.block`. The script reads the arrays
            with ``readBlock(name)``.

    Raises:
        ValueError: the name of a block has characters other than lower-case letters, digits and hyphens.
    """
    code, look = joined_modules(script) if script else "", "\n".join(map(static_text, ("base.css", *styles)))
    policy = (
        f"default-src 'none'; script-src {_source(code)}; style-src {_source(look)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    data = [_data_block("info", "application/json", _json(info or {}))]
    for name, text in (blocks or {}).items():
        if not _BLOCK_NAME.fullmatch(name):
            raise ValueError(f"{name!r} cannot be the name of a block")
        data.append(_data_block(f"block-{name}", "application/octet-stream", text))
    return filled_template(
        "page.html", title=escaped_html(title), policy=policy, style=look, body=body, data="\n".join(data), script=code
    )


def _source(text: str) -> str:
    """The entry of a Content-Security-Policy that allows exactly this script or style sheet."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _json(info: Mapping[str, Any]) -> str:
    """JSON that cannot end the HTML element in which it is: ASCII only, and without ``<``, ``>`` and ``&``."""
    text = json.dumps(to_json(info), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _data_block(name: str, kind: str, text: str) -> str:
    return f'<script type="{kind}" id="{name}">{text}</script>'


def joined_modules(entry: str) -> str:
    """The text of one module that contains a module and all modules that it imports.

    Modules within one file cannot import each other. So each module becomes a function that is called once and returns
    the module's exports: the exports of ``viewer.js``, for example, are then in the object ``viewer_js``.

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
