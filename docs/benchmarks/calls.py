"""Cost of calls of right-hand sides, of the wrappers of SciPy's solvers, and of a run beside its steps.

python docs/benchmarks/calls.py
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from equations import accelerations_of, lambdified
from measure import Page, best, microseconds, milliseconds, shown, verdict
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from systems import chain, double_pendulum, henon_heiles
from taylor_systems import springs

import lagrange as lg

BATCH = 100_000
STATE_BARS = {2: 1.2, 10: 2.0}
"""Microseconds that a call of one state may take on llvm, by the number of coordinates."""

SOLVERS = {f"scipy-{name.lower()}": name for name in ("RK45", "DOP853", "Radau", "BDF", "LSODA")}
WITH_JACOBIAN = ("Radau", "BDF", "LSODA")
WRAPPER_BAR, SOLVE_BAR, RUN_BAR, SHORT_BAR = 1.3, 0.9, 1.3, 60.0
TOLERANCES: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-8}


def systems() -> dict[str, lg.System]:
    """Return systems of 2, 5 and 10 coordinates whose accelerations SymPy can write out."""
    return {
        "double pendulum": double_pendulum(),
        "chain of 5": lg.System(**chain(5)),
        "10 masses on springs": springs(10, cubic=False),
    }


def state_of(system: lg.System) -> NDArray[Any]:
    """Return a state that moves."""
    return np.array(system.statement.initial) + np.linspace(0.05, 0.4, 2 * len(system.coordinates))


def of_columns(system: lg.System) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return the right-hand side of many states at once by lambdify."""
    call, n = accelerations_of(system, "numpy"), len(system.coordinates)
    return lambda y: np.concatenate([y[n:], call(*y)])


def right_hand_sides(page: Page, known: dict[str, lg.System]) -> None:
    """Compare calls from Python: one state, many states, and as SciPy's solvers make them."""
    single, many, solved = [], [], []
    for name, system in known.items():
        y, n = state_of(system), len(system.coordinates)
        compiled, printed = system.compile(), system.compile("numpy")
        usual, arrays, columns = lambdified(system, "math"), lambdified(system, "numpy"), of_columns(system)
        calls: dict[str, Callable[[], Any]] = {
            "llvm": partial(compiled.rhs, 0.0, y),
            "numpy": partial(printed.rhs, 0.0, y),
            "math": partial(usual, 0.0, y),
            "math as array": partial(as_array, usual, y),
            "arrays": partial(arrays, 0.0, y),
        }
        agree(calls)
        t = best(calls)
        within = verdict(1e6 * t["llvm"], STATE_BARS[n]) if n in STATE_BARS else ""
        single.append((name, n, *(microseconds(t[k]) for k in calls), within, verdict(t["numpy"], t["math"])))
        batch = y[:, None] + np.random.default_rng(n).normal(0.0, 0.1, (2 * n, BATCH))
        calls = {
            "llvm": partial(compiled.rhs, 0.0, batch),
            "numpy": partial(printed.rhs, 0.0, batch),
            "arrays": partial(columns, batch),
        }
        agree(calls)
        t = best(calls, rounds=10)
        many.append((name, n, *(milliseconds(t[k]) for k in calls), verdict(t["numpy"], 0.5 * t["arrays"])))
        for method in ("RK45", "DOP853"):
            laws: dict[str, Any] = {"llvm": compiled.rhs, "numpy": printed.rhs, "math": usual, "arrays": arrays}
            runs = {k: partial(solve_ivp, f, (0.0, 10.0), y, method=method, **TOLERANCES) for k, f in laws.items()}
            t = best(runs, rounds=7)
            rival = min(t["math"], t["arrays"])
            ratio = f"{t['llvm'] / rival:.2f}"
            solved.append(
                (name, method, *(milliseconds(t[k]) for k in runs), ratio, verdict(t["llvm"], SOLVE_BAR * rival))
            )
    page.text("## One state, us a call")
    head = ("system", "coordinates", "`rhs`, llvm", "`rhs`, numpy target")
    bars = ("llvm: at most 1.2 for 2, 2.0 for 10", "numpy target: at most math's")
    page.table((*head, "lambdify, math", "as an array", "lambdify, numpy", *bars), single)
    page.text(f"## {BATCH} states at once, ms a call")
    page.table((*head, "lambdify, numpy", "numpy target: at most half of lambdify's"), many)
    page.text("## SciPy's `solve_ivp` with each, t = 10, rtol = atol = 1e-8, ms a run")
    head_of_runs = ("system", "method", "llvm", "numpy target", "lambdify, math", "lambdify, numpy")
    page.table((*head_of_runs, "llvm to lambdify's best", f"at most {SOLVE_BAR}"), solved)


def as_array(f: Callable[[float, Any], list[float]], y: NDArray[Any]) -> NDArray[Any]:
    """Return a right-hand side as an array."""
    return np.array(f(0.0, y))


def agree(calls: dict[str, Callable[[], Any]]) -> None:
    """Stop unless all compute the same."""
    first, *others = (np.asarray(call(), dtype=float) for call in calls.values())
    assert all(np.allclose(first, other, rtol=1e-9, atol=1e-9) for other in others)


