"""Hard cases: one table of errors against independent truths.

python docs/benchmarks/hard_cases.py
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import thread_time
from typing import Any

import hard_systems as systems
import numpy as np
import taylor_systems
from long_runs import blocks, long_run
from measure import Page, milliseconds, shown
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import mathieu_a
from systems import henon_heiles
from taylor_systems import final_state

import lagrange as lg

STARTS, TRUST_ERROR, TRUST_SPAN = 200, 1e-3, 40.0
"""Random starts of the double pendulum, the error that its runs are trusted to hold to, and how long they are."""

TRUSTED: tuple[tuple[str, dict[str, float]], ...] = (
    ("taylor", {}),
    ("taylor", {"rtol": 1e-15, "atol": 1e-16}),
    ("dop853", {"rtol": 1e-6, "atol": 1e-6}),
    ("rk4", {"step": 1e-3}),
)
"""Methods and settings whose horizons are held against the truth: rough, and at the edge of round-off."""

LONGEST = 60.0
"""Seconds that a run may take."""

PER_BLOCK, BLOCKS = 100_000, 100
TIGHT: dict[str, Any] = {"rtol": 1e-13, "atol": 1e-16}
HEAD = ("case", "method", "error against the truth", "time / ms", "remark")


@dataclass(frozen=True)
class Line:
    """A line of the table."""

    case: str
    method: str
    error: float | str
    seconds: float
    remark: str = ""

    def cells(self) -> tuple[str, ...]:
        """Return the line as text."""
        error = self.error if isinstance(self.error, str) else f"{self.error:.1e}"
        return self.case, f"`{self.method}`" if self.method else "", error, milliseconds(self.seconds), self.remark


def own(least: int = 5) -> list[str]:
    """Return the adaptive methods that are not another package's, of some order at least."""
    rows = (row for row in lg.methods.table() if not row.name.startswith(("scipy-", "cvode")))
    return [row.name for row in rows if row.claims.adaptive and row.claims.order >= least]


def taken(
    model: lg.Model, end: float, initial: dict[str, float] | None, method: str, **options: Any
) -> tuple[lg.Solution | None, float, str]:
    """Return a run, its seconds, and why there is none: the first sentence of the refusal or of the early end."""
    try:
        lg.integrate(model, (0.0, end), initial, method=method, **options, max_steps=1)
        began = thread_time()
        solution = lg.integrate(model, (0.0, end), initial, method=method, max_wall=LONGEST, **options)
    except lg.StatementError as error:
        return None, 0.0, f"refused: {str(error).split('. ')[0]}"
    seconds = thread_time() - began
    if not solution.status.complete:
        return None, seconds, f"{solution.status.value} at t = {solution.t[-1]:.6g}"
    return solution, seconds, ""


def against(
    case: str,
    model: lg.Model,
    end: float,
    truth: NDArray[Any],
    *,
    initial: dict[str, float] | None = None,
    remark: str = "",
    only: tuple[str, ...] = (),
    options: dict[str, Any] | None = None,
) -> Iterator[Line]:
    """Yield a line for every method, its error the largest of the final state."""
    for method in only or own():
        solution, seconds, why = taken(model, end, initial, method, **(TIGHT if options is None else options))
        if solution is None:
            yield Line(case, method, "-", seconds, why)
        else:
            yield Line(case, method, float(np.abs(solution.y[:, -1] - truth).max()), seconds, remark)


def kepler() -> Iterator[Line]:
    """Near-parabolic orbits, three and a bit revolutions from the pericentre, against Kepler's equation."""
    model = taylor_systems.kepler().compile()
    for e in (0.99, 0.9999):
        start = systems.pericentre(e)
        end = 20.0
        truth = systems.kepler_state(start, end)
        yield from against(
            f"Kepler, e = {e}",
            model,
            end,
            truth,
            initial=start,
            remark="Kepler's equation, 40 digits, from the same doubles",
        )


def three_bodies() -> Iterator[Line]:
    """Burrau's bodies at rest, and the figure-eight."""
    burrau, eight = systems.burrau(), systems.figure_eight()
    for end in (10.0, 60.0):
        truth, doubt = final_state(burrau, end)
        remark = f"80-bit Taylor run, known to {doubt:.0e}"
        yield from against(f"Burrau's three bodies, t = {end:g}", burrau.compile(), end, truth, remark=remark)
    yield systems_end(burrau)
    model = eight.compile()
    start = np.array(eight.statement.initial)
    yield from against(
        "figure-eight, one period", model, systems.EIGHT_PERIOD, start, remark="it returns; 14 published digits"
    )


