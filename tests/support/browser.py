"""Pages in headless Chromium: one browser for all tests of a file. A plugin of pytest (tests/conftest.py)."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

CHROMIUMS = ("chromium", "chromium-browser", "google-chrome")

FLAGS = (
    "--no-sandbox",  # tests may run as root
    "--use-angle=swiftshader",  # WebGL on machines without a graphics card
    "--enable-unsafe-swiftshader",
)

LONGEST_S = 120.0
"""A page that has not done something by then does not do it, on the busiest machine."""

NO_WEBGL = """
const real = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : real.call(this, kind, ...rest);
};
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Playwright's browser. PETMJX_TEST_BROWSER names another one than the Chromium in PATH.

    It closes after each file: while it is open, an event loop runs in this thread, and nothing else can start one.
    """
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra: dev)")
    path = os.environ.get("PETMJX_TEST_BROWSER") or next(filter(None, map(shutil.which, CHROMIUMS)), None)
    if path is None:
        pytest.skip("no Chromium on this machine")
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        yield opened
        opened.close()


@dataclass
class Opened:
    """A page and what it did.

    Attributes:
        page: Playwright's page.
        errors: console errors, warnings and exceptions.
        requests: addresses that it asked for, besides the file itself.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def pixels(self, selector: str = "canvas") -> NDArray[np.uint8]:
        """(height, width, 3) what is seen of an element, and of what lies above it."""
        image = pytest.importorskip("PIL.Image", reason="pillow is not installed (extra: show)")
        shot = self.page.locator(selector).first.screenshot(animations="disabled")
        return np.asarray(image.open(io.BytesIO(shot)).convert("RGB"))

    def until(self, condition: str, seconds: float = LONGEST_S) -> None:
        """Wait until an expression is true. Playwright's own waiting evaluates texts, which the pages' policy forbids.

        Raises:
            AssertionError: it is not true in time.
        """
        for _ in range(round(seconds / 0.02)):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"{condition} is not true after {seconds:g} s")

    def settled(self) -> None:
        """Wait until what was asked for is drawn."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


OpenPage = Callable[..., Opened]


@pytest.fixture
def open_page(browser: Any, tmp_path: Path) -> Iterator[OpenPage]:
    """Opens HTML from a file, as people do: ``open_page(html, width=1280, height=800, dark=False, webgl=True)``.

    ``scripts=False`` turns scripts off, ``fragment`` goes behind the ``#``. Other arguments are those of Playwright's
    ``new_context``.
    """
    contexts = []

    def opened(
        html: str,
        *,
        width: int = 1280,
        height: int = 800,
        dark: bool = False,
        webgl: bool = True,
        scripts: bool = True,
        fragment: str = "",
        **more: Any,
    ) -> Opened:
        context = browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme="dark" if dark else "light",
            java_script_enabled=scripts,
            **more,
        )
        context.set_default_timeout(1000 * LONGEST_S)
        contexts.append(context)
        view = Opened(context.new_page())
        if not webgl:
            view.page.add_init_script(NO_WEBGL)
        file = tmp_path / f"page-{len(contexts)}.html"
        file.write_text(html, encoding="utf-8")
        address = file.as_uri()
        view.page.on(
            "console", lambda message: message.type in ("error", "warning") and view.errors.append(message.text)
        )
        view.page.on("pageerror", lambda error: view.errors.append(str(error)))
        view.page.on("request", lambda request: request.url.startswith(address) or view.requests.append(request.url))
        view.page.goto(address + (f"#{fragment}" if fragment else ""))
        view.page.wait_for_load_state("load")
        return view

    yield opened
    for context in contexts:
        context.close()
