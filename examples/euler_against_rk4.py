"""Euler's method against the classical Runge-Kutta method on a pendulum, with fixed steps.

Euler's method adds energy in every step, until the pendulum goes over the top; RK4 with the same step loses an amount
that the eye does not see. The errors fall with the first and with the fourth power of the step [1]. Exact is
theta = 2 asin(k sn(K - w t)), k = sin(a/2), with Jacobi's elliptic function sn [2].

[1] E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., 1993, sections II.1, II.3.
[2] NIST Digital Library of Mathematical Functions, section 22.19(i).

    python examples/euler_against_rk4.py [FOLDER]
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.special import ellipj, ellipk
from sympy import cos

import lagrange as lg

G, LENGTH, AMPLITUDE = 9.81, 1.0, 1.5
STEP, SHORT, LONG = 0.02, 1.0, 12.0
COUNTS = (50, 100, 200, 400, 800)
METHODS = {"euler": "#d1495b", "rk4": "#0b6e99"}


def pendulum() -> lg.System:
    """Return the pendulum, its angle measured from below."""
    theta = lg.coordinate("theta")
    m, g, l = lg.parameters("m g l")
    return lg.System(
        kinetic=m * l**2 * theta.dot**2 / 2,
        potential=m * g * l * (1 - cos(theta)),
        parameters={m: 1.0, g: G, l: LENGTH},
        initial={theta: AMPLITUDE},
        name="pendulum",
    )


def exact_angle(t: float) -> float:
    """Return the angle of a pendulum that starts at rest at the amplitude."""
    k2 = np.sin(AMPLITUDE / 2) ** 2
    sn, _, _, _ = ellipj(ellipk(k2) - np.sqrt(G / LENGTH) * t, k2)
    return float(2 * np.arcsin(np.sqrt(k2) * sn))


def errors(system: lg.System) -> dict[str, list[float]]:
    """Return the error of the angle after a short run with ever smaller steps, by method."""
    expected = exact_angle(SHORT)
    return {
        method: [abs(system.run(SHORT, method=method, step=SHORT / n)["theta"][-1] - expected) for n in COUNTS]
        for method in METHODS
    }


def orders(values: list[float]) -> list[float]:
    """Return the observed order between neighbours: log2 of the ratio of their errors."""
    return [float(np.log2(a / b)) for a, b in pairwise(values)]


def picture(runs: dict[str, lg.Solution], found: dict[str, list[float]], path: Path) -> None:
    """Draw the phase portraits, the energies and the errors."""
    figure = Figure(figsize=(10.6, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    phase, energy, order = (figure.add_subplot(place) for place in (grid[:, 0], grid[0, 1], grid[1, 1]))
    for method, solution in runs.items():
        colour = METHODS[method]
        phase.plot(solution["theta"], solution["theta_dot"], color=colour, linewidth=1.3, label=method)
        energy.plot(solution.t, solution.energy, color=colour, linewidth=1.3)
    phase.plot(AMPLITUDE, 0.0, "o", color="#222222", markersize=5, label="start")
    separatrix(phase)
    phase.set(xlabel="angle", ylabel="angular velocity", title=f"phase portrait, {LONG:g} s with step {STEP:g} s")
    phase.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=4, fontsize=9)
    energy.axhline(2 * G * LENGTH, color="#8a8a8a", linestyle="--", linewidth=1.0)
    energy.annotate("enough to go over the top", (0.0, 2 * G * LENGTH), (0, 4), textcoords="offset points", fontsize=8)
    energy.set(xlabel="t", title="energy", ylim=(0.0, None))
    steps = SHORT / np.array(COUNTS)
    for method, values in found.items():
        order.loglog(steps, values, "o-", color=METHODS[method], linewidth=1.3, markersize=4)
        slope = orders(values)[-1]
        order.annotate(f"order {slope:.2f}", (steps[2], values[2]), (8, -10), textcoords="offset points", fontsize=9)
    order.set(xlabel="step", title=f"error of the angle at t = {SHORT:g}")
    order.xaxis.set_minor_formatter(NullFormatter())
    for axis in (phase, energy, order):
        dress(axis)
    figure.savefig(path, dpi=130)


def separatrix(axis: Axes) -> None:
    """Draw the boundary between swinging and turning over."""
    angle = np.linspace(-np.pi, 3 * np.pi, 400)
    speed = 2 * np.sqrt(G / LENGTH) * np.abs(np.cos(angle / 2))
    axis.plot(angle, speed, color="#8a8a8a", linestyle="--", linewidth=1.0, label="swinging | turning over")
    axis.plot(angle, -speed, color="#8a8a8a", linestyle="--", linewidth=1.0)


def dress(axis: Axes) -> None:
    """Give a panel a quiet frame."""
    axis.grid(color="#e3e3e3", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set_title(axis.get_title(), loc="left", fontsize=10)
    axis.set_title("")


def main(folder: Path = Path("out")) -> dict[str, tuple[float, float]]:
    """Print the tables, save the picture and return (observed order, energy at the end) by method."""
    system = pendulum()
    found = errors(system)
    print(f"{'step':>10}" + "".join(f"  {name + ' error':>12}  {'order':>6}" for name in METHODS))
    for i, count in enumerate(COUNTS):
        cells = [f"  {found[name][i]:12.3e}  {orders(found[name])[i - 1] if i else np.nan:6.3f}" for name in METHODS]
        print(f"{SHORT / count:10.6f}" + "".join(cells))
    runs = {method: system.run(LONG, method=method, step=STEP) for method in METHODS}
    for method, solution in runs.items():
        print(f"{method}: energy {solution.energy[0]:.6f} at the start, {solution.energy[-1]:.6f} after {LONG:g} s")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "euler_against_rk4.png"
    picture(runs, found, path)
    print(f"written to {path}")
    return {method: (orders(found[method])[-1], float(runs[method].energy[-1])) for method in METHODS}


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
