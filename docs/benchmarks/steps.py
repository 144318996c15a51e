"""Cost of steps beside their evaluations, cost of Newton's method, and runs against SciPy's methods of the same name.

python docs/benchmarks/steps.py
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from equations import lambdified
from measure import Page, best, milliseconds, shown, verdict
from native import in_turn, kernel
from runs import T_END, error, start, time_for
from scipy.integrate import solve_ivp
from systems import chain, double_pendulum, henon_heiles
from taylor_systems import final_state

import lagrange as lg
from lagrange.trajectory.methods.registry import find

STEPS, H = 2000, 1e-4
"""Of one run with fixed steps; they are short, so that no evaluation costs more than another."""
EXPLICIT = {"euler": 1, "heun": 2, "rk4": 4, "symplectic-euler": 1, "verlet": 1, "yoshida6": 7}
"""Evaluations of a step."""
NEWTON = (
    *("backward-euler", "implicit-midpoint", "bdf2", "trapezoidal", "gauss2", "gauss3"),
    *("variational-midpoint", "variational-trapezoid", "galerkin4", "galerkin6", "discrete-gradient"),
)
LENGTHS = (1e-3, 1e-2)
"""Of the steps, in s, with which those are measured."""
COST_BAR, NEWTON_BAR, FACTOR = 1.3, 4.0, 50.0
"""The bars: a step over its evaluations, one that solves over an explicit one, and SciPy's time over ours."""
NAMESAKES = {"dopri5": "RK45", "bs3": "RK23", "dop853": "DOP853", "radau5": "Radau"}
TOLERANCES = tuple(10.0**-k for k in range(3, 12))
GOAL = 1e-6
"""The error at the end at which methods of the same name are compared."""


def systems() -> dict[str, lg.System]:
    """Return what steps are taken on, by name."""
    scenes = ("pendulum", "kepler", "elastic-pendulum")
    chains = {f"{n} links": lg.System(**chain(n)) for n in (3, 5, 10)}
    few = {"Henon-Heiles": henon_heiles(), "double pendulum": double_pendulum()}
    return {**{name: lg.scene(name) for name in scenes}, **few, **chains}


def fixed_steps(page: Page) -> None:
    """Measure explicit methods with fixed steps against their evaluations."""
    lines, worst = [], 0.0
    for name, system in systems().items():
        model, y0 = system.compile(), start(system)
        runs: dict[str, Callable[[], Any]] = {"": in_turn(*kernel(model, "rhs"), y0, STEPS)}
        for method in EXPLICIT:
            try:
                flow = lg.flow(model, method=method, step=H)
                flow(y0, 0.0, H)
            except lg.StatementError:
                continue  # not legal for this system
            runs[method] = partial(flow, y0, 0.0, STEPS * H)
        times = best(runs)
        one = times.pop("")
        ratios = {method: seconds / (EXPLICIT[method] * one) for method, seconds in times.items()}
        worst = max(worst, *ratios.values())
        cells = [f"{ratios[method]:.2f}" if method in ratios else "refused" for method in EXPLICIT]
        lines.append((name, 2 * model.dimension, shown(1e9 * one / STEPS), *cells))
    page.text("## Fixed steps, over stages times one evaluation")
    page.table(("system", "numbers of a state", "ns of one evaluation", *EXPLICIT), lines)
    page.text(
        f"At most {COST_BAR} times: {verdict(worst, COST_BAR)}, the largest is {worst:.2f}. One evaluation is the "
        "compiled right-hand side in a loop in C (`right_side.c`) in which each waits for the slopes before, through "
        "memory. A step hands small states on in registers, and its stages overlap where they do not need one another: "
        "that is how it can cost less. Splittings need no slopes of coordinates, which are velocities."
    )


