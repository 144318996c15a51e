"""Derive Hamilton's form of a system: Legendre transform, H = p.v - L, Hamilton's equations and Poisson brackets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import sympy

from lagrange.equations.solve_plan import coupled_blocks
from lagrange.errors import StatementError, listing
from lagrange.evidence.formula_comparison import LARGEST_ERROR, compared
from lagrange.machine.model import Model
from lagrange.mechanics.plain_form import (
    FORMULA_DIGITS,
    STATES,
    PlainForm,
    is_zero,
    momentum_names,
    number,
    rational_below,
    simplest,
    size,
)
from lagrange.mechanics.reduction import with_origin
from lagrange.statement.coordinate import coordinate_of, velocity_of
from lagrange.statement.declare import declare
from lagrange.statement.display import ShownAsPage
from lagrange.statement.expression import expression as expression_of
from lagrange.statement.expression import refusing_deep
from lagrange.statement.parameters import Survey, in_own_parameters
from lagrange.statement.random_states import SamplePoint, holds, random_points
from lagrange.statement.statement import Statement

LARGEST_COUPLED_BLOCK = 4
"""Largest number of coupled velocities solved for in symbols. The inverse of a 5 x 5 matrix has thousands of terms."""


@dataclass(frozen=True)
class Legendre:
    """Result of the Legendre transform of a Lagrangian, in SymPy symbols without functions of time.

    `symbols` are the n momenta. `velocities` (n) and the Hamiltonian are expressions in coordinates and momenta.
    """

    symbols: tuple[Any, ...]
    velocities: tuple[Any, ...]
    hamiltonian: Any


def legendre(form: PlainForm, symbols: Sequence[Any]) -> Legendre:
    """Return the Legendre transform of the Lagrangian of a system; `symbols` are the symbols for the n momenta.

    Raises StatementError if the momenta do not determine the velocities.
    """
    mass = form.mass
    blocks = coupled_blocks([[entry != 0 for entry in row] for row in mass.tolist()])
    solve = _solved if mass.has(*form.v) else _inverted
    velocities: dict[int, Any] = {}
    energies = []
    for block in blocks:
        solutions, energy = solve(form, block, symbols)
        velocities.update(zip(block, solutions, strict=True))
        energies.append(energy)
    rates = tuple(velocities[i] for i in range(len(form.v)))
    if solve is _inverted:
        rest = form.lagrangian.xreplace(dict.fromkeys(form.v, sympy.S.Zero))
        return Legendre(tuple(symbols), rates, sympy.Add(*energies, -simplest(rest)))
    if len(blocks) == 1 and energies[0] is not None:
        return Legendre(tuple(symbols), rates, energies[0])
    work = sympy.Add(*(p * v for p, v in zip(symbols, rates, strict=True)))
    left = form.lagrangian.xreplace(dict(zip(form.v, rates, strict=True)))
    return Legendre(tuple(symbols), rates, simplest(work - left))


def inverse(form: PlainForm, block: Sequence[int]) -> tuple[Any, Any]:
    """Return the adjugate and the determinant of a block of the mass matrix.

    `block` lists the indices of the rows and columns of the block. Raises StatementError if the block is singular or
    too large.
    """
    if len(block) > LARGEST_COUPLED_BLOCK:
        names = listing(form.statement.names[i] for i in block)
        raise StatementError(
            f"{form.statement.name} is too large for its velocities to be written out in momenta: {names} are coupled, "
            f"and at most {LARGEST_COUPLED_BLOCK} are solved for in symbols. compile() runs it in velocities."
        )
    mass = form.mass.extract(list(block), list(block))
    determinant = simplest(mass.det(method="berkowitz"))
    if is_zero(determinant):
        raise StatementError(_degenerate(form, block))
    return mass.adjugate(method="berkowitz").applyfunc(simplest), determinant


def _inverted(form: PlainForm, block: Sequence[int], symbols: Sequence[Any]) -> tuple[list[Any], Any]:
    """Return the velocities of the coordinates `block` as functions of the momenta, and (p - b) M^-1 (p - b)/2.

    The block M of the mass matrix must not depend on velocities. b are the momenta at zero velocities. `symbols` are
    the symbols of all momenta p. `block` has the indices of the coordinates.
    """
    adjugate, determinant = inverse(form, block)
    still = dict.fromkeys(form.v, sympy.S.Zero)
    column = sympy.Matrix([symbols[i] - form.momenta[i].xreplace(still) for i in block])
    mass = form.mass.extract(list(block), list(block))
    return [simplest(x / determinant) for x in adjugate * column], half_square(mass, (adjugate, determinant), column)


def half_square(mass: Any, inverted: tuple[Any, Any], column: Any) -> Any:
    """Return c M^-1 c/2 for a `column` c and a `mass` matrix M, in its shortest form.

    The form is one fraction, or a sum of squares if the sum is shorter, as for a top. `inverted` are the adjugate and
    the determinant of M.
    """
    adjugate, determinant = inverted
    above, below = sympy.fraction(simplest((column.T * adjugate * column)[0] / (2 * determinant)))
    whole, squares = sympy.expand(above) / below, _squares(mass, list(column))
    return min((whole, sympy.Add(*squares)), key=size) if squares else whole


def _squares(mass: Any, column: list[Any]) -> list[Any]:
    """Return the list of terms w^2/(2 d) whose sum is c M^-1 c/2, or [] if elimination meets a pivot d that is zero.

    `mass` is M, `column` is c. Pivots with short formulas come first.
    """
    n = len(column)
    k = min(range(n), key=lambda i: (mass[i, i] == 0, size(mass[i, i])))
    pivot, rest = mass[k, k], [i for i in range(n) if i != k]
    if pivot == 0:
        return []
    first = column[k] ** 2 / (2 * pivot)
    if not rest:
        return [first]
    factors = [simplest(mass[i, k] / pivot) for i in rest]
    smaller = sympy.Matrix(n - 1, n - 1, lambda i, j: simplest(mass[rest[i], rest[j]] - factors[i] * mass[k, rest[j]]))
    left = [simplest(column[i] - factor * column[k]) for i, factor in zip(rest, factors, strict=True)]
    others = _squares(smaller, left)
    return [first, *others] if others else []


def _degenerate(form: PlainForm, block: Sequence[int]) -> str:
    """Return the error message if momenta do not determine velocities; `block` has the indices of the coordinates."""
    names = [form.statement.names[i] for i in block]
    if len(block) == 1:
        reason = f"d2L/d{names[0]}_dot2 = 0, so that {names[0]}_dot does not follow from its momentum"
    else:
        reason = (
            f"the determinant of d2L/dv2 of {listing(names)} is zero, so that their velocities do not follow from the "
            "momenta"
        )
    return (
        f"the Lagrangian of {form.statement.name} has no Legendre transform: {reason}. Run it as it is stated, or use "
        "fewer coordinates."
    )


def _solved(form: PlainForm, block: Sequence[int], symbols: Sequence[Any]) -> tuple[list[Any], Any]:
    """Return the velocities of the coordinates with indices `block` as functions of the momenta `symbols`, and H.

    The mass matrix of these coordinates depends on their velocities. H is None if it does not follow with them. Of
    several solutions the one is returned that reproduces velocities of random states. Raises StatementError if none
    does.
    """
    candidates = _by_length(form, block, symbols)
    if not candidates and len(block) == 1:
        (i,) = block
        candidates = [([root], None) for root in sympy.solve(form.momenta[i] - symbols[i], form.v[i])]
    for velocities, energy in candidates:
        if _is_inverse(form, block, symbols, velocities):
            return velocities, energy
    if is_zero(form.mass.extract(list(block), list(block)).det(method="berkowitz")):
        raise StatementError(_degenerate(form, block))
    names = listing(form.statement.names[i] for i in block)
    raise StatementError(
        f"the momenta of {form.statement.name} cannot be solved for the velocities of {names} in symbols: they are not "
        "linear in them. compile() runs the system in velocities."
    )


def _by_length(form: PlainForm, block: Sequence[int], symbols: Sequence[Any]) -> list[tuple[list[Any], Any]]:
    """Return solutions (velocities, H) for L = F(u) + b.v with u = c + v B v, as for a relativistic particle.

    Then p - b = 2 F'(u) B v, so 4 F'(u)^2 (u - c) = (p - b) B^-1 (p - b), which is solved for u. The list is empty for
    other Lagrangians. `block` has the indices of the coordinates, and `symbols` are the momenta p.
    """
    v = [form.v[i] for i in block]
    u = sympy.Symbol("u", positive=True)
    bases = {power.base for power in form.lagrangian.atoms(sympy.Pow) if not power.exp.is_Integer and power.has(*v)}
    for base in sorted(bases, key=str):
        curved = sympy.hessian(base, v) / 2
        rest = sympy.expand(base - (sympy.Matrix([v]) * curved * sympy.Matrix(v))[0])
        whole = form.lagrangian.xreplace({base: u})
        slope, shift = whole.diff(u), [whole.diff(x) for x in v]
        if any(x.has(*v) for x in (curved, rest, slope, *shift)) or any(b.has(u) for b in shift) or not curved.det():
            continue
        straight = whole - sympy.Add(*(b * x for b, x in zip(shift, v, strict=True)))
        column = sympy.Matrix([symbols[i] - b for i, b in zip(block, shift, strict=True)])
        along = curved.inv() * column
        sign = -1 if (-curved).is_positive_definite else 1
        definite = (sign * curved).is_positive_definite
        squared = sympy.Symbol("squared", nonnegative=True) if definite else sympy.Symbol("squared", real=True)
        length = {squared: simplest(sign * (column.T * along)[0])}
        potential, kinetic = straight.as_independent(u, as_Add=True)
        candidates = []
        for root in sympy.solve(4 * slope**2 * (u - rest) - sign * squared, u):
            factored = {u: sympy.factor(sympy.cancel(root))}  # a product, of which roots are taken factor by factor
            factor = simplest((1 / (2 * slope)).xreplace(factored))
            work = sign * squared * factor - kinetic.xreplace(factored)
            energy = min((work, simplest(work), rational_below(work)), key=size) - potential
            candidates.append(([x * factor.xreplace(length) for x in along], energy.xreplace(length)))
        return candidates
    return []


def _is_inverse(form: PlainForm, block: Sequence[int], symbols: Sequence[Any], velocities: Sequence[Any]) -> bool:
    """Return True if the formulas `velocities` give the velocities of random states from their momenta `symbols`."""

    def reproduced(point: SamplePoint) -> bool | None:
        values = form.at(point)
        momenta = [number(form.momenta[i], values) for i in block]
        if not all(p.imag == 0 for p in momenta):
            return None
        point_values = values | {
            symbols[i]: sympy.Float(p.real, FORMULA_DIGITS) for i, p in zip(block, momenta, strict=True)
        }
        again = [number(x, point_values) for x in velocities]
        return all(
            abs(x - values[form.v[i]]) <= LARGEST_ERROR * (1 + abs(x)) for i, x in zip(block, again, strict=True)
        )

    return bool(holds(random_points(form.statement, seed=0), reproduced, STATES))


@dataclass(frozen=True, eq=False)
class Hamiltonian(ShownAsPage):
    """The Hamiltonian H(q, p, t) of a system in SymPy, with Poisson brackets and Hamilton's equations.

    `expression` is H. `momenta` maps each coordinate to its momentum p_q, a function of time. `velocities` maps each
    coordinate to dq/dt, and `forces` to its force without a potential, Q - dD/dv, as functions of coordinates and
    momenta. `statement` states a system whose coordinates are q and p, by the Lagrangian p.dq/dt - H. `system_of` is
    a function that returns the System of a statement.
    """

    expression: Any
    momenta: Mapping[Any, Any]
    velocities: Mapping[Any, Any]
    forces: Mapping[Any, Any]
    statement: Statement
    system_of: Callable[[Statement], Any]

    def __repr__(self) -> str:
        return f"<Hamiltonian: {self.expression}>"

    def equations(self) -> list[Any]:
        """Return Hamilton's equations as a list of SymPy Eq: those for dq/dt, then those for dp/dt."""
        rates = [sympy.Eq(velocity_of(q), self._slope(p), evaluate=False) for q, p in self.momenta.items()]
        pulls = {p: simplest(-self._slope(q)) + self.forces[q] for q, p in self.momenta.items()}
        return rates + [sympy.Eq(velocity_of(p), pull, evaluate=False) for p, pull in pulls.items()]

    @refusing_deep
    def poisson(self, f: Any, g: Any) -> Any:
        """Return the Poisson bracket {f, g} = sum df/dq dg/dp - df/dp dg/dq.

        `f` and `g` are expressions in coordinates, momenta, parameters and t. Velocities in them are replaced by
        functions of momenta. Raises StatementError for any other symbol.
        """
        first, second = self._function(f, "the first function"), self._function(g, "the second function")
        form = self._form
        pairs = ((form.plain[q], form.plain[p]) for q, p in self.momenta.items())
        terms = (first.diff(x) * second.diff(y) - first.diff(y) * second.diff(x) for x, y in pairs)
        return form.written(simplest(sympy.Add(*terms)))

    @cached_property
    def system(self) -> Any:
        """The System of first order whose coordinates are q and p. Its runs agree with the original system."""
        return self.system_of(self.statement)

    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Compile Hamilton's equations for a `target`. The state (4n,) is [q, p] followed by their time derivatives."""
        model: Model = self.system.compile(target, check=check)
        return model

    def run(self, *arguments: Any, **options: Any) -> Any:
        """Run Hamilton's equations as `System.run` does; the solution has rows for coordinates and momenta."""
        return self.system.run(*arguments, **options)

    @cached_property
    def _form(self) -> PlainForm:
        return PlainForm(self.statement)

    def _slope(self, leaf: Any) -> Any:
        """Return the partial derivative of H by `leaf`, a coordinate or a momentum as a function of time."""
        form = self._form
        return form.written(simplest(form.read(self.expression).diff(form.plain[leaf])))

    def _function(self, function: Any, what: str) -> Any:
        """Return a user's function of q and p with symbols in place of functions of time; `what` names it in errors."""
        stated, survey = in_own_parameters(expression_of(function, what), self.statement.parameters), Survey()
        survey.add(stated, what)
        known = (*self.statement.coordinates, *self.statement.given, *self.statement.parameters)
        survey.require(known, what, f": its coordinates and momenta are {listing(self.statement.names)}.")
        rates = {velocity_of(q): self.velocities[q] for q in self.momenta}
        stated = stated.xreplace(rates)
        left = [rate for rate in survey.velocities if rate not in rates]
        if left:
            raise StatementError(f"{what} contains {left[0]}: give coordinates and momenta, not the rates of momenta.")
        return self._form.read(stated)


