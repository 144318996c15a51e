"""Signals that end the program: none is lost, and none prints a traceback."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")

ROOT = Path(__file__).resolve().parent.parent

SENTENCE = "lagrange: interrupted; no file was left half written.\n"

START = """\
import os, runpy, signal, sys
from lagrange.cli.interruption import Interruption
signal.signal(signal.SIGHUP, signal.SIG_DFL)
interruption = Interruption()
interruption.listen()
runpy.run_path(sys.argv[1], dict(interruption=interruption), "lagrange.trial")
"""
"""Runs a file as if it were a module of the package: what is not one is other people's code. Tests that run under nohup
ignore SIGHUP, and their children would too."""


def trial(tmp_path: Path, source: str, *signals: int, code: int = 0) -> str:
    """Run code as a module of the package, send it signals after its first line of output, and return its output.

    Its input ends after the signals.
    """
    path = tmp_path / "trial.py"
    path.write_text("import os, signal, sys, time\n" + source)
    program, paths = [sys.executable, "-c", START, str(path)], {**os.environ, "PYTHONPATH": str(tmp_path)}
    pipe = subprocess.PIPE
    with subprocess.Popen(program, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=paths) as process:
        try:
            first = ""
            if signals and process.stdout is not None:
                first = process.stdout.readline()
            for number in signals:
                process.send_signal(number)
            printed, complaint = process.communicate(timeout=300)
        finally:
            process.kill()
    assert (process.returncode, complaint) == (code, "")
    return first + printed


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_raises_with_its_number(tmp_path: Path, number: signal.Signals) -> None:
    source = """
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt as interrupt:
    print(*interrupt.args, interruption.number, interruption.code)
"""
    assert trial(tmp_path, source, number) == f"ready\n{int(number)} {int(number)} {128 + number}\n"


LOST = {
    "a finalizer": """
class Held:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
def lose():
    Held()
""",
    "a callback": """
import weakref
class Held:
    pass
def gone(_):
    os.kill(os.getpid(), signal.SIGINT)
def lose():
    held = Held()
    watched = weakref.ref(held, gone)
    del held
    return watched
""",
}


@pytest.mark.parametrize("where", LOST)
def test_what_gets_lost_is_raised_once_more(tmp_path: Path, where: str) -> None:
    (tmp_path / "foreign.py").write_text("import os, signal\n" + LOST[where])
    source = """
import foreign
try:
    foreign.lose()
    time.sleep(60)
    print("lost")
except KeyboardInterrupt as interrupt:
    print("raised", *interrupt.args)
"""
    assert trial(tmp_path, source) == "raised 2\n"


def test_an_interruption_of_code_given_as_text_is_over_when_it_is_caught(tmp_path: Path) -> None:
    source = """
try:
    exec("os.kill(os.getpid(), signal.SIGTERM)\\nprint(1)")
except KeyboardInterrupt as interrupt:
    print("raised", interrupt.code)
"""
    assert trial(tmp_path, source) == "raised 143\n"


def test_other_people_s_modules_are_imported_whole(tmp_path: Path) -> None:
    (tmp_path / "inner.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nWHOLE = True\n")
    (tmp_path / "foreign.py").write_text("try:\n    import inner\nexcept BaseException:\n    inner = None\n")
    source = """
try:
    import foreign
    time.sleep(60)
    print("lost")
except KeyboardInterrupt as interrupt:
    print("raised", *interrupt.args, sys.modules["foreign"].inner.WHOLE)
"""
    assert trial(tmp_path, source) == "raised 2 True\n"


def test_what_the_program_was_told_to_ignore_stays_ignored() -> None:
    code = "import signal\nfrom lagrange.cli.interruption import Interruption\nInterruption().listen()\n" + (
        "print(*(signal.getsignal(n) is signal.SIG_IGN for n in (signal.SIGHUP, signal.SIGTERM)))"
    )
    program = ["sh", "-c", 'trap "" HUP; exec "$@"', "sh", sys.executable, "-c", code]
    assert subprocess.run(program, capture_output=True, text=True, check=True).stdout == "True False\n"


def test_after_the_end_nothing_is_raised(tmp_path: Path) -> None:
    source = """
interruption.close()
print("ready", flush=True)
sys.stdin.read()
print("done", interruption.number)
"""
    assert trial(tmp_path, source, signal.SIGINT, signal.SIGTERM) == "ready\ndone None\n"


PROGRAM = """\
import os, sys
import lagrange.cli.program, lagrange.__main__
def ends(argv=None):
    try:
        os.kill(os.getpid(), int(sys.argv[1]))
    except KeyboardInterrupt:
        del argv
    raise ImportError("a module is not there")
lagrange.cli.program.main = ends
sys.exit(lagrange.__main__.main())
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (0, 1)])
def test_an_interruption_that_a_library_makes_another_error_of(number: int, code: int) -> None:
    program = [sys.executable, "-c", PROGRAM, str(int(number))]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == SENTENCE if number else done.stderr.endswith("ImportError: a module is not there\n")


def test_the_handler_is_there_before_anything_heavy() -> None:
    code = (
        "import sys\nbefore = set(sys.modules)\nimport lagrange.__main__\n"
        "print(*sorted({'typing', 're', 'argparse', 'pathlib'} & (set(sys.modules) - before)))\n"
        "print(*sorted(name for name in sys.modules if name.startswith('lagrange')))"
    )
    result = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert result.stdout == "\nlagrange lagrange.__main__ lagrange.cli lagrange.cli.interruption\n"