def systems_end(burrau: lg.System) -> Line:
    """What becomes of Burrau's bodies: the one of mass 3 leaves the other two, which are bound."""
    began = thread_time()
    solution = burrau.run(80.0, method="taylor", **TIGHT).require()
    seconds = thread_time() - began
    outcome = systems.outcome(solution.y[:, -1])
    return Line("Burrau's three bodies, the end", "taylor", outcome, seconds, "published: 3 escapes, 4 and 5 are bound")


def kapitza() -> Iterator[Line]:
    """The amplitude of the pivot from which the inverted pendulum is stable, against Mathieu's a_0."""
    system = systems.kapitza()
    model = system.compile()
    value = {symbol.name: number for symbol, number in system.parameters.items()}
    omega, g, l = value["omega"], value["g"], value["l"]
    period = 2 * np.pi / omega
    truth = l / 2 * brentq(lambda q: mathieu_a(0, q) + 4 * g / (l * omega**2), 1e-3, 0.8, xtol=1e-15)
    tiny = 1e-9  # the flow is linear to its square
    for method in own():
        try:
            flow = lg.flow(model, method=method, rtol=1e-13, atol=1e-25)

            def trace(amplitude: float, flow: Any = flow) -> float:
                changed = {"a": amplitude}
                first = flow(np.array([tiny, 0.0]), 0.0, period, changed)
                second = flow(np.array([0.0, tiny]), 0.0, period, changed)
                return float((first[0] + second[1]) / tiny - 2)

            began = thread_time()
            found = brentq(trace, 0.5 * truth, 1.5 * truth, xtol=1e-16, rtol=1e-14)
        except lg.LagrangeError as error:
            yield Line("Kapitza's pendulum, threshold", method, "-", 0.0, str(error).split(". ")[0])
            continue
        leading = np.sqrt(2 * g * l) / omega
        yield Line(
            "Kapitza's pendulum, threshold",
            method,
            abs(found - truth) / truth,
            thread_time() - began,
            f"amplitude {found:.12f}; a^2 omega^2 = 2 g l gives {leading:.6f}",
        )


def spherical() -> Iterator[Line]:
    """A spherical pendulum past its lower pole, in angles, against Cartesian coordinates in 80 bits."""
    model = systems.spherical().compile()
    for turn in (1e-2, 1e-4, 1e-6):
        initial = {"theta": 1.0, "phi_dot": turn}
        truth, doubt = systems.spherical_truth(1.0, turn, systems.SPHERICAL_END)
        for method in own():
            solution, seconds, why = taken(model, systems.SPHERICAL_END, initial, method, **TIGHT)
            case = f"spherical pendulum past the pole, phi' = {turn:g}"
            if solution is None:
                yield Line(case, method, "-", seconds, why)
                continue
            place = systems.cartesian(*solution.y[:2, -1])
            remark = f"Cartesian, known to {doubt:.0e}; passes at {np.abs(np.sin(solution['theta'])).min():.0e} rad"
            yield Line(case, method, float(np.abs(place - truth).max()), seconds, remark)


def thin() -> Iterator[Line]:
    """A double pendulum whose lower mass is next to nothing: the upper one does not feel it."""
    system = systems.light_double_pendulum(1e-12)
    truth, doubt = final_state(system, 10.0)
    alone = systems.pendulum_angle(1.0, 9.81, 10.0)
    near = abs(truth[0] - alone)
    remark = f"80-bit Taylor run, known to {doubt:.0e}; its upper angle is a single pendulum's to {near:.0e}"
    yield from against("double pendulum, m2 = 1e-12", system.compile(), 10.0, truth, remark=remark)


def stiff() -> Iterator[Line]:
    """An elastic pendulum with ever stiffer springs."""
    for k in (1e2, 1e4, 1e6, 1e8, 1e10):
        system = systems.elastic_pendulum(k)
        end = 1.0
        truth, doubt = final_state(system, end)
        remark = f"80-bit Taylor run, known to {doubt:.0e}; {np.sqrt(k) * end / (2 * np.pi):.0f} oscillations"
        options = {"rtol": 1e-10, "atol": 1e-12}
        yield from against(
            f"elastic pendulum, k = {k:.0e}", system.compile(), end, truth, remark=remark, options=options
        )