def hamiltonian(statement: Statement, model: Model, system_of: Callable[[Statement], Any]) -> Hamiltonian:
    """Return the Hamiltonian of a statement, tested against its compiled `model`.

    `system_of` returns the System of a statement. Raises StatementError for constraints and rotations, and if the
    momenta do not determine the velocities.
    """
    if statement.constraints:
        raise StatementError(
            f"{statement.name} has constraints ({listing(constraint.name for constraint in statement.constraints)}), "
            "and Hamilton's equations have no constraint forces: eliminate(...) makes a system without constraints on "
            "positions."
        )
    if statement.rotations:
        raise StatementError(
            f"{statement.name} has the rotation {statement.rotations[0]}: Hamilton's equations are not written out for "
            "rotations. Use `momenta` and `energy`, or state the system with angles."
        )
    form = PlainForm(statement)
    names = momentum_names(statement, statement.names)
    transform = legendre(form, [sympy.Symbol(name, real=True) for name in names])
    _check(form, transform, model)
    return _record(form, list(map(coordinate_of, names)), transform, system_of)


def _record(
    form: PlainForm, momenta: list[Any], legendre: Legendre, system_of: Callable[[Statement], Any]
) -> Hamiltonian:
    """Return the `Hamiltonian` that a Legendre transform gives, with a statement in coordinates and momenta.

    `momenta` are functions of time p_q, in place of the symbols in `legendre`. `system_of` returns the System of a
    statement.
    """
    statement = form.statement
    back = dict(zip(legendre.symbols, momenta, strict=True))
    in_momenta = dict(zip(form.v, legendre.velocities, strict=True))

    def stated(expression: Any) -> Any:
        return form.written(expression).xreplace(back)

    energy = stated(legendre.hamiltonian)
    forces = {
        q: stated(simplest(force.xreplace(in_momenta)))
        for q, force in zip(statement.coordinates, form.forces, strict=True)
    }
    pairs = list(zip(statement.coordinates, momenta, strict=True))
    # Momenta have no initial values if a parameter has none.
    initial = dict(zip(statement.coordinates, statement.initial, strict=False))
    initial |= {p: x for p, x in zip(momenta, form.initial_momenta, strict=True) if x is not None}
    first_order = declare(
        lagrangian=sympy.Add(*(p * velocity_of(q) for q, p in pairs)) - energy,
        coordinates=[*statement.coordinates, *momenta],
        forces={q: force for q, force in forces.items() if force != 0},
        parameters={p: statement.defaults.get(p) for p in statement.parameters},
        initial=initial,
        positions={
            name: tuple(stated(form.read(x).xreplace(in_momenta)) for x in point)
            for name, point in statement.positions.items()
        },
        links=statement.links,
        name=f"{statement.name} in Hamilton's form",
    )
    return Hamiltonian(
        expression=energy,
        momenta=MappingProxyType(dict(pairs)),
        velocities=MappingProxyType(
            {q: stated(v) for q, v in zip(statement.coordinates, legendre.velocities, strict=True)}
        ),
        forces=MappingProxyType(forces),
        statement=with_origin(first_order, statement),
        system_of=system_of,
    )


def _check(form: PlainForm, legendre: Legendre, model: Model) -> None:
    """Raise RunError if the Legendre transform differs from the compiled model at random states.

    H, dH/dp and -dH/dq + Q are compared with the energy, the velocities and the forces.
    """
    slopes = [legendre.hamiltonian.diff(p) for p in legendre.symbols]
    pulls = [-legendre.hamiltonian.diff(q) + force for q, force in zip(form.q, form.forces, strict=True)]

    def values(point: Any) -> tuple[list[float], list[Any]]:
        numbers = form.at(point)
        momenta = model.momenta(point.q, point.v, point.t, point.parameters)
        numbers |= {p: sympy.Rational(float(x)) for p, x in zip(legendre.symbols, momenta, strict=True)}
        compiled = [
            model.energy(point.q, point.v, point.t, point.parameters),
            *point.v,
            *model.evaluate("forces", point.q, point.v, point.t, point.parameters),
        ]
        return compiled, [number(x, numbers) for x in (legendre.hamiltonian, *slopes, *pulls)]

    compared("the Hamiltonian", form.statement, values)
