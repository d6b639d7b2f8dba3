"""``python -m petmjx`` and the installed command ``petmjx``."""

from __future__ import annotations

import sys

from petmjx.cli import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
