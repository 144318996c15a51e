"""Three magnets below a pendulum: over which of them it comes to rest, for each start at rest.

The bob moves in a plane, with a spring for gravity, friction, and three attracting magnets at the distance d below:

    x'' = -c x' - k x - sum_i (x - a_i)/((x - a_i)^2 + (y - b_i)^2 + d^2)^(3/2), and so for y.

Each colour is a magnet, paler where the bob takes longer. Near the borders, which are fractal, a start tells little
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
from sympy import sqrt

import lagrange as lg
from lagrange.show.dynamics import Basins

CELLS = 200
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


def basins(cells: int = CELLS) -> Basins:
    """Return where the bob comes to rest, for starts at rest."""
    return lg.basins(magnet_pendulum(), {"x": (-2.0, 2.0, cells), "y": (-2.0, 2.0, cells)})


def picture(found: Basins, path: Path) -> None:
    """Draw the basins."""
    figure = found.plot()
    figure.axes[0].set_title("a pendulum over three magnets: where does it come to rest?", loc="left", fontsize=11)
    figure.savefig(path, dpi=150)


def main(folder: Path = Path("out")) -> Basins:
    """Print the attractors and their shares, save the picture and return the basins."""
    began = perf_counter()
    found = basins()
    print(f"{found.message} That took {perf_counter() - began:.1f} s.")
    for k, attractor in enumerate(found.attractors):
        x, y = attractor.states[0, :2]
        print(f"at rest at ({x:6.3f}, {y:6.3f}): {(found.labels == k).mean():.1%} of the starts")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "magnet_pendulum.png"
    picture(found, path)
    print(f"written to {path}")
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
