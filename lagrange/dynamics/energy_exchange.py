"""How energy moves along a run: between its kinds, between normal modes, or between coordinates.

About an equilibrium, with small changes x, the energy is v M v/2 + x K x/2. In the normal modes of M and K, shapes s_k
with s_k M s_k = 1 and K s_k = w_k^2 M s_k, it is the sum of (y_k'^2 + w_k^2 y_k^2)/2 with y_k = s_k M x.
Source: H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., 2002, section 6.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from scipy.linalg import LinAlgError, eigh

from lagrange.dynamics.angles import angles, difference
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.mechanics.linearization import Linearization, linearized_at
from lagrange.mechanics.plain_form import number, numeric
from lagrange.mechanics.point import StatedPoint, stated_point
from lagrange.statement.choice import one_of
from lagrange.statement.given import require_values, with_values
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status, Trajectory

ENERGIES, MODES, COORDINATES = KINDS = ("energies", "modes", "coordinates")

SAMPLES = 2000
"""Times at which energies are evaluated, at least."""

PER_STEP = 64
"""Times in each step, at least: a step of a Taylor series holds three periods at most."""

MOST_SAMPLES = 200_000


@dataclass(frozen=True, eq=False)
class ExchangeData:
    """Energies along a run: `t` (k,), and `parts` with (k,) each, whose sum is `total` (k,).

    `by` is "energies" (kinetic and potential), "modes" (of the normal modes about an equilibrium) or "coordinates" (of
    each coordinate's own mass and stiffness, and of the coupling). `error` is the largest difference of the total from
    the energy of the run, relative to what the energy moves by between its kinds; it is of second order for "modes" and
    "coordinates". `frequencies` (n,) are those of the modes.
    """

    statement: Statement
    by: str
    t: FloatArray
    parts: Mapping[str, FloatArray]
    total: FloatArray
    error: float
    frequencies: FloatArray
    status: Status
    message: str


def energy_exchange(
    model: Model, trajectory: Trajectory, parameters: Mapping[Any, float], by: Any, at: Mapping[Any, Any] | None
) -> ExchangeData:
    """Return the energies along a run; see `lagrange.energy_exchange`."""
    kind = one_of(by, KINDS, "by = {given}: give {known}.")
    if at is not None and kind == ENERGIES:
        raise StatementError('at is the equilibrium about which modes are looked at: give by="modes" with it.')
    if kind != ENERGIES and trajectory.history is not None:
        raise StatementError(
            'events of this run set parameters, and modes are those of constant ones: take by="energies", or a run '
            "of each part."
        )
    if not len(trajectory.t):
        raise StatementError("there is no energy to follow: the run ended before the first of its output times.")
    require_values(model.statement)
    t, y = _sampled(trajectory)
    q, v = model.layout.split(y)
    along = trajectory.parameters_at(t, parameters)
    whole = np.asarray(model.energy(q, v, t, along))
    frequencies = np.empty(0)
    kinds = _kinds(model, t, y, along)
    if kind == ENERGIES:
        parts = kinds
    else:
        point, lin = _about(model, at)
        parts, frequencies, rest = _small(model, (q, v), parameters, point, lin, by_modes=kind == MODES)
        whole = whole - rest
    total = np.sum(list(parts.values()), axis=0)
    size = float(max(np.ptp(part) for part in kinds.values())) or float(np.abs(whole).max()) or 1.0
    error = float(np.abs(total - whole).max()) / size
    words = ""
    if kind != ENERGIES:
        words = f"To second order about the equilibrium: the sum is off the energy by {error:.1e} of what is exchanged."
    elif error > 1e-6:
        words = (
            "T + V is not the energy v.p - L here: something prescribed moves the system, or V depends on velocities."
        )
    return ExchangeData(
        model.statement,
        kind,
        t,
        parts,
        total,
        error,
        frequencies,
        trajectory.status,
        f"{trajectory.message} {words}".strip(),
    )


def _sampled(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return times (k,) and states (2n, k) along a run, from its dense output where it has one there."""
    begin, end = float(trajectory.t[0]), float(trajectory.t[-1])
    count = min(max(SAMPLES, PER_STEP * trajectory.steps), MOST_SAMPLES)
    times = np.linspace(begin, end, count)
    try:
        return times, trajectory.dense(times)
    except StatementError:
        return trajectory.t, trajectory.y  # the steps were dropped, or the run was read from a file


def _kinds(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> dict[str, FloatArray]:
    """Return T and V as stated, or for a Lagrangian alone its parts of second and of no degree in the velocities."""
    known = with_values(model.statement)
    if not known.lagrangian_alone:
        return {
            "kinetic": model.evaluate_expression(known.kinetic, t, y, parameters),
            "potential": model.evaluate_expression(known.potential, t, y, parameters),
        }
    q, v = model.layout.split(y)
    rest = -np.asarray(model.evaluate("lagrangian", q, np.zeros_like(v), t, parameters))
    return {"kinetic": np.asarray(model.energy(q, v, t, parameters)) - rest, "potential": rest}


def _about(model: Model, at: Mapping[Any, Any] | None) -> tuple[StatedPoint, Linearization]:
    """Return an equilibrium and the linear equations about it."""
    point = stated_point(with_values(model.statement), at)
    lin = linearized_at(point)
    if not lin.equilibrium:
        raise StatementError(f"there are no modes at this point. {lin.note} system.equilibria() looks for equilibria.")
    if lin.K.rows != len(model.statement.coordinates):
        raise StatementError(
            f"{model.statement.name} has constraints: eliminate(...) coordinates first, and its modes have energies."
        )
    return point, lin


def _small(
    model: Model,
    state: tuple[FloatArray, FloatArray],
    parameters: Mapping[Any, float],
    point: StatedPoint,
    lin: Linearization,
    *,
    by_modes: bool,
) -> tuple[dict[str, FloatArray], FloatArray, float]:
    """Return the energies of small changes, frequencies (n,), and the energy at the equilibrium."""
    q, v = state
    values = {p: sympy.Rational(x) for p, x in parameters.items()}
    mass, stiffness = numeric(lin.M, values), numeric(lin.K, values)
    place = np.array([number(x, values).real for x in point.q])
    if np.abs(stiffness - stiffness.T).max() > 1e-9 * np.abs(stiffness).max():
        raise StatementError(
            f"the stiffness of {model.statement.name} is not symmetric: forces without a potential act, and modes "
            "have no energies of their own."
        )
    x = difference(q.T, place, angles(model.statement)).T
    try:
        squares, shapes = eigh(stiffness, mass)
    except LinAlgError as error:
        raise StatementError(
            f"the mass matrix of {model.statement.name} is not positive definite at the equilibrium: {error}."
        ) from error
    rest = float(np.asarray(model.energy(place, np.zeros_like(place), 0.0, parameters)))
    frequencies = np.sqrt(squares.astype(complex))
    if by_modes:
        y, rates = shapes.T @ mass @ x, shapes.T @ mass @ v
        energies = (rates**2 + squares[:, None] * y**2) / 2
        return {f"mode {k + 1}": row for k, row in enumerate(energies)}, frequencies, rest
    own = (np.diag(mass)[:, None] * v**2 + np.diag(stiffness)[:, None] * x**2) / 2
    whole = (np.einsum("ik,ij,jk->k", v, mass, v) + np.einsum("ik,ij,jk->k", x, stiffness, x)) / 2
    found = dict(zip(model.statement.names, own, strict=True))
    return found | {"coupling": whole - own.sum(axis=0)}, frequencies, rest
