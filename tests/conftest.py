"""What every test shares: no window opens, random examples repeat, and a default run takes few of many cases."""

import gc
import hashlib
import os
import signal
import sys
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import hypothesis
import joblib
import llvmlite.binding as llvm
import matplotlib as mpl
import pytest
from sympy import Symbol
from sympy.core.function import AppliedUndef

from lagrange.algorithm.series import exported_integrator
from lagrange.machine.llvm import engine
from lagrange.procedure import rewrite
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import Procedure
from lagrange.statement.coordinate import COORDINATES, PARAMETERS
from tests import covering
from tests.procedure.verify import verify

mpl.use("Agg")

# Dozens of processes that tests start import the package. Without what Python keeps, each takes twice as long.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A shell that starts the tests in the background lets them ignore Ctrl-C; what is tested is what a terminal does.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def verified(make: Any) -> Any:
    """Return a function that makes a procedure, followed by a check of the procedure."""

    def checked(*args: Any, **options: Any) -> Procedure:
        made: Procedure = make(*args, **options)
        verify(made)
        return made

    return checked


for owner, maker in ((Builder, "finish"), (rewrite._Binder, "_made"), (exported_integrator, "without_vectors")):
    setattr(owner, maker, verified(getattr(owner, maker)))

# LLVM takes almost half of the processor time of a test run. Most texts that it compiles occurred in the previous run.

ROOM = 500_000_000
"""Bytes in the folder after a run. A default run writes some 60 MB, a run of all cases several times as much."""

compile_text = engine._compiled


def compiled(key: str, text: str, effort: int, passes: Callable[[Any, Any], None] | None) -> bytes:
    """Return the object code of a text. `key` is a hash of all on which it depends; joblib reads no other argument."""
    return compile_text(text, effort, passes)


class KeptCode:
    """A replacement for the function that compiles a text, which reads the code of known texts from a folder.

    The key of a code has the text, the passes, the version of LLVM, the processor, and the source of the engine.
    """

    def __init__(self, folder: Path) -> None:
        self._memory = joblib.Memory(folder, verbose=0)
        self._kept = self._memory.cache(compiled, ignore=["text", "effort", "passes"])
        processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
        self._setting = f"{llvm.llvm_version_info} {processor} {Path(engine.__file__).read_text('utf-8')}"

    def __call__(self, text: str, effort: int, passes: Callable[[Any, Any], None] | None) -> bytes:
        """Return the object code of a text."""
        way = f"{self._setting}\n{effort} {passes and passes.__name__}\n{text}"
        code: bytes = self._kept(hashlib.sha256(way.encode()).hexdigest(), text, effort, passes)
        return code

    def shrink(self) -> None:
        """Remove the least recently used code until the rest fits."""
        self._memory.reduce_size(bytes_limit=ROOM)


EXAMPLES = {True: 100, False: 10}
"""Random examples of a law that says no number of its own, with and without --all."""


def load_profile(*, whole: bool) -> None:
    """Say how examples are drawn. Deadlines measure the machine, not the code: the first call of a kernel compiles."""
    always = bool(os.environ.get("CI"))
    hypothesis.settings.register_profile(
        "tests", deadline=None, max_examples=EXAMPLES[whole], derandomize=always, print_blob=always
    )
    hypothesis.settings.load_profile("tests")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="run every case of every product of parameters")
    parser.addoption("--remaining", action="store_true", help="run what --all has beyond a run without options")
    parser.addoption("--cap", type=float, metavar="S", help="list cases of more than S s that are not marked slow")
    parser.addoption("--conformance", action="store_true", help="export every scene to every target, for an hour")


def pytest_configure(config: pytest.Config) -> None:
    if config.option.all and config.option.remaining:
        raise pytest.UsageError("--all has what --remaining takes: give one of them.")
    covering.ALL = config.option.all or config.option.remaining
    load_profile(whole=covering.ALL)
    if getattr(config.option, "dist", "no") == "load":
        # Each process gets whole files, in their order: models and machine code are made once per file.
        config.option.dist, config.option.loadscopereorder = "loadfile", False
    if config.pluginmanager.has_plugin("cacheprovider"):
        engine._compiled = KeptCode(config.cache.mkdir("object_code"))


