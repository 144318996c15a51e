"""Find and prove the conserved quantities of a system: energy, momenta and others; evaluate them along a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
import sympy
from sympy import Abs, Float, Matrix, Rational, S, sqrt

from lagrange.equations.terms import MonomialSum, TooLargeError, differentiable, printable
from lagrange.equations.textbook_algebra import StatedAlgebra, TextbookAlgebra, canonical
from lagrange.errors import FAULT, RunError, StatementError, formula, listing, shown
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import Parameters, some_of
from lagrange.mechanics.symmetries import (
    BodyPosition,
    Symmetry,
    SymmetryEquation,
    body_motions,
    body_turns,
    described,
    oriented,
    place,
    rotations,
    shifts,
)
from lagrange.statement.coordinate import acceleration_of, t, velocity_of
from lagrange.statement.display import ShownAsPage
from lagrange.statement.expression import ByName, check_once, expression, in_full, one_of, refusing_deep
from lagrange.statement.parameters import Survey, in_own_parameters, label_of
from lagrange.statement.random_states import SamplePoint, random_points, usable
from lagrange.statement.rotation import AXES
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.measures.conservation import SIZE_SAMPLES
from lagrange.trajectory.trajectory import FloatArray


def runge_lenz(stated: StatedAlgebra, body: BodyPosition) -> Iterator[tuple[str, MonomialSum]]:
    """Yield (name, expression) for the components of the Runge-Lenz vector of a body, if its potential is k/|r|.

    The vector is p x l - mass k r/|r|, where p is the momentum and l the angular momentum. The term p x l equals mass^2
    (r v^2 - v (r . v)). `body` has the position r, the velocity v, the mass, and the other terms of the Lagrangian.
    """
    statement, algebra = stated.statement, stated.algebra
    if statement.constraints or any(statement.forces) or statement.dissipation != 0 or not body.rest:
        return
    square = algebra.merge_angles(algebra.read(sum((x**2 for x in body.r), S.Zero)))
    if not any(algebra.free(k) & frozenset(stated.q) for monomial in square for k, _ in monomial):
        return
    # The forms in which the distance |r| may occur in L: a coordinate that equals it, or a square root.
    root = sqrt(algebra.write(square))
    distances = [*(q for q in stated.q if square == algebra.read(q**2)), root, differentiable(root)]
    moving, r, v = frozenset((*stated.q, *stated.v, stated.time)), Matrix(body.r), Matrix(body.v)
    for distance in distances:
        # L = mass |v|^2 / 2 + k/|r| if the other terms times |r| are a constant, k.
        constant = algebra.merge_angles(algebra.multiply(body.rest, algebra.read(distance)))
        if any(algebra.free(k) & moving for monomial in constant for k, _ in monomial):
            continue
        for k, axis in enumerate("xyz"[: len(body.r)]):
            whole = body.mass**2 * (r[k] * v.dot(v) - v[k] * r.dot(v))
            whole -= body.mass * algebra.write(constant) * r[k] / distance
            yield f"Runge-Lenz vector {axis}", algebra.merge_angles(algebra.read(whole))
        return


MOST_SEARCHED = 24  # Largest number of coordinates for which symmetries other than ignorable coordinates are searched

MOST_SYMMETRY_MONOMIALS = 60_000
"""Largest number of monomials formed in the proof of one symmetry: about 1 s of computing."""


@dataclass(frozen=True, repr=False)
class Conserved(ShownAsPage):
    """A quantity that stays constant along every motion, in coordinates, velocities, parameters and t.

    `name` is "energy", "p_phi", "angular momentum z" and the like. `expression` is the formula. `reason` is a sentence
    that says why the quantity is conserved. `statement` states the system.
    """

    name: str
    expression: Any
    reason: str
    statement: Statement = field(compare=False)

    def __str__(self) -> str:
        return f"{self.name} = {self.expression}: {self.reason}"

    def __repr__(self) -> str:
        return f"<Conserved: {self}>"


def conserved_quantities(model: Model) -> list[Conserved]:
    """Return the quantities that are proven to be conserved by a system. The system may have others.

    Each is tested against the compiled model. Raises RunError if one changes along the motion, which is a fault of this
    library.
    """
    if "conserved" not in model.prepared:
        quantities = list(_proven_quantities(model))
        check_constant(model, {quantity.name: in_full(quantity.expression) for quantity in quantities})
        model.prepared["conserved"] = quantities
    return list(model.prepared["conserved"])


def _proven_quantities(model: Model) -> Iterator[Conserved]:
    structure, stated = model.equations.structure, TextbookAlgebra(model.statement)
    read = stated if model.statement.reading is None else TextbookAlgebra(model.statement.as_read)
    taken = [f"p_{structure.names[i]}" for i in structure.cyclic]
    if structure.conservative:
        taken.append(structure.energy_name)
        yield Conserved(taken[-1], read.show(read.energy), f"{structure.energy_reason()}.", model.statement)
    for name, i in zip(taken, structure.cyclic, strict=False):
        reason = f"{structure.names[i]} is not in the Lagrangian."
        yield Conserved(name, stated.show(stated.momenta[i]), reason, model.statement)
    if len(stated.q) > MOST_SEARCHED:
        return
    equation, body = SymmetryEquation(stated), place(stated)
    yield from _momenta_of_turns(equation, stated, read)
    for proven in _symmetries(model, equation, body):
        symmetry, name = oriented(stated, proven, body, structure.energy_name)
        numbered = [name, *(f"{name} ({k})" for k in range(2, len(taken) + 2))]
        taken.append(next(candidate for candidate in numbered if candidate not in taken))
        yield Conserved(
            taken[-1],
            stated.show(equation.quantity(symmetry)),
            described(stated, proven if proven.tau != 0 else symmetry),
            model.statement,
        )
    for name, terms in runge_lenz(stated, body) if body is not None else ():
        reason = "The force falls with the square of the distance, so the axis of the orbit does not turn."
        yield Conserved(name, stated.show(terms), reason, model.statement)


def _momenta_of_turns(
    equation: SymmetryEquation, stated: TextbookAlgebra, read: TextbookAlgebra
) -> Iterator[Conserved]:
    """Yield the conserved angular momenta of rigid bodies, about axes fixed in space and axes fixed in a body.

    `equation` tests symmetries. `stated` has the energies in quaternions. `read` has the energies in the rates of the
    bodies about their own axes, in which the momenta are written.
    """
    statement = stated.statement
    for each, of_body, axis, candidate in body_turns(stated):
        if _proven(equation, candidate, complete=False) is None:
            continue
        if statement.reading is None:
            momentum = stated.show(equation.quantity(candidate))
        else:
            indices = [statement.reading.coordinates.index(turn) for turn in each.turns]
            momenta = [read.show(read.momenta[index]) for index in indices]
            weights = [sympy.Integer(k == axis) for k in range(3)] if of_body else each.matrix.row(axis)
            momentum = sum(weight * p for weight, p in zip(weights, momenta, strict=True))
        about = f"{AXES[axis]} of {'the body' if of_body else 'space'}"
        whose = f" of {each.name}" if len(statement.coordinates) > len(each.quaternion) else ""
        yield Conserved(
            f"angular momentum {AXES[axis]}{' of the body' if of_body else ''}{whose}",
            momentum,
            f"Turning {each.name} about the axis {about} leaves the Lagrangian as it is.",
            statement,
        )


def _symmetries(model: Model, equation: SymmetryEquation, body: BodyPosition | None) -> Iterator[Symmetry]:
    """Yield the symmetries of a system that are proven: shifts of coordinates and time, and rotations.

    Shifts of ignorable coordinates and linear combinations of earlier shifts are left out. `body` is the position of
    the body if the system is a single one, else None.
    """
    structure, stated = model.equations.structure, equation.stated
    n = len(stated.q)
    earlier: list[list[Any]] = [[int(j == i) for j in range(n)] for i in structure.cyclic]
    motions = () if body is None else body_motions(stated, body)
    candidates = [*shifts(stated), *rotations(stated), *motions]
    for candidate in candidates:
        shift = [int(xi) if xi in (0, 1) else None for xi in candidate.xi]
        if candidate.tau != 0:
            if structure.conservative or not structure.workless:
                continue
        elif None not in shift and sympy.Matrix([*earlier, shift]).rank() == len(earlier):
            continue
        symmetry = _proven(equation, candidate)
        if symmetry is not None:
            earlier += [shift] if None not in shift and candidate.tau == 0 else []
            yield symmetry


def _proven(equation: SymmetryEquation, candidate: Symmetry, *, complete: bool = True) -> Symmetry | None:
    """Return a candidate if it is proven to be a symmetry, or None if it is not or the proof would be too long.

    If `complete` is true, the result has the gauge function F(q, t) with which the candidate is a symmetry.
    """
    try:
        with equation.stated.algebra.at_most(MOST_SYMMETRY_MONOMIALS):
            symmetry = equation.completed(candidate) if complete else candidate
            return symmetry if symmetry is not None and equation.proven(symmetry) else None
    except TooLargeError:
        return None


LONGEST_SHOWN = 200  # Largest number of characters of a quantity in a message


@refusing_deep
def noether_quantity(model: Model, generator: Mapping[Any, Any]) -> Any:
    """Return the conserved quantity p . xi - tau E - F of a symmetry, stated by its generator {q: xi, t: tau}.

    p are the momenta, E is the energy, and F the gauge function. Raises StatementError if the generator is not a
    symmetry of the system.
    """
    statement = model.statement
    shift = _checked_generator(statement, generator)
    stated = TextbookAlgebra(statement)
    equation = SymmetryEquation(stated)
    xi = tuple(differentiable(shift.get(q, S.Zero).xreplace(stated.plain)) for q in statement.coordinates)
    try:
        moved = Symmetry(xi, shift.get(t, S.Zero))
        symmetry = equation.completed(moved) or moved
        quantity = stated.show(equation.quantity(symmetry))
        # A symmetry that shifts time gives a conserved quantity only if the constraint forces do no work.
        kept = symmetry.tau == 0 or model.equations.structure.workless
        if kept and equation.proven(symmetry):
            check_constant(model, {"the quantity of this symmetry": quantity})
            return quantity
    except TooLargeError:
        raise StatementError(
            f"{statement.name} is too large for this symmetry to be tested in symbols: substitute numbers for its "
            "parameters."
        ) from None
    raise StatementError(_refusal(model, stated, equation, symmetry, quantity))


def _checked_generator(statement: Statement, generator: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return a user's generator as {coordinate or t: exact expression}. Raises StatementError for invalid entries."""
    if not isinstance(generator, Mapping) or not generator:
        raise StatementError(
            f"noether takes a dict from coordinates to how they move, as {{x: -y, y: x}}, not {shown(generator)}."
        )
    by_name = {**dict(zip(statement.names, statement.coordinates, strict=True)), t.name: t}
    shift: dict[Any, Any] = {}
    labels = [label_of(key) for key in generator]
    check_once(labels, "the generator")
    for label, value in zip(labels, generator.values(), strict=True):
        if label != t.name:
            one_of(label, statement.names, "{given} is neither t nor a coordinate of this system; they are {known}.")
        what, survey = f"the motion of {label}", Survey()
        stated = in_own_parameters(expression(value, what), statement.parameters)
        # Proofs need exact numbers: a decimal becomes the fraction that its digits denote.
        shift[by_name[label]] = stated.xreplace({number: Rational(str(number)) for number in stated.atoms(Float)})
        survey.add(shift[by_name[label]], what)
        known = (*statement.coordinates, *statement.given, *statement.parameters)
        if survey.velocities or (label == t.name and (survey.coordinates or shift[t].has(t))):
            where = "parameters alone" if label == t.name else "coordinates, parameters and t"
            raise StatementError(
                f"{what} is {shown(str(value))}: give an expression in {where}, as a point symmetry has."
            )
        survey.require(known, what, f"; it has {listing(map(str, known))}.")
    return shift


