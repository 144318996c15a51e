"""The flip-time map of the double pendulum: when, from rest at two angles, one of its rods first goes over the top.

Colours show how long that takes. Where the energy is too low nothing flips [1]: with equal masses and rods, g = l = 1,

    V = -2 cos(theta1) - cos(theta2) < -1

keeps the lower rod from the top: with the upper one hanging V is -1 there. Around this lens the border of the colours
is a fractal: two neighbours on it part, and flip at times that have nothing to do with one another.

[1] J. S. Heyl, The double pendulum fractal, 2008.

    python examples/flip_times.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from matplotlib.colors import LogNorm
from numpy.typing import NDArray
from sympy import cos

import lagrange as lg

CELLS, T_END = 160, 30.0
"""Starts along each axis, and how long a flip is waited for, in units of sqrt(l/g)."""

Array = NDArray[np.float64]


def double_pendulum() -> lg.System:
    """Return two equal masses on two equal rods, in units of these."""
    theta1, theta2 = lg.coordinates("theta1 theta2")
    kinetic = theta1.dot**2 + theta2.dot**2 / 2 + theta1.dot * theta2.dot * cos(theta1 - theta2)
    return lg.System(kinetic=kinetic, potential=-2 * cos(theta1) - cos(theta2), name="double pendulum")


def flips(cells: int = CELLS, t_end: float = T_END) -> lg.Ensemble:
    """Return runs from rest, each until a rod goes over the top: cos(theta/2) is zero there."""
    system, axis = double_pendulum(), (-3.1, 3.1, cells)
    tops = [lg.event(cos(theta / 2), terminal=True) for theta in system.coordinates]
    starts = lg.grid({"theta1": axis, "theta2": axis})
    return lg.ensemble(system, t_end, starts, rtol=1e-8, events=tops, keep=("end", ("events", 1)))


def flip_times(runs: lg.Ensemble) -> Array:
    """Return when each member first flips, (members,), NaN where it does not."""
    upper, lower = (times[:, 0] for times in runs.t_events)
    return np.asarray(np.fmin(upper, lower))


def energies(runs: lg.Ensemble) -> Array:
    """Return the energy of each start, (members,)."""
    return np.asarray(-2 * np.cos(runs.given("theta1")) - np.cos(runs.given("theta2")))


def picture(runs: lg.Ensemble, path: Path) -> None:
    """Draw the map, and the lens inside of which nothing can flip."""
    cells = round(len(runs) ** 0.5)
    across, upwards, energy, times = (
        values.reshape(cells, cells).T
        for values in (runs.given("theta1"), runs.given("theta2"), energies(runs), flip_times(runs))
    )
    figure = lg.figure()
    axis = figure.axes[0]
    first = float(np.nanquantile(times, 0.02))
    drawn = axis.pcolormesh(across, upwards, times, cmap="viridis_r", norm=LogNorm(first, float(np.nanmax(times))))
    figure.colorbar(drawn, label="time of the first flip")
    axis.contour(across, upwards, energy, levels=[-1.0], colors="#444444", linewidths=1.2, linestyles="--")
    axis.annotate("the energy forbids a flip", (0.0, 0.0), ha="center", fontsize=10)
    axis.set(xlabel="theta1", ylabel="theta2", aspect="equal")
    axis.set_title("double pendulum from rest: how long until a rod goes over the top?", loc="left", fontsize=11)
    figure.savefig(path, dpi=150)


def main(folder: Path = Path("out")) -> lg.Ensemble:
    """Print how many starts flip, save the picture and return the runs."""
    began = perf_counter()
    runs = flips()
    flipped, low = np.isfinite(flip_times(runs)), energies(runs) < -1.0
    print(f"{flipped.sum()} of {len(runs)} starts flipped. That took {perf_counter() - began:.1f} s.")
    print(f"{low.mean():.1%} of the starts have too little energy for a flip; {flipped[low].sum()} of these flipped.")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "flip_times.png"
    picture(runs, path)
    print(f"written to {path}")
    return runs


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
