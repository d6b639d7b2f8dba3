"""Reads TOML files (``read_toml``)."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Final

from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.safe_read import read_regular
from petmjx.common.text import printable
from petmjx.common.unreadable_files import foreign_kind

MOST_TOML_BYTES: Final = 16 << 20
"""Largest size of a TOML file. As an example, a list of 100,000 time windows with forces takes half of this size."""

_MOST_PARTS: Final = 64
_MANY_PARTS: Final = re.compile(rb"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){%d}""" % _MOST_PARTS)
"""Regular expression that matches a dotted key of TOML with more than ``_MOST_PARTS`` parts. The time that tomllib
needs grows with the square of the number of parts, so a very long key would take minutes."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        InputError: the file cannot be read, or is not TOML ("x.toml: not valid TOML: …").
    """
    try:
        data = read_regular(path, MOST_TOML_BYTES)
    except FileNotFoundError:
        raise InputError(f"{printable(str(path))}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: no file can have this name
        raise InputError(f"{printable(str(path))}: cannot be read: {reason(error)}") from None
    if (kind := foreign_kind(data)) is not None:
        raise InputError(f"{printable(str(path))}: {kind.partition(':')[0]}, not TOML")
    if _MANY_PARTS.search(data):
        raise InputError(f"{path}: not valid TOML: a key has more than {_MOST_PARTS} parts")
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise InputError(f"{path}: not valid TOML: not UTF-8 text") from None
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: lists or tables are nested too deeply") from None
    except ValueError as error:  # tomllib also raises ValueError for a whole number with too many digits
        raise InputError(f"{path}: not valid TOML: {reason(error)}") from None
