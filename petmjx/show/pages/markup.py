"""Makes HTML and SVG. Text that is not markup is escaped, so text from a plan or a file can never become markup."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from petmjx.show.pages.html_page import escaped_html as escaped_text


class Markup(str):
    """Text that is markup, and is therefore not escaped."""

    __slots__ = ()


Content = str | Markup | None
"""A child of an element: markup, or text that will be escaped. None means that there is no child."""

NOTHING: Final = Markup("")

_EMPTY: Final = frozenset({"br", "col", "hr", "img", "input", "meta"})
"""HTML elements that have no end tag."""


def escaped_markup(text: str) -> Markup:
    """Text as markup: it is escaped, and invisible characters are made visible. Markup is returned unchanged."""
    return text if isinstance(text, Markup) else Markup(escaped_text(text))


def joined_markup(*parts: Content) -> Markup:
    """Parts, joined in order. Parts that are not markup are escaped."""
    return Markup("".join(escaped_markup(part) for part in parts if part is not None))


def element(name: str, *children: Content, **attributes: str | float | bool | None) -> Markup:
    """An element with children.

    Args:
        name: name of the element, such as "p".
        attributes: attributes of the element. ``class_`` becomes class, and ``aria_label`` becomes aria-label. An
            attribute with the value None or False is left out. An attribute with the value True is written without a
            value.
    """
    written = "".join(_attribute(key, value) for key, value in attributes.items())
    end = "" if name in _EMPTY else f"</{name}>"
    return Markup(f"<{name}{written}>{joined_markup(*children)}{end}")


def _attribute(key: str, value: str | float | bool | None) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    if value is True:
        return f" {name}"
    text = f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)
    return f' {name}="{escaped_text(text)}"'


def table(
    head: Iterable[Content],
    rows: Iterable[Iterable[Content]],
    *,
    caption: str = "",
    texts: int = 1,
    class_: str = "",
) -> Markup:
    """A small table.

    Args:
        caption: title of the table, which screen readers also read.
        texts: number of columns, from the left, that contain text. The other columns contain numbers, which are aligned
            to the right.
        class_: class of the style sheet.
    """
    heads = [element("th", cell, scope="col", class_=_side(at, texts)) for at, cell in enumerate(head)]
    lines = []
    for row in rows:
        first, *other_cells = row
        cells = [element("td", cell, class_=_side(at, texts)) for at, cell in enumerate(other_cells, start=1)]
        lines.append(element("tr", element("th", first, scope="row", class_="text"), *cells))
    inner = element(
        "table",
        element("caption", caption) if caption else None,
        element("thead", element("tr", *heads)),
        element("tbody", *lines),
        class_=class_ or None,
    )
    return element("div", inner, class_="wide")


def _side(at: int, texts: int) -> str | None:
    return "text" if at < texts else None
