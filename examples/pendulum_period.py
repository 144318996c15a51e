"""The period of a pendulum against its amplitude, measured from runs and compared with two formulas.

The small-angle formula T0 = 2 pi sqrt(l/g) knows nothing of the amplitude a; the exact period is
T = 4 sqrt(l/g) K(sin^2(a/2)) with the complete elliptic integral K [1].

[1] L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., 1976, section 11, problem 1.

    python examples/pendulum_period.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ellipk
from sympy import cos

import lagrange as lg

G, LENGTH = 9.81, 1.0
SMALL_ANGLE = 2 * np.pi * np.sqrt(LENGTH / G)
DEGREES = (1, 5, 10, 20, 30, 45, 60, 75, 90, 105, 120, 135, 150, 160, 170, 175, 179)


def pendulum() -> lg.System:
    """Return the pendulum, its angle measured from below."""
    theta = lg.coordinate("theta")
    m, g, l = lg.parameters("m g l")
    return lg.System(
        kinetic=m * l**2 * theta.dot**2 / 2,
        potential=-m * g * l * cos(theta),
        parameters={m: 1.0, g: G, l: LENGTH},
        name="pendulum",
    )


def measured_period(system: lg.System, amplitude: float) -> float:
    """Return the period: four times the time from rest at the amplitude to the lowest point.

    A run brackets the moment, its path between the steps gives it roughly, and Newton's method on the flow exactly.
    """
    run = system.run(10 * SMALL_ANGLE, {"theta": amplitude}, rtol=1e-13, atol=1e-15)
    below = int(np.argmax(run["theta"] < 0))
    moment = brentq(lambda t: run.at(t)[0], run.t[below - 1], run.t[below], xtol=1e-9)
    flow = lg.flow(system.compile(), rtol=1e-13, atol=1e-15)
    for _ in range(3):
        theta, velocity = flow([amplitude, 0.0], 0.0, moment)
        moment -= theta / velocity
    return 4 * float(moment)


def exact_period(amplitude: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the period by the elliptic integral."""
    period: NDArray[np.float64] = 4 * np.sqrt(LENGTH / G) * ellipk(np.sin(amplitude / 2) ** 2)
    return period


def picture(degrees: Sequence[float], measured: NDArray[np.float64], path: Path) -> None:
    """Draw the period, and how far each formula and the measurement are from the exact one."""
    figure = Figure(figsize=(7.2, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.2, 1.0))
    fine = np.linspace(0.5, 179.4, 1000)
    exact = exact_period(np.radians(fine))
    corrected = SMALL_ANGLE * (1 + np.radians(fine) ** 2 / 16)
    upper.plot(fine, exact / SMALL_ANGLE, color="#0b6e99", label="elliptic integral")
    upper.plot(fine, corrected / SMALL_ANGLE, color="#a35c00", linewidth=1.2, label="first correction, $1 + a^2/16$")
    upper.axhline(1.0, color="#d1495b", linewidth=1.2, label="small-angle formula")
    upper.plot(degrees, measured / SMALL_ANGLE, "o", color="#222222", markersize=4.5, label="measured from runs")
    upper.set(ylabel="period / small-angle period", ylim=(0.8, 4.2))
    upper.set_title("period of a pendulum against its amplitude a", loc="left", fontsize=10)
    upper.legend(frameon=False)
    lower.semilogy(fine, np.abs(SMALL_ANGLE / exact - 1), color="#d1495b", linewidth=1.2)
    lower.semilogy(fine, np.abs(corrected / exact - 1), color="#a35c00", linewidth=1.2)
    there = exact_period(np.radians(degrees))
    errors = np.maximum(np.abs(measured / there - 1), 1e-17)
    lower.semilogy(degrees, errors, "o", color="#222222", markersize=4.5)
    lower.set(xlabel="amplitude in degrees", ylabel="relative difference", xticks=range(0, 181, 30))
    lower.set_ylim(1e-17, 10)
    lower.set_title("difference from the elliptic integral", loc="left", fontsize=10)
    for axis in (upper, lower):
        dress(axis)
    figure.savefig(path, dpi=130)


def dress(axis: Axes) -> None:
    """Give a panel a quiet frame."""
    axis.grid(color="#e3e3e3", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def main(folder: Path = Path("out")) -> list[tuple[float, float, float]]:
    """Print the table, save the picture and return (degrees, measured period, exact period)."""
    system = pendulum()
    rows = []
    print(
        f"{'amplitude':>9}  {'measured, s':>14}  {'elliptic, s':>14}  {'difference':>10}  {'small-angle formula':>20}"
    )
    for degrees in DEGREES:
        amplitude = float(np.radians(degrees))
        measured, exact = measured_period(system, amplitude), float(exact_period(amplitude))
        off, naive = measured / exact - 1, SMALL_ANGLE / exact - 1
        print(f"{degrees:>8}°  {measured:14.11f}  {exact:14.11f}  {off:10.1e}  {naive:19.3%}")
        rows.append((float(degrees), measured, exact))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "pendulum_period.png"
    picture(DEGREES, np.array([row[1] for row in rows]), path)
    print(f"written to {path}")
    return rows


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
