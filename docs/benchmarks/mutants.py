"""Mutants: one operator, comparison or number of the source changed, and the test that detects it.

    python docs/benchmarks/mutants.py reach          # which tests call which functions: once, and again for new tests
    python docs/benchmarks/mutants.py run            # the mutants
    python docs/benchmarks/mutants.py run --again    # those that survived once more, after tests were added
    python docs/benchmarks/mutants.py page           # out/benchmarks/mutants.md, the table of all mutants

It works on copies of the tree in `--folder` and keeps its verdicts there, so that a stopped run continues. A mutant
whose file has changed runs the test that killed it first.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue

from measure import FOLDER, Page

sys.path.insert(0, str(FOLDER.parents[1]))

from tests.mutants.mutate import Mutant, mutated, sample
from tests.mutants.order import Reached, chosen

ROOT = FOLDER.parents[1]
SEED, COUNT, PROCESSES = 1, 100, 2
BUDGET = 25.0
"""Processor seconds of tests that a mutant meets at most, as they took on the source."""

COPIED = ("lagrange", "tests", "docs", "examples", "pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE")
LEFT_OUT = ("tests/test_house.py", "tests/test_layering.py", "tests/test_documents.py", "tests/mutants/")
"""Tests of the text of the source, which a mutant is not to be seen by, and of mutants."""

BY_CHANCE = ("ctrl_c", "interrupt", "signal", "max_wall", "time_limit", "threads", "microseconds")
"""Parts of the names of tests that depend on what else the machine does: they would see a mutant by chance."""

FIRST = 3
"""From so many files a mutant meets tests before the others are collected."""

LONGEST = 3600
"""Seconds by the clock that tests of a mutant may take, for one that waits for what does not come."""


@dataclass(frozen=True)
class Verdict:
    """What came of a mutant, and by which test: `killed`, `timed out` or `survived`, after how many seconds."""

    name: str
    digest: str
    outcome: str
    test: str
    seconds: float
    tests: int


def digest(text: str) -> str:
    """Return a short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Copy:
    """A copy of the tree, to run tests in."""

    def __init__(self, place: Path) -> None:
        self.place = place.resolve()
        place = self.place
        for name in COPIED:
            source, target = ROOT / name, place / name
            if source.is_dir():
                shutil.rmtree(target, ignore_errors=True)
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", ".hypothesis"))
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, target)
        # What was compiled counts for the text that it was made from, not for the time of a file.
        command = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "lagrange", "tests"]
        subprocess.run(command, cwd=place, check=True)
        if self.meet({"tests/machine/test_linear_systems.py::test_every_size[positive]": 1.0})[0] != "survived":
            raise SystemExit(f"tests do not pass in {place}: see pytest.log there.")

    def pytest(self, arguments: Sequence[str], *, seconds: float | None = None) -> int:
        """Run pytest, for so many seconds of the processor at most, and return its status."""

        command = [sys.executable, "-m", "pytest", "-q", "-x", "--all", "-p", "no:cacheprovider"]
        command += ["-p", "tests.mutants.reach", *([] if seconds is None else ["--seconds", str(seconds)])]
        environment = {**os.environ, "PYTHONPATH": str(self.place), "PYTHONDONTWRITEBYTECODE": "1", "CI": "1"}
        with (self.place / "pytest.log").open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                [*command, *arguments],
                cwd=self.place,
                env=environment,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            try:
                return process.wait(LONGEST)
            except subprocess.TimeoutExpired:
                return -signal.SIGXCPU
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()

    def meet(self, tests: Mapping[str, float]) -> tuple[str, str]:
        """Run tests, until one fails; return what came of them, and the one that failed."""
        order, now = self.place / "order.json", self.place / "order.now"
        order.write_text(json.dumps(tests), encoding="utf-8")
        now.write_text("while tests were collected", encoding="utf-8")
        files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        status = self.pytest(["--order", str(order), *files])
        outcome = {0: "survived", 5: "survived"}.get(status, "killed")
        if status in (-signal.SIGPROF, -signal.SIGXCPU):
            outcome = "timed out"
        return outcome, now.read_text("utf-8") if outcome != "survived" else ""


