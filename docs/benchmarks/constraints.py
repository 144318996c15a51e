"""Systems with constraints: runs against SUNDIALS IDA at equal error, Cartesian against angle form, and a long ladder.

python docs/benchmarks/constraints.py
"""

from __future__ import annotations

import ctypes
import random
import time
from argparse import ArgumentParser
from collections.abc import Callable
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import sksundae
import sympy
from measure import Page, best, milliseconds, shown, verdict
from native import compiled, load_sundials
from numpy.typing import NDArray
from taylor import PATIENCE

import lagrange as lg
from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.program.lower import lower

MECHANISMS = {
    "cartesian-pendulum": 10.0,
    "cartesian-double-pendulum": 5.0,
    "slider-crank": 10.0,
    "four-bar": 10.0,
    "hanging-chain": 3.0,
    "seven-body-mechanism": 0.03,
}
"""Scenes of the library, and the ends of their runs: before chaos makes rounding errors as large as the goal."""
GOAL = 1e-8
TOLERANCES = tuple(10.0**-k for k in np.arange(5.0, 13.01, 0.5))
OURS = ("taylor", "dop853")
NATIVE, DIRECT = "IDA, C", "IDA, scikit-sundae"
BARS = {NATIVE: 3.0, DIRECT: 20.0}
MOST_STEPS = 10**6
LOOPS = (10, 20, 40, 80, 160)
FLAT_LOOPS = (10, 20, 40)


class Residual:
    """The stabilised index-2 form as two programs in machine code.

    With q, v, lambda and mu: q' - v + G^T mu = 0, M v' - h - G^T lambda = 0, psi = 0, phi = 0. The second program is
    dF/dy + c dF/dy'.
    """

    def __init__(self, equations: Equations) -> None:
        e, held, graph = equations, equations.constraints, equations.graph
        m = len(held)

        def fresh(name: str, count: int) -> list[Node]:
            return [graph.symbol(f"{name} {i}", Binding.VELOCITY) for i in range(count)]

        multipliers, corrections = fresh("lambda", m), fresh("mu", m)
        y = [*e.q, *e.v, *multipliers, *corrections]
        slopes, (factor,) = fresh("slope", len(y)), fresh("factor", 1)
        rates, accelerations = slopes[: len(e.q)], slopes[len(e.q) : 2 * len(e.q)]
        pushed = held.forces(corrections)
        residual = [rate - v + push for rate, v, push in zip(rates, e.v, pushed, strict=True)]
        for row, bias, force in zip(e.mass, e.bias, held.forces(multipliers), strict=True):
            inertia = graph.sum([(1, entry * a) for entry, a in zip(row, accelerations, strict=True)])
            residual.append(inertia - bias - force)
        residual += [*held.velocities, *(phi for phi in held.positions if phi is not None)]
        given = {"y": y, "slope": slopes, "factor": [factor]}
        columns = []
        for own, slope in zip(y, slopes, strict=True):
            column = tangents(residual, {own: graph.one, slope: factor})
            columns.append([column(row) for row in residual])
        jacobian = [entry for row in zip(*columns, strict=True) for entry in row]
        self.size = len(y)
        self.residual = LlvmKernel(lower("residual", {"residual": residual}, given, e.time, e.parameters))
        self.jacobian = LlvmKernel(lower("residual_jacobian", {"jacobian": jacobian}, given, e.time, e.parameters))


