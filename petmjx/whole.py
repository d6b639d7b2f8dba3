"""Files that users name, written so that they appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from petmjx.checked import reason
from petmjx.errors import InputError
from petmjx.text import printable


@contextmanager
def whole_file(file: Path) -> Iterator[Path]:
    """A hidden path beside a file, with the same ending; what the body writes there takes the file's place.

    Raises:
        InputError: it cannot be written.
    """
    temporary = file.with_name(f".{secrets.token_hex(8)}.{file.name}")
    try:
        yield temporary
        os.replace(temporary, file)
    except OSError as error:
        raise InputError(f"{printable(str(file))}: cannot be written: {reason(error)}") from error
    except InputError as error:  # of what was written, which names the hidden path
        raise InputError(str(error).replace(str(temporary), str(file))) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
