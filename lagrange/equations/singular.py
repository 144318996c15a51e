"""Explain a state at which the accelerations are undetermined: dependent constraints, or a motion without inertia.

The equations M a = h + G^T lambda and G a + gamma = 0 (see `euler_lagrange`) have one solution if the rows of G are
independent and M is definite on the motions that the constraints allow, the kernel of G. Matrices are scaled before
each test, so that units do not matter. Source: J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., 2006, lemma
16.1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.euler_lagrange import RELATION, Equations, StateLayout
from lagrange.errors import listing
from lagrange.graph.node import Node
from lagrange.statement.rotation import AXES, ENTRIES, symbols_of_entries
from lagrange.statement.space import body_rates

FloatArray = NDArray[np.float64]

Values = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Function that returns an array of values of a quantity, from time, a state (2n,) and parameters (k,)."""

RANK = 1e-13  # Smaller singular values of a balanced matrix, relative to the largest, count as zero

NEARLY_SINGULAR = 1e-6
"""Threshold of `Singular.regularity`, above which a message blames the mass matrix instead of the constraints."""

DEPENDENT = 1e-8
"""Gradients of constraints count as dependent if their least singular value is below this fraction of the largest.

States satisfy the constraints only to 1e-12, so gradients that are dependent at exact states differ by that much.
"""

NAMED_SHARE = 1e-6  # Rounding threshold of the entries of a null vector, relative to the largest
NAMED_VELOCITIES = 8  # Largest number of velocities that a message names


class Provider(Protocol):
    """Source of functions that are evaluated at few states: a model, or an object with the kernels of a model."""

    def interpreted(self, name: str) -> Values:
        """Return the quantity `name`, such as "mass_matrix", as a function that is not compiled."""

    def function(self, name: str, nodes: tuple[Node, ...]) -> Values:
        """Return a function that evaluates nodes of the equations' graph. `name` is its name in code."""


@dataclass(frozen=True, eq=False)
class Singular:
    """Cause of undetermined accelerations: dependent constraints, or velocities `motion` (n,) without inertia.

    `rows` are pairs (index of a constraint, factor): the sum of factor times gradient is zero. `regularity` is the
    least singular value divided by the largest, of the gradients or of the mass matrix.
    """

    regularity: float
    rows: tuple[tuple[int, float], ...] = ()
    motion: FloatArray | None = None


