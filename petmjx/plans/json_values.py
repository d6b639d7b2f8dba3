"""Decodes JSON and JSON lines of other tools (``decoded_json``)."""

from __future__ import annotations

import json
from typing import Any

from petmjx.common.errors import InputError
from petmjx.plans.json_reader import any_integer


class JsonLines(list[Any]):
    """The values of a text in JSON lines.

    Attributes:
        lines: for each value, the number of its line.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[int] = []


def decoded_json(text: str) -> Any:
    """Decode a text that is JSON or JSON lines.

    Raises:
        InputError: the text is neither. The error names the line and the column, but not the file.
    """
    try:
        return _json_value(text)
    except RecursionError:
        raise InputError("not JSON (nested too deeply)") from None
    except json.JSONDecodeError as error:
        lines = [line for line in text.splitlines() if line.strip()]
        if error.msg == "Extra data" and len(lines) > 1 and all(line.lstrip()[:1] in "{[" for line in lines):
            values = JsonLines()
            for number, line in enumerate(text.splitlines(), start=1):
                if not line.strip():
                    continue
                values.lines.append(number)
                try:
                    values.append(_json_value(line))
                except RecursionError:
                    raise InputError(f"not JSON at line {number} (nested too deeply)") from None
                except json.JSONDecodeError as fault:
                    raise InputError(f"not JSON at line {number}, column {fault.colno} ({fault.msg})") from None
            return values
        raise InputError(f"not JSON at line {error.lineno}, column {error.colno} ({error.msg})") from None


def _json_value(text: str) -> Any:
    """Decode JSON. Python refuses whole numbers with thousands of digits; here they become infinite, and a later check
    refuses them as not finite, with their row and column."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        raise
    except ValueError:
        return json.loads(text, parse_int=any_integer)
