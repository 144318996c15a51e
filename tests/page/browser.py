"""Headless Chromium, controlled by its DevTools protocol over two pipes, without other packages."""

from __future__ import annotations

import itertools
import json
import os
import select
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any, Self

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage"),
    "--remote-debugging-pipe",
)
READS, WRITES = 3, 4
"""The descriptors from which the browser reads commands, and to which it writes answers."""

ANSWER = 300.0
"""Seconds for an answer, beyond which the browser counts as dead: the longest here takes some two."""

ASKED = {"awaitPromise": True, "returnByValue": True, "allowUnsafeEvalBlockedByCSP": False}
"""How scripts are evaluated: as the page's own policy allows."""

PATIENCE = 300.0
"""Seconds until something becomes true in a page; what takes longest here is half a second of motion."""

COMPLAINTS = ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled")


def program() -> str | None:
    """Return the path of the browser, or None if none is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """A browser process with a new profile."""

    def __init__(self) -> None:
        self.folder = tempfile.mkdtemp(prefix="browser-")
        given, self._commands = os.pipe()
        self._answers, taken = os.pipe()
        path = program()
        assert path is not None
        high = [os.dup2(item, item + 20, inheritable=False) for item in (given, taken)]
        actions = [
            (os.POSIX_SPAWN_DUP2, high[0], READS),
            (os.POSIX_SPAWN_DUP2, high[1], WRITES),
            (os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0),
        ]
        arguments = [path, *FLAGS, f"--user-data-dir={self.folder}", "about:blank"]
        self._process = os.posix_spawn(path, arguments, os.environ, file_actions=actions)
        for item in (given, taken, *high):
            os.close(item)
        self._count, self._read = itertools.count(1), b""
        self.events: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.call("Browser.close")
        os.waitpid(self._process, 0)
        os.close(self._commands)
        os.close(self._answers)
        shutil.rmtree(self.folder, ignore_errors=True)

    def call(self, method: str, session: str | None = None, **options: Any) -> Any:
        """Send a command and return its result. Events that arrive meanwhile are stored in `events`."""
        number = next(self._count)
        message = {"id": number, "method": method, "params": options} | ({"sessionId": session} if session else {})
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        until = time.monotonic() + ANSWER
        while b"\0" not in self._read:
            ready, _, _ = select.select([self._answers], [], [], max(0.0, until - time.monotonic()))
            assert ready, f"the browser did not answer for {ANSWER:g} s"
            block = os.read(self._answers, 1 << 16)
            assert block, "the browser has gone"
            self._read += block
        message, _, self._read = self._read.partition(b"\0")
        result: dict[str, Any] = json.loads(message)
        return result

    def open(self, path: Path, width: int = 1280, height: int = 800, *, dark: bool = False) -> Tab:
        """Open a file in a tab of a given size. A narrow tab emulates a phone."""
        return Tab(self, path, width, height, dark=dark)


class Tab:
    """An open page."""

    def __init__(self, browser: Browser, path: Path, width: int, height: int, *, dark: bool) -> None:
        self.browser, self.path, self._first = browser, path, len(browser.events)
        self._target = browser.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = browser.call("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]
        phone = width < 600
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)
        self.call("Emulation.setTouchEmulationEnabled", enabled=phone)
        schemes = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=schemes)
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.navigate", url=path.as_uri())
        self.wait("typeof lagrange === 'object'")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.browser.call("Target.closeTarget", targetId=self._target)

    def call(self, method: str, **options: Any) -> Any:
        """Send a command to the page."""
        return self.browser.call(method, self._session, **options)

    def value(self, script: str) -> Any:
        """Return the value of a script as JSON data."""
        result = self.call("Runtime.evaluate", expression=script, **ASKED)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, script: str) -> None:
        """Wait until a script returns a true value. Fails after an error of the page, or after a time limit."""
        until = time.monotonic() + PATIENCE
        while not self.value(script):
            failed = [item for item in self.complaints() if "exceptionDetails" in item]
            assert not failed and time.monotonic() < until, f"{script} is not true; complaints: {self.complaints()}"
            time.sleep(0.01)

    def text(self, selector: str) -> str:
        """Return the text of an element after the next frame is drawn."""
        self.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return str(self.value(f"document.querySelector({json.dumps(selector)}).textContent"))

    def click(self, selector: str, times: int = 1) -> None:
        """Click an element."""
        self.value(f"for (let k = 0; k < {times}; k++) document.querySelector({json.dumps(selector)}).click()")

    def type(self, selector: str, value: float, event: str = "change") -> None:
        """Set the value of an input, as a person does by typing (change) or dragging (input)."""
        result = f"document.querySelector({json.dumps(selector)})"
        self.value(f"{result}.value = {value!r}; {result}.dispatchEvent(new Event('{event}', {{ bubbles: true }}))")

    def press(self, key: str, code: str | None = None) -> None:
        """Press and release a key."""
        typed = key if len(key) == 1 else ""
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=code or key, text=typed if kind == "keyDown" else ""
            )

    def complaints(self) -> list[str]:
        """Return errors and warnings of the console, and requests for other files than the page."""
        result = []
        for event in self.browser.events[self._first :]:
            given = event.get("params", {})
            if event.get("sessionId") != self._session:
                continue
            if event["method"] in COMPLAINTS:
                result.append(json.dumps(given)[:400])
            if event["method"] == "Network.requestWillBeSent" and given["request"]["url"] != self.path.as_uri():
                result.append(f"asked for {given['request']['url']}")
        return result