def quantities(page: Page) -> None:
    """Measure the other calls of one state on llvm."""
    rows = []
    for system in (double_pendulum(), lg.System(**chain(10)), springs(10, cubic=False)):
        model, y = system.compile(), state_of(system)
        n = model.dimension
        q, v = y[:n].copy(), y[n:].copy()
        calls: dict[str, Callable[[], Any]] = {
            "rhs": partial(model.rhs, 0.0, y),
            "energy": partial(model.energy, q, v),
            "accelerations": partial(model.accelerations, q, v),
            "jacobian": partial(model.jacobian, 0.0, y),
        }
        t = best(calls)
        within = verdict(1e6 * max(t.values()), STATE_BARS[n])
        rows.append((system.statement.name, n, *(microseconds(t[k]) for k in calls), STATE_BARS[n], within))
    page.text("## Quantities of one state on llvm, us a call")
    page.table(("system", "coordinates", "rhs", "energy", "accelerations", "jacobian", "bar", "within"), rows)


def runs_of() -> dict[str, lg.Model]:
    """Return the systems of the tables of runs."""
    return {
        "pendulum": lg.scene("pendulum").compile(),
        "Henon-Heiles": henon_heiles().compile(),
        "double pendulum": double_pendulum().compile(),
        "chain of 10": lg.System(**chain(10)).compile(),
    }


def wrappers(page: Page, models: dict[str, lg.Model]) -> None:
    """Compare our runs by SciPy's solvers with solve_ivp on our compiled right-hand side."""
    rows = []
    for name, model in models.items():
        y0, end = np.array(model.statement.initial), 5.0 if model.dimension > 2 else 20.0
        for method, theirs in SOLVERS.items():
            given: dict[str, Any] = {"jac": model.jacobian} if theirs in WITH_JACOBIAN else {}
            plain = partial(solve_ivp, model.rhs, (0.0, end), y0, method=theirs, **TOLERANCES, **given)
            ours = partial(lg.integrate, model, (0.0, end), method=method, **TOLERANCES)
            t = best({"ours": ours, "dense": partial(plain, dense_output=True), "plain": plain}, rounds=7)
            ratios = [t["ours"] / t[k] for k in ("dense", "plain")]
            numbers = (milliseconds(t[k]) for k in ("ours", "dense", "plain"))
            judged = (cell for ratio in ratios for cell in (f"{ratio:.2f}", verdict(ratio, WRAPPER_BAR)))
            rows.append((name, method, *numbers, *judged))
    page.text(
        "## Runs by SciPy's solvers, ms\n\n`solve_ivp` has `model.rhs`, and `model.jacobian` where the method takes "
        "one. A solution of ours has its path between the steps, which `solve_ivp` keeps with `dense_output=True`: "
        "that is the run at equal options. RK45's and DOP853's is made when it is read."
    )
    head = ("system", "method", "`lg.integrate`", "`solve_ivp`, dense", "`solve_ivp`", "to dense", "at most 1.3")
    page.table((*head, "to plain", f"at most {WRAPPER_BAR}"), rows)


def ballast(page: Page, models: dict[str, lg.Model]) -> None:
    """Compare runs with flows, which keep nothing: 1,000 steps, and a step or two."""
    rows = []
    for name, model in models.items():
        y0 = np.array(model.statement.initial)
        for method in ("taylor", "dop853", "rk4", "verlet"):
            if method == "verlet" and name != "Henon-Heiles":
                continue
            options: dict[str, Any] = {"step": 0.01} if method in ("rk4", "verlet") else {"rtol": 1e-9, "atol": 1e-9}
            flow, end = lg.flow(model, method=method, **options), 10.0
            if "step" not in options:
                end = 100.0 * 1000 / lg.integrate(model, (0.0, 100.0), method=method, **options).steps
            calls: dict[str, Callable[[], Any]] = {}
            for what, e in (("long", end), ("short", 0.02)):
                calls[f"run {what}"] = partial(lg.integrate, model, (0.0, e), method=method, **options)
                calls[f"flow {what}"] = partial(flow, y0, 0.0, e)
            t = best(calls, rounds=15)
            ratio, beside = t["run long"] / t["flow long"], 1e6 * (t["run short"] - t["flow short"])
            numbers = (microseconds(t[k]) for k in ("run long", "flow long"))
            judged = verdict(ratio, RUN_BAR) if model.dimension == 2 else ""
            rows.append((name, method, *numbers, f"{ratio:.2f}", judged, shown(beside), verdict(beside, SHORT_BAR)))
    page.text(
        "## What a run costs beside its steps, us\n\n`lg.integrate` against `lg.flow`, which keeps no steps and "
        "returns the last state: about 1,000 steps, and a run over 0.02 units of time."
    )
    head = ("system", "method", "run, 1,000 steps", "flow", "ratio", f"2 coordinates: at most {RUN_BAR}")
    page.table((*head, "a short run beside its flow", f"at most {SHORT_BAR:g}"), rows)


def main() -> None:
    """Measure, and write the page."""
    page = Page("Calls", __file__)
    right_hand_sides(page, systems())
    quantities(page)
    models = runs_of()
    wrappers(page, models)
    ballast(page, models)
    page.write()


if __name__ == "__main__":
    main()
