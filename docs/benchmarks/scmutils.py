"""Accelerations of scenes against scmutils, which derives them from the same Lagrangians in MIT Scheme.

python docs/benchmarks/scmutils.py

Needs the Debian packages mit-scheme and scmutils. A scene's Lagrangian becomes a function of a local tuple, scmutils'
`Lagrangian->acceleration` differentiates and solves it, and both are evaluated at the same random states.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import sympy
from measure import Page, verdict

import lagrange as lg

SCENES = (
    *("bead-on-hoop", "chain-of-springs", "charge-in-field", "double-pendulum", "elastic-pendulum", "henon-heiles"),
    *("kepler", "pendulum", "pleiades", "rock", "spherical-pendulum", "sun-earth-moon"),
)
"""The scenes without constraints and without forces besides the potential."""

STATES = 10
BAR = 1e-12
"""Largest difference relative to the largest acceleration of the state: rounding of some hundred operations."""

NAMES = {"atan2": "atan", "Abs": "abs"}
"""Functions that Scheme calls otherwise."""


def scheme(expression: Any, symbols: Mapping[Any, str]) -> str:
    """Return an expression as Scheme writes it; numbers are exact or have all their digits."""
    if expression in symbols:
        return symbols[expression]
    if expression is sympy.pi:
        return ":pi"
    if expression.is_Rational:
        return str(expression)
    if expression.is_Float:
        return repr(float(expression))
    parts = " ".join(scheme(one, symbols) for one in expression.args)
    if expression.is_Add or expression.is_Mul:
        return f"({'+' if expression.is_Add else '*'} {parts})"
    if expression.is_Pow:
        root = expression.exp == sympy.Rational(1, 2)
        return f"(sqrt {scheme(expression.base, symbols)})" if root else f"(expt {parts})"
    name = type(expression).__name__
    return f"({NAMES.get(name, name)} {parts})"


def program(system: lg.System, states: np.ndarray) -> str:
    """Return the Scheme text that prints the accelerations of a system at some states, one line each."""
    statement = system.statement
    n = len(statement.names)
    single = n == 1
    symbols = {lg.t: "(time s)"}
    for i, (q, v) in enumerate(zip(statement.coordinates, statement.velocities, strict=True)):
        symbols[q] = "(coordinate s)" if single else f"(ref (coordinate s) {i})"
        symbols[v] = "(velocity s)" if single else f"(ref (velocity s) {i})"
    symbols |= {p: repr(float(value)) for p, value in statement.defaults.items()}
    lines = [
        f"(define (L s) {scheme(statement.lagrangian, symbols)})",
        "(define a (Lagrangian->acceleration L))",
    ]
    for state in states:
        q, v = (" ".join(map(repr, map(float, half))) for half in (state[:n], state[n:]))
        local = f"(up 0.3 {q} {v})" if single else f"(up 0.3 (up {q}) (up {v}))"
        lines.append(f"(newline) (display (a {local}))")
    return "\n".join([*lines, "(newline) (exit 0)"])


def by_scmutils(system: lg.System, states: np.ndarray) -> np.ndarray:
    """Return the accelerations at each state, (states, n)."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.scm"
        path.write_text(program(system, states), encoding="utf-8")
        command = ["mit-scheme", "--quiet", "--band", "mechanics.com", "--load", str(path)]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=600, check=False, stdin=subprocess.DEVNULL
        )
    rows = [re.findall(r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?", line) for line in done.stdout.splitlines() if line.strip()]
    found = np.array([[float(x) for x in row] for row in rows])
    if found.shape != (len(states), states.shape[1] // 2):
        raise SystemExit(f"{system.name}: scmutils answered {done.stdout[:300]!r}")
    return found


def installed(package: str) -> str:
    """Return the version of a Debian package."""
    command = ["dpkg-query", "--show", "--showformat=${Version}", package]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def difference(name: str) -> tuple[int, float]:
    """Return the coordinates of a scene, and the largest difference of its accelerations."""
    system = lg.scene(name)
    n = len(system.statement.names)
    start = np.array(system.statement.initial)
    scale = np.maximum(np.abs(start), 0.1 * np.abs(start).max(initial=1.0))
    states = start + 0.2 * scale * np.random.default_rng(1).normal(size=(STATES, 2 * n))
    model = system.compile()
    ours = np.array([model.accelerations(state[:n], state[n:], 0.3) for state in states])
    theirs = by_scmutils(system, states)
    return n, float((np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1)).max())


def main() -> None:
    """Compare all scenes and write the page."""
    page = Page("Against scmutils", __file__)
    rows = []
    for name in SCENES:
        n, found = difference(name)
        rows.append((f"`{name}`", n, f"{found:.1e}", verdict(found, BAR)))
        print(*rows[-1])
    page.table(("scene", "coordinates", "difference", f"within {BAR:g}"), rows)
    page.write()


if __name__ == "__main__":
    main()
