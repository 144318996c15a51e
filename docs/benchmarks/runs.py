"""Whole runs: fixed steps against C by hand, DOP853 against SciPy's, and error against time for every method.

python docs/benchmarks/runs.py
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from by_hand import ByHand
from equations import lambdified
from measure import Page, best, microseconds, milliseconds, shown, verdict
from numpy.typing import NDArray
from picture import Curve, work_precision
from scipy.integrate import solve_ivp
from systems import double_pendulum, henon_heiles
from taylor_systems import final_state

import lagrange as lg

T_END, STEP, TOLERANCE = 20.0, 1e-3, 1e-8
RK4_BAR, RATIO_BAR, FLOW_BAR = 12e-3, 50.0, 10e-6
TOLERANCES = tuple(10.0**-k for k in range(3, 14))
STEPS = tuple(500 * 2**k for k in range(9))
RIVAL = 'SciPy, lambdify(modules="math")'
SHORT, LONGEST = 0.02, 1.0
"""Seconds of a run that is repeated less, and of one after which the next method is taken up."""


def start(system: lg.System) -> NDArray[Any]:
    """Return the initial state [q, v]."""
    return np.array(system.statement.initial)


def error(y: NDArray[Any], expected: NDArray[Any]) -> float:
    """Return the largest error of a final state."""
    return float(np.abs(y - expected).max())


def fixed_steps(page: Page, system: lg.System, expected: NDArray[Any]) -> None:
    """Measure RK4 with a step of a millisecond against a loop in C."""
    model, hand, y0 = system.compile(), ByHand(), start(system)
    count = round(T_END / STEP)
    runs: dict[str, Callable[[], Any]] = {
        "lagrange, lg.integrate(...)": lambda: lg.integrate(model, (0.0, T_END), method="rk4", step=STEP),
        "C by hand, the same loop": lambda: hand.rk4(y0, STEP, count),
    }
    ends = {"lagrange, lg.integrate(...)": runs["lagrange, lg.integrate(...)"]().y[:, -1]}
    ends["C by hand, the same loop"] = hand.rk4(y0, STEP, count)[-1]
    times = best(runs)
    bars = {"lagrange, lg.integrate(...)": verdict(times["lagrange, lg.integrate(...)"], RK4_BAR)}
    page.text(f"## RK4 with {count} steps of {STEP:g} s")
    page.table(
        ("run", "ms", "ns per step", "error at the end", f"at most {milliseconds(RK4_BAR)} ms"),
        [
            (name, milliseconds(s), shown(1e9 * s / count), f"{error(ends[name], expected):.1e}", bars.get(name, ""))
            for name, s in times.items()
        ],
    )


def adaptive(page: Page, system: lg.System, expected: NDArray[Any]) -> None:
    """Measure DOP853 against SciPy's on a lambdified right-hand side."""
    model, y0 = system.compile(), start(system)
    fast, usual = lambdified(system, "math"), lambdified(system, "numpy")
    options: dict[str, Any] = {"rtol": TOLERANCE, "atol": TOLERANCE}
    runs: dict[str, Callable[[], Any]] = {
        "lagrange": lambda: lg.integrate(model, (0.0, T_END), method="dop853", **options),
        "SciPy, lambdify": lambda: solve_ivp(usual, (0.0, T_END), y0, method="DOP853", **options),
        RIVAL: lambda: solve_ivp(fast, (0.0, T_END), y0, method="DOP853", **options),
        "SciPy, model.rhs": lambda: solve_ivp(model.rhs, (0.0, T_END), y0, method="DOP853", **options),
    }
    found = {name: run() for name, run in runs.items()}
    errors = {name: error(solution.y[:, -1], expected) for name, solution in found.items()}
    times = best(runs)
    rows = []
    for name, seconds in times.items():
        calls = getattr(found[name], "nfev", None) or found[name].evaluations
        ratio = seconds / times["lagrange"]
        rows.append((name, milliseconds(seconds), calls, f"{errors[name]:.1e}", f"{ratio:.0f}"))
    page.text(f"## DOP853 with rtol = atol = {TOLERANCE:g}")
    page.table(("run", "ms", "evaluations", "error at the end", "times lagrange's"), rows)
    ratio = times[RIVAL] / times["lagrange"]
    same = errors["lagrange"] / errors[RIVAL]
    page.text(
        f"At least {RATIO_BAR:.0f} times faster than SciPy, on Python's own floats too: {verdict(RATIO_BAR, ratio)}. "
        f"Both take the same steps, so that the errors agree to round-off: their ratio is {same:.6f}."
    )


