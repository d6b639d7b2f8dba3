"""Makes HTML and SVG. Text that is not markup is escaped, so text from a plan or a file can never become markup."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from petmjx.show.pages.html_page import escaped_html


class Markup(str):
    """Text that is markup, and is therefore not escaped."""

    __slots__ = ()


Content = str | Markup | None
"""A child of an element: markup, or text that will be escaped. None means that there is no child."""

NOTHING: Final = Markup("")


def joined_markup(*parts: Content) -> Markup:
    """Parts, joined in order. Parts that are not markup are escaped, and their invisible characters are made
    visible."""
    return Markup(
        "".join(part if isinstance(part, Markup) else escaped_html(part) for part in parts if part is not None)
    )


def element(name: str, *children: Content, **attributes: str | float | None) -> Markup:
    """An element with children and an end tag.

    Args:
        name: name of the element, such as "p".
        attributes: attributes of the element. ``class_`` becomes class, and ``aria_label`` becomes aria-label. An
            attribute with the value None is left out.
    """
    written = "".join(_attribute(key, value) for key, value in attributes.items() if value is not None)
    return Markup(f"<{name}{written}>{joined_markup(*children)}</{name}>")


def _attribute(key: str, value: str | float) -> str:
    text = f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)
    return f' {key.rstrip("_").replace("_", "-")}="{escaped_html(text)}"'


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
