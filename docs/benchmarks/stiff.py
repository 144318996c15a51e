"""Stiff runs: an elastic pendulum on a spring that gets stiffer, by implicit and explicit methods and by CVODE.

python docs/benchmarks/stiff.py
python docs/benchmarks/stiff.py --methods radau5 dop853 --stiffness 1e4 1e8
"""

from __future__ import annotations

import ctypes
import math
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import sksundae
from measure import Page, best, milliseconds
from native import compiled, kernel, load_sundials
from numpy.typing import NDArray
from systems import elastic_pendulum
from taylor import PATIENCE
from taylor_systems import final_state

import lagrange as lg

T_END, ANGLE = 2.0, 1.0
STIFFNESS = (1e2, 1e4, 1e6, 1e8, 1e10)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
STEPS = (100, 400, 1600, 6400)
"""Of a method with fixed steps, in place of tolerances."""
GOALS = (1e-4, 1e-7)
LIMIT = 5.0
"""Seconds of one run, beyond which a method is not waited for."""
METHODS = (
    *("radau5", "radau3", "bdf2", "gauss2", "implicit-midpoint", "backward-euler"),
    *("cvode", "scipy-radau", "scipy-bdf", "dop853", "taylor"),
)
NATIVE, DIRECT = "CVODE, C", "CVODE, scikit-sundae"


@dataclass
class Point:
    """One run: its setting, its error at the end, its steps, and its time once it is known."""

    label: str
    setting: float
    error: float
    steps: int
    seconds: float = math.nan


class _Law(ctypes.Structure):
    """The struct `law` of cvode.c."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("rhs", "jacobian", "for_rhs", "for_jacobian", "rows")),
        *((name, ctypes.c_int64) for name in ("size", "calls", "jacobians")),
    )


class Native:
    """CVODE from the libraries that scikit-sundae brings, called by C around a model's machine code."""

    def __init__(self, model: lg.Model) -> None:
        load_sundials("cvode")
        self.run = compiled("cvode.c").run
        self.run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, *([ctypes.c_double] * 3), ctypes.c_void_p]
        size = 2 * model.dimension
        (rhs, for_rhs), (jacobian, for_jacobian) = (kernel(model, name) for name in ("rhs", "jacobian"))
        self.kept = for_rhs, for_jacobian, np.empty((size, size))
        self.law = _Law(rhs, jacobian, *(array.ctypes.data for array in self.kept), size)
        self.steps = ctypes.c_long()

    def __call__(self, y0: NDArray[Any], rtol: float, atol: float) -> NDArray[Any]:
        """Return the state at the end."""
        y = y0.copy()
        flag = self.run(ctypes.byref(self.law), y.ctypes.data, T_END, rtol, atol, ctypes.byref(self.steps))
        if flag < 0:
            raise RuntimeError(f"CVODE failed with {flag}")
        return y


class Direct:
    """CVODE as scikit-sundae calls it: a Python function around the same machine code, no steps kept."""

    def __init__(self, model: lg.Model) -> None:
        self.values = model.parameter_array()
        self.kernels = model.kernel("rhs"), model.kernel("jacobian")
        self.calls = 0

    def __call__(self, y0: NDArray[Any], rtol: float, atol: float) -> NDArray[Any]:
        """Return the state at the end."""
        (rhs, jacobian), values = self.kernels, self.values

        def slope(t: float, y: NDArray[Any], out: NDArray[Any]) -> None:
            out[:] = rhs(t, y, values)

        def matrix(t: float, y: NDArray[Any], _slope: NDArray[Any], out: NDArray[Any]) -> None:
            out[:] = jacobian(t, y, values)

        solver = sksundae.cvode.CVODE(slope, jacfn=matrix, rtol=rtol, atol=atol, max_num_steps=10**7)
        solver.init_step(0.0, y0)
        end = solver.step(T_END, "normal", T_END)
        if not end.success:
            raise RuntimeError(end.message)
        self.calls = end.nfev + end.njev
        return np.array(end.y)