def balanced(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a symmetric matrix A scaled so that the largest entry of each row is about 1, and the scales s.

    The scaled entries are A_ij / (s_i s_j). Source: D. Ruiz, RAL-TR-2001-034.
    """
    scale = np.ones(len(matrix))
    for _ in range(30):
        largest = np.abs(_scaled(matrix, scale)).max(axis=1, initial=0.0)
        scale = scale * np.sqrt(np.where(largest > 0, largest, 1.0))
    return _scaled(matrix, scale), scale


def _scaled(matrix: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the matrix with the entries A_ij / (s_i s_j), where A is `matrix` and s are the scale factors `scale`.

    Each entry is divided twice, since the product of two scales may underflow.
    """
    return np.asarray(matrix / scale[:, None] / scale)


def scales(mass: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the scale factors s (n + m,) of A = [[M, G^T], [G, 0]]: the rows of A_ij / (s_i s_j) have similar sizes.

    `mass` is the mass matrix M (n, n), and `gradient` the gradient G (m, n) of the constraints.
    """
    return balanced(_whole(mass, gradient))[1]


def least_regular(mass: FloatArray, gradient: FloatArray, scale: FloatArray | None = None) -> Singular | None:
    """Return the combination of constraints, or the motion with little inertia, that is nearest to singular.

    `mass` is the mass matrix M (n, n), and `gradient` the gradient G (m, n) of the constraints. A combination of
    constraints is singular if the same combination of the rows of G is zero. Returns None if an entry of a matrix is
    not finite. `scale` (n + m,) are the scale factors of another state: a row that has become much smaller since that
    state counts as nearly zero. With None the factors are computed for this state.
    """
    n, m = len(mass), len(gradient)
    if not (np.isfinite(mass).all() and np.isfinite(gradient).all()):
        return None
    normalised = scale is None
    scale = scales(mass, gradient) if scale is None else scale
    whole = _scaled(_whole(mass, gradient), scale)
    rows = whole[n:, :n]
    dependent = _dependent(rows, scale[n:], normalised=normalised) if m else None
    if dependent is not None and dependent.regularity <= RANK:
        return dependent
    # Columns of `allowed` (n, n - m) are an orthonormal basis of the motions that the rows allow, their null space.
    allowed = np.asarray(np.linalg.svd(rows)[2][m:].T) if m else np.eye(n)
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


def _dependent(scaled: FloatArray, scale: FloatArray, *, normalised: bool) -> Singular:
    """Return the linear combination of the gradients of constraints that is nearest to zero, as a `Singular`.

    `scaled` (m, n) are the gradients, divided by the factors `scale` (m,) that balance them. If `normalised` is true,
    each gradient is then divided by its length.
    """
    sizes = np.sqrt((scaled**2).sum(axis=1))
    units = np.where(sizes > 0, sizes, 1.0) if normalised else np.ones(len(scaled))
    left, values, _ = np.linalg.svd(scaled / units[:, None])
    least = float(values[-1] / ((values[0] or 1.0) if normalised else 1.0)) if len(values) == len(scaled) else 0.0
    factors = left[:, -1] / units
    largest = np.abs(factors * units).max()
    rows = [(i, float(factors[i] / scale[i])) for i in range(len(scaled)) if abs(left[i, -1]) > NAMED_SHARE * largest]
    return Singular(least, rows=tuple(rows))


def matrices_at(
    provider: Provider, equations: Equations, t: Any, y: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mass matrix (n, n) and the gradient of the constraints (m, n) at a time `t` and a state `y` (2n,).

    For k times (k,) and states (2n, k) the shapes are (n, n, k) and (m, n, k). `provider` evaluates the matrices.
    """
    constraints, n = equations.constraints, len(equations.q)
    entries = tuple(entry for row in constraints.gradient for entry in row)
    with np.errstate(all="ignore"):
        mass = provider.interpreted("mass_matrix")(t, y, parameters)
        gradient = provider.function("gradient", entries)(t, y, parameters) if entries else np.empty((0, *y.shape[1:]))
    return mass, gradient.reshape(len(constraints), n, *y.shape[1:])


def singular_sentence(provider: Provider, equations: Equations, t: float, y: FloatArray, parameters: FloatArray) -> str:
    """Return the message for a state `y` (2n,) at which the accelerations are not determined.

    It names the time t and the coordinates, what is singular at this state, and the remedy. `provider` evaluates the
    matrices of the `equations` for the values `parameters` (k,).
    """
    layout, names = equations.layout, equations.constraints.names
    state_text = ", ".join(
        [f"t = {t:.6g}", *(f"{name} = {x:.6g}" for name, x in zip(layout.coordinates, y, strict=False))]
    )
    worst = least_regular(*matrices_at(provider, equations, t, y, parameters))
    motion = "" if worst is None or worst.motion is None else motion_along(layout, y, worst.motion)
    if motion and (zeros := _zeros_without_inertia(provider, equations, t, y, parameters)):
        return (
            f"{no_inertia_along(motion)} with {listing(f'{name} = 0' for name in zeros)}, so the accelerations are not "
            "determined at any state: give another value, or add the kinetic energy that is missing."
        )
    if not names or worst is None or worst.regularity > NEARLY_SINGULAR:
        return (
            f"the mass matrix is singular at {state_text}: the accelerations are not determined there. Start "
            "elsewhere, or choose coordinates that are regular at this configuration."
        )
    if motion:
        return (
            f"a motion with {motion} satisfies the constraints and has no inertia at {state_text}: the accelerations "
            "are not determined there. Add the kinetic energy that is missing, or start elsewhere."
        )
    relations = any(names[i].startswith(RELATION) for i, _ in worst.rows)
    what, remedy = (FIRST_ORDER, "") if relations else (UNDETERMINED, ", or leave out one constraint")
    return f"{dependent_rows(names, worst)} at {state_text}: {what} Start elsewhere{remedy}."


def _zeros_without_inertia(
    provider: Provider, equations: Equations, t: float, y: FloatArray, parameters: FloatArray
) -> list[str]:
    """Return the names of parameters whose value 0 leaves a motion without inertia at all states, not only at `y`.

    These are the parameters that make the matrices regular if one of them is 1 instead. If there are none, all
    parameters that are zero are returned. `provider` evaluates the matrices of the `equations` at the time t.
    """
    elsewhere = y + np.sin(np.arange(1, len(y) + 1))

    def has_inertia(values: FloatArray) -> bool:
        singular = least_regular(*matrices_at(provider, equations, t, elsewhere, values))
        return singular is None or singular.motion is None or singular.regularity > RANK

    zeros = {str(equations.express(equations.parameters[k])): k for k in np.flatnonzero(parameters == 0)}
    if not zeros or has_inertia(parameters):
        return []
    units = np.eye(len(parameters))
    return [name for name, k in zeros.items() if has_inertia(parameters + units[k])] or [*zeros]


FIRST_ORDER = "the accelerations are not determined there."
UNDETERMINED = "the multipliers, and with them the accelerations, are not determined there."


def dependent_rows(names: Sequence[str], singular: Singular) -> str:
    """Return the beginning of a message: the dependent constraints, or the coordinates without inertia.

    `names` are the names of all constraints, and `singular` has the indices of the dependent ones.
    """
    related = [names[i].removeprefix(RELATION) for i, _ in singular.rows if names[i].startswith(RELATION)]
    if related:
        verb = "has no inertia, and its equation" if len(related) == 1 else "have no inertia, and their equations"
        return f"{listing(related)} {verb} of first order {'leaves' if len(related) == 1 else 'leave'} velocities open"
    involved = [repr(names[i]) for i, _ in singular.rows]
    if len(involved) == 1:
        return f"the constraint {involved[0]} restricts no velocity, as all its velocity derivatives vanish,"
    return f"the constraints {listing(involved)} are dependent"


def motion_along(layout: StateLayout, q: Sequence[float] | FloatArray, null: FloatArray) -> str:
    """Return the velocities `null` (n,) at coordinates `q` (n,) as text, such as ``x.dot = 1, R_body_z = -0.5``.

    The rates of a body replace the velocities of its quaternion.
    """
    rates = dict(zip(layout.rates, null, strict=True))
    motion = {f"{name}.dot": x for name, x in rates.items() if name not in symbols_of_entries(layout.rotations)}
    place = dict(zip(layout.coordinates, q, strict=False))
    for name in layout.rotations:
        entries = [f"{name}_{entry}" for entry in ENTRIES]
        turns = body_rates([place[entry] for entry in entries], [rates[entry] for entry in entries])
        if np.abs(turns).max() <= 1e-9 * np.abs(null).max() and any(rates[entry] for entry in entries):
            turns = (1.0, 1.0, 1.0)  # Only the quaternion's length changes, which has no inertia if no turn has
        motion |= {f"{name}_body_{axis}": x for axis, x in zip(AXES, turns, strict=True)}
    size = np.abs([*motion.values()])
    # The first of the largest entries becomes exactly 1.
    unit = [*motion.values()][int(np.argmax(size > 0.999 * size.max()))]
    return shortened_list([f"{name} = {x / unit:.4g}" for name, x in motion.items() if abs(x / unit) > 1e-9])


def no_inertia_along(motion: str) -> str:
    """Return the beginning of a message on velocities without inertia; `motion` is their text from `motion_along`."""
    if "," in motion:
        return f"a motion with {motion} has no inertia"
    name, _, axis = motion.removesuffix(" = 1").removesuffix(".dot").partition("_body_")
    return f"{name} has no inertia{axis and f' about the axis {axis} of its body'}"


def shortened_list(parts: list[str]) -> str:
    """Return a text that lists at most `NAMED_VELOCITIES` of the `parts`, then "and so on"."""
    return ", ".join(parts if len(parts) <= NAMED_VELOCITIES else [*parts[: NAMED_VELOCITIES - 1], "and so on"])


def dependent_everywhere(names: tuple[str, ...], singular: Singular, *, allowed: bool = False) -> str:
    """Return the message for constraints that are dependent at every state that satisfies them.

    `names` are the names of all constraints, and `singular` has the indices of the dependent ones. `allowed` is true if
    the system was stated with redundant='allow', which changes the remedy.
    """
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
    remedy = "state the system with redundant='allow': the constraints then share their forces."
    if allowed:
        remedy = "state the system with these parameters: redundant constraints are found for the stated ones."
    return (
        f"{dependent_rows(names, singular)} here: where {listing(involved[:-1])} "
        f"{'holds' if len(involved) == 2 else 'hold'}, {involved[-1]} restricts no further. Drop one of them, or "
        f"{remedy}"
    )


def contradiction(names: tuple[str, ...], singular: Singular) -> str:
    """Return the message for dependent constraints that no state satisfies.

    `names` are the names of all constraints, and `singular` has the indices of the dependent ones.
    """
    return (
        f"{dependent_rows(names, singular)} and contradict one another: no state was found that satisfies them "
        "together. Drop one of them, or correct it."
    )
