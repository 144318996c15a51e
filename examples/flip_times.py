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
from numpy.typing import NDArray
from sympy import cos

import lagrange as lg
from lagrange.show.dynamics import FirstPassage

CELLS, T_END = 160, 30.0
"""Starts along each axis, and how long a flip is waited for, in units of sqrt(l/g)."""

Array = NDArray[np.float64]


def double_pendulum() -> lg.System:
    """Return two equal masses on two equal rods, in units of these."""
    theta1, theta2 = lg.coordinates("theta1 theta2")
    kinetic = theta1.dot**2 + theta2.dot**2 / 2 + theta1.dot * theta2.dot * cos(theta1 - theta2)
    return lg.System(kinetic=kinetic, potential=-2 * cos(theta1) - cos(theta2), name="double pendulum")


def flip_times(cells: int = CELLS, t_end: float = T_END) -> FirstPassage:
    """Return the first time at which a rod goes over the top, for starts at rest."""
    axis = (-3.1, 3.1, cells)
    return lg.first_passage(double_pendulum(), {"theta1": axis, "theta2": axis}, t_end=t_end, rtol=1e-8)


def energies(found: FirstPassage) -> Array:
    """Return the energy of each start, (m, k) as the times of the map."""
    theta1, theta2 = np.meshgrid(found.plane[0].values, found.plane[1].values)
    return np.asarray(-2 * np.cos(theta1) - np.cos(theta2))


def picture(found: FirstPassage, path: Path) -> None:
    """Draw the map, and the lens inside of which nothing can flip."""
    figure = found.plot(style="dark")
    axis = figure.axes[0]
    places = found.plane[0].values, found.plane[1].values
    axis.contour(*places, energies(found), levels=[-1.0], colors="#e6e6e6", linewidths=1.2, linestyles="--")
    axis.annotate("the energy forbids a flip", (0.0, 0.0), ha="center", color="#e6e6e6", fontsize=10)
    axis.set_title("double pendulum from rest: how long until a rod goes over the top?", loc="left", fontsize=11)
    figure.savefig(path, dpi=150)


def main(folder: Path = Path("out")) -> FirstPassage:
    """Print how many starts flip, save the picture and return the map."""
    began = perf_counter()
    found = flip_times()
    print(f"{found.message} That took {perf_counter() - began:.1f} s.")
    low = energies(found) < -1.0
    flipped = int((found.which[low] >= 0).sum())
    print(f"{low.mean():.1%} of the starts have too little energy for a flip; {flipped} of these flipped.")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "flip_times.png"
    picture(found, path)
    print(f"written to {path}")
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
