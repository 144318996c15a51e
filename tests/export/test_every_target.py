"""Awkward names are allowed with every registered target."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shutil
from collections.abc import Iterator, Sequence
from itertools import cycle, islice
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.export.languages import c, fortran, javascript, julia, octave, python, rust
from lagrange.export.target import find
from tests.export.callers import run
from tests.export.systems import named

STRICT = {
    "cc -std=c99": "cc -std=c99 -Wall -Wextra -Wconversion -Werror",
    "gfortran": "gfortran -Wall -Wextra -Werror",
    "rustc": "rustc -D warnings",
    "python": "python -W error",
}
"""What makes warnings errors, by how a command begins."""

PACKAGES = {"jax": "jax", "casadi": "casadi"}
"""What a target needs of Python, beside NumPy."""


def missing(target: str, commands: Sequence[str] = ()) -> str:
    """Return the reason why a target cannot be tested here, or an empty text."""
    package = PACKAGES.get(target)
    if package and importlib.util.find_spec(package) is None:
        return f"{package} is not installed"
    words = [command.split()[0] for command in commands]
    return next((f"{word} is not installed" for word in words if not word.startswith("./") and not found(word)), "")


def found(word: str) -> bool:
    return word == "python" or shutil.which(word) is not None


def strict(command: str) -> str:
    """Return a command whose warnings are errors."""
    plain = next((item for item in STRICT if command.startswith(f"{item} ")), "")
    return command.replace(plain, STRICT[plain], 1) if plain else command


def passes(target: str, system: lg.System, folder: Path) -> None:
    """Export a system, and run its test without warnings."""
    steps = ["rk4"] if "steps" in find(target).contents else []
    made = system.export(target, folder, ["rhs", "energy", *steps])
    why = missing(target, made.commands)
    if why:
        pytest.skip(why)
    said = [run(strict(command), folder) for command in made.commands][-1]
    assert re.search(r"(\d+) of \1 results are right\n$", said), said


WORDS = (
    *("x0", "x1", "x2", "lam1", "_t", "t_", "t1", "dt", "θ", "θ1", "theta", "ω2", "Ω", "ψ", "φ", "ε", "λ1", "Δ", "π1"),
    *("a" * 63, "a" * 64, "b" * 62, "m", "M", "y", "Y", "p", "P", "out", "out_at", "q", "v", "h", "rhs", "energy"),
    *("prepare", "main", "test", "results", "singular", "inf", "nan", "jnp", "ca", "jax", "np", "pi", "e", "j", "I"),
    *("a1", "A1", "a_1", "a__1", "M_PI", "NULL", "errno", "stdin", "model", "equation", "der", "time", "parameter"),
    *(f"{stem}{k}" for stem in ("x", "lam", "y", "p", "t", "s", "f", "r") for k in range(20)),
    *keyword.kwlist,
    *c.RESERVED,
    *fortran.RESERVED,
    *javascript.RESERVED,
    *julia.RESERVED,
    *octave.RESERVED,
    *python.RESERVED,
    *rust.RESERVED,
)
TITLES = ("while", "θ", "a" * 64, "end", "math", "numpy", "class", "program", "stdio", "Main", "x0", "lambda", "julia")
AT_ONCE, COORDINATES = 250, 8


def awkward() -> Iterator[str]:
    """Return words, in several cases, as names of coordinates and parameters."""
    cases = dict.fromkeys(item for word in WORDS for item in (word, word.capitalize(), word.upper()))
    return (word for word in cases if accepted(word))


def accepted(word: str) -> bool:
    """Return True if a statement accepts a word as a name."""
    try:
        named([word], ["g"] if word != "g" else ["k"])
    except lg.StatementError:
        return False
    return True


def systems(at_once: int) -> Iterator[lg.System]:
    """Yield systems with awkward names, all of which are used."""
    words, titles = awkward(), cycle(TITLES)
    while some := [*islice(words, at_once)]:
        yield named(some[:COORDINATES], some[COORDINATES:], next(titles))


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "target", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("fmu", "jax"))) for name in lg.targets()]
)
def test_awkward_names(target: str, tmp_path: Path) -> None:
    passes(target, next(systems(60)), tmp_path)


@pytest.mark.conformance
@pytest.mark.parametrize("target", list(lg.targets()))
def test_more_than_a_thousand_awkward_names(target: str, tmp_path: Path) -> None:
    count = 0
    for k, system in enumerate(systems(AT_ONCE)):
        (tmp_path / str(k)).mkdir()
        passes(target, system, tmp_path / str(k))
        count += len(system.coordinates) + len(system.parameters)
    assert count >= 1500
