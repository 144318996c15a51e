"""Pages in headless Chromium, by Playwright. The browser is the one that the machine has."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")

PATIENCE = 300.0
"""Seconds until something becomes true in a page; what takes longest here is half a second of motion."""


def program() -> str | None:
    """Return the path of the browser, or None if none is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def started() -> Iterator[Browser]:
    """Start the browser, and close it at the end."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program(), args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def opened(browser: Browser, path: Path, width: int = 1280, height: int = 800, *, dark: bool = False) -> Iterator[Tab]:
    """Open a file in a tab of a given size. A narrow tab emulates a phone."""
    phone = width < 600
    context = browser.new_context(
        viewport=ViewportSize(width=width, height=height),
        color_scheme="dark" if dark else "light",
        is_mobile=phone,
        has_touch=phone,
    )
    tab = Tab(context.new_page(), path)
    yield tab
    context.close()


class Tab:
    """An open page. `complaints` are errors and messages of the console, and requests for other files than the page."""

    def __init__(self, page: Page, path: Path) -> None:
        self.page, self.complaints = page, list[str]()
        self._session = page.context.new_cdp_session(page)
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.complaints.extend({request.url} - {path.as_uri()}))
        page.goto(path.as_uri())
        self.wait("typeof lagrange === 'object'")

    def call(self, method: str, **options: Any) -> Any:
        """Send a command of Chromium's DevTools protocol to the page."""
        return self._session.send(method, options)

    def value(self, script: str) -> Any:
        """Return the value of a script as JSON data."""
        return self.page.evaluate(script)

    def wait(self, script: str) -> None:
        """Wait until a script returns a true value. Fails after a time limit."""
        until = time.monotonic() + PATIENCE
        # The policy of the page forbids what Playwright's own function for this would do.
        while not self.value(script):
            assert time.monotonic() < until, f"{script} is not true; complaints: {self.complaints}"
            self.page.wait_for_timeout(10)

    def text(self, selector: str) -> str:
        """Return the text of an element after the next frame is drawn."""
        self.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return str(self.page.locator(selector).text_content())

    def click(self, selector: str, times: int = 1) -> None:
        """Click an element."""
        self.value(f"for (let k = 0; k < {times}; k++) document.querySelector({json.dumps(selector)}).click()")

    def type(self, selector: str, value: float, event: str = "change") -> None:
        """Set the value of an input, as a person does by typing (change) or dragging (input)."""
        result = f"document.querySelector({json.dumps(selector)})"
        self.value(f"{result}.value = {value!r}; {result}.dispatchEvent(new Event('{event}', {{ bubbles: true }}))")

    def press(self, key: str) -> None:
        """Press and release a key."""
        self.page.keyboard.press(key)
