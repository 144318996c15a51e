"""Cost of events, resets and switching surfaces: sections, bounces, a billiard and switching forces.

python docs/benchmarks/events.py --only pendulum henon-heiles
"""

from __future__ import annotations

import json
import math
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import thread_time
from typing import Any

import heyoka as hy
import numpy as np
from measure import Page, best, in_new_process, microseconds, milliseconds, shown, verdict
from scipy.integrate import solve_ivp
from stadium import START, reflections, rival_stadium, stadium, walls
from sympy import Abs, Expr, Max, cos, lambdify, sign
from taylor_systems import CASES, MODES, Case, equations

import lagrange as lg

SPANS = {
    "pendulum": 200.0,
    "henon-heiles": 2000.0,
    "kepler": 400 * np.pi,
    "double": 100.0,
    "solar": 500_000.0,
    "chain5": 50.0,
    "chain10": 20.0,
}
"""The time at the end of each run."""

TOLERANCES, COARSE = (1e-9, 1e-15), 1e-9
EVENT_BAR, OWN_BAR, FIVE_BAR, DOP853_BAR = 1.0, 1.5, 2.0, 1.6
BOUNCE_BAR, MILLION_BAR, BILLIARD_BAR, SURFACE_BAR = 4.0, 4.0, 20.0, 5.0
REFLECTIONS, BOUNCES, ROOM = 100_000, 1_000_000, 64_000_000
MOST_STEPS = 10_000_000
FREE_PATH = 2.17
"""The mean time between two reflections in the stadium, nearly: pi times its area by its circumference."""

Calls = dict[str, Callable[[], Any]]


@dataclass(frozen=True)
class Run:
    """A case, its model, and the functions that are watched along it: the first is the section."""

    case: Case
    system: lg.System
    model: lg.Model
    watched: Sequence[Expr]

    def integrate(self, method: str, tolerance: float, count: int) -> lg.Solution:
        """Run by a method of ours with the first so many events."""
        return lg.integrate(
            self.model,
            (0.0, SPANS[self.case.name]),
            self.case.initial(self.model),
            method=method,
            rtol=tolerance,
            events=list(self.watched[:count]),
        )

    def modes(self, tolerance: float) -> list[str]:
        """Return the modes of heyoka that compile in a minute."""
        return [mode for mode in MODES if mode == "compact" or self.case.unrolled <= tolerance]

    def rival(self, mode: str, tolerance: float) -> Callable[[], list[float]]:
        """Return a run of heyoka's, which gives the times of the section."""
        plain = self.system.statement.plain
        table = {symbol: hy.expression(value) for symbol, value in self.system.parameters.items()}
        function = hy.from_sympy(self.watched[0].xreplace(plain), s_dict=table)
        found: list[float] = []
        event = hy.nt_event(function, callback=lambda _, t, __: found.append(t))
        start, end = self.case.starts()[0], SPANS[self.case.name]
        taylor = hy.taylor_adaptive(
            equations(self.case, self.system, float),
            start,
            tol=tolerance,
            compact_mode=MODES[mode],
            nt_events=[event],
        )

        def run() -> list[float]:
            found.clear()
            taylor.time = 0.0
            taylor.state[:] = start
            taylor.propagate_until(end)
            return found

        return run


def stated(case: Case) -> Run:
    """Return a case with five functions of its coordinates and velocities that vanish again and again."""
    system = case.system()
    q = system.coordinates
    if case.name == "pendulum":
        (x,) = q
        watched = [x, x.dot, x - 1, x + 1, x.dot - x]
    elif case.name == "solar":
        sun, jupiter, saturn = q[0:3], q[3:6], q[6:9]
        watched = [jupiter[1] - sun[1], jupiter[0] - sun[0], saturn[1] - sun[1], saturn[0] - sun[0], jupiter[0].dot]
    else:
        x, y = q[0], q[-1]
        watched = [x, y, x.dot, y.dot, x - y]
        if case.name == "kepler":
            watched[0], watched[1] = y, x
    return Run(case, system, system.compile(), watched)


