"""Why a motion has no accelerations at a state: constraints that are dependent there, or a motion without inertia.

M a = h + G^T lambda and G a + gamma = 0 have one solution where the rows of G are independent and M is definite on the
motions that they allow, the kernel of G. All tests are made on matrices whose rows are scaled alike, so that units do
not matter.
Source: J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., 2006, lemma 16.1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.euler_lagrange import RELATION, Equations
from lagrange.errors import listing
from lagrange.graph.node import Node

FloatArray = NDArray[np.float64]

Values = Callable[[float, FloatArray, FloatArray], FloatArray]
"""A function of t, a state (2n,) and parameters (k,)."""

RANK = 1e-13
"""A singular value below this fraction of the largest counts as zero once rows and columns are scaled alike."""

NEARLY_SINGULAR = 1e-6
"""Where nothing is nearer to zero than this part, what was solved for is not the motion."""

DEPENDENT = 1e-8
"""Rows are dependent on the surface where their least singular value is below this part of the largest: a state is on
the surface up to 1e-12, and off it rows that are dependent on it differ by as much."""

NAMED_SHARE = 1e-6
"""Entries of a null vector below this part of the largest are round-off."""

MOST_NAMED = 8
"""Most velocities that a message names."""


class Provider(Protocol):
    """What makes kernels for a few states: a model, or what a model is made of."""

    def interpreted(self, name: str) -> Values:
        """Return a quantity of the system."""

    def function(self, name: str, nodes: tuple[Node, ...]) -> Values:
        """Return nodes of the equations' graph as a function of t, q and v."""


@dataclass(frozen=True, eq=False)
class Singular:
    """What is singular: `rows` of G, each with its factor in the sum that vanishes, or a `motion` (n,) without inertia.

    `regularity` is the singular value that vanishes, relative to the largest.
    """

    regularity: float
    rows: tuple[tuple[int, float], ...] = ()
    motion: FloatArray | None = None


