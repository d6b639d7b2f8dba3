"""Arguments of the form NAME=PATH."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name


def named_paths(texts: Sequence[str], option: str) -> dict[str, str]:
    """Split texts of the form NAME=PATH. Returns name → path; an empty dictionary if no text has a name. A text that is
    an existing path counts as a path without a name, even if it contains "=".

    Raises:
        InputError: only some texts have a name, or two texts have the same name.
    """
    name_parts = [text.partition("=") for text in texts if not Path(text).exists()]
    pairs = [(name, path) for name, _, path in name_parts if name and path]
    if pairs and len(pairs) < len(texts):
        raise InputError(f"{option}: give each a name (NAME=PATH), or none")
    names = [name for name, _ in pairs]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise InputError(f"{option} {printable_name(name)}: two entries have this name")
    return dict(pairs)
