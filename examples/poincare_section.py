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
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

import lagrange as lg
from lagrange.show.dynamics import PoincareSection

ENERGY = 1 / 8
CROSSINGS = 500
STARTS = (
    *((y, 0.0) for y in (-0.36, -0.3, -0.23, -0.15, 0.05, 0.12, 0.2, 0.26, 0.33, 0.4, 0.5, 0.58, 0.64)),
    *((0.0, speed) for speed in (-0.42, -0.35, -0.29, -0.24, 0.24, 0.29, 0.35)),
)
"""(y, y') at the start of each orbit, on the section."""

Array = NDArray[np.float64]
Starts = Sequence[tuple[float, float]]


def star() -> lg.System:
    """Return a star of mass 1 in the plane of a galaxy."""
    x, y = lg.coordinates("x y")
    return lg.System(
        kinetic=lg.kinetic_energy(1, (x, y)), potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3, name="Henon-Heiles"
    )


def section(star: lg.System | lg.Model, starts: Starts = STARTS, count: int = CROSSINGS) -> PoincareSection:
    """Return the states at which orbits from points (y, y') pass x = 0 to the right, behind their starts there."""
    x, y = star.statement.coordinates
    states = [{y: place, y.dot: speed} for place, speed in starts]
    return lg.poincare(star, lg.event(x, direction=1), states, crossings=count, energy=ENERGY, solve_for=x.dot)


def energy(states: Array) -> Array:
    """Return the energies (k,) of states (k, 4)."""
    x, y, u, v = states.T
    return np.asarray((u**2 + v**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3)


def main(folder: Path = Path("out")) -> list[Array]:
    """Print what was found, save the picture and return the section of each orbit."""
    began = perf_counter()
    model = star().compile()
    section(model, STARTS[:1], count=1)
    compiled = perf_counter()
    found = section(model)
    ended = perf_counter()
    print(f"{found.message} They took {ended - compiled:.2f} s,")
    print(f"and {compiled - began:.2f} s before it to compile the equations and the event.")
    off = np.abs(energy(found.points) - ENERGY).max()
    print(f"x is off zero by {np.abs(found.points[:, 0]).max():.1e}, the energy by {off:.1e}")
    folder.mkdir(parents=True, exist_ok=True)
    print(f"wrote {found.to_png(folder / 'poincare_section.png', dpi=130)}")
    return list(found.states)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