def agree(run: Run, tolerance: float, theirs: Callable[[], list[float]]) -> tuple[int, int, float]:
    """Return how many crossings both sides find behind the start, and how far the first ten are apart."""
    ours, others = run.integrate("taylor", tolerance, 1).t_events[0], np.array(theirs())
    others = others[others > 0]
    first = min(10, len(ours), len(others))
    return len(ours), len(others), float(np.abs(ours[:first] - others[:first]).max(initial=0.0))


def sections(page: Page, options: Namespace) -> None:
    """Compare runs with a section against heyoka's, and against our own without it."""
    rows, ratios = [], []
    for case in (each for each in CASES if each.name in options.only and each.name in SPANS):
        run = stated(case)
        for tolerance in TOLERANCES:
            counts = {"without": 0, "one": 1, "five": 5}
            calls: Calls = {k: partial(run.integrate, "taylor", tolerance, n) for k, n in counts.items()}
            rivals = {mode: run.rival(mode, tolerance) for mode in run.modes(tolerance)}
            theirs = best(rivals, rounds=3)
            mode = min(theirs, key=lambda each: theirs[each])
            t = best(calls, rounds=options.rounds)
            beside = best({"one": calls["one"], mode: rivals[mode]}, rounds=options.rounds)
            ours, others, apart = agree(run, tolerance, rivals[mode])
            five = sum(map(len, run.integrate("taylor", tolerance, 5).t_events))
            steps = run.integrate("taylor", tolerance, 0).steps
            rows.append(
                (
                    case.name,
                    f"{tolerance:g}",
                    steps,
                    *(ours, others, five, f"{apart:.0e}"),
                    *(milliseconds(t[k]) for k in counts),
                    milliseconds(beside[mode]),
                )
            )
            shares = (beside["one"] / beside[mode], t["one"] / t["without"], t["five"] / t["without"])
            bars = (EVENT_BAR, OWN_BAR, FIVE_BAR)
            judged = [
                cell for share, bar in zip(shares, bars, strict=True) for cell in (shown(share), verdict(share, bar))
            ]
            ratios.append((case.name, f"{tolerance:g}", *judged, f"{1e9 * (t['one'] - t['without']) / steps:.0f}"))
    page.text(
        "## A section that does not end the run: `taylor` against heyoka's `nt_event`, ms a run\n\n"
        "Our own runs take turns among themselves, and the one with an event again with heyoka's: behind runs in its "
        "compact mode short runs of ours took up to twice their time."
    )
    head: tuple[str, ...] = ("system", "tolerance", "steps", "crossings", "heyoka's", "of five", "first ten apart")
    page.table((*head, "without", "one event", "five events", "heyoka, one event"), rows)
    head = ("system", "tolerance", "one / heyoka's", f"at most {EVENT_BAR:g}", "one / without", f"at most {OWN_BAR:g}")
    page.table((*head, "five / without", f"at most {FIVE_BAR:g}", "one event, ns a step"), ratios)


def other_methods(page: Page, options: Namespace) -> None:
    """Compare dop853 with and without a section; beside it SciPy's solver with one, on our right-hand side."""
    rows = []
    for case in (each for each in CASES if each.name in options.only and each.name in SPANS):
        run = stated(case)
        calls: Calls = {str(n): partial(run.integrate, "dop853", COARSE, n) for n in (0, 1, 5)}
        t = best(calls | {"SciPy": partial(scipy_section, run)}, rounds=options.rounds)
        ratio, scipy = t["1"] / t["0"], t["SciPy"] / t["1"]
        found, theirs = len(calls["1"]().t_events[0]), int((scipy_section(run).t_events[0] > 0).sum())
        numbers = (*(milliseconds(t[k]) for k in calls), milliseconds(t["SciPy"]))
        judged = (shown(ratio), verdict(ratio, DOP853_BAR), shown(t["5"] / t["0"]), shown(scipy))
        rows.append((case.name, run.integrate("dop853", COARSE, 0).steps, found, theirs, *numbers, *judged))
    page.text(f"## A section with `dop853`, rtol = {COARSE:g}, ms a run")
    head = ("system", "steps", "crossings", "SciPy's", "without", "one event", "five events", "SciPy, one event")
    page.table((*head, "one / without", f"at most {DOP853_BAR}", "five / without", "SciPy / ours"), rows)