def copies(folder: Path, count: int) -> SimpleQueue[Copy]:
    """Return so many copies of the tree."""
    queue: SimpleQueue[Copy] = SimpleQueue()
    for i in range(count):
        queue.put(Copy(folder / f"tree{i}"))
    return queue


def each(items: Iterable[object], folder: Path, processes: int, act: Callable[[object, Copy], None]) -> None:
    """Act on each item in some copy of the tree, several at once."""
    free = copies(folder, processes)

    def one(item: object) -> None:
        copy = free.get()
        try:
            act(item, copy)
        finally:
            free.put(copy)

    with ThreadPoolExecutor(processes) as pool:
        list(pool.map(one, items))


# --- which tests call which functions -------------------------------------------------------------------------


def records(folder: Path) -> Path:
    """Return where is kept what tests call."""
    place = folder / "reach"
    place.mkdir(parents=True, exist_ok=True)
    return place


def test_files() -> list[str]:
    """Return the test files, those of the folders that are mutated first."""
    found = [path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "tests").rglob("test_*.py"))]
    near = ("machine", "program", "evidence", "trajectory", "laws", "textbook")
    kept = [file for file in found if not file.startswith(LEFT_OUT)]
    return sorted(kept, key=lambda file: near.index(file.split("/")[1]) if file.split("/")[1] in near else len(near))


def reach(folder: Path, processes: int, seconds: float) -> None:
    """Run each test file for so many processor seconds, and keep which functions its tests call."""
    place = records(folder)

    def one(file: object, copy: Copy) -> None:
        target = place / f"{str(file).replace('/', '_')}.jsonl"
        done, text = target.with_suffix(".done"), digest((ROOT / str(file)).read_text("utf-8"))
        if done.exists() and done.read_text("utf-8") == text:
            return
        target.unlink(missing_ok=True)
        copy.pytest(["--maxfail=1000", "--reach", str(target), str(file)], seconds=seconds)
        done.write_text(text, encoding="utf-8")
        print(file, flush=True)

    each(test_files(), folder, processes, one)


def reached(folder: Path) -> list[Reached]:
    """Return what is known of each test that passes and whose file is there."""
    lines = [json.loads(line) for path in sorted(records(folder).glob("*.jsonl")) for line in path.open()]
    return [
        Reached(line["test"], line["seconds"], frozenset(line["functions"]))
        for line in lines
        if line["passed"]
        and (ROOT / line["test"].partition("::")[0]).exists()
        and not any(part in line["test"] for part in BY_CHANCE)
    ]


# --- mutants --------------------------------------------------------------------------------------------------


def known(folder: Path) -> dict[str, Verdict]:
    """Return the last verdict on each mutant that has one."""
    path = folder / "verdicts.jsonl"
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return {verdict.name: verdict for verdict in (Verdict(**json.loads(line)) for line in lines)}


def judge(
    mutant: Mutant, copy: Copy, source: str, tests: Sequence[Reached], budget: float, before: Verdict | None
) -> Verdict:
    """Let a mutant of a source meet its tests."""
    (copy.place / mutant.file).write_text(mutated(source, mutant), encoding="utf-8")
    began, outcome, test = time.monotonic(), "survived", ""
    selected = chosen(mutant, tests, budget)
    seconds = {one.test: one.seconds for one in tests}
    try:
        if before is not None and before.test in seconds:
            outcome, test = copy.meet({before.test: seconds[before.test]})
        for part in parts(selected):
            if outcome == "survived":
                outcome, test = copy.meet(part)
    finally:
        (copy.place / mutant.file).write_text(source, encoding="utf-8")
    taken = round(time.monotonic() - began, 1)
    return Verdict(mutant.name, digest(source), outcome, test, taken, len(selected))


def parts(tests: Mapping[str, float]) -> list[dict[str, float]]:
    """Return tests as those of the first files, which are few to collect, and the others."""
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))[:FIRST]
    near = {test: seconds for test, seconds in tests.items() if test.partition("::")[0] in files}
    found = [near, {test: seconds for test, seconds in tests.items() if test not in near}]
    return [part for part in found if part]