class _Law(ctypes.Structure):
    """The struct `law` of ida.c."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("residual", "jacobian", "for_residual", "for_jacobian")),
        *((name, ctypes.c_void_p) for name in ("given", "rows")),
        *((name, ctypes.c_int64) for name in ("size", "calls", "jacobians")),
    )


class Case:
    """A mechanism: its state at the end to 12 digits or so, and IDA's and our runs to there."""

    def __init__(self, name: str, end: float, native: ctypes.CDLL) -> None:
        self.end, self.system = end, lg.scene(name)
        self.model = self.system.compile()
        held = self.system.consistent()
        self.initial = {key: float(value) for key, value in held.initial.items()}
        reference = self.system.run(end, self.initial, rtol=1e-15).require()
        self.y0, self.expected = reference.y[:, 0], reference.y[:, -1]
        self.scale = np.maximum(np.abs(reference.y).max(axis=1), 1e-300)
        self.parameters = self.model.parameter_array()
        self.residual, self.native = Residual(self.model.equations), native
        q, v = self.model.layout.split(self.y0)
        m = len(self.model.equations.constraints)
        multipliers = self.model.multipliers(q, v)
        self.start = np.concatenate([self.y0, multipliers, np.zeros(m)])
        self.slope = np.concatenate([self.model.rhs(0.0, self.y0), np.zeros(2 * m)])
        self.differential = np.concatenate([np.ones(len(self.y0)), np.zeros(2 * m)])
        size = self.residual.size
        self.kept = (
            self.residual.residual.prepare(self.parameters),
            self.residual.jacobian.prepare(self.parameters),
            np.empty(2 * size + 1),
            np.empty((size, size)),
        )
        kernels = self.residual.residual.address, self.residual.jacobian.address
        self.law = _Law(*kernels, *(array.ctypes.data for array in self.kept), size)
        self.steps = ctypes.c_long()

    def error(self, y: NDArray[Any]) -> float:
        """Return the largest error of a state at the end, each entry relative to its largest size along the run."""
        return float((np.abs(y[: len(self.expected)] - self.expected) / self.scale).max())

    def absolute(self, tolerance: float) -> NDArray[Any]:
        """Return absolute tolerances that leave the multipliers out of the error test, and of that of convergence."""
        return np.where(self.differential == 0.0, 1e6, tolerance)

    def by_c(self, tolerance: float) -> NDArray[Any]:
        """Return IDA's end, called from C."""
        y, slope = self.start.copy(), self.slope.copy()
        absolute = self.absolute(tolerance)
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (y, slope, self.differential, absolute)]
        numbers = [ctypes.c_double(x) for x in (self.end, tolerance)]
        flag = self.native.run(ctypes.byref(self.law), *pointers, *numbers, ctypes.byref(self.steps))
        if flag < 0:
            raise RuntimeError(f"IDA failed with {flag}")
        return y

    def by_python(self, tolerance: float) -> NDArray[Any]:
        """Return IDA's end through scikit-sundae, with the same machine code."""
        residual, jacobian, values = self.residual.residual, self.residual.jacobian, self.parameters
        given, size = np.zeros(2 * self.residual.size + 1), self.residual.size

        def law(t: float, y: NDArray[Any], slope: NDArray[Any], out: NDArray[Any]) -> None:
            given[:size], given[size:-1] = y, slope
            out[:] = residual(t, given, values)

        def matrix(
            t: float, y: NDArray[Any], slope: NDArray[Any], _r: NDArray[Any], c: float, out: NDArray[Any]
        ) -> None:
            given[:size], given[size:-1], given[-1] = y, slope, c
            out[:] = jacobian(t, given, values).reshape(size, size)

        algebraic = np.flatnonzero(self.differential == 0.0).tolist()
        solver = sksundae.ida.IDA(
            *(law,),
            jacfn=matrix,
            rtol=tolerance,
            atol=self.absolute(tolerance),
            max_num_steps=MOST_STEPS,
            algebraic_idx=algebraic,
        )
        solver.init_step(0.0, self.start, self.slope)
        end = solver.step(self.end, "normal", self.end)
        if not end.success:
            raise RuntimeError(end.message)
        return np.array(end.y)

    def ours(self, method: str) -> Callable[[float], NDArray[Any]]:
        """Return our runs by a method, as a function of the tolerance."""
        prepared = cache(partial(lg.flow, self.model, method=method))
        return lambda tolerance: prepared(rtol=tolerance)(self.y0, 0.0, self.end)


def first_good(case: Case, run: Callable[[float], NDArray[Any]]) -> tuple[float, float] | None:
    """Return the largest tolerance whose run is as accurate as the goal, and its error."""
    for tolerance in TOLERANCES:
        try:
            found = case.error(run(tolerance))
        except (RuntimeError, lg.RunError):
            continue
        if found <= GOAL:
            return tolerance, found
    return None


