"""Three magnets below a pendulum: over which of them it comes to rest, for each start at rest.

The bob moves in a plane, with a spring for gravity, friction, and three attracting magnets at the distance d below:

    x'' = -c x' - k x - sum_i (x - a_i)/((x - a_i)^2 + (y - b_i)^2 + d^2)^(3/2), and so for y.

Each colour is a magnet. Near the borders, which are fractal, a start tells little
about the end, though the law leaves nothing to chance [1]. Turned by 120 degrees the picture is itself, with
the colours exchanged.

[1] H.-O. Peitgen, H. Jurgens, D. Saupe, Chaos and Fractals, 2nd ed., 2004, section 12.8.

    python examples/magnet_pendulum.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray
from sympy import sqrt

import lagrange as lg

CELLS, T_END = 200, 150.0
"""Starts along each axis; a time after which friction has left exp(-c t/2) = 3e-7 of a small oscillation."""

MAGNETS = tuple((float(np.cos(a)), float(np.sin(a))) for a in np.radians([90.0, 210.0, 330.0]))
"""On a circle of radius 1."""


def magnet_pendulum() -> lg.System:
    """Return the bob, of mass 1, its place measured from the point over which the pendulum hangs."""
    x, y = lg.coordinates("x y")
    c, k, d = lg.parameters("c k d")
    pull = sum(1 / sqrt((x - a) ** 2 + (y - b) ** 2 + d**2) for a, b in MAGNETS)
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=k * (x**2 + y**2) / 2 - pull,
        dissipation=c * (x.dot**2 + y.dot**2) / 2,
        parameters={c: 0.2, k: 0.5, d: 0.25},
        name="magnet pendulum",
    )


def rests(cells: int = CELLS) -> lg.Ensemble:
    """Return runs that start at rest and have come to rest."""
    starts = lg.grid({"x": (-2.0, 2.0, cells), "y": (-2.0, 2.0, cells)})
    return lg.ensemble(magnet_pendulum(), T_END, starts, rtol=1e-9)


def nearest(runs: lg.Ensemble) -> NDArray[np.int_]:
    """Return the magnet that each member ends next to, (members,)."""
    places = runs.y[:2].T
    return np.asarray(np.linalg.norm(places[:, None] - np.array(MAGNETS), axis=-1).argmin(axis=1))


def picture(runs: lg.Ensemble, path: Path) -> None:
    """Draw a colour for each start."""
    cells = round(len(runs) ** 0.5)
    across, upwards, magnet = (
        values.reshape(cells, cells).T for values in (runs.given("x"), runs.given("y"), nearest(runs))
    )
    figure = lg.figure()
    axis = figure.axes[0]
    axis.pcolormesh(across, upwards, magnet, cmap=ListedColormap(["#0b6e99", "#d1495b", "#edae49"]))
    axis.plot(*zip(*MAGNETS, strict=True), "o", color="white", markeredgecolor="black")
    axis.set(xlabel="x", ylabel="y", aspect="equal")
    axis.set_title("a pendulum over three magnets: where does it come to rest?", loc="left", fontsize=11)
    figure.savefig(path, dpi=150)


def main(folder: Path = Path("out")) -> lg.Ensemble:
    """Print where the bob comes to rest and how often, save the picture and return the runs."""
    began = perf_counter()
    runs = rests()
    magnet = nearest(runs)
    print(f"{len(runs)} runs took {perf_counter() - began:.1f} s.")
    for k in range(len(MAGNETS)):
        x, y = np.median(runs.y[:2, magnet == k], axis=1)
        print(f"at rest at ({x:6.3f}, {y:6.3f}): {(magnet == k).mean():.1%} of the starts")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "magnet_pendulum.png"
    picture(runs, path)
    print(f"written to {path}")
    return runs


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