def _refusal(
    model: Model, stated: TextbookAlgebra, equation: SymmetryEquation, symmetry: Symmetry, quantity: Any
) -> str:
    """Return the error message for a user's symmetry that is none, with the rate at which its `quantity` changes."""
    (rates,) = quantity_rates(model, [quantity])
    worst = rates.worst
    across = [
        constraint.name
        for constraint, terms in zip(model.statement.constraints, equation.across(symmetry), strict=True)
        if canonical(stated.algebra, terms)
    ]
    if worst is None:
        return (
            f"it could not be proven that this is a symmetry of {model.statement.name}: neither a proof that its "
            f"quantity {_spelled(model, quantity)} is conserved nor a state at which it changes was found."
        )
    rate = str(stated.show(equation.defect(symmetry)).xreplace(dict(model.statement.plain)))
    formula = "" if across or len(rate) > LONGEST_SHOWN else f" {rate}, which is"
    cause = f" It does not keep the constraint {listing(across)}." if across else ""
    return (
        f"this is not a symmetry of {model.statement.name}: its quantity {_spelled(model, quantity)} changes at the "
        f"rate{formula} {rates.values[worst]:.4g} at {rates.points[worst].describe(model.statement.names, 4)}.{cause}"
    )


def _spelled(model: Model, quantity: Any) -> str:
    """Return a quantity in the notation of scene files, truncated if it is long."""
    return formula(quantity.xreplace(dict(model.statement.plain)), LONGEST_SHOWN)


