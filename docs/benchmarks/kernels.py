"""One evaluation of the accelerations: against C by hand, and in batches against heyoka's cfunc.

python docs/benchmarks/kernels.py
"""

from __future__ import annotations

import os

# Rivals run on one thread, ours does not use more; heyoka reads this when it is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Callable, Mapping
from typing import Any

import heyoka as hy
import numpy as np
from by_hand import FLAGS, PARAMETERS, ByHand
from measure import Page, best, microseconds, verdict
from numpy.typing import NDArray
from sympy import Symbol
from systems import double_pendulum

import lagrange as lg
from lagrange.statement.coordinate import velocity_of

STATEMENTS = {"textbook L": False, "Cartesian sums": True}
SCALAR_BAR, BATCH = 1.1, 4096
NAMES = ("m1", "m2", "l1", "l2", "g")


def random_states(count: int) -> NDArray[Any]:
    """Return states (count, 4), angles anywhere on the circle."""
    draw = np.random.default_rng(20)
    return np.hstack([draw.uniform(-np.pi, np.pi, (count, 2)), draw.uniform(-5, 5, (count, 2))])


def states_of_a_run(count: int) -> NDArray[Any]:
    """Return states (count, 4) of a lively run, 0.01 s apart, as an integrator meets them."""
    start = {"theta1": 2.0, "theta2": 2.5}
    t_eval = np.arange(count) * 0.01
    return np.ascontiguousarray(double_pendulum().run(t_eval[-1], start, t_eval=t_eval, rtol=1e-9).y.T)


def scalar(page: Page, models: Mapping[str, lg.Model]) -> None:
    """Compare single evaluations, called from compiled code."""
    hand = ByHand()
    calls = {"C by hand": (hand.address, PARAMETERS)}
    for name, model in models.items():
        kernel: Any = model.kernel("accelerations")
        calls[f"lagrange, {name}"] = (kernel.address, kernel.prepare(model.parameter_array()))
    rows = []
    for states, loop, words in (
        (states_of_a_run(4000), "chained", "states of a run, each call waits for the last"),
        (states_of_a_run(4000), "independent", "states of a run, independent calls"),
        (random_states(4000), "chained", "random states, each call waits for the last"),
        (random_states(4000), "independent", "random states, independent calls"),
    ):
        runs = {name: hand.loop(loop, address, p, states) for name, (address, p) in calls.items()}
        _agree({name: np.array(run()) for name, run in runs.items()}, 1e-9)
        times = {name: seconds / len(states) for name, seconds in best(runs, rounds=40, least=0.004).items()}
        for name, seconds in times.items():
            ratio = seconds / times["C by hand"]
            within = "" if name == "C by hand" else verdict(ratio, SCALAR_BAR)
            rows.append((words, name, f"{1e9 * seconds:.1f}", f"{ratio:.2f}", within))
    page.table(("loop", "kernel", "ns per evaluation", "of C's time", "at most 1.1"), rows)


def textbook(symbols: list[Any], p: list[Any]) -> list[Any]:
    """Return the textbook accelerations as heyoka expressions, the same as in the C file."""
    a, b, v1, v2 = symbols
    m1, m2, l1, l2, g = p
    s, c, s1, s2 = hy.sin(a - b), hy.cos(a - b), hy.sin(a), hy.sin(b)
    d = m1 + m2 * s * s
    return [
        -(m2 * s * (l1 * v1 * v1 * c + l2 * v2 * v2) + g * ((m1 + m2) * s1 - m2 * s2 * c)) / (l1 * d),
        (s * ((m1 + m2) * l1 * v1 * v1 + m2 * l2 * v2 * v2 * c) + (m1 + m2) * g * (s1 * c - s2)) / (l2 * d),
    ]


def derived(system: lg.System, symbols: list[Any], p: list[Any]) -> list[Any]:
    """Return SymPy's accelerations of the system as heyoka expressions."""
    plain = [Symbol(str(symbol)) for symbol in symbols]
    velocities = [velocity_of(q) for q in system.coordinates]
    to_plain = dict(zip((*velocities, *system.coordinates), (*plain[2:], *plain[:2]), strict=True))
    values = {Symbol(name): hy.expression(value) for name, value in zip(NAMES, p, strict=True)}
    values.update(zip(plain, symbols, strict=True))
    found = []
    for expression in system.accelerations().values():
        flat = expression.subs(to_plain)
        flat = flat.subs({symbol: Symbol(symbol.name) for symbol in flat.free_symbols})
        found.append(hy.from_sympy(flat, s_dict=values))
    return found


