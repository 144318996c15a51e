"""One evaluation of the accelerations: against C by hand, and in batches against heyoka's cfunc.

python docs/benchmarks/kernels.py
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import heyoka as hy
import native
import numpy as np
from by_hand import PARAMETERS, ByHand
from equations import from_lagrangian, from_sympy, textbook
from measure import Page, best, microseconds, shown, verdict
from numpy.typing import NDArray
from systems import chain, double_pendulum

import lagrange as lg

STATEMENTS = {"textbook L": False, "Cartesian sums": True}
SCALAR_BAR, BATCH = 1.1, 4096
CHAINS = (2, 5, 8, 12, 20, 30)


def random_states(count: int) -> NDArray[Any]:
    """Return states (count, 4), angles anywhere on the circle."""
    draw = np.random.default_rng(20)
    return np.hstack([draw.uniform(-np.pi, np.pi, (count, 2)), draw.uniform(-5, 5, (count, 2))])


def states_of_a_run(count: int) -> NDArray[Any]:
    """Return states (count, 4) of a lively run, 0.01 s apart, as an integrator meets them."""
    start = {"theta1": 2.0, "theta2": 2.5}
    t_eval = np.arange(count) * 0.01
    return np.ascontiguousarray(double_pendulum().run(t_eval[-1], start, t_eval=t_eval, rtol=1e-9).y.T)


def aligned(shape: tuple[int, int]) -> NDArray[Any]:
    """Return an array that begins at a cache line, so that no rival has the luck of the allocator."""
    memory = np.empty(shape[0] * shape[1] + 8)
    skip = -memory.ctypes.data // 8 % 8
    return memory[skip : skip + shape[0] * shape[1]].reshape(shape)


def scalar(page: Page, models: Mapping[str, lg.Model]) -> None:
    """Compare single evaluations, called from compiled code."""
    hand = ByHand()
    calls = {"C by hand": (hand.address, PARAMETERS)}
    for name, model in models.items():
        calls[f"lagrange, {name}"] = native.kernel(model, "accelerations")
    rows = []
    for states, loop, words in (
        (states_of_a_run(4000), "chained", "states of a run, each call waits for the last"),
        (states_of_a_run(4000), "independent", "states of a run, independent calls"),
        (random_states(4000), "chained", "random states, each call waits for the last"),
        (random_states(4000), "independent", "random states, independent calls"),
    ):
        runs = {name: hand.loop(loop, address, p, states) for name, (address, p) in calls.items()}
        _agree({name: np.array(run()) for name, run in runs.items()}, 1e-9)
        times = {name: seconds / len(states) for name, seconds in best(runs).items()}
        for name, seconds in times.items():
            ratio = seconds / times["C by hand"]
            within = "" if name == "C by hand" else verdict(ratio, SCALAR_BAR)
            rows.append((words, name, f"{1e9 * seconds:.1f}", f"{ratio:.2f}", within))
    page.table(("loop", "kernel", "ns per evaluation", "of C's time", "at most 1.1"), rows)


def heyoka_calls(system: lg.System, y: NDArray[Any]) -> dict[str, Callable[[], NDArray[Any]]]:
    """Return calls of heyoka's compiled functions: each of three equations, parameters as numbers or per column."""
    hy.set_nthreads(1)  # a batch is shared between threads otherwise
    symbols = hy.make_vars("a", "b", "u", "v")
    batch = y.shape[1]
    columns = np.repeat(PARAMETERS[:, None], batch, axis=1)
    out = aligned((2, batch))
    numbers = [hy.expression(value) for value in PARAMETERS]
    calls: dict[str, Callable[[], NDArray[Any]]] = {}
    ways: dict[str, Callable[[list[Any], list[Any]], list[Any]]] = {
        "textbook equations": textbook,
        "equations by SymPy": lambda x, p: from_sympy(system, x, p),
        "equations by hy.lagrangian": from_lagrangian,
    }
    for what, equations in ways.items():
        fixed = hy.cfunc(equations(symbols, numbers), vars=symbols)
        free = hy.cfunc(equations(symbols, [hy.par[i] for i in range(5)]), vars=symbols)
        calls[f"heyoka, {what}, parameters fixed when compiled"] = partial(fixed, y, outputs=out)
        calls[f"heyoka, {what}, parameters given"] = partial(free, y, pars=columns, outputs=out)
    return calls