def against_ida(page: Page, rounds: int) -> None:
    """Add the table of runs at equal error."""
    load_sundials("ida")
    native, rows = compiled("ida.c"), []
    for name, end in MECHANISMS.items():
        case = Case(name, end, native)
        rivals = {NATIVE: case.by_c, DIRECT: case.by_python, **{method: case.ours(method) for method in OURS}}
        good = {label: first_good(case, run) for label, run in rivals.items()}
        calls = {label: partial(rivals[label], found[0]) for label, found in good.items() if found}
        seconds = best(calls, rounds=rounds, patience=PATIENCE)
        cells = [name]
        for label in rivals:
            found = good[label]
            if found is None:
                cells.append("never")
                continue
            cells.append(f"{milliseconds(seconds[label])} ({found[0]:.0e}, {found[1]:.0e})")
        for label in (NATIVE, DIRECT):
            ratio = seconds[label] / seconds["taylor"] if label in seconds and "taylor" in seconds else np.inf
            cells.append(f"{shown(ratio)} {verdict(BARS[label], ratio)}")
        rows.append(cells)
        print(cells, flush=True)
    page.text(f"## Against IDA: ms of a run whose error is at most {GOAL:.0e} (tolerance, error)")
    head = ("mechanism", *(NATIVE, DIRECT), *OURS, *(f"{label} / taylor, at least {BARS[label]:g}" for label in BARS))
    page.table(head, rows)


def angle_form() -> lg.System:
    """Return the double pendulum of the library in angles."""
    return lg.scene("double-pendulum")


def ladder(loops: int) -> tuple[lg.System, dict[Any, float]]:
    """Return the N-loop four-bar ladder in coordinates of its points, with a state in which it leans by 0.3 rad."""
    names = " ".join(f"x{i} y{i}" for i in range(loops + 1))
    flat = lg.coordinates(names)
    places = [(flat[2 * i], flat[2 * i + 1]) for i in range(loops + 1)]
    m, g, l = lg.parameters("m g l")
    feet = [(i * l, sympy.S.Zero) for i in range(loops + 1)]
    rods = [*zip(feet, places, strict=True), *pairwise(places)]
    kinetic = potential = sympy.S.Zero
    for a, b in rods:
        for p, q in zip(a, b, strict=True):
            u, w = sympy.diff(p, lg.t), sympy.diff(q, lg.t)
            kinetic += m * (u**2 + u * w + w**2) / 6
        potential += m * g * (a[1] + b[1]) / 2
    held = {f"rod_{k}": sum((q - p) ** 2 for p, q in zip(a, b, strict=True)) - l**2 for k, (a, b) in enumerate(rods)}
    start: dict[Any, float] = {}
    for i, (x, y) in enumerate(places):
        start |= {x: i + np.sin(0.3), y: np.cos(0.3), x.dot: np.cos(0.3), y.dot: -np.sin(0.3)}
    return lg.System(
        kinetic, potential, coordinates=flat, constraints=held, parameters={m: 1.0, g: 9.81, l: 1.0}
    ), start


def cartesian(page: Page) -> None:
    """Add the cost of the Cartesian double pendulum against that in angles."""
    runs: dict[str, Callable[[], Any]] = {}
    for label, system in (("angles", angle_form()), ("Cartesian", lg.scene("cartesian-double-pendulum"))):
        model = system.compile()
        y0 = np.array(system.statement.initial)
        for tolerance in (1e-9, 1e-14):
            runs[f"{label} {tolerance:g}"] = partial(lg.flow(model, rtol=tolerance), y0, 0.0, 5.0)
    seconds = best(runs)
    rows = []
    for tolerance in (1e-9, 1e-14):
        pair = [seconds[f"{label} {tolerance:g}"] for label in ("angles", "Cartesian")]
        rows.append([f"{tolerance:g}", *map(milliseconds, pair), shown(pair[1] / pair[0])])
    page.text("## The double pendulum in Cartesian coordinates, by taylor to t = 5: ms (at most 3 times)")
    page.table(("rtol", "angles", "Cartesian", "ratio"), rows)


