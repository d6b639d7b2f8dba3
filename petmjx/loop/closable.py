"""``Closable``: the base class of objects that hold an engine until they are closed."""

from __future__ import annotations

from petmjx.common.errors import InputError


class Closable:
    """Base class of objects that hold an engine until they are closed. The use of a closed object raises an InputError
    of one line."""

    _is_closed = False

    def _check_open(self) -> None:
        """Raise InputError if the object has been closed."""
        if self._is_closed:
            raise InputError(f"petmjx.{type(self).__name__}: closed; make a new one")
