"""A Poincare section: the star in a galaxy of Henon and Heiles [1], each time it passes x = 0 to the right.

On the section x = 0 an orbit of energy E is a point (y, y'), and x' = sqrt(2E - 2V(0, y) - y'^2) follows. Where there
is another conserved quantity the points of an orbit lie on a curve; where there is none they fill an area. At E = 1/8
there are both: islands, and chaotic orbits around them.

[1] M. Henon, C. Heiles, The applicability of the third integral of motion: some numerical experiments, Astronomical
    Journal 69, 1964, figure 5.

    python examples/poincare_section.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import lagrange as lg

ENERGY = 1 / 8
CROSSINGS = 500
LONGEST = 8.0
"""More time than an orbit of this energy takes from one crossing to the next, on the average."""

STARTS = (
    *((y, 0.0) for y in (-0.36, -0.3, -0.23, -0.15, 0.05, 0.12, 0.2, 0.26, 0.33, 0.4, 0.5, 0.58, 0.64)),
    *((0.0, speed) for speed in (-0.42, -0.35, -0.29, -0.24, 0.24, 0.29, 0.35)),
)
"""(y, y') at the start of each orbit, on the section."""

Array = NDArray[np.float64]


def star() -> lg.System:
    """Return a star of mass 1 in the plane of a galaxy."""
    x, y = lg.coordinates("x y")
    return lg.System(
        kinetic=lg.kinetic_energy(1, (x, y)), potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3, name="Henon-Heiles"
    )


def speed_through(y: float, y_dot: float) -> float:
    """Return the x' > 0 with which an orbit of the energy passes a point of the section."""
    return float(np.sqrt(2 * ENERGY - y**2 + 2 * y**3 / 3 - y_dot**2))


def section(model: lg.Model, y: float, y_dot: float, count: int = CROSSINGS) -> Array:
    """Return the states (count, 4) at which an orbit passes x = 0 to the right, behind its start there."""
    x = model.statement.coordinates[0]
    passing = lg.event(x, direction=1, terminal=count)
    start = {"y": y, "y_dot": y_dot, "x_dot": speed_through(y, y_dot)}
    return lg.integrate(model, (0.0, LONGEST * count), start, rtol=1e-12, events=[passing]).y_events[0]


def energy(states: Array) -> Array:
    """Return the energies (k,) of states (k, 4)."""
    x, y, u, v = states.T
    return np.asarray((u**2 + v**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3)


def picture(orbits: list[Array], path: Path) -> None:
    """Draw the section, an orbit in a colour, and around it where x' would be zero."""
    figure = Figure(figsize=(7.6, 6.6), layout="constrained")
    axis = figure.subplots()
    y = np.linspace(-0.5, 0.75, 2001)
    square = 2 * ENERGY - y**2 + 2 * y**3 / 3
    y, edge = y[square >= 0], np.sqrt(square[square >= 0])
    around = np.concatenate([y, y[::-1], y[:1]]), np.concatenate([edge, -edge[::-1], edge[:1]])
    axis.plot(*around, color="0.6", linewidth=0.8)
    colours = matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, len(orbits)))
    for states, colour in zip(orbits, colours, strict=True):
        axis.plot(states[:, 1], states[:, 3], ".", color=colour, markersize=2.2, markeredgewidth=0.0)
    axis.set_title(f"Henon-Heiles at E = {ENERGY:g}: x = 0, x' > 0", loc="left", fontsize=10)
    axis.set(xlabel="y", ylabel="y'")
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def main(folder: Path = Path("out")) -> list[Array]:
    """Print what was found, save the picture and return the section of each orbit."""
    began = perf_counter()
    model = star().compile()
    section(model, *STARTS[0], count=1)
    compiled = perf_counter()
    orbits = [section(model, y, y_dot) for y, y_dot in STARTS]
    ended = perf_counter()
    found = np.concatenate(orbits)
    print(f"{len(found)} crossings of {len(orbits)} orbits in {ended - compiled:.2f} s")
    print(f"{compiled - began:.2f} s before it, to compile the equations and the event")
    print(f"x is off zero by {np.abs(found[:, 0]).max():.1e}, the energy by {np.abs(energy(found) - ENERGY).max():.1e}")
    folder.mkdir(parents=True, exist_ok=True)
    picture(orbits, folder / "poincare_section.png")
    print(f"wrote {folder / 'poincare_section.png'}")
    return orbits


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
