"""Each method against its formula and its claims: order, symplecticity, symmetry, energy, and where it is refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.integrate

from lagrange.trajectory.methods.explicit import RungeKutta
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.splitting import KAHAN_LI, YOSHIDA6
from lagrange.trajectory.tableaux.butcher import ButcherTableau
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, k, m, model, x, y
from tests.trajectory.runs import ADAPTIVE, EQUAL, MOMENTA, SPLITTINGS, STEPPED, exact, run, stepped

Rhs = Callable[[float, Any], Any]
Step = Callable[[Rhs, float, Any, float], Any]

EXPLICIT = tuple(name for name in STEPPED if find(name).claims.explicit)


# --- formulas, written out again ------------------------------------------------------------------------------


def euler(f: Rhs, t: float, y: Any, h: float) -> Any:
    return y + h * f(t, y)


def midpoint(f: Rhs, t: float, y: Any, h: float) -> Any:
    return y + h * f(t + h / 2, y + h / 2 * f(t, y))


def rk4(f: Rhs, t: float, y: Any, h: float) -> Any:
    a = f(t, y)
    b = f(t + h / 2, y + h / 2 * a)
    c = f(t + h / 2, y + h / 2 * b)
    d = f(t + h, y + h * c)
    return y + h / 6 * (a + 2 * b + 2 * c + d)


def heun(f: Rhs, t: float, y: Any, h: float) -> Any:
    first = f(t, y)
    return y + h / 2 * (first + f(t + h, y + h * first))


def bs3(f: Rhs, t: float, y: Any, h: float) -> Any:
    a = f(t, y)
    b = f(t + h / 2, y + h / 2 * a)
    c = f(t + 3 * h / 4, y + 3 * h / 4 * b)
    return y + h / 9 * (2 * a + 3 * b + 4 * c)


def by_tableau(tableau: ButcherTableau) -> Step:
    """Return the step of a tableau with many digits, which its order conditions hold to them."""

    def step(f: Rhs, t: float, y: Any, h: float) -> Any:
        slopes: list[Any] = []
        for row, c in zip(tableau.A, tableau.c, strict=True):
            slopes.append(f(t + float(c) * h, y + h * sum(float(a) * s for a, s in zip(row, slopes, strict=True))))
        return y + h * sum(float(b) * s for b, s in zip(tableau.b, slopes, strict=True))

    return step


def by_scipy(solver: Any) -> Step:
    def step(f: Rhs, t: float, y: Any, h: float) -> Any:
        slopes: list[Any] = []
        for row, c in zip(solver.A, solver.C, strict=True):
            slopes.append(
                f(t + c * h, y + h * sum((a * s for a, s in zip(row, slopes, strict=False)), np.zeros(len(y))))
            )
        return y + h * sum(b * s for b, s in zip(solver.B, slopes, strict=True))

    return step


def symplectic_euler(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    v = y[n:] + h * f(t, y)[n:]
    return np.concatenate([y[:n] + h * v, v])


def symplectic_euler_b(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    q = y[:n] + h * y[n:]
    return np.concatenate([q, y[n:] + h * f(t + h, np.concatenate([q, y[n:]]))[n:]])


def velocity_verlet(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    q = y[:n] + h * y[n:] + h * h / 2 * f(t, y)[n:]
    force = f(t, y)[n:] + f(t + h, np.concatenate([q, y[n:]]))[n:]
    return np.concatenate([q, y[n:] + h / 2 * force])


def verlet(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    middle = y[:n] + h / 2 * y[n:]
    v = y[n:] + h * f(t + h / 2, np.concatenate([middle, y[n:]]))[n:]
    return np.concatenate([middle + h / 2 * v, v])


def leapfrog(f: Rhs, t: float, y: Any, h: float) -> Any:
    """The velocity at t + h/2, from which the coordinates leap, and its half of the next kick."""
    n = len(y) // 2
    between = y[n:] + h / 2 * f(t, y)[n:]
    q = y[:n] + h * between
    return np.concatenate([q, between + h / 2 * f(t + h, np.concatenate([q, between]))[n:]])


def ruth3(f: Rhs, t: float, y: Any, h: float) -> Any:
    n = len(y) // 2
    q, v, now = y[:n], y[n:], t
    for kick, drift in ((7 / 24, 2 / 3), (3 / 4, -2 / 3), (-1 / 24, 1)):
        v = v + kick * h * f(now, np.concatenate([q, v]))[n:]
        q, now = q + drift * h * v, now + drift * h
    return np.concatenate([q, v])


def composed(step: Step, outer: tuple[float, ...]) -> Step:
    """Return steps of symmetric sizes, one after the other."""

    def composition(f: Rhs, t: float, y: Any, h: float) -> Any:
        for part in (*outer, 1 - 2 * sum(outer), *reversed(outer)):
            y, t = step(f, t, y, part * h), t + part * h
        return y

    return composition


FORMULAS: dict[str, Step] = {
    "euler": euler,
    "midpoint": midpoint,
    "rk4": rk4,
    "dopri5": by_scipy(scipy.integrate.RK45),
    "dop853": by_scipy(scipy.integrate.DOP853),
    "heun": heun,
    "bs3": bs3,
    "symplectic-euler": symplectic_euler,
    "symplectic-euler-b": symplectic_euler_b,
    "verlet": verlet,
    "velocity-verlet": velocity_verlet,
    "leapfrog": leapfrog,
    "ruth3": ruth3,
    "forest-ruth4": composed(verlet, (1 / (2 - 2 ** (1 / 3)),)),
    "yoshida6": composed(verlet, YOSHIDA6),
    "composition8": composed(verlet, KAHAN_LI),
}


def driven() -> Any:
    """A system that every method may run: constant mass matrix, forces of position and time."""
    from sympy import cos, sin

    from lagrange.statement.coordinate import t

    return {
        "kinetic": m * (x.dot**2 + x.dot * y.dot + y.dot**2) / 2,
        "potential": k * x**2 / 2 + sin(x * y) + y**4 / 4,
        "forces": {x: cos(3 * t), y: -x * sin(t)},
        "coordinates": [x, y],
        "initial": {x: 0.7, y: -0.4, x.dot: 0.2, y.dot: 0.5},
    }


def formula(name: str) -> Step:
    """Return the formula of a step, of a tableau without one by hand as any textbook writes it."""
    method = find(name)
    written = FORMULAS.get(name)
    return by_tableau(method.tableau) if written is None and isinstance(method, RungeKutta) else FORMULAS[name]


def test_no_formula_stands_here_without_its_method() -> None:
    assert set(FORMULAS) <= set(EXPLICIT)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", EXPLICIT)
def test_steps_follow_the_formula(name: str, target: str) -> None:
    compiled = build(target, **driven())
    h, count = 0.05, 12
    found = run(compiled, 0.3 + count * h, stepped(name, h), start=0.3)
    step, state = formula(name), np.array(compiled.statement.initial)
    for i in range(count):
        assert found.t[i] == pytest.approx(0.3 + i * h, abs=1e-15)
        assert found.y[:, i] == pytest.approx(state, rel=1e-12, abs=1e-13)
        state = step(compiled.rhs, 0.3 + i * h, state, h)
    assert found.y[:, -1] == pytest.approx(state, rel=1e-12)
    assert found.steps == count and found.rejected == 0


# --- claims ---------------------------------------------------------------------------------------------------


SEPARABLE = {"Henon-Heiles": 3.0, "pendulum": 1.0}
GENERAL = {"cart and pole": 1.2, "double pendulum": 0.5}
COUNTS = tuple(round(4 * 2 ** (i / 2)) for i in range(18))
"""Numbers of steps, from 4 to 1448, by factors of the square root of 2."""
FLOOR = 3e-11
"""Errors below this are left out: round-off, some 1e-14, would move a measured order by a tenth where they double."""


@pytest.mark.parametrize("name", [name for name in STEPPED if find(name).claims.order <= 4])
def test_the_observed_order_is_the_claimed_one(name: str) -> None:
    """On two non-linear systems, by the four runs with the smallest errors above round-off.

    Methods of higher order come down to round-off before their errors fall by that order alone; those are measured
    in more digits, in `test_steps_precisely.py`.
    """
    claims = find(name).claims
    for system, end in (SEPARABLE if name in SPLITTINGS else GENERAL).items():
        compiled = model(system)
        truth = exact(compiled, end).y[:, -1]
        kept: list[tuple[int, float]] = []
        for n in COUNTS:
            error = np.abs(run(compiled, end, stepped(name, end / n)).y[:, -1] - truth).max()
            if error < FLOOR:
                break
            kept.append((n, error))
        counts, errors = zip(*kept[-4:], strict=True)
        order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
        assert order == pytest.approx(claims.order, abs=0.15), (system, kept)


@pytest.mark.parametrize("name", [name for name in (*SPLITTINGS, *EQUAL) if find(name).claims.symplectic])
def test_energy_stays_bounded_without_drift(name: str) -> None:
    """Methods of momenta are symplectic where the mass matrix moves as well."""
    compiled = model("double pendulum" if name in MOMENTA else "Henon-Heiles")
    end, long = (3000.0, 0.4) if name in SPLITTINGS else (300.0, 0.1)
    found = run(compiled, end, name, step=0.05 if find(name).claims.order < 6 else long)
    energy = compiled.energy(*np.split(found.y, 2))
    error = energy / energy[0] - 1
    halves = np.array_split(np.abs(error), 2)
    assert found.status is Status.SUCCESS and halves[0].max() < (0.2 if find(name).claims.order == 1 else 3e-3)
    assert halves[1].max() < 1.1 * halves[0].max()
    means = [part.mean() for part in np.array_split(error, 10)]
    assert np.ptp(means) < 0.2 * np.abs(error).max(), (means, np.abs(error).max())


@pytest.mark.few
@pytest.mark.parametrize("name", ADAPTIVE)
def test_errors_follow_the_tolerance(name: str) -> None:
    compiled = model("double pendulum")
    truth = exact(compiled, 3.0).y[:, -1]
    tolerances = (1e-5, 1e-7, 1e-9, 1e-11)
    errors = []
    for rtol in tolerances:
        found = run(compiled, 3.0, name, rtol=rtol, atol=rtol)
        errors.append(np.abs(found.y[:, -1] - truth).max())
        assert errors[-1] < 300 * rtol
    # The order of a series follows the tolerance, and with it the ratio of error to tolerance, up or down.
    least = 10 if name in STEPPED else 5
    assert all(b < a / least for a, b in itertools.pairwise(errors)), errors


SCIPY: dict[str, Any] = {"bs3": "RK23", "dopri5": "RK45", "dop853": "DOP853"}


@pytest.mark.parametrize("name", SCIPY)
def test_steps_are_in_line_with_scipys(name: str) -> None:
    """The same tableau and the same error norm should need about the same steps."""
    compiled = model("double pendulum")
    solver = SCIPY[name]
    slope: Any = compiled.rhs
    theirs = scipy.integrate.solve_ivp(slope, (0, 5), compiled.statement.initial, method=solver, rtol=1e-8, atol=1e-10)
    ours = run(compiled, 5.0, name, rtol=1e-8, atol=1e-10)
    assert ours.steps < 1.25 * (len(theirs.t) - 1)
    assert ours.evaluations < 1.25 * theirs.nfev