@pytest.hookimpl(tryfirst=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    # pytest then looks for garbage five times. One look finds what tests gave up; the rest is kept to the end.
    gc.collect()
    gc.freeze()
    if isinstance(engine._compiled, KeptCode) and not hasattr(config, "workerinput"):
        engine._compiled.shrink()


def chosen_by_hand(config: pytest.Config) -> bool:
    """Whether all cases were asked for, or tests by their names."""
    named = bool(config.option.keyword or any("::" in given for given in config.args))
    return config.option.all or (named and not config.option.remaining)


def pytest_report_header(config: pytest.Config) -> str:
    if chosen_by_hand(config):
        return "cases: all"
    if config.option.remaining:
        return "cases: those that a run without options leaves out, and those that are larger in a run of all"
    return f"cases: {covering.CASES} of each product of parameters, none that is slow; --all takes all"


def larger(item: pytest.Item) -> bool:
    """Return whether a case does more in a run of all: it asks how much, or is a law on examples of Hypothesis."""
    asks = not {"everything", "share"}.isdisjoint(getattr(item, "fixturenames", ()))
    return asks or hypothesis.is_hypothesis_test(getattr(item, "obj", None))


@pytest.fixture(scope="session")
def everything() -> bool:
    """Return whether a test does all that it can. A test that asks runs by default and with --remaining."""
    return covering.ALL


@pytest.fixture(scope="session")
def share() -> covering.Share:
    """Return how often a test repeats what it does in a run of all so many times, with other random numbers."""
    return covering.examples


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.option.conformance:
        left = [item for item in items if item.get_closest_marker("conformance")]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if not item.get_closest_marker("conformance")]
    if chosen_by_hand(config):
        return
    chosen, left = covering.thinned(items)
    if config.option.remaining:
        chosen, left = [*left, *filter(larger, chosen)], [item for item in chosen if not larger(item)]
    config.hook.pytest_deselected(items=left)
    kept = set(chosen)
    items[:] = [item for item in items if item in kept]


def processor_time() -> float:
    """Return the processor time of this process and of those that it started and that have ended, in seconds."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Note the processor time of a case on its report."""
    began = processor_time()
    try:
        return (yield)
    finally:
        item.user_properties.append(("processor time", processor_time() - began))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """List the cases that take longer than --cap says and are not marked slow."""
    if (cap := config.option.cap) is not None:
        reports = [report for report in terminalreporter.getreports("passed") if "slow" not in report.keywords]
        seconds = {report.nodeid: dict(report.user_properties).get("processor time", 0.0) for report in reports}
        above = sorted((time, case) for case, time in seconds.items() if time > cap)[::-1]
        terminalreporter.section(f"{len(above)} cases not marked slow take more than {cap:g} s of processor time")
        for time, case in above:
            terminalreporter.write_line(f"{time:6.2f} s  {case}")


def pytest_collection() -> None:
    """Collect tests without looking for garbage: nearly all that is made then is kept."""
    gc.disable()


@pytest.fixture(autouse=True)
def _declared(request: pytest.FixtureRequest) -> None:
    """Declare the names of the file of each test again, whatever other files and tests declared in this process."""
    coordinates, parameters = names_of(request.module)
    COORDINATES.declare(coordinates)
    PARAMETERS.declare(parameters)


@cache
def names_of(module: ModuleType) -> tuple[list[str], list[str]]:
    """Return the names of the coordinates and of the symbols that a file of tests has."""
    values: dict[Any, None] = {}
    _collect(module, values)
    return (
        [value.name for value in values if isinstance(value, AppliedUndef)],
        [value.name for value in values if isinstance(value, Symbol)],
    )


def _collect(module: ModuleType, values: dict[Any, None]) -> None:
    """Add the coordinates and symbols of a file of tests, after those of the files that it imports from."""
    own = [*vars(module).values()]
    files = dict.fromkeys(value.__module__ for value in own if isinstance(value, (type, FunctionType)))
    for name in files:
        if name.startswith("tests.") and name != module.__name__:
            _collect(sys.modules[name], values)
    values.update(dict.fromkeys(value for value in own if isinstance(value, (AppliedUndef, Symbol))))


OLDEST = 2
"""The last generation of the collector: looking at it is looking at all that is kept."""
LOOKS = [0]
"""How often the collector had looked at everything when a test began."""


@pytest.fixture(autouse=True)
def _spared() -> None:
    """Spare the collector what has outlived a look at everything: shared models, which are never given up.

    It happens between tests, so that what a test makes and gives up is found in it.
    """
    looks = gc.get_stats()[OLDEST]["collections"]
    if looks != LOOKS[0]:
        LOOKS[0] = looks
        gc.freeze()


def pytest_collection_finish() -> None:
    """Spare the collector what is there before the tests and stays: it would walk all of it again and again.

    Tests share models and graphs, which stay too: it looks at them less often than a program without them is used to.
    """
    gc.enable()
    gc.freeze()
    gc.set_threshold(200_000, 20, 20)
