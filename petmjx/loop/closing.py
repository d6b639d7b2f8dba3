"""Objects that hold an engine until they are closed."""

from __future__ import annotations

from petmjx.basics.errors import InputError


class Closable:
    """Says so in one line when it is used after it has been closed."""

    _is_closed = False

    def _check_open(self) -> None:
        """Raises InputError: it has been closed."""
        if self._is_closed:
            raise InputError(f"petmjx.{type(self).__name__}: closed; make a new one")