def scipy_section(run: Run) -> Any:
    """Run SciPy's DOP853 with the section."""
    statement = run.system.statement
    symbols = [statement.plain[each] for each in (*statement.coordinates, *statement.velocities)]
    function = lambdify([symbols], run.watched[0].xreplace(statement.plain), modules="math")
    span = (0.0, SPANS[run.case.name])
    return solve_ivp(
        run.model.rhs,
        span,
        run.case.starts()[0],
        method="DOP853",
        rtol=COARSE,
        atol=COARSE,
        events=lambda _, y: function(y),
    )


def bouncing_ball() -> tuple[lg.System, lg.Event, float]:
    """Return a ball, the floor that reflects it, and the time from one bounce to the next."""
    y = lg.coordinate("y")
    g = lg.parameters("g")
    system = lg.System(kinetic=y.dot**2 / 2, potential=g * y, parameters={g: 9.81}, initial={y: 1.0}, name="ball")
    return system, lg.event(y, direction=-1, reset={y.dot: -y.dot}), 2 * math.sqrt(2 / 9.81)


def bounce(model: lg.Model, floor: lg.Event, period: float, count: int, **options: Any) -> lg.Solution:
    """Run until a number of bounces have happened."""
    return lg.integrate(model, (0.0, period * count), events=[floor], max_steps=MOST_STEPS, **options)


def million(kind: str) -> None:
    """Print seconds, bounces and MB for a million bounces: what the process had at most before and behind."""
    system, floor, period = bouncing_ball()
    model = system.compile()
    for _ in range(3):
        bounce(model, floor, period, 10_000)
    options: dict[str, Any] = {}
    if kind == "outputs":
        options = {"t_eval": np.linspace(0.0, BOUNCES * period, 101), "max_memory": ROOM}
    before, started = peak(), thread_time()
    found = bounce(model, floor, period, BOUNCES, **options)
    seconds = thread_time() - started
    print(json.dumps([seconds, len(found.t_events[0]), before, peak(), found.status.value]))


