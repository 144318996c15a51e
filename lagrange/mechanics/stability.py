"""Whether a motion near an equilibrium stays near: by the energy where it decides, else by eigenvalues.

An eigenvalue with a positive real part makes it unstable. If all real parts are negative, it is asymptotically stable.
If forces have a potential, or only brake, and the energy has a strict minimum, it is stable (Lagrange, Dirichlet),
with gyroscopic forces too. Without a minimum gyroscopic forces may hold it, which eigenvalues on the imaginary axis do
not decide. Ignorable coordinates are left out, their momenta held: a pendulum on a free cart drifts, and is stable.
Source: D. R. Merkin, Introduction to the Theory of Stability, 1997, chapters 3 and 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from lagrange.mechanics.identity import vanishes
from lagrange.mechanics.plain_form import PlainForm

REAL_PART = 1e-6
"""Real part of an eigenvalue that counts as zero, relative to the largest: double ones are found to 1e-8."""

DEFINITE = 1e-9
"""Eigenvalue of a stiffness that counts as zero, relative to the largest."""


@dataclass(frozen=True)
class Verdict:
    """Whether an equilibrium is stable, None where that is undecided, and why."""

    stable: bool | None
    reason: str


def ignorable(form: PlainForm) -> tuple[int, ...]:
    """Return the coordinates that nothing depends on and whose momenta are constant."""
    statement = form.statement
    return tuple(
        i
        for i, q in enumerate(form.q)
        if vanishes(form, form.lagrangian.diff(q))
        and vanishes(form, form.forces[i])
        and all(vanishes(form, force.diff(q)) for force in form.forces)
        and not any(one.expression.has(statement.coordinates[i]) for one in statement.constraints)
        and not any(one.expression.has(statement.velocities[i]) for one in statement.constraints)
    )


def at_fixed_momenta(mass: Any, damping: Any, stiffness: Any, gone: tuple[int, ...]) -> tuple[Any, Any, Any]:
    """Return M, C and K of the other coordinates where those of ignorable ones keep their momenta.

    The momentum M_IR v_R + M_II v_I + C_IR q_R is constant, which gives v_I. For arrays and SymPy matrices alike.
    """
    if not gone:
        return mass, damping, stiffness
    symbolic = isinstance(mass, sympy.MatrixBase)
    left = [i for i in range(mass.shape[0]) if i not in gone]

    def part(matrix: Any, rows: Any, columns: Any) -> Any:
        return matrix.extract(list(rows), list(columns)) if symbolic else matrix[np.ix_(rows, columns)]

    held = part(mass, gone, gone)
    inverse = held.inv() if symbolic else np.linalg.inv(held)
    m_ri, m_ir = part(mass, left, gone), part(mass, gone, left)
    c_ri, c_ir = part(damping, left, gone), part(damping, gone, left)
    return (
        part(mass, left, left) - m_ri @ inverse @ m_ir,
        part(damping, left, left) - m_ri @ inverse @ c_ir - c_ri @ inverse @ m_ir,
        part(stiffness, left, left) - c_ri @ inverse @ c_ir,
    )


def has_energy(form: PlainForm) -> bool:
    """Return whether L is free of time and no force feeds energy in: only Rayleigh's dissipation, which may be."""
    statement = form.statement
    free = vanishes(form, form.lagrangian.diff(sympy.Symbol("t")))
    return free and all(vanishes(form, form.read(force)) for force in statement.forces)


def verdict(mass: Any, damping: Any, stiffness: Any, *, energetic: bool) -> Verdict:
    """Return the verdict on numbers M, C and K at fixed momenta; `energetic` if the energy cannot grow."""
    n = mass.shape[0]
    if not n:
        return Verdict(stable=None, reason="nothing is left to move at fixed momenta.")
    lower = np.linalg.solve(mass, np.hstack([-stiffness, -damping]))
    values = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))
    size = max(1e-300, float(np.abs(values).max()))
    largest = float(values.real.max())
    if largest > REAL_PART * size:
        return Verdict(stable=False, reason=f"an eigenvalue has the positive real part {largest:.6g}.")
    if largest < -REAL_PART * size:
        return Verdict(stable=True, reason=f"all eigenvalues have negative real parts, up to {largest:.6g}.")
    drag = (damping + damping.T) / 2
    smallest = [float(np.linalg.eigvalsh((x + x.T) / 2).min()) for x in (mass, drag, stiffness)]
    sizes = [max(1e-300, float(np.abs(x).max())) for x in (mass, damping, stiffness)]
    symmetric = float(np.abs(stiffness - stiffness.T).max()) <= DEFINITE * sizes[2]
    braked = smallest[1] >= -DEFINITE * sizes[1]
    minimum = smallest[0] > 0 and smallest[2] > DEFINITE * sizes[2]
    if energetic and symmetric and braked and minimum:
        return Verdict(stable=True, reason="the energy has a strict minimum there.")
    if smallest[2] < -DEFINITE * sizes[2]:
        return Verdict(
            stable=None, reason="no eigenvalue has a positive real part, and the energy has no minimum there."
        )
    return Verdict(
        stable=None, reason="eigenvalues on the imaginary axis decide nothing, and the energy has no strict minimum."
    )
