"""The Legendre transform: velocities as functions of momenta, and H = p.v - L.

Where L is quadratic in the velocities, p = M v + b and H = (p - b) M^-1 (p - b)/2 - L(v = 0). Elsewhere the momenta
are solved for the velocities, block by block of d2L/dv2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.equations.solve import coupled_blocks
from lagrange.errors import StatementError, listing
from lagrange.evidence.sample import SAMPLE_KINDS, Sampler
from lagrange.mechanics.number_check import LARGEST_ERROR, MOST_DRAWS
from lagrange.mechanics.plain_form import DIGITS, PlainForm, number
from lagrange.mechanics.simplification import is_zero, simplest, size

LARGEST_BLOCK = 4
"""Coupled velocities that are solved for in symbols: the inverse of five has thousands of terms."""


@dataclass(frozen=True)
class Legendre:
    """Momenta as symbols, velocities and H as functions of them, in plain symbols."""

    symbols: tuple[Any, ...]
    velocities: tuple[Any, ...]
    hamiltonian: Any


def legendre(form: PlainForm, symbols: Sequence[Any]) -> Legendre:
    """Return the transform of a Lagrangian. Raises StatementError where velocities do not follow from momenta."""
    mass = form.mass
    blocks = coupled_blocks([[entry != 0 for entry in row] for row in mass.tolist()])
    solve = _solved if mass.has(*form.v) else _inverted
    velocities: dict[int, Any] = {}
    energies = []
    for block in blocks:
        found, energy = solve(form, block, symbols)
        velocities.update(zip(block, found, strict=True))
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
    """Return adjugate and determinant of a block of the mass matrix. Raises StatementError if it is singular."""
    if len(block) > LARGEST_BLOCK:
        names = listing(form.statement.names[i] for i in block)
        raise StatementError(
            f"{form.statement.name} is too large for its velocities to be written out in momenta: {names} are coupled, "
            f"and at most {LARGEST_BLOCK} are solved for in symbols. compile() runs it in velocities."
        )
    mass = form.mass.extract(list(block), list(block))
    determinant = simplest(mass.det(method="berkowitz"))
    if is_zero(determinant):
        raise StatementError(_degenerate(form, block))
    return mass.adjugate(method="berkowitz").applyfunc(simplest), determinant


def _inverted(form: PlainForm, block: Sequence[int], symbols: Sequence[Any]) -> tuple[list[Any], Any]:
    """Return the velocities of a block of inertia without velocities in it, and (p - b) M^-1 (p - b)/2."""
    adjugate, determinant = inverse(form, block)
    still = dict.fromkeys(form.v, sympy.S.Zero)
    column = sympy.Matrix([symbols[i] - form.momenta[i].xreplace(still) for i in block])
    mass = form.mass.extract(list(block), list(block))
    return [simplest(x / determinant) for x in adjugate * column], half_square(mass, (adjugate, determinant), column)


def half_square(mass: Any, inverted: tuple[Any, Any], column: Any) -> Any:
    """Return c M^-1 c/2 over one denominator, or as a sum of squares where that is shorter, as for a top.

    `inverted` are the adjugate and the determinant of M.
    """
    adjugate, determinant = inverted
    above, below = sympy.fraction(simplest((column.T * adjugate * column)[0] / (2 * determinant)))
    whole, squares = sympy.expand(above) / below, _squares(mass, list(column))
    return min((whole, sympy.Add(*squares)), key=size) if squares else whole


def _squares(mass: Any, column: list[Any]) -> list[Any]:
    """Return the terms w^2/(2 d) of c M^-1 c/2, with pivots d taken in order of their length; none without pivots."""
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
    """Return why momenta do not determine velocities."""
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
    """Return the velocities of a block whose inertia depends on them, and H where it is known beside them.

    Of several branches the one is taken that gives back the velocities of random states.
    """
    candidates = _by_length(form, block, symbols)
    if not candidates and len(block) == 1:
        (i,) = block
        candidates = [([root], None) for root in sympy.solve(form.momenta[i] - symbols[i], form.v[i])]
    for found, energy in candidates:
        if _is_inverse(form, block, symbols, found):
            return found, energy
    if is_zero(form.mass.extract(list(block), list(block)).det(method="berkowitz")):
        raise StatementError(_degenerate(form, block))
    names = listing(form.statement.names[i] for i in block)
    raise StatementError(
        f"the momenta of {form.statement.name} are not solved for the velocities of {names} in symbols: they are not "
        "linear in them. compile() runs the system in velocities."
    )


def _by_length(form: PlainForm, block: Sequence[int], symbols: Sequence[Any]) -> list[tuple[list[Any], Any]]:
    """Return velocities and H where L = F(u) + b.v with u = c + v B v, as for a relativistic particle in a field.

    Then p - b = 2 F'(u) B v, and 4 F'(u)^2 (u - c) = (p - b) B^-1 (p - b) is solved for u.
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
        found = []
        for root in sympy.solve(4 * slope**2 * (u - rest) - sign * squared, u):
            held = {u: sympy.factor(sympy.cancel(root))}  # a product, of which roots are taken factor by factor
            factor = simplest((1 / (2 * slope)).xreplace(held))
            energy = _with_roots_together(sign * squared * factor - straight.xreplace(held))
            found.append(([x * factor.xreplace(length) for x in along], energy.xreplace(length)))
        return found
    return []


def _with_roots_together(given: Any) -> Any:
    """Return a sum with its terms that have roots over one denominator."""
    rooted: list[Any] = []
    rest: list[Any] = []
    for term in sympy.Add.make_args(sympy.expand(given)):
        has = any(not power.exp.is_Integer for power in term.atoms(sympy.Pow))
        (rooted if has else rest).append(term)
    whole = sympy.Add(*rooted)
    return sympy.Add(min((whole, sympy.simplify(whole)), key=size), *rest)


def _is_inverse(form: PlainForm, block: Sequence[int], symbols: Sequence[Any], found: Sequence[Any]) -> bool:
    """Return whether velocities come back from the momenta that they make, at a few random states."""
    sampler, seen = Sampler(form.statement, seed=0), 0
    for attempt in range(MOST_DRAWS):
        values = form.at(sampler.point(SAMPLE_KINDS[(attempt + 1) % 4], attempt))
        momenta = [number(form.momenta[i], values) for i in block]
        if not all(p.imag == 0 for p in momenta):
            continue
        known = values | {symbols[i]: sympy.Float(p.real, DIGITS) for i, p in zip(block, momenta, strict=True)}
        again = [number(x, known) for x in found]
        if any(abs(x - values[form.v[i]]) > LARGEST_ERROR * (1 + abs(x)) for i, x in zip(block, again, strict=True)):
            return False
        seen += 1
    return seen > 0