def peak() -> float:
    """Return the largest memory that this process has had since it began, in MB; of Linux."""
    lines = Path("/proc/self/status").read_text("utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e3


def bounces(page: Page, options: Namespace) -> None:
    """Measure a bouncing ball: each bounce, and a million with their memory."""
    system, floor, period = bouncing_ball()
    model = system.compile()
    rows: list[tuple[Any, ...]] = []
    for method in ("taylor", "dop853"):
        count = 10_000
        run = partial(bounce, model, floor, period, count, method=method)
        each = 1e6 * best({"run": run}, rounds=options.rounds)["run"] / len(run().t_events[0])
        rows.append((method, count, shown(each), verdict(each, BOUNCE_BAR) if method == "taylor" else ""))
    page.text("## A bouncing ball: an event that resets the state")
    page.table(("method", "bounces", "us a bounce", f"taylor: at most {BOUNCE_BAR:g}"), rows)
    rows = []
    for kind, words in (("all", "all steps are kept"), ("outputs", f"101 outputs, `max_memory={ROOM:g}`")):
        seconds, found, before, after, status = in_new_process(__file__, "--million", kind)
        size = f"{after - before:.0f}"
        rows.append((words, found, status, f"{seconds:.2f}", verdict(seconds, MILLION_BAR), f"{before:.0f}", size))
    page.text(
        f"A run of {BOUNCES:,} bounces in a process of its own. The events take 24 bytes a bounce, and stay whatever "
        "is kept; MB are the most that the process had before the run, and what the run added to it."
    )
    head = ("what is kept", "bounces", "status", "seconds", f"at most {MILLION_BAR:g}", "MB before", "MB added")
    page.table(head, rows)


def billiard(page: Page, options: Namespace) -> None:
    """Compare a billiard in a stadium with heyoka's terminal events and a callback."""
    system = stadium()
    model, events, rows = system.compile(), walls(system), []
    initial = dict(zip(("x", "y", "x_dot", "y_dot"), START, strict=True))
    end = REFLECTIONS * FREE_PATH
    for tolerance in TOLERANCES:
        ours = partial(lg.integrate, model, (0.0, end), initial, events=events, rtol=tolerance, max_steps=MOST_STEPS)
        theirs = rival_stadium(end, tolerance)
        t = best({"ours": ours, "heyoka": theirs}, rounds=min(options.rounds, 5))
        solution, others = ours(), theirs()
        found, factor = reflections(solution), t["heyoka"] / others / (t["ours"] / reflections(solution))
        off = abs(math.hypot(*solution.y[2:, -1]) - 1)
        each = (microseconds(t["ours"] / found), microseconds(t["heyoka"] / others), f"{factor:.2f}")
        met = verdict(BILLIARD_BAR, factor)
        rows.append((f"{tolerance:g}", found, others, sum(map(len, solution.t_events)), f"{off:.0e}", *each, met))
    page.text(
        "## A stadium billiard: four walls that reflect a free particle\n\n"
        "heyoka has terminal events with a callback in Python for each. Circles are also passed inside the stadium, "
        "which is an event without a reflection, for both. The motion is chaotic: the numbers of reflections are "
        "alike and not equal."
    )
    head = ("tolerance", "reflections", "heyoka's", "our events", "speed is off by", "us a reflection", "heyoka, us")
    page.table((*head, "heyoka / ours", f"at least {BILLIARD_BAR:g}"), rows)


def switching(page: Page, options: Namespace) -> None:
    """Measure equations that switch: the whole run for each crossing of a surface."""
    x = lg.coordinate("x")
    cases: dict[str, tuple[dict[str, Any], Expr, float]] = {
        "bilinear spring": ({"potential": x**2 / 2 + 2 * Max(x, 0) ** 2}, x, 1.0),
        "abs(x)": ({"potential": Abs(x)}, x, 1.0),
        "dry friction": ({"potential": x**2 / 2, "forces": {x: 3 * cos(1.25 * lg.t) - sign(x.dot) / 2}}, x.dot, -5.0),
    }
    rows = []
    for name, (stated_by, surface, start) in cases.items():
        model = lg.System(kinetic=x.dot**2 / 2, coordinates=[x], initial={x: start}, **stated_by).compile()
        run = partial(lg.integrate, model, (0.0, 10_000.0), rtol=COARSE, max_steps=MOST_STEPS)
        count, solution = len(run(events=[surface]).t_events[0]), run()
        each = 1e6 * best({"run": run}, rounds=options.rounds)["run"] / count
        rows.append((name, count, solution.steps, solution.status.value, shown(each), verdict(each, SURFACE_BAR)))
    page.text(
        f"## Crossing a switching surface, `taylor`, rtol = {COARSE:g}\n\nThe time is that of the whole run for each "
        "crossing, with its steps. The friction is that of a body which is driven so that it does not stick."
    )
    page.table(("force", "crossings", "steps", "status", "us a crossing", f"at most {SURFACE_BAR:g}"), rows)


def request() -> Namespace:
    """Return what is asked for on the command line."""
    parser = ArgumentParser(description="What events, resets and switching surfaces cost.")
    parser.add_argument("--only", nargs="*", default=list(SPANS), metavar="SYSTEM", help=", ".join(SPANS))
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--million", choices=("all", "outputs"), help="a million bounces in this process, and no page")
    return parser.parse_args()


def main() -> None:
    """Measure, and write the page."""
    options = request()
    if options.million:
        million(options.million)
        return
    page = Page("Events", __file__)
    sections(page, options)
    other_methods(page, options)
    bounces(page, options)
    billiard(page, options)
    switching(page, options)
    if set(options.only) == set(SPANS):
        page.write()


if __name__ == "__main__":
    main()
