"""A window that shows one picture after another, with Matplotlib (extra ``show``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError


class PictureWindow:
    """A window that opens when the first picture is shown.

    Args:
        title: title of the window.
        pause_s: shortest time for which a picture is visible, s.

    Raises:
        InputError: Matplotlib is missing, or can only draw into files, for example because there is no display.
    """

    def __init__(self, title: str, pause_s: float) -> None:
        try:
            from matplotlib import pyplot
        except ImportError as error:
            raise InputError("render_mode='human' needs matplotlib: pip install 'petmjx[show]'") from error
        import matplotlib
        from matplotlib.backends.registry import BackendFilter, backend_registry

        backend = matplotlib.get_backend()
        registry: Any = backend_registry  # Matplotlib's registry has no type annotations
        if backend.lower() not in registry.list_builtin(BackendFilter.INTERACTIVE):
            raise InputError(f"render_mode='human' needs a window, but Matplotlib's backend {backend} has no windows")
        self._pyplot: Any = pyplot
        self._pause_s = pause_s
        self._figure = pyplot.figure(title, frameon=False)
        self._image: Any = None

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture, (height, width, 3)."""
        if self._image is None:
            axes = self._figure.add_axes((0, 0, 1, 1))
            axes.axis("off")
            self._image = axes.imshow(picture)
        self._image.set_data(picture)
        self._pyplot.pause(self._pause_s)

    def close(self) -> None:
        """Close the window."""
        self._pyplot.close(self._figure)