class Case:
    """The pendulum at one stiffness, its reference, and all runs."""

    def __init__(self, k: float) -> None:
        self.k = k
        values = {symbol.name: value for symbol, value in lg.scene("elastic-pendulum").parameters.items()}
        m, g, rest = (values[name] for name in ("m", "g", "rest"))
        # On the slow motion k (r - rest) = m (g cos(theta) + r theta_dot**2 - r_ddot), r_ddot from that without it.
        weight, bend = m * g * math.cos(ANGLE), 3 * (m * g * math.sin(ANGLE)) ** 2 / rest
        system = elastic_pendulum(k, {"r": rest + (weight - bend / k) / k, "theta": ANGLE})
        self.model, self.y0 = system.compile(), np.array(system.statement.initial)
        self.expected = final_state(system, T_END)[0].astype(float)
        self.points: dict[str, Point] = {}
        self.calls: dict[str, Callable[[], Any]] = {}
        self.lost: dict[tuple[str, float], str] = {}

    def add(self, label: str, setting: float, call: Callable[[], NDArray[Any]], steps: Callable[[], int]) -> None:
        """Add a run that is made outside lagrange."""
        error = float(np.abs(call() - self.expected).max())
        name = f"{label} {setting:g}"
        self.points[name] = Point(label, setting, error, steps())
        self.calls[name] = call

    def ours(self, method: str, setting: float) -> None:
        """Add a run of a registered method, unless it fails or takes too long."""
        adaptive = next(row.claims.adaptive for row in lg.methods.table() if row.name == method)
        options: dict[str, Any] = {"rtol": setting, "atol": setting} if adaptive else {"step": T_END / setting}
        try:
            probe = lg.integrate(self.model, (0.0, T_END), method=method, t_eval=[T_END], max_wall=LIMIT, **options)
        except lg.StatementError:
            self.lost[method, setting] = "not for it"
            return
        if not probe.status.complete:
            self.lost[method, setting] = f"over {LIMIT:g} s" if probe.status is lg.Status.MAX_WALL else "fails"
            return
        flow = lg.flow(self.model, method=method, **options)
        self.add(method, setting, partial(flow, self.y0, 0.0, T_END), lambda: probe.steps)


def measure(page: Page, case: Case, methods: Sequence[str], rounds: int) -> tuple[list[Point], float]:
    """Measure at one stiffness, and add its table; return the points, and the price of a call through Python."""
    native, direct = Native(case.model), Direct(case.model)
    prices: list[tuple[str, str, int]] = []
    for tolerance in TOLERANCES:
        case.add(NATIVE, tolerance, partial(native, case.y0, tolerance, tolerance), lambda: native.steps.value)
        case.add(DIRECT, tolerance, partial(direct, case.y0, tolerance, tolerance), lambda: native.steps.value)
        prices.append((f"{NATIVE} {tolerance:g}", f"{DIRECT} {tolerance:g}", direct.calls))
    claims = {row.name: row.claims for row in lg.methods.table()}
    for method in methods:
        for setting in TOLERANCES if claims[method].adaptive else STEPS:
            case.ours(method, setting)
    for name, seconds in best(case.calls, rounds=rounds, patience=PATIENCE).items():
        case.points[name].seconds = seconds
    at = {(p.label, k): p for p in case.points.values() for k in [p.setting]}
    rows = []
    for label in (NATIVE, DIRECT, *methods):
        fixed = label in claims and not claims[label].adaptive
        settings = STEPS if fixed else TOLERANCES
        cells = [shown_point(at.get((label, k)), case.lost.get((label, k), "none")) for k in settings]
        rows.append([label + (" (fixed steps)" if fixed else ""), *cells])
    page.text(f"## k = {case.k:.0e}: springing is {math.sqrt(case.k) / math.pi:.3g} times as fast as swinging")
    page.table(("method", *(f"{t:.0e}: ms, error, steps" for t in TOLERANCES)), rows)
    extra = [(case.points[b].seconds - case.points[a].seconds) / calls for a, b, calls in prices]
    return list(case.points.values()), float(np.median(extra))


def shown_point(point: Point | None, otherwise: str) -> str:
    """Return time, error and steps."""
    return f"{milliseconds(point.seconds)}, {point.error:.0e}, {point.steps}" if point else otherwise


def summary(page: Page, found: dict[float, list[Point]], methods: Sequence[str]) -> None:
    """Add the tables of the least times for an error."""
    for goal in GOALS:
        page.text(f"## Least time in ms of those runs whose error is at most {goal:.0e}")
        rows = []
        for label in (NATIVE, DIRECT, *methods):
            cells = []
            for points in found.values():
                good = [p.seconds for p in points if p.label == label and p.error <= goal]
                cells.append(milliseconds(min(good)) if good else "none")
            rows.append([label, *cells])
        page.table(("method", *(f"k = {k:.0e}" for k in found)), rows)


def request() -> Namespace:
    """Return what the command line asks for."""
    parser = ArgumentParser(description="Time methods on a stiff elastic pendulum, and write the page.")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), help="registered names; those not here are left")
    parser.add_argument("--stiffness", nargs="+", type=float, default=list(STIFFNESS), help="spring constants in N/m")
    parser.add_argument("--rounds", type=int, default=10, help="turns of every run in the timing")
    return parser.parse_args()


def main() -> None:
    """Measure, print, and write the page."""
    options = request()
    here = lg.methods.names()
    methods = [name for name in options.methods if name in here]
    page = Page("Stiff runs", __file__)
    page.text(f"scikit-sundae {sksundae.__version__}, SUNDIALS {sksundae.SUNDIALS_VERSION}")
    found, prices = {}, []
    for k in options.stiffness:
        found[k], price = measure(page, Case(k), methods, options.rounds)
        prices.append(price)
    summary(page, found, methods)
    page.text(
        f"A call through Python costs CVODE {1e6 * min(prices):.2g} to {1e6 * max(prices):.2g} us more than one in C: "
        f"`{DIRECT}` less that for each of its calls is `{NATIVE}`, which is CVODE without the price of Python."
    )
    page.write()


if __name__ == "__main__":
    main()
