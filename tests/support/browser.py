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
    "--disable-gpu-rasterization",  # SwiftShader, which is slow, draws WebGL alone
    "--disable-gpu-compositing",
)

READS_BACK = "GPU stall due to ReadPixels"
"""A message of the browser, which reads what WebGL has drawn to put it into the page. No page reads pixels."""

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


@pytest.fixture(scope="module")
def usual_page(browser: Any) -> Any:
    """A page without options of its own, which tests use one after the other. A context, a page and the processes that
    belong to it take 0.7 s of CPU time, and another address in a page a tenth of that."""
    context = browser.new_context()
    context.set_default_timeout(1000 * LONGEST_S)
    return context.new_page()


@pytest.fixture
def open_page(browser: Any, usual_page: Any, tmp_path: Path) -> Iterator[OpenPage]:
    """Opens HTML from a file, as people do: ``open_page(html, width=1280, height=800, dark=False, webgl=True)``.

    ``scripts=False`` turns scripts off, ``fragment`` goes behind the ``#``. Other arguments are those of Playwright's
    ``new_context``. Pages with one of these arguments, and all but the first of a test, have a context of their own.
    """
    contexts = []
    views: list[Opened] = []
    listeners: list[tuple[str, Callable[[Any], object]]] = []

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
        size, scheme = {"width": width, "height": height}, "dark" if dark else "light"
        is_usual = webgl and scripts and not more and not views
        if is_usual:
            page = usual_page
            page.set_viewport_size(size)
            page.emulate_media(color_scheme=scheme)
        else:
            context = browser.new_context(viewport=size, color_scheme=scheme, java_script_enabled=scripts, **more)
            context.set_default_timeout(1000 * LONGEST_S)
            contexts.append(context)
            page = context.new_page()
        view = Opened(page)
        views.append(view)
        if not webgl:
            page.add_init_script(NO_WEBGL)
        file = tmp_path / f"page-{len(views)}.html"
        file.write_text(html, encoding="utf-8")
        address = file.as_uri()
        on = {
            "console": lambda message: (
                message.type in ("error", "warning")
                and READS_BACK not in message.text
                and view.errors.append(message.text)
            ),
            "pageerror": lambda error: view.errors.append(str(error)),
            "request": lambda request: request.url.startswith(address) or view.requests.append(request.url),
        }
        for event, listener in on.items():
            page.on(event, listener)
            if is_usual:
                listeners.append((event, listener))
        page.goto(address + (f"#{fragment}" if fragment else ""))
        page.wait_for_load_state("load")
        return view

    yield opened
    for event, listener in listeners:
        usual_page.remove_listener(event, listener)
    for context in contexts:
        context.close()
