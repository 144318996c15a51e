"""A plugin of pytest for mutants: it records which tests call which functions, and runs selected tests.

    python -m pytest -p tests.mutants.reach --reach FILE --mutated FOLDER ...
    python -m pytest -p tests.mutants.reach --order FILE ...

The first command writes one line of JSON for each test: its name, its seconds, its success, and the functions of the
package that it called, as file:qualified name. The second runs the tests in FILE, in that order, and writes the name of
the running test to FILE.now. A test that takes far longer than FILE says ends the process by the signal SIGPROF. The
limit is in processor time, so that other work on the machine does not count. It also stops endless machine code.
"""

import json
import resource
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

MEMORY = 8 * 2**30
"""Bytes that a process may take."""

LONGER, LEAST = 5.0, 10.0
"""A test may take so many times its time, and so many seconds more: a mutant may cost corrections or steps."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--reach", help="a file for the functions that each test calls")
    parser.addoption("--order", help="a file with the tests to run, in their order, with their seconds")

    parser.addoption("--seconds", type=int, help="the seconds that the process may take")


def pytest_configure(config: pytest.Config) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    if seconds := config.getoption("--seconds"):
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    if config.getoption("--reach"):
        config.pluginmanager.register(Reach(Path(config.getoption("--reach")), config.rootpath), "lagrange-reach")
    if config.getoption("--order"):
        config.pluginmanager.register(Order(Path(config.getoption("--order"))), "lagrange-order")


class Reach:
    """Records the functions that each test calls."""

    def __init__(self, target: Path, root: Path) -> None:
        self.target, self.package = target, str(root / "lagrange") + "/"
        self.skip = len(str(root)) + 1
        self.passed = False

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        called: dict[CodeType, None] = {}

        def note(frame: FrameType, event: str, argument: Any) -> None:
            called[frame.f_code] = None

        self.passed = True
        began = time.process_time()
        sys.settrace(note)
        try:
            result = yield
        finally:
            sys.settrace(None)
        ours = [code for code in called if code.co_filename.startswith(self.package)]
        line = {
            "test": item.nodeid,
            "seconds": round(time.process_time() - began, 3),
            "passed": self.passed,
            "functions": sorted({f"{c.co_filename[self.skip :]}:{_plain(c.co_qualname)}" for c in ours}),
        }
        with self.target.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.passed = self.passed and (report.passed or report.when != "call") and not report.failed


def _plain(name: str) -> str:
    """Return a qualified name without the parts that Python adds for local scopes, such as <locals>."""
    parts = [part for part in name.split(".") if not part.startswith("<")]
    return ".".join(parts)


class Order:
    """Runs the tests that a file names, in its order, each with a time limit."""

    def __init__(self, source: Path) -> None:
        self.seconds: dict[str, float] = json.loads(source.read_text("utf-8"))
        self.now = source.with_suffix(".now")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        place = {test: i for i, test in enumerate(self.seconds)}
        others = [item for item in items if item.nodeid not in place]
        items[:] = sorted((item for item in items if item.nodeid in place), key=lambda item: place[item.nodeid])
        config.hook.pytest_deselected(items=others)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.now.write_text(item.nodeid, encoding="utf-8")
        signal.setitimer(signal.ITIMER_PROF, LEAST + LONGER * self.seconds[item.nodeid])
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