def run(folder: Path, processes: int, seed: int, count: int, budget: float, *, again: bool, only: str) -> None:
    """Let the mutants of a sample meet their tests, those that have not."""
    found, tests = known(folder), reached(folder)
    taken = [mutant for mutant in sample(ROOT, seed, count) if only in mutant.file]
    # The tree may change while this runs: copies, mutants and sources are those of now.
    sources = {mutant.file: (ROOT / mutant.file).read_text("utf-8") for mutant in taken}

    def is_left(mutant: Mutant) -> bool:
        verdict = found.get(mutant.name)
        if verdict is None or verdict.digest != digest(sources[mutant.file]):
            return True
        return again and verdict.outcome == "survived"

    def one(item: object, copy: Copy) -> None:
        assert isinstance(item, Mutant)
        verdict = judge(item, copy, sources[item.file], tests, budget, found.get(item.name))
        with (folder / "verdicts.jsonl").open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(verdict)) + "\n")
        print(f"{verdict.outcome} after {verdict.seconds} s: {item}  {verdict.test}", flush=True)

    each([mutant for mutant in taken if is_left(mutant)], folder, processes, one)


def confirm(folder: Path, verdicts: Iterable[Verdict]) -> str:
    """Return a test that fails on the source itself, if one that has killed a mutant does."""
    seconds = {one.test: one.seconds for one in reached(folder)}
    tests = {v.test: seconds[v.test] for v in verdicts if v.test in seconds}
    return Copy(folder / "tree0").meet(tests)[1] if tests else ""


def write(folder: Path, seed: int, count: int) -> None:
    """Write the table of all mutants."""
    mutants, found = sample(ROOT, seed, count), known(folder)
    pairs = [(mutant, found[mutant.name]) for mutant in mutants if mutant.name in found]
    failing = confirm(folder, [verdict for _, verdict in pairs])
    if failing:
        raise SystemExit(f"{failing} fails on the source itself: mend it, and run the mutants that it killed again.")
    page = Page("Mutants", __file__)
    outcomes = [verdict.outcome for _, verdict in pairs]
    totals = ", ".join(f"{outcomes.count(name)} {name}" for name in ("killed", "timed out", "survived"))
    page.text(f"**{len(pairs)} mutants of seed {seed}: {totals}.**")
    survivors = [mutant for mutant, verdict in pairs if verdict.outcome == "survived"]
    page.text("## Survivors")
    rows = [(f"`{m.file}:{m.line}`", f"`{m.function}`", cell(m.before), cell(m.after), why(m)) for m in survivors]
    page.table(("place", "function", "was", "became", "why no test sees it"), rows)
    page.text("## All")
    rows = [
        (f"`{m.file.removeprefix('lagrange/')}:{m.line}`", cell(m.before), cell(m.after), v.outcome, cell(v.test))
        for m, v in pairs
    ]
    page.table(("place", "was", "became", "outcome", "by"), rows)
    page.write()


def why(mutant: Mutant) -> str:
    """Return why a mutant changes nothing that a test could see, where that is known."""
    return REASONS.get(mutant.name, "not known")


REASONS = {
    "0095bba9645c": "only the sign of the direction is read",
    "00cf5ec3aa8e": "no operand asks for more than 8, so 8 and 9 print alike",
    "0229ee976038": "no operand asks for more than 8, so 10 and 11 print alike",
    "022a98760f8a": "numbers are spread over the lanes where they are used instead of before the loop: the same bits",
}
"""Why mutants change nothing that a test could see, by their names."""


def cell(text: str) -> str:
    """Return a text as a cell of a table."""
    return f"`{text}`".replace("|", "\\|") if text else ""


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("what", choices=("reach", "run", "list", "page"))
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "mutants", help="where everything is kept")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--processes", type=int, default=PROCESSES)
    parser.add_argument("--budget", type=float, default=BUDGET, help="processor seconds of tests for a mutant")
    parser.add_argument("--again", action="store_true", help="also those that have survived")
    parser.add_argument("--only", default="", help="mutants of files whose path contains this")
    given = parser.parse_args()
    if given.what == "reach":
        reach(given.folder, given.processes, seconds=300)
    elif given.what == "list":
        for mutant in sample(ROOT, given.seed, given.count):
            print(mutant.name, mutant)
    elif given.what == "page":
        write(given.folder, given.seed, given.count)
    else:
        sample_of = (given.folder, given.processes, given.seed, given.count, given.budget)
        run(*sample_of, again=given.again, only=given.only)


if __name__ == "__main__":
    main()