def newton(page: Page) -> None:
    """Measure methods that solve for their stages against explicit ones of as many."""
    system = double_pendulum()
    model, y0 = system.compile(), start(system)
    lines, worst = [], 0.0
    for h in LENGTHS:
        flows = {name: lg.flow(model, method=name, step=h) for name in (*NEWTON, "euler", "heun", "rk4")}
        times = best({name: partial(flow, y0, 0.0, STEPS * h) for name, flow in flows.items()}, rounds=10)
        explicit = {1: times["euler"], 2: times["heun"]}
        for name in NEWTON:
            run = lg.integrate(model, (0.0, STEPS * h), method=name, step=h)
            stages = stages_of(name, model)
            ratio = times[name] / explicit.get(stages, times["rk4"] * stages / 4)
            worst = max(worst, ratio)
            turns = f"{run.evaluations / run.steps / stages:.2f}"
            lines.append((f"`{name}`", stages, h, turns, shown(1e9 * times[name] / STEPS), f"{ratio:.2f}"))
    page.text("## Methods that solve for their stages, on the double pendulum")
    page.table(
        ("method", "stages", "step, s", "corrections", "ns per step", "times an explicit step of as many stages"), lines
    )
    page.text(
        f"At most {NEWTON_BAR:.0f} times: {verdict(worst, NEWTON_BAR)}, the largest is {worst:.2f}. Stages are the "
        "evaluations of a step with one correction, of slopes, or of momenta and forces for the variational methods. "
        "The explicit step is Euler's or Heun's, or as many quarters of one of RK4."
    )


def stages_of(name: str, model: lg.Model) -> int:
    """Return how many evaluations a step takes whose unknowns need one correction."""
    method: Any = find(name)
    problem = lg.Problem(model, model.parameter_values(), 0.0, 1.0, np.array(model.statement.initial), step=0.1)
    step = method.plan(problem).step
    return len(step.calls) + sum(len(solve.calls) for solve in step.solves)


def namesakes(page: Page) -> None:
    """Measure adaptive methods against SciPy's of the same name, on a lambdified right-hand side."""
    system = double_pendulum()
    model, y0, expected = system.compile(), start(system), final_state(system, T_END)[0].astype(float)
    slow = lambdified(system, "math")
    lines, least = [], math.inf
    for method, name in NAMESAKES.items():
        curves: list[list[tuple[float, float]]] = [[], []]
        for tolerance in TOLERANCES:
            options: dict[str, Any] = {"rtol": tolerance, "atol": tolerance}
            calls: dict[str, Callable[[], Any]] = {
                "ours": partial(lg.integrate, model, (0.0, T_END), method=method, **options),
                "theirs": partial(solve_ivp, slow, (0.0, T_END), y0, method=name, **options),
            }
            errors = [error(call().y[:, -1], expected) for call in calls.values()]
            times = best(calls, rounds=5)
            for curve, off, seconds in zip(curves, errors, times.values(), strict=True):
                curve.append((seconds, off))
            if max(errors) < GOAL / 2:
                break
        ours, theirs = (time_for(curve, GOAL) for curve in curves)
        least = min(least, theirs / ours)
        lines.append((f"`{method}`", f"SciPy {name}", milliseconds(ours), milliseconds(theirs), f"{theirs / ours:.0f}"))
    page.text(f"## SciPy's methods of the same name, at an error of {GOAL:g}")
    page.table(("ours", "theirs", "ms, ours", "ms, theirs", "times faster"), lines)
    page.text(
        f"At least {FACTOR:.0f} times faster: {verdict(FACTOR, least)}. The double pendulum from half a radian to "
        "t = 20 s; times of whole calls of `lg.integrate` and `solve_ivp`, interpolated between tolerances, rtol = "
        'atol. SciPy gets the right-hand side that SymPy lambdifies with `modules="math"`, which is the faster one '
        "for single states."
    )


def main() -> None:
    """Measure, print and write the page."""
    page = Page("Cost of steps", __file__)
    fixed_steps(page)
    newton(page)
    namesakes(page)
    page.write()


if __name__ == "__main__":
    main()