def long_ladders(page: Page) -> None:
    """Add the growth of the cost of a step with the number of loops, and of the way to the first step."""
    rows, before = [], None
    for loops in LOOPS:
        began = time.process_time()
        system, start = ladder(loops)
        stated = time.process_time()
        first = system.run(0.01, start, rtol=1e-10).require()
        ready = time.process_time()
        probe = system.run(0.3, start, rtol=1e-10).require()
        flow = lg.flow(system.compile(), rtol=1e-10)
        seconds = best({"run": partial(flow, first.y[:, 0], 0.0, 0.3)}, rounds=5)["run"] / probe.steps
        power = "" if before is None else f"{np.log2(seconds / before):.2f}"
        rows.append([loops, shown(stated - began), shown(ready - stated), shown(1e6 * seconds), power])
        before = seconds
    page.text(
        "## The ladder of N four-bar loops by taylor at rtol = 1e-10: to state it and to its first step in s, and us a "
        "step with the power of N with which that grows"
    )
    page.table(("N", "statement", "first step", "us a step", "power"), rows)


def flat_ladder(loops: int, seed: int | None) -> tuple[lg.System, dict[Any, float]]:
    """Return a ladder of point masses that starts upright at 1 m/s, stated from one end or, with a seed, at random."""
    names = lg.coordinates(" ".join(f"x{i} y{i}" for i in range(loops + 1)))
    places = list(zip(names[::2], names[1::2], strict=True))
    rods = [*(((i, 0), place) for i, place in enumerate(places)), *pairwise(places)]
    held = [(f"rod_{k}", sum((q - p) ** 2 for p, q in zip(a, b, strict=True)) - 1) for k, (a, b) in enumerate(rods)]
    coordinates = list(names)
    if seed is not None:
        for stated in (held, coordinates):
            random.Random(seed).shuffle(stated)
    kinetic, potential = sum(q.dot**2 for q in names) / 2, 9.81 * sum(y for _, y in places)
    start: dict[Any, float] = {}
    for i, (x, y) in enumerate(places):
        start |= {x: float(i), y: 1.0, x.dot: 1.0, y.dot: 0.0}
    return lg.System(kinetic, potential, coordinates=coordinates, constraints=dict(held)), start


def flat_ladders(page: Page) -> None:
    """Add the cost of a step of ladders that pass configurations with all rods in one line."""
    rows = []
    for loops in FLAT_LOOPS:
        cells: list[Any] = [loops]
        for seed in (None, 1, 2):
            system, start = flat_ladder(loops, seed)
            run = system.run(3.0, start, rtol=1e-10).require()
            flow = lg.flow(system.compile(), rtol=1e-10)
            seconds = best({"run": partial(flow, run.y[:, 0], 0.0, 3.0)}, rounds=20)["run"]
            cells.append(shown(1e6 * seconds / run.steps))
        rows.append(cells)
        print(cells, flush=True)
    page.text(
        "## The ladder of N loops of point masses by taylor at rtol = 1e-10, from upright at 1 m/s to t = 3, over "
        "three configurations with all rods in one line: us a step, by the order of the statement"
    )
    page.table(("N", "from one end", "at random", "at random"), rows)


def main() -> None:
    """Measure, print, and write the page."""
    parser = ArgumentParser(description="Time systems with constraints, and write the page.")
    parser.add_argument("--rounds", type=int, default=10, help="turns of every run in the timing")
    parser.add_argument("--parts", nargs="+", default=["ida", "cartesian", "ladders", "flat"])
    options = parser.parse_args()
    page = Page("Systems with constraints", __file__)
    page.text(f"scikit-sundae {sksundae.__version__}, SUNDIALS {sksundae.SUNDIALS_VERSION}")
    if "ida" in options.parts:
        against_ida(page, options.rounds)
    if "cartesian" in options.parts:
        cartesian(page)
    if "ladders" in options.parts:
        long_ladders(page)
    if "flat" in options.parts:
        flat_ladders(page)
    if len(options.parts) == 4:
        page.write()


if __name__ == "__main__":
    main()