RATE_STATES = 6  # Number of random states at which a rate is tested

LARGEST_RATE = 1e-8
"""Largest time derivative of a conserved quantity that counts as zero, relative to its terms. The accelerations in it
are accurate to about 1e-12."""

REST = 1e-4  # Terms of a rate below this fraction of the largest terms of all quantities count as rounding errors


@dataclass(frozen=True, eq=False)
class QuantityRates:
    """Time derivatives of a quantity at the K states `points`.

    `values` (K,) are the derivatives. `sizes` (K,) are the sums of the magnitudes of their terms.
    """

    points: Sequence[SamplePoint]
    values: FloatArray
    sizes: FloatArray

    @property
    def worst(self) -> int | None:
        """Index of the state with the largest derivative beyond rounding, or None if it is only rounding everywhere."""
        finite = np.isfinite(self.values) & np.isfinite(self.sizes)
        share = np.where(finite, np.abs(self.values) - LARGEST_RATE * self.sizes, -1.0)
        worst = int(np.argmax(share)) if len(share) else 0
        return worst if len(share) and share[worst] > 0 else None


def quantity_rates(model: Model, expressions: Sequence[Any]) -> list[QuantityRates]:
    """Return the time derivatives of expressions in q, v and t at random states, one object for each expression.

    The accelerations are those of the compiled model.
    """
    points = [*islice(usable(random_points(model.statement, 17), lambda point: _placed(model, point)), RATE_STATES)]
    terms = [_rate_terms(model, expression) for expression in expressions]
    if not points or not any(terms):
        return [QuantityRates(points, np.zeros(len(points)), np.zeros(len(points))) for _ in terms]
    rates = model.function("rates", tuple(model.equations.translate(term) for parts in terms for term in parts))
    with np.errstate(all="ignore"):
        columns = [rates(p.t, np.array([*p.q, *p.v]), model.parameter_array(p.parameters)) for p in points]
    blocks = np.split(np.array(columns).T, np.cumsum([len(parts) for parts in terms])[:-1])
    sizes = [np.abs(block).sum(axis=0) for block in blocks]
    # If all terms of a rate are rounding, the terms of the other quantities give the scale of that rounding.
    largest = REST * np.max(sizes, axis=0)
    pairs = zip(blocks, sizes, strict=True)
    return [QuantityRates(points, block.sum(axis=0), np.maximum(size, largest)) for block, size in pairs]