def rigid_body() -> Iterator[Line]:
    """A free body that flips about its middle axis, stated in Euler's angles, against Jacobi's functions."""
    system = systems.rigid_body()
    model = system.compile()
    for method in own():
        solution, seconds, why = taken(model, systems.BODY_END, None, method, **TIGHT)
        case = f"free rigid body, {systems.flips()} flips of its middle axis"
        if solution is None:
            yield Line(case, method, "-", seconds, why)
            continue
        found = systems.body_rates(solution.y)
        error = np.abs(found - systems.jacobi_rates(solution.t)).max()
        remark = f"sn, cn, dn at every step; gimbal lock passed at {np.abs(np.sin(solution['theta'])).min():.1g}"
        yield Line(case, method, float(error), seconds, remark)


def ten_million() -> Iterator[Line]:
    """The slope of the energy error over 1e7 steps: every symplectic method, and RK4 for comparison."""
    model = henon_heiles().compile()
    for row in lg.methods.table():
        if not (row.claims.symplectic or row.name == "rk4") or row.claims.adaptive:
            continue
        count = BLOCKS if row.claims.explicit else BLOCKS // 10
        case = f"Henon-Heiles, {count * PER_BLOCK:.0e} steps of 0.05"
        try:
            run = long_run(blocks(model, row.name, 0.05 * PER_BLOCK, count, step=0.05))
        except lg.LagrangeError as error:
            yield Line(case, row.name, "-", 0.0, str(error).split(". ")[0])
            continue
        slope, width = run.slope()
        verdict = "a drift" if run.drifts() else "no drift"
        remark = f"slope of the energy {slope:+.1e} ± {width:.0e} per unit of time: {verdict}"
        yield Line(case, row.name, f"largest {run.largest.max():.1e}", run.seconds, remark)


def scales() -> Iterator[Line]:
    """One orbit and one pendulum in units from 1e-30 to 1e30: numbers that only scale must agree."""
    for name, error_of in (
        ("Kepler orbit", systems.scaled_kepler),
        ("double pendulum", systems.scaled_double_pendulum),
    ):
        for method in own():
            began = thread_time()
            try:
                worst = max(error_of(method, 10.0**power) for power in (-30, -20, -10, 0, 10, 20, 30))
            except lg.LagrangeError as error:
                yield Line(f"{name}, lengths from 1e-30 to 1e30", method, "-", 0.0, str(error).split(". ")[0])
                continue
            remark = (
                "largest difference from the run in natural units, in those; masses and times scale as well. Taylor's "
                "steps scale; where other steps are taken, runs differ by their errors"
            )
            yield Line(f"{name}, lengths from 1e-30 to 1e30", method, worst, thread_time() - began, remark)


def trust() -> Iterator[Line]:
    """The trust horizon of a chaotic double pendulum over random starts."""
    claims = systems.Claims(TRUST_SPAN, TRUST_ERROR)
    for method, options in TRUSTED:
        began = thread_time()
        times, errors = zip(*(claims.held(seed, method, options) for seed in range(STARTS)), strict=True)
        worst = max(errors) / TRUST_ERROR
        over = sum(error > TRUST_ERROR for error in errors)
        usual = f"{min(times):.2g} to {max(times):.2g} s, median {np.median(times):.2g}"
        setting = ", ".join(f"{key} = {value:g}" for key, value in options.items()) or "default tolerances"
        yield Line(
            f"double pendulum at high energy, {STARTS} starts, trusted to {TRUST_ERROR:g}",
            method,
            f"{worst:.2f} of the claim at worst",
            (thread_time() - began) / STARTS,
            f"{setting}: {over} over-claimed; horizons {usual}",
        )


CASES = (trust, kepler, three_bodies, kapitza, spherical, thin, stiff, rigid_body, scales, ten_million)


def main() -> None:
    """Run, print and write the page."""
    page = Page("Hard cases", __file__)
    lines: list[Line] = []
    for case in CASES:
        began = thread_time()
        for line in case():
            lines.append(line)
            print(*line.cells(), sep=" | ", flush=True)
        print(f"{case.__name__}: {shown(thread_time() - began)} s\n")
    page.table(HEAD, [line.cells() for line in lines])
    page.write()


if __name__ == "__main__":
    main()