def balanced(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A_ij / (s_i s_j), which has entries of about 1 in every row, and s (Ruiz, RAL-TR-2001-034)."""
    scale = np.ones(len(matrix))
    for _ in range(30):
        largest = np.abs(_divided(matrix, scale)).max(axis=1, initial=0.0)
        scale = scale * np.sqrt(np.where(largest > 0, largest, 1.0))
    return _divided(matrix, scale), scale


def _divided(matrix: FloatArray, scale: FloatArray) -> FloatArray:
    """Return A_ij / (s_i s_j); the product of two scales may be too small for a double."""
    return np.asarray(matrix / scale[:, None] / scale)


def scales(mass: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return what makes the rows of [[M, G^T], [G, 0]] comparable, (n + m,)."""
    return balanced(_whole(mass, gradient))[1]


def least_regular(mass: FloatArray, gradient: FloatArray, scale: FloatArray | None = None) -> Singular | None:
    """Return what is nearest to being singular, None where an entry is not finite.

    `mass` is (n, n) and `gradient` (m, n). With the `scale` of another state, (n + m,), rows that are smaller than
    there count as smaller; else all are scaled alike.
    """
    n, m = len(mass), len(gradient)
    if not (np.isfinite(mass).all() and np.isfinite(gradient).all()):
        return None
    alike = scale is None
    scale = scales(mass, gradient) if scale is None else scale
    whole = _divided(_whole(mass, gradient), scale)
    held = whole[n:, :n]
    dependent = _dependent(held, scale[n:], alike=alike) if m else None
    if dependent is not None and dependent.regularity <= RANK:
        return dependent
    allowed = _kernel(held) if m else np.eye(n)
    if not allowed.shape[1]:
        return dependent
    values, vectors = np.linalg.eigh(allowed.T @ whole[:n, :n] @ allowed)
    which = int(np.argmin(np.abs(values)))
    left = float(abs(values[which]) / (np.abs(values).max() or 1.0))
    if dependent is not None and dependent.regularity < left:
        return dependent
    return Singular(left, motion=allowed @ vectors[:, which] / scale[:n])


def _whole(mass: FloatArray, gradient: FloatArray) -> FloatArray:
    return np.block([[mass, gradient.T], [gradient, np.zeros((len(gradient),) * 2)]])


def _dependent(held: FloatArray, scale: FloatArray, *, alike: bool) -> Singular:
    """Return the combination of rows that is nearest to zero, the rows made equally long if they count alike."""
    sizes = np.sqrt((held**2).sum(axis=1))
    units = np.where(sizes > 0, sizes, 1.0) if alike else np.ones(len(held))
    left, values, _ = np.linalg.svd(held / units[:, None])
    least = float(values[-1] / ((values[0] or 1.0) if alike else 1.0)) if len(values) == len(held) else 0.0
    factors = left[:, -1] / units
    largest = np.abs(factors * units).max()
    rows = [(i, float(factors[i] / scale[i])) for i in range(len(held)) if abs(left[i, -1]) > NAMED_SHARE * largest]
    return Singular(least, rows=tuple(rows))


def _kernel(held: FloatArray) -> FloatArray:
    """Return a basis, (n, n - m), of what the rows allow."""
    return np.asarray(np.linalg.svd(held)[2][len(held) :].T)


def matrices_at(
    made: Provider, equations: Equations, t: float, y: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return M (n, n) and G (m, n) at a state (2n,)."""
    held, n = equations.constraints, len(equations.q)
    entries = tuple(entry for row in held.gradient for entry in row)
    with np.errstate(all="ignore"):
        mass = made.interpreted("mass_matrix")(t, y, parameters)
        gradient = made.function("gradient", entries)(t, y, parameters) if entries else np.empty(0)
    return mass, gradient.reshape(len(held), n)


def singular_sentence(made: Provider, equations: Equations, t: float, y: FloatArray, parameters: FloatArray) -> str:
    """Return a sentence for a state (2n,) without accelerations: where it is, what is singular, and the remedy."""
    layout, names = equations.layout, equations.constraints.names
    place = ", ".join([f"t = {t:.6g}", *(f"{name} = {x:.6g}" for name, x in zip(layout.coordinates, y, strict=False))])
    found = least_regular(*matrices_at(made, equations, t, y, parameters)) if names else None
    if found is None or found.regularity > NEARLY_SINGULAR:
        return (
            f"the mass matrix is singular at {place}: the accelerations are not determined there. Start elsewhere, or "
            "choose coordinates that are regular at this configuration."
        )
    if found.motion is not None:
        return (
            f"a motion with {motion_along(layout.rates, found.motion)} satisfies the constraints and has no inertia at "
            f"{place}: the accelerations are not determined there. Add the kinetic energy that is missing, or start "
            "elsewhere."
        )
    relations = any(names[i].startswith(RELATION) for i, _ in found.rows)
    what, remedy = (FIRST_ORDER, "") if relations else (UNDETERMINED, ", or state one constraint less")
    return f"{dependent_rows(names, found)} at {place}: {what} Start elsewhere{remedy}."


FIRST_ORDER = "the accelerations are not determined there."
UNDETERMINED = "the multipliers, and with them the accelerations, are not determined there."


def dependent_rows(names: Sequence[str], found: Singular) -> str:
    """Return which constraints are dependent, as the beginning of a sentence."""
    related = [names[i].removeprefix(RELATION) for i, _ in found.rows if names[i].startswith(RELATION)]
    if related:
        have = "has no inertia, and its equation" if len(related) == 1 else "have no inertia, and their equations"
        return f"{listing(related)} {have} of first order {'leaves' if len(related) == 1 else 'leave'} velocities open"
    involved = [repr(names[i]) for i, _ in found.rows]
    if len(involved) == 1:
        return f"the constraint {involved[0]} restricts no velocity, for all its derivatives by them vanish,"
    return f"the constraints {listing(involved)} are dependent"


def motion_along(names: Sequence[str], null: FloatArray) -> str:
    """Return a combination of velocities as text, such as ``x.dot = 1, y.dot = -0.5``."""
    size = np.abs(null)
    # The first of the largest entries is exactly 1.
    null = null / null[np.argmax(size > 0.999 * size.max())]
    return few([f"{name}.dot = {x:.4g}" for name, x in zip(names, null, strict=True) if abs(x) > 1e-9])


def few(parts: list[str]) -> str:
    """Return the parts of a list in one line, the last of many left out."""
    return ", ".join(parts if len(parts) <= MOST_NAMED else [*parts[: MOST_NAMED - 1], "and so on"])


def dependent_everywhere(names: tuple[str, ...], singular: Singular, *, allowed: bool = False) -> str:
    """Return the refusal of constraints that are dependent wherever they hold, those that are `allowed` to be too."""
    if any(names[i].startswith(RELATION) for i, _ in singular.rows):
        return (
            f"{dependent_rows(names, singular)} at every state tried. Add the kinetic energy that is missing, or use "
            "fewer coordinates."
        )
    involved = [repr(names[i]) for i, _ in singular.rows]
    if len(involved) == 1:
        return (
            f"{dependent_rows(names, singular)} wherever it holds: state it without the square, or leave it out if it "
            "holds always."
        )
    remedy = "state the system with redundant='allow', and they share their forces."
    if allowed:
        remedy = (
            "state the system with these parameters: which constraints are redundant is found with those it states."
        )
    return (
        f"{dependent_rows(names, singular)} here: where {listing(involved[:-1])} "
        f"{'holds' if len(involved) == 2 else 'hold'}, {involved[-1]} restricts no further. Drop one of them, or "
        f"{remedy}"
    )


def contradiction(names: tuple[str, ...], singular: Singular) -> str:
    """Return the refusal of dependent constraints that no state satisfies."""
    return (
        f"{dependent_rows(names, singular)} and contradict one another: no state was found that satisfies them "
        "together. Drop one of them, or correct it."
    )
