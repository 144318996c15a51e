"""What a system conserves, along a run: the values, and how far momenta moved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from sympy import Abs

from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters, some_of
from lagrange.mechanics.conserved import conserved_quantities
from lagrange.statement.choice import ByName
from lagrange.trajectory.trajectory import FloatArray

MOST_COORDINATES = 12
"""With more coordinates no momentum is on the card: deciding which are constant takes 0.3 s for 30 links."""

SAMPLES = 200
"""Outputs at which the mass matrix is taken, for the size of the terms."""

MOST_LINES = 3
"""Momenta on the card, and in the plot."""


def invariants(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> Mapping[str, FloatArray]:
    """Return what the system conserves by name, (N,) each, at states y (2n, N) at the times t (N,)."""
    found = conserved_quantities(model)
    if not found:
        return ByName("invariant")
    nodes = tuple(model.equations.translate(one.expression) for one in found)
    with np.errstate(all="ignore"):  # a run that left the finite numbers says so itself
        values = model.called(model.function("invariants", nodes), t, y, parameters)
    return ByName("invariant", ((one.name, row) for one, row in zip(found, values, strict=True)))


def invariant_sizes(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> Mapping[str, float]:
    """Return the largest size of the terms of each conserved quantity, which itself may be zero up to round-off."""
    found = conserved_quantities(model)
    if not found or not len(t):
        return {}
    nodes = tuple(model.equations.translate(_terms(one.expression)) for one in found)
    some = np.unique(np.linspace(0, len(t) - 1, SAMPLES).astype(int))
    with np.errstate(all="ignore"):
        sizes = model.called(model.function("sizes", nodes), t[some], y[:, some], some_of(parameters, some))
    return {one.name: float(row.max()) for one, row in zip(found, np.abs(sizes), strict=True)}


def _terms(given: Any) -> Any:
    """Return the sum of the sizes of the terms of an expression."""
    if given.is_Add or given.is_Mul:
        return given.func(*map(_terms, given.args))
    if given.is_Pow and given.exp.is_Integer and given.exp > 0:
        return _terms(given.base) ** given.exp
    return Abs(given)


def momentum_drifts(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> Mapping[str, FloatArray]:
    """Return how far the momenta of ignorable coordinates are from their first values, (N,) each.

    That is relative to the largest of what they are sums of, the entries M_ij v_j: a momentum may be zero. They are few
    and known without a search, unlike other invariants.
    """
    structure = model.equations.structure
    places = list(structure.cyclic) if len(structure.names) <= MOST_COORDINATES else []
    if not places or not len(t):
        return {}
    q, v = model.layout.split(y)
    with np.errstate(all="ignore"):
        momenta = np.asarray(model.momenta(q, v, t, parameters))[places]
        some = np.unique(np.linspace(0, len(t) - 1, SAMPLES).astype(int))
        kernel = model.interpreted("mass_matrix")
        mass = model.called(kernel, t[some], y[:, some], some_of(parameters, some))[places]
        terms = np.abs(mass * v[:, some]).sum(axis=1).max(axis=1, keepdims=True)
        scale = np.maximum(np.abs(momenta).max(axis=1, keepdims=True), terms)
        drifts = np.divide(momenta - momenta[:, :1], scale, out=np.zeros_like(momenta), where=scale > 0)
    return {f"p_{structure.names[i]}": drift for i, drift in zip(places, drifts, strict=True)}


def drift_lines(drifts: Mapping[str, FloatArray]) -> list[tuple[str, str]]:
    """Return lines of a status card: the largest drift of each momentum, and how many are left out."""
    lines = [(f"{name} drift", f"{np.abs(drift).max():.1e} of its largest term") for name, drift in drifts.items()]
    left = len(lines) - MOST_LINES
    return lines[:MOST_LINES] + ([("other momenta", f"{left} in solution.invariants")] if left > 0 else [])
