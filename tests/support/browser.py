"""Opens pages in headless Chromium, with one browser for all tests of a file. A plugin of pytest
(tests/conftest.py)."""

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
    "--disable-gpu-rasterization",  # only WebGL is drawn by SwiftShader, which is slow
    "--disable-gpu-compositing",
)

READS_BACK = "GPU stall due to ReadPixels"
"""A message of the browser about reading the pixels that WebGL has drawn. The browser itself does this to show them; no
page of petmjx reads pixels."""

LONGEST_S = 120.0
"""Longest wait for a page, s. Even on the busiest machine, a page that needs longer is broken."""

NO_WEBGL = """
const real = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : real.call(this, kind, ...rest);
};
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Playwright's browser. The environment variable PETMJX_TEST_BROWSER names a browser other than the Chromium in
    PATH.

    The browser is closed after each file. While it is open, an event loop runs in this thread, and no other event loop
    can start.
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
    """An open page, and what happened in it.

    Attributes:
        page: Playwright's page.
        errors: errors and warnings of the console, and exceptions.
        requests: addresses that the page requested, except that of the file itself.
    """

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def pixels(self, selector: str = "canvas") -> NDArray[np.uint8]:
        """(height, width, 3) the pixels of an element as a user sees it, including elements that cover it."""
        image = pytest.importorskip("PIL.Image", reason="pillow is not installed (extra: show)")
        shot = self.page.locator(selector).first.screenshot(animations="disabled")
        return np.asarray(image.open(io.BytesIO(shot)).convert("RGB"))

    def until(self, condition: str, seconds: float = LONGEST_S) -> None:
        """Wait until a JavaScript expression is true. Playwright's own waiting evaluates texts, which the pages'
        security policy forbids.

        Raises:
            AssertionError: the expression is not true in time.
        """
        for _ in range(round(seconds / 0.02)):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"{condition} is not true after {seconds:g} s")

    def settled(self) -> None:
        """Wait until all requested drawing is done."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


OpenPage = Callable[..., Opened]


@pytest.fixture(scope="module")
def usual_page(browser: Any) -> Any:
    """A page with default options, which tests use one after another. A new context with its page and processes takes
    0.7 s of CPU time, opening another address in the same page a tenth of that."""
    context = browser.new_context()
    context.set_default_timeout(1000 * LONGEST_S)
    return context.new_page()


@pytest.fixture
def open_page(browser: Any, usual_page: Any, tmp_path: Path) -> Iterator[OpenPage]:
    """Opens HTML from a file, as users do: ``open_page(html, width=960, height=540, dark=False, webgl=True)``.

    ``scripts=False`` turns scripts off, ``fragment`` is added behind ``#``. Other arguments are those of Playwright's
    ``new_context``. A page with one of these arguments has a context of its own, and so has every page of a test except
    the first.
    """
    contexts = []
    views: list[Opened] = []
    listeners: list[tuple[str, Callable[[Any], object]]] = []

    def opened(
        html: str,
        *,
        width: int = 960,
        height: int = 540,
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