def _placed(model: Model, point: SamplePoint) -> SamplePoint | None:
    """Return a sample point moved onto the constraints of a system, or None if no state on them is found near it.

    Coordinates without inertia get the velocities that their first-order equations of motion require.
    """
    if not len(model.equations.constraints):
        return point
    projection = Projection(model, point.t, model.parameter_array(point.parameters))
    try:
        y = projection.reached(np.array([*point.q, *point.v]), nearest=False)
    except (RunError, StatementError):
        return None
    if y is None:
        return None
    q, v = model.layout.split(y)
    return replace(point, q=tuple(q.tolist()), v=tuple(v.tolist()))


def _rate_terms(model: Model, expression: Any) -> list[Any]:
    """Return the terms of the time derivative of an expression: v df/dq, a df/dv for each coordinate, and df/dt."""
    statement = model.statement
    plain = {**statement.plain, t: sympy.Dummy("t", real=True)}
    back = {symbol: leaf for leaf, symbol in plain.items()}
    smooth = differentiable(expression.xreplace(plain))
    parts = [(plain[t], sympy.S.One)]
    for q, v in zip(statement.coordinates, statement.velocities, strict=True):
        parts += [(plain[q], velocity_of(q)), (plain[v], acceleration_of(q))]
    slopes = [(smooth.diff(symbol), rate) for symbol, rate in parts]
    return [printable(slope).xreplace(back) * rate for slope, rate in slopes if slope != 0]


