"""Beats: two pendulums with a weak spring between them hand their energy to one another, and each mode keeps its own.

In small oscillations the matrices M and K have common eigenvectors, the modes. The energy of a mode is

    (r'^2 + w^2 r^2)/2  with  r = s^T M q

for a shape s of s^T M s = 1; that of a coordinate alone is (M_ii q_i'^2 + K_ii q_i^2)/2 [1].

[1] H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., 2002, section 6.3.

    python examples/beats.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from sympy import cos

import lagrange as lg

Array = NDArray[np.float64]


def coupled() -> lg.System:
    """Return two pendulums of mass, length and gravity 1 with a weak spring between the bobs, the first one pulled."""
    a, b = lg.coordinates("a b")
    k = lg.parameters("k")
    return lg.System(
        kinetic=(a.dot**2 + b.dot**2) / 2,
        potential=-cos(a) - cos(b) + k * (a - b) ** 2 / 2,
        parameters={k: 0.1},
        initial={a: 0.02},
        name="coupled pendulums",
    )


def energies(system: lg.System, run: lg.Solution) -> tuple[Array, Array]:
    """Return the energies of the modes and of the coordinates alone along a run, (n, N) each."""
    lin, values = system.linearize(), dict(system.statement.defaults)
    mass, stiffness = (np.array(matrix.subs(values), dtype=float) for matrix in (lin.M, lin.K))
    squares, shapes = eigh(stiffness, mass)
    q, v = np.split(run.y, 2)
    modes = ((shapes.T @ mass @ v) ** 2 + squares[:, None] * (shapes.T @ mass @ q) ** 2) / 2
    alone = (np.diag(mass)[:, None] * v**2 + np.diag(stiffness)[:, None] * q**2) / 2
    return modes, alone


def main(folder: Path = Path("out")) -> tuple[Array, Array]:
    """Print by how much the energies change, save the picture and return them."""
    system = coupled()
    run = system.run(140.0, rtol=1e-12, t_eval=np.linspace(0.0, 140.0, 1401))
    modes, alone = energies(system, run)
    for names, rows in ((("together", "against one another"), modes), (system.statement.names, alone)):
        for name, row in zip(names, rows, strict=True):
            print(f"{name}: {row.min():.2e} to {row.max():.2e}")
    figure = lg.figure()
    axis = figure.axes[0]
    for row, name in zip(alone, system.statement.names, strict=True):
        axis.plot(run.t, row, label=f"{name} alone")
    for row, name in zip(modes, ("in phase", "opposed"), strict=True):
        axis.plot(run.t, row, "--", label=f"mode: {name}")
    axis.set(xlabel="t", ylabel="energy")
    axis.legend()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "beats.png"
    figure.savefig(path, dpi=150)
    print(f"written to {path}")
    return modes, alone


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