def batches(page: Page, models: Mapping[str, lg.Model], batch: int) -> None:
    """Compare evaluations of many states at once, called from Python."""
    y, q, v = aligned((4, batch)), aligned((2, batch)), aligned((2, batch))
    y[:] = random_states(batch).T
    q[:], v[:] = y[:2], y[2:]
    calls: dict[str, Callable[[], NDArray[Any]]] = heyoka_calls(double_pendulum(), y)
    for name, model in models.items():
        kernel, p = model.kernel("accelerations"), model.parameter_array()
        calls[f"lagrange, {name}, model.accelerations(q, v)"] = partial(model.accelerations, q, v)
        calls[f"lagrange, {name}, kernel(t, y, p)"] = partial(kernel, 0.0, y, p)
    fixed = double_pendulum(numbers=True).compile()
    calls["lagrange, textbook L with numbers, model.accelerations(q, v)"] = partial(fixed.accelerations, q, v)
    reference = double_pendulum().compile("numpy")
    calls["lagrange, textbook L, numpy target"] = partial(reference.accelerations, q, v)
    _agree({name: np.array(call()) for name, call in calls.items()}, 1e-9)
    times = best(calls)
    rival = min(seconds for name, seconds in times.items() if name.startswith("heyoka"))
    rows = [
        (name, microseconds(seconds), shown(1e9 * seconds / batch), f"{seconds / rival:.2f}")
        for name, seconds in times.items()
    ]
    page.table((f"{batch} states", "us per call", "ns per state", "of heyoka's best time"), rows)
    if batch == BATCH:
        slowest = max(s for name, s in times.items() if "model.accelerations" in name)
        page.text(f"`model.accelerations` not slower than heyoka at its best: {verdict(slowest, rival)}.")


def chains(page: Page) -> None:
    """Measure longer chains, where the linear system in the accelerations takes over."""
    rows = []
    steps = 200
    for n in CHAINS:
        model = lg.System(**chain(n)).compile()
        q = np.random.default_rng(n).uniform(-1.0, 1.0, (n, BATCH))
        y0 = np.concatenate([np.full(n, 0.5), np.zeros(n)])
        flow = lg.flow(model, method="rk4", step=1e-3)
        runs: dict[str, Callable[[], NDArray[Any]]] = {
            "run": partial(flow, y0, 0.0, steps * 1e-3),
            "batch": partial(model.accelerations, q, q),
        }
        times = best(runs)
        rows.append((n, shown(1e9 * times["run"] / (4 * steps)), shown(1e9 * times["batch"] / BATCH)))
    page.text("## Chains of n pendulums, Cartesian sums")
    page.table(("n", "ns per evaluation in RK4, steps included", f"ns per state, {BATCH} states"), rows)


def _agree(values: Mapping[str, NDArray[Any]], tolerance: float) -> None:
    """Stop unless all rivals compute the same."""
    first, *others = values.items()
    scale = np.abs(first[1]).max()
    for name, value in others:
        if not np.abs(value - first[1]).max() <= tolerance * scale:
            raise SystemExit(f"{name} and {first[0]} differ by {np.abs(value - first[1]).max():g}")


def main() -> None:
    """Measure, print and write the page."""
    page = Page("One evaluation of the accelerations", __file__)
    models = {name: double_pendulum(cartesian=cartesian).compile() for name, cartesian in STATEMENTS.items()}
    page.text("## One state, called from compiled code through a pointer")
    scalar(page, models)
    page.text(
        "## Many states, called from Python, one thread\n\n"
        "`heyoka.cfunc` takes parameters as numbers known when it compiles, or as one value per column and parameter. "
        "Ours are given at run time, one set for all columns, or are numbers in the statement. Both write contiguous "
        "arrays (n, batch); heyoka's is given to it, ours is new."
    )
    for batch in (BATCH, 8):
        batches(page, models, batch)
    chains(page)
    page.write()


if __name__ == "__main__":
    main()