def flows(page: Page, system: lg.System) -> None:
    """Measure what a call of a flow costs beside its steps: a step so short that nothing else is left."""
    model, y0 = system.compile(), start(system)
    one = lg.flow(model, method="rk4", step=1e-3)
    adaptive_one = lg.flow(model, method="dop853", rtol=TOLERANCE, atol=TOLERANCE)
    kernel: Any = model.kernel("rhs")
    p = model.parameter_array()
    runs: dict[str, Callable[[], Any]] = {
        "flow(y0, 0, 1e-3), one step of RK4": lambda: one(y0, 0.0, 1e-3),
        "flow(y0, 0, 1e-9), one step of DOP853": lambda: adaptive_one(y0, 0.0, 1e-9),
        "model.rhs(t, y)": lambda: model.rhs(0.0, y0),
        "model.kernel('rhs')(t, y, p)": lambda: kernel(0.0, y0, p),
    }
    times = best(runs)
    rows = [
        (name, microseconds(s), verdict(s, FLOW_BAR) if name.startswith("flow") else "") for name, s in times.items()
    ]
    page.text("## Calls from Python")
    page.table(("call", "us", f"at most {microseconds(FLOW_BAR)} us"), rows)


def curves(system: lg.System, expected: NDArray[Any]) -> dict[str, Curve]:
    """Return time and error of every method that is legal for the system, from rough to fine."""
    model = system.compile()
    found: dict[str, Curve] = {}
    for row in lg.methods.table():
        options: Sequence[dict[str, Any]]
        if row.claims.adaptive:
            options = [{"rtol": tolerance, "atol": tolerance} for tolerance in TOLERANCES]
        else:
            options = [{"step": T_END / count} for count in STEPS]
        points = list(_points(model, row.name, options, expected))
        if points:
            found[row.name] = points
    return found


def _points(model: lg.Model, name: str, options: Sequence[dict[str, Any]], expected: NDArray[Any]) -> Any:
    for chosen in options:
        try:
            solution = lg.integrate(model, (0.0, T_END), method=name, **chosen)
        except lg.StatementError:
            return  # the method is not legal for this system
        if solution.wall > LONGEST:
            return
        off = error(solution.y[:, -1], expected)
        if np.isfinite(off) and off < 1.0:
            call = {name: lambda chosen=chosen: lg.integrate(model, (0.0, T_END), method=name, **chosen)}
            yield best(call, rounds=5 if solution.wall > SHORT else 30, least=0.0)[name], off


def table_of(page: Page, found: dict[str, Curve]) -> None:
    """Add the least time for each error, by interpolation along each method's line."""
    goals = [10.0**-k for k in (2, 4, 6, 8, 10, 12)]
    rows = []
    for name, curve in found.items():
        times = [time_for(curve, goal) for goal in goals]
        cells = ["" if math.isnan(seconds) else milliseconds(seconds) for seconds in times]
        rows.append((f"`{name}`", *cells))
    page.table(("ms for an error of", *(f"{goal:.0e}" for goal in goals)), rows)


def time_for(curve: Curve, goal: float) -> float:
    """Return the seconds that a method needs for an error, NaN where its line does not reach it."""
    for (t0, e0), (t1, e1) in pairwise(curve):
        if e0 >= goal >= e1 and e0 > e1:
            share = np.log(e0 / goal) / np.log(e0 / e1)
            return float(np.exp(np.log(t0) + share * np.log(t1 / t0)))
    return math.nan


def main() -> None:
    """Measure, print and write the page and the picture."""
    page = Page("Whole runs", __file__)
    pendulum, stars = double_pendulum(), henon_heiles()
    expected = {system.name: final_state(system, T_END)[0].astype(float) for system in (pendulum, stars)}
    fixed_steps(page, pendulum, expected[pendulum.name])
    adaptive(page, pendulum, expected[pendulum.name])
    flows(page, pendulum)
    page.text("## Error against time, every registered method")
    panels = {}
    for system in (pendulum, stars):
        panels[f"{system.name}, {T_END:g} s"] = found = curves(system, expected[system.name])
        page.text(f"{system.name}:")
        table_of(page, found)
    work_precision(panels, "runs.png")
    page.text("![Error against time for every method, on two systems](runs.png)")
    page.write()


if __name__ == "__main__":
    main()