def heyoka_calls(system: lg.System, y: NDArray[Any]) -> dict[str, Callable[[], NDArray[Any]]]:
    """Return calls of heyoka's compiled functions: both equations, parameters as numbers or per column."""
    symbols = hy.make_vars("a", "b", "u", "v")
    batch = y.shape[1]
    columns = np.repeat(PARAMETERS[:, None], batch, axis=1)
    out = np.empty((2, batch))
    calls: dict[str, Callable[[], NDArray[Any]]] = {}
    for what, equations in (("textbook", textbook), ("SymPy's", lambda x, p: derived(system, x, p))):
        fixed = hy.cfunc(equations(symbols, list(PARAMETERS)), vars=symbols)
        free = hy.cfunc(equations(symbols, [hy.par[i] for i in range(5)]), vars=symbols)
        calls[f"heyoka, {what} equations, parameters fixed at compile time"] = lambda f=fixed: f(y, outputs=out)
        calls[f"heyoka, {what} equations, parameters given"] = lambda f=free: f(y, pars=columns, outputs=out)
    return calls


def batches(page: Page, models: Mapping[str, lg.Model], batch: int) -> None:
    """Compare evaluations of many states at once, called from Python."""
    y = np.ascontiguousarray(random_states(batch).T)
    q, v = y[:2].copy(), y[2:].copy()
    calls: dict[str, Callable[[], NDArray[Any]]] = heyoka_calls(double_pendulum(), y)
    for name, model in models.items():
        kernel, p = model.kernel("accelerations"), model.parameter_array()
        calls[f"lagrange, {name}, model.accelerations(q, v)"] = lambda m=model: m.accelerations(q, v)
        calls[f"lagrange, {name}, kernel(t, y, p)"] = lambda k=kernel, p=p: k(0.0, y, p)
    reference = double_pendulum().compile("numpy")
    calls["lagrange, textbook L, numpy target"] = lambda: reference.accelerations(q, v)
    _agree({name: np.array(call()) for name, call in calls.items()}, 1e-9)
    times = best(calls, rounds=25, least=0.004)
    rival = min(seconds for name, seconds in times.items() if name.startswith("heyoka"))
    rows = [
        (name, microseconds(seconds), f"{1e9 * seconds / batch:.2f}", f"{seconds / rival:.2f}")
        for name, seconds in times.items()
    ]
    page.table((f"{batch} states", "us per call", "ns per state", "of heyoka's best time"), rows)


def _agree(values: Mapping[str, NDArray[Any]], tolerance: float) -> None:
    """Stop unless all rivals compute the same."""
    first, *others = values.items()
    scale = np.abs(first[1]).max()
    for name, value in others:
        if not np.abs(value - first[1]).max() <= tolerance * scale:
            raise SystemExit(f"{name} and {first[0]} differ by {np.abs(value - first[1]).max():g}")


def main() -> None:
    """Measure, print and write the page."""
    page = Page(
        "One evaluation of the accelerations",
        __file__,
        "The double pendulum, stated with the Lagrangian of the textbooks, in cos(theta1 - theta2), and as sums of "
        f"Cartesian velocities. C by hand is `double_pendulum.c`, gcc {' '.join(FLAGS)}. Each time is the mean over 4000 "
        "states, of a run (0.01 s apart, as an integrator meets them) or random (which the processor's branch prediction "
        "cannot follow into the branches of the C library's sine).",
    )
    models = {name: double_pendulum(cartesian=cartesian).compile() for name, cartesian in STATEMENTS.items()}
    page.text("## One state, called from compiled code through a pointer")
    scalar(page, models)
    page.text(
        "## Many states, called from Python, one thread\n\n"
        "`heyoka.cfunc` takes parameters as numbers known when it compiles, or as one value per column and parameter; "
        "ours are given at run time, one set for all columns. Both write contiguous arrays (n, batch)."
    )
    for batch in (BATCH, 8):
        batches(page, models, batch)
    page.write()


if __name__ == "__main__":
    main()
