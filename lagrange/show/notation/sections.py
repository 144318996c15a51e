"""Divide a derivation into sections as in a textbook: energies, Lagrangian, each coordinate, equations, solution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError

if TYPE_CHECKING:
    from lagrange.equations.derivation import Derivation
    from lagrange.statement.statement import Statement

# SymPy is imported in functions: the command line parses its options before it needs SymPy.

READABLE = 150
"""Largest number of operations in an acceleration that a page prints; a longer one is replaced by a sentence. 150
operations fill five lines; an acceleration of the double pendulum has 60. `accelerations()` has all of them."""
LARGEST_MATRIX = 6  # Largest number of rows of a matrix that a page shows
WIDEST_MATRIX = 50
"""Largest number of operations in a row of a printed matrix, which fills a line. Each column counts as its longest
entry."""

WIDEST_VECTOR = 30  # Largest number of operations of all entries of a vector on one line


@dataclass(frozen=True)
class ShownQuantity:
    """A quantity in a formula: its letter, such as T or p, with its indices; the square of the letter if `squared`.

    The indices are names of coordinates, of a constraint or of a point, as in p_theta.
    """

    letter: str
    indices: tuple[str, ...] = ()
    squared: bool = False


@dataclass(frozen=True)
class Partial:
    """A partial derivative in a formula, such as dL/dtheta: of `quantity` by the coordinate or velocity `by`."""

    quantity: ShownQuantity
    by: Any


@dataclass(frozen=True)
class Rate:
    """A time derivative d/dt in a formula: of a partial derivative or of a momentum, `inside`."""

    inside: Partial | ShownQuantity


@dataclass(frozen=True)
class Product:
    """A product in a formula. Its `factors` are expressions and quantities."""

    factors: tuple[Any, ...]


@dataclass(frozen=True)
class Transpose:
    """The transpose, in a formula, of a matrix or of a row."""

    matrix: Any


@dataclass(frozen=True)
class SignedTerms:
    """A sum in a formula: its `terms` are pairs (True if the term is subtracted, term)."""

    terms: tuple[tuple[bool, Any], ...]


@dataclass(frozen=True)
class ExpressionRows:
    """A matrix in a formula: its rows of expressions. With `vector` it has one row, printed as a vector (x, y)."""

    rows: tuple[tuple[Any, ...], ...]
    vector: bool = False


@dataclass(frozen=True)
class Formula:
    """A formula a = b = ...: its sides, each a SymPy expression or an object such as `Partial` or `SignedTerms`."""

    sides: tuple[Any, ...]

    @property
    def operations(self) -> int:
        """Number of operations in the expressions of the formula."""
        from sympy import Basic

        return sum(int(side.count_ops()) for side in self.sides if isinstance(side, Basic))


@dataclass(frozen=True)
class Section:
    """A section of a derivation: its heading, and its `rows`, which are formulas and sentences.

    `symbol` is the coordinate that the section is about, or None.
    """

    heading: str
    rows: tuple[Formula | str, ...]
    symbol: Any = None


LAGRANGIAN, KINETIC, POTENTIAL = (ShownQuantity(letter) for letter in "LTV")


def sections(derivation: Derivation) -> Iterator[Section]:
    """Yield the sections of a derivation; a sentence replaces formulas that are too long.

    A known function that is a table of values appears as a function with a name, such as S(x).
    """
    derivation, tables = derivation.with_named_tables()
    statement = derivation.statement
    yield Section("Stated", (*_stated(derivation), *tables))
    if derivation.refusal:
        yield Section("Equations of motion", (f"Not written out: {derivation.refusal}",))
        return
    solved = "Accelerations and multipliers" if statement.constraints else "Accelerations"
    # The Jacobi integral is J = v.p - L, where it differs from E = T + V.
    energy, letter = ("Energy", "E") if derivation.energy_is_sum else ("Jacobi integral", "J")
    parts: list[tuple[str, Any, Callable[[Derivation], Iterable[Formula | str]]]] = [
        ("Positions and velocities", None, _points),
        ("Lagrangian", None, _lagrangian),
        *(("Coordinate", q, partial(_coordinate, index=index)) for index, q in enumerate(statement.coordinates)),
        ("Equations of motion", None, lambda d: [Formula((eq.lhs, eq.rhs)) for eq in (*d.equations, *d.constraints)]),
        ("Matrix form", None, _matrices),
        (solved, None, _accelerations),
        (energy, None, lambda d: [Formula((ShownQuantity(letter), d.energy))] if statement.lagrangian != 0 else ()),
    ]
    for heading, symbol, part in parts:
        rows: tuple[Formula | str, ...]
        try:
            rows = tuple(part(derivation))
        except StatementError as refusal:
            rows = (f"Not written out: {refusal}",)
        if rows:
            yield Section(heading, rows, symbol)


def stated_formulas(statement: Statement) -> Iterator[Formula | str]:
    """Yield the stated energies, forces, known functions of time and constraints as formulas.

    A known function that is a table of values is described by a sentence.
    """
    if statement.lagrangian_alone:
        yield Formula((LAGRANGIAN, statement.lagrangian))
    else:
        yield Formula((KINETIC, statement.kinetic))
        yield Formula((POTENTIAL, statement.potential))
    for name, force in zip(statement.names, statement.forces, strict=True):
        if force != 0:
            yield Formula((ShownQuantity("Q", (name,)), force))
    if statement.dissipation != 0:
        yield Formula((ShownQuantity("D"), statement.dissipation))
    for motion in statement.known_motions:
        yield motion if isinstance(motion, str) else Formula(motion)
    for constraint in statement.constraints:
        yield Formula((ShownQuantity("f", (constraint.name,)), constraint.expression))


def _stated(derivation: Derivation) -> Iterator[Formula | str]:
    """Yield the description, the source and the stated formulas of the system of a derivation.

    An energy T = a also shows its simplified expression b, as T = a = b, if b differs from a and is not too long.
    """
    statement = derivation.statement
    if statement.about:
        yield statement.about
    if statement.source:
        yield f"Source: {statement.source}"
    energies = {KINETIC: "kinetic", POTENTIAL: "potential"}
    for row in stated_formulas(statement):
        sides = row.sides if isinstance(row, Formula) else ()
        if sides and sides[0] in energies and not derivation.refusal:
            with suppress(StatementError):
                simplified = getattr(derivation, energies[sides[0]])
                row = row if simplified == sides[1] else Formula((*sides, simplified))
        yield row


def _points(derivation: Derivation) -> Iterator[Formula | str]:
    from sympy import Rational

    for point in derivation.points:
        yield Formula((ShownQuantity("r", (point.name,)), _vector(point.position)))
        yield Formula((ShownQuantity("v", (point.name,)), _vector(point.velocity)))
        squared = ShownQuantity("v", (point.name,), squared=True)
        half = Product((Rational(1, 2), point.mass, squared))
        yield Formula((squared, point.squared_speed))
        yield Formula((ShownQuantity("T", (point.name,)), half))


def _vector(entries: tuple[Any, ...]) -> ExpressionRows:
    """Return the vector with these entries for a formula, as a row, or as a column if a row is wider than a line."""
    if sum(int(entry.count_ops()) for entry in entries) <= WIDEST_VECTOR:
        return ExpressionRows((entries,), vector=True)
    return ExpressionRows(tuple((entry,) for entry in entries))


def _lagrangian(derivation: Derivation) -> Iterator[Formula | str]:
    statement = derivation.statement
    if statement.lagrangian_alone:
        if derivation.lagrangian != statement.lagrangian:  # the stated L is already in the section above
            yield Formula((LAGRANGIAN, derivation.lagrangian))
        return
    difference = SignedTerms(((False, KINETIC), (True, POTENTIAL)))
    yield Formula((LAGRANGIAN, difference, derivation.lagrangian))


def _coordinate(derivation: Derivation, index: int) -> Iterator[Formula | str]:
    """Yield the terms of the Euler-Lagrange equation of coordinate number `index`, then the equation itself.

    Terms are formulas such as dL/dtheta = -m g l sin(theta). The equation contains only their left sides.
    """
    statement = derivation.statement
    q, name = statement.coordinates[index], statement.names[index]
    velocity, force = statement.velocities[index], statement.forces[index]
    slope = Partial(LAGRANGIAN, velocity)
    yield Formula((ShownQuantity("p", (name,)), slope, derivation.momenta[q]))
    yield Formula((Rate(slope), derivation.momentum_rates[q]))
    yield Formula((Partial(LAGRANGIAN, q), derivation.gradient[q]))
    left: list[tuple[bool, Any]] = [(False, Rate(slope)), (True, Partial(LAGRANGIAN, q))]
    right: list[tuple[bool, Any]] = []
    if derivation.drag[q] != 0:
        drag = Partial(ShownQuantity("D"), velocity)
        yield Formula((drag, derivation.drag[q]))
        left.append((False, drag))
    if force != 0:
        yield Formula((ShownQuantity("Q", (name,)), force))
        right.append((False, ShownQuantity("Q", (name,))))
    for constraint in statement.constraints:
        exerted = derivation.constraint_forces[constraint.name][q]
        if exerted != 0:
            push = Product(
                (
                    constraint.multiplier,
                    Partial(ShownQuantity("f", (constraint.name,)), q if constraint.holonomic else velocity),
                )
            )
            yield Formula((push, exerted))
            right.append((False, push))
    if not right and len(left) == 2 and derivation.gradient[q] == 0:
        yield Formula((Rate(ShownQuantity("p", (name,))), SignedTerms(())))
    else:
        yield Formula((SignedTerms(tuple(left)), SignedTerms(tuple(right))))


def _matrices(derivation: Derivation) -> Iterator[Formula | str]:
    """Yield the equations of motion as M a = h, then the matrices, for systems with more than one coordinate.

    M is the mass matrix, a are the accelerations, and h is the right side. With constraints the transpose of their
    gradient G, times the multipliers, is added to h.
    """
    statement = derivation.statement
    names = statement.names
    if len(names) == 1:
        return
    if len(names) > LARGEST_MATRIX:
        yield f"M a = h has {len(names)} rows, which are the equations of motion; mass_matrix has its matrix."
        return
    mass, right, gradient = (ShownQuantity(letter) for letter in "MhG")
    multipliers = [constraint.multiplier for constraint in statement.constraints]
    accelerations = _column(list(statement.plain.values())[2::3])
    pushed = [(False, Product((Transpose(gradient), _column(multipliers))))] if multipliers else []
    rests = [(False, right)] if any(derivation.right_sides.values()) else []
    yield Formula((Product((mass, accelerations)), SignedTerms((*rests, *pushed))))
    entries = [tuple(derivation.mass_matrix.row(i)) for i in range(len(names))]
    yield from _matrix("M", entries, names, symmetric=True)
    if rests:
        yield from _matrix("h", [(h,) for h in derivation.right_sides.values()], names)
    rows = [
        tuple(derivation.constraint_forces[constraint.name][q] / constraint.multiplier for q in statement.coordinates)
        for constraint in statement.constraints
    ]
    if rows:
        yield from _matrix("G", rows, [constraint.name for constraint in statement.constraints], names)


def _column(entries: Sequence[Any]) -> Any:
    """Return a column vector for a formula, written as the transpose of a row of `entries`; a single entry as it is."""
    return entries[0] if len(entries) == 1 else Transpose(ExpressionRows((tuple(entries),), vector=True))


def _matrix(
    letter: str,
    rows: Sequence[tuple[Any, ...]],
    names: Sequence[str],
    column_names: Sequence[str] = (),
    *,
    symmetric: bool = False,
) -> Iterator[Formula]:
    """Yield the formula of a matrix called `letter`, or one formula for each nonzero entry if the matrix is too wide.

    `names` are the names of the rows, and `column_names` the names of the columns, by default the same names. Each pair
    of equal entries of a `symmetric` matrix is written once.
    """
    if sum(max(int(entry.count_ops()) for entry in column) for column in zip(*rows, strict=True)) <= WIDEST_MATRIX:
        yield Formula((ShownQuantity(letter), ExpressionRows(tuple(rows))))
        return
    columns = column_names or names
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            if entry != 0 and not (symmetric and j < i):
                indices = (names[i],) if len(row) == 1 and not column_names else (names[i], columns[j])
                yield Formula((ShownQuantity(letter, indices), entry))


def _accelerations(derivation: Derivation) -> Iterator[Formula | str]:
    statement = derivation.statement
    multipliers = {constraint.name: constraint.multiplier for constraint in statement.constraints}
    constants = _constant_sums(statement)
    solved = [
        *zip(list(statement.plain.values())[2::3], derivation.accelerations.values(), strict=True),
        *((multipliers[name], value) for name, value in derivation.multipliers.items()),
    ]
    solved = [(symbol, value.xreplace(constants)) for symbol, value in solved]
    long = [symbol for symbol, value in solved if value.count_ops() > READABLE]
    for symbol, value in solved:
        if symbol not in long:
            yield Formula((symbol, value))
    if long:
        subject = "The other formulas are" if len(long) < len(solved) else "The formulas are"
        longest = max(int(value.count_ops()) for _, value in solved)
        yield (
            f"{subject} too long to be read: the longest has {longest} operations, and a page shows up to {READABLE}. "
            "accelerations() has them as expressions; compile() gives them as numbers."
        )


def _constant_sums(statement: Statement) -> dict[Any, Any]:
    """Return a dict from sums that constraints keep constant to their values, such as {x**2 + y**2: l**2}."""
    constants: dict[Any, Any] = {}
    for constraint in statement.constraints:
        zero = constraint.expression.expand().as_content_primitive()[1]
        fixed, moving = zero.as_independent(*statement.coordinates, *statement.velocities, as_Add=True)
        if moving.is_Add and fixed != 0 and constraint.holonomic:
            constants |= {moving: -fixed, -moving: fixed}
    return constants