def check_constant(model: Model, quantities: Mapping[str, Any]) -> None:
    """Raise RunError if one of the proven `quantities`, {name: expression}, changes along the compiled motion."""
    for name, rates in zip(quantities, quantity_rates(model, list(quantities.values())), strict=True):
        worst = rates.worst
        if worst is not None:
            raise RunError(
                f"{name} of {model.statement.name} is proven to be conserved, but changes at the rate "
                f"{rates.values[worst]:.6g} at {rates.points[worst].describe(model.statement.names, 4)}. {FAULT}"
            )


def invariants(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> Mapping[str, FloatArray]:
    """Return {name: values (N,)} of the conserved quantities, for states y (2n, N) at times t (N,)."""
    quantities = conserved_quantities(model)
    if not quantities:
        return ByName("invariant")
    nodes = tuple(model.equations.translate(quantity.expression) for quantity in quantities)
    with np.errstate(all="ignore"):  # the status of the run reports states that are not finite
        values = model.called(model.function("invariants", nodes), t, y, parameters)
    return ByName("invariant", ((quantity.name, row) for quantity, row in zip(quantities, values, strict=True)))


def invariant_sizes(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> Mapping[str, float]:
    """Return {conserved quantity: scale for its drift} for states y (2n, N) at times t (N,).

    The scale is the largest sum of magnitudes of the quantity's terms, over up to SIZE_SAMPLES of the times.
    """
    quantities = conserved_quantities(model)
    if not quantities or not len(t):
        return {}
    nodes = tuple(model.equations.translate(_terms(quantity.expression)) for quantity in quantities)
    some = np.unique(np.linspace(0, len(t) - 1, SIZE_SAMPLES).astype(int))
    with np.errstate(all="ignore"):
        sizes = model.called(model.function("sizes", nodes), t[some], y[:, some], some_of(parameters, some))
    return {quantity.name: float(row.max()) for quantity, row in zip(quantities, np.abs(sizes), strict=True)}


def _terms(expression: Any) -> Any:
    """Return an expression with the magnitudes of its terms, so that they do not cancel: x - y becomes |x| + |y|."""
    if expression.is_Add or expression.is_Mul:
        return expression.func(*map(_terms, expression.args))
    if expression.is_Pow and expression.exp.is_Integer and expression.exp > 0:
        return _terms(expression.base) ** expression.exp
    return Abs(expression)
