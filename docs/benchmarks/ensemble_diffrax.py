"""Many double pendulums by diffrax, compiled and mapped over members, on the same processor and at the same error."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import jax
import numpy as np
from ensemble_measures import SPANS, Array, Errors, best, ours, starts
from measure import Page, microseconds, shown, verdict
from taylor_systems import CASES

import lagrange as lg

ERROR, BAR = 1e-6, 20.0
"""The error that is asked for, and how many times as long diffrax should take."""

TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(8, 24))
METHODS = ("taylor", "dop853", "tsit5")


def mapped(system: lg.System, end: float, solver: Any, tolerance: float) -> Callable[[Array], Array]:
    """Return a function from starts (m, 2n) to ends."""
    model = system.compile()
    term, parameters = diffrax.ODETerm(model.as_jax()), model.parameter_array()
    control = diffrax.PIDController(rtol=tolerance, atol=tolerance)

    def one(y0: Any) -> Any:
        found = diffrax.diffeqsolve(
            term, solver, 0.0, end, None, y0, parameters, stepsize_controller=control, max_steps=100_000
        )
        return found.ys[-1]

    compiled = jax.jit(jax.vmap(one))
    return lambda y0: np.asarray(compiled(y0).block_until_ready())


def against_diffrax(page: Page, options: Namespace) -> None:
    """Measure members against diffrax."""
    jax.config.update("jax_enable_x64", val=True)
    case = next(one for one in CASES if one.name == "double")
    system, y0 = case.system(), starts(case, options.members)
    end, errors = SPANS[case.name], Errors(case, system, y0)
    rows, times = [], {}
    for name, solver in (("Tsit5", diffrax.Tsit5()), ("Dopri8", diffrax.Dopri8())):
        tolerance, run, error = loosest(partial(mapped, system, end, solver), y0, errors)
        times[f"diffrax {name}"] = best({name: partial(run, y0)}, rounds=options.rounds)[name] / len(y0)
        rows.append((f"diffrax {name}", f"{tolerance:.0e}", f"{error:.1e}", microseconds(times[f"diffrax {name}"])))
    for method in METHODS:
        tolerance, run, error = loosest(partial(members, case, system, method), y0, errors)
        times[method] = best({method: partial(run, y0)}, rounds=options.rounds)[method] / len(y0)
        rows.append((f"lagrange {method}", f"{tolerance:.0e}", f"{error:.1e}", microseconds(times[method])))
    theirs = min(seconds for name, seconds in times.items() if name.startswith("diffrax"))
    mine = min(times[method] for method in METHODS)
    page.text(
        f"## Against diffrax {diffrax.__version__}, with `jit` and `vmap`, jax {jax.__version__}\n\n"
        f"{len(y0)} double pendulums at an error of {ERROR:g}, on one core, processor time of all threads. "
        f"The fastest of diffrax takes {shown(theirs / mine)} times as long as the fastest of ours; at least {BAR:g} "
        f"was aimed at: {verdict(BAR * mine, theirs)}."
    )
    page.table(("method", "tolerance", "error", "us a member"), rows)


def members(case: Any, system: lg.System, method: str, tolerance: float) -> Callable[[Array], Array]:
    """Return a function from starts to ends by an ensemble."""
    return lambda y0: ours(case, system, y0, method=method, rtol=tolerance, atol=tolerance)().y.T


def loosest(
    made: Callable[[float], Callable[[Array], Array]], y0: Array, errors: Errors
) -> tuple[float, Callable[[Array], Array], float]:
    """Return the largest tolerance whose error is at most the one asked for, its run, and its error."""
    for tolerance in TOLERANCES:
        run = made(tolerance)
        error = errors.of(run(y0[: len(errors.exact)]))
        if error <= ERROR:
            return tolerance, run, error
    raise SystemExit(f"no tolerance down to {TOLERANCES[-1]:g} reaches an error of {ERROR:g}")
