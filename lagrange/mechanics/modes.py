"""Find the modes of small oscillations: frequencies and shapes of M x'' + C x' + K x = 0.

Without C, det(K - w^2 M) = 0 and (K - w^2 M) x = 0; with C, det(M s^2 + C s + K) = 0. Results are symbolic if the
factors of the determinant have degree 1 or 2. Source: H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed.,
2002, chapter 6.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from lagrange.equations.solve_plan import distinct_values
from lagrange.errors import FAULT, RunError, StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.mechanics.expansion import StatedPoint
from lagrange.mechanics.linearization import Linearization, has_inertia, has_long_formulas
from lagrange.mechanics.plain_form import (
    PlainForm,
    is_zero,
    number,
    numeric,
    rational_below,
    root_of_square,
    simplest,
    size,
)
from lagrange.mechanics.stability import REAL_PART, first_order_matrix, matrix_values, stability_of
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.declare import ORIGIN
from lagrange.statement.display import ShownAsPage
from lagrange.statement.statement import Statement

LARGEST_SYMBOLIC = 4
"""Largest number of coordinates for symbolic frequencies. For five the characteristic polynomial fills pages."""

LONGEST_POLYNOMIAL = 3000  # Largest number of operations in a characteristic polynomial that is factored

LONGEST_SIMPLIFIED = 60
"""Largest number of operations in a formula with roots that SymPy simplifies. Longer ones may take hours."""

NULL_ENTRY = 1e-18
"""Largest entry of a null vector that counts as zero, relative to its largest entry: rounding in 30 digits"""

SMALL = 1e-7  # Frequencies below this fraction of the largest count as zero. Their squares are accurate to about 1e-16


@dataclass(frozen=True, eq=False)
class Modes(ShownAsPage):
    """The n modes of vibration about an equilibrium: `frequencies`, and `shapes` as column vectors in `coordinates`.

    A mode has the eigenvalues -decay + i frequency and -decay - i frequency. The frequency is real if the mode
    oscillates and imaginary if it does not. A mode with an imaginary frequency grows if its magnitude exceeds `decay`.
    If `symbolic` is true, frequencies, decays and shapes are formulas; else numbers at the values of the parameters.
    `eigenvalues` are 2n numbers, or empty if a parameter has no value. `stable` is True, False, or None if undecided;
    `reason` says why. `linearization` has the matrices M, C and K.
    """

    coordinates: tuple[Any, ...]
    frequencies: tuple[Any, ...]
    decay: tuple[Any, ...]
    shapes: tuple[Any, ...]
    eigenvalues: tuple[complex, ...]
    symbolic: bool
    stable: bool | None
    reason: str
    linearization: Linearization

    def __repr__(self) -> str:
        return self._summary(map(str, self.frequencies))

    def _summary(self, frequencies: Iterable[str]) -> str:
        """Return a line of text on the stability and the `frequencies`, which are given as texts."""
        word = {True: "stable", False: "unstable", None: "undecided"}[self.stable]
        return f"<Modes: {word}; frequencies {listing(frequencies)}>"


def check_first_order(lin: Linearization, form: PlainForm) -> None:
    """Raise StatementError if a coordinate has no inertia at any state, so that it cannot vibrate."""
    name, coordinates = form.statement.name, form.statement.coordinates
    massless = {q for q, p in zip(coordinates, form.momenta, strict=True) if not p.has(*form.v)}
    names = [name_of(q) for q in lin.velocity_coordinates if q in massless]
    if not names:
        return
    raise StatementError(
        f"{listing(names)} {'has' if len(names) == 1 else 'have'} no inertia, so not all motions of {name} are modes "
        "of vibration: take the eigenvalues of linearize(...).A, which tell how motions decay, grow or vibrate."
    )


@dataclass(frozen=True)
class _Root:
    """One mode before its shape is computed: `value` is its eigenvalue s = -`decay` + i `frequency`."""

    frequency: Any
    decay: Any
    value: Any


def modes(lin: Linearization, point: StatedPoint) -> Modes:
    """Return the modes about an equilibrium or a steady motion. Raises StatementError at any other point."""
    statement = point.form.statement
    if not lin.equilibrium:
        raise StatementError(f"there are no modes at this point. {lin.note} equilibria() looks for equilibria.")
    if any(x.has(t) for x in (*lin.M, *lin.C, *lin.K)):
        raise StatementError(
            f"the linear equations of {statement.name} depend on time at this point, and have no modes: linearize() "
            "gives the matrices."
        )
    if not has_inertia(lin):
        check_first_order(lin, point.form)
        raise StatementError(
            f"the mass matrix of {statement.name} is singular at this point: state the modes in coordinates that are "
            "regular there."
        )
    moving = lin.of_velocity_coordinates()
    if moving is None:
        raise StatementError(
            f"{statement.name} has constraints on velocities, and its forces depend on more coordinates than it has "
            "independent velocities, so M, C and K have no modes: take the eigenvalues of linearize(...).A."
        )
    lin = moving
    values = matrix_values(lin, point)
    short = not point.decimal and lin.M.rows <= LARGEST_SYMBOLIC and not has_long_formulas(lin)
    symbolic = _symbolic(lin) if short else None
    if symbolic is None and values is None:
        statement.require_parameters(f"the modes of {statement.name} are not found in symbols, and for numbers")
    verdict = stability_of(lin, point)
    if symbolic is not None:
        roots, shapes = symbolic
        _check(roots, lin, values)
        known = values or _values_of(lin.M, lin.C, lin.K)
        frequencies = [number(root.frequency, known) for root in roots]
        order = sorted(range(len(roots)), key=lambda i: (abs(frequencies[i].imag), abs(frequencies[i].real)))
        roots, shapes = [roots[i] for i in order], [shapes[i] for i in order]
    elif values is not None:
        roots, shapes = _numbers(lin, values)
    return Modes(
        lin.coordinates,
        tuple(root.frequency for root in roots),
        tuple(root.decay for root in roots),
        tuple(shapes),
        () if values is None else tuple(complex(x) for x in eigenvalues(lin, values)),
        symbolic is not None,
        verdict.stable,
        verdict.reason,
        lin,
    )


def _check(roots: Sequence[_Root], lin: Linearization, values: Mapping[Any, Any] | None) -> None:
    """Raise RunError if a symbolic root is no eigenvalue at `values` of the symbols, or at arbitrary ones if None."""
    values = _values_of(lin.M, lin.C, lin.K) if values is None else values
    numbers = eigenvalues(lin, values)
    for root in roots:
        value = complex(number(sympy.I * root.frequency - root.decay, values))
        # A double eigenvalue is accurate to the square root of rounding.
        if cmath.isfinite(value) and np.abs(numbers - value).min() > REAL_PART * max(1e-300, np.abs(numbers).max()):
            raise RunError(
                f"the frequency {root.frequency} is wrong: {value:.12g} is not an eigenvalue of the linear equations. "
                + FAULT
            )


def _values_of(*matrices: Any) -> Mapping[Any, Any]:
    """Return {symbol: number} for all symbols in matrices, with distinct, arbitrary numbers.

    With these numbers frequencies can be sorted although parameters have no values.
    """
    return distinct_values(s for matrix in matrices for x in matrix for s in sorted(x.free_symbols, key=str))


def eigenvalues(lin: Linearization, values: Mapping[Any, Any]) -> Any:
    """Return the eigenvalues s of (M s^2 + C s + K) x = 0 at `values` of the symbols, sorted by their real parts."""
    mass, damping, stiffness = (numeric(x, values) for x in (lin.M, lin.C, lin.K))
    return np.sort_complex(np.linalg.eigvals(first_order_matrix(mass, damping, stiffness)))


def _symbolic(lin: Linearization) -> tuple[list[_Root], list[Any]] | None:
    """Return (roots, shapes) of the modes in symbols, or None if they are not found.

    They are not found if det(M s^2 + C s + K) is too long, if the matrices contain decimals, or if a factor of the
    determinant is not solved, such as one of degree above two.
    """
    s = sympy.Dummy("s")
    pencil = lin.M * s**2 + lin.C * s + lin.K
    polynomial = sympy.expand(pencil.det(method="berkowitz"))
    if size(polynomial) > LONGEST_POLYNOMIAL or any(x.has(sympy.Float) for x in (*lin.M, *lin.C, *lin.K)):
        return None
    polynomial = sympy.numer(sympy.together(polynomial))
    even = not sympy.expand(polynomial - polynomial.xreplace({s: -s}))
    squared = sympy.Dummy("squared")
    if even:
        polynomial = sympy.Poly(polynomial, s).as_expr().xreplace({s ** (2 * k): squared**k for k in range(1, 20)})
    roots = _roots(polynomial, squared if even else s, even)
    if roots is None or len(roots) != lin.M.rows:
        return None
    shapes: list[Any] = []
    for root in roots:
        same = [other for other in roots[: len(shapes)] if other.value == root.value]
        shape = _shape(pencil.xreplace({s: root.value}), len(same))
        if shape is None:
            return None
        shapes.append(shape)
    return roots, shapes


def _roots(polynomial: Any, x: Any, even: bool) -> list[_Root] | None:
    """Return the modes whose eigenvalues s are the roots of the characteristic polynomial, or None if it is not solved.

    If `even` is true, only even powers of s occur, as without damping, and x is the symbol for s^2. Else x is s.
    """
    roots: list[_Root] = []
    for factor, power in sympy.factor_list(polynomial, x)[1]:
        if not factor.has(x):
            continue  # SymPy lists the square root of a parameter as a factor
        coefficients = [simplest(c) for c in sympy.Poly(factor, x).all_coeffs()]
        pair = _of_factor(coefficients, even)
        if pair is None:
            return None
        roots += pair * power
    if not even:
        zeros = [root for root in roots if root.value == 0]  # both zeros of s^2 = 0 are one mode
        roots = [root for root in roots if root.value != 0] + zeros[: (len(zeros) + 1) // 2]
    return roots


def _of_factor(coefficients: Sequence[Any], even: bool) -> list[_Root] | None:
    """Return the modes of a factor of the characteristic polynomial, or None if its degree is above two.

    `coefficients` are those of powers of s^2 if `even` is true, else of the eigenvalue s; the highest power is first.
    A linear factor in s other than s itself is not solved either.
    """
    zero = sympy.S.Zero
    if len(coefficients) == 2:
        root = simplest(-coefficients[1] / coefficients[0])
        if not even:
            return [_Root(zero, zero, zero)] if root == 0 else None
        return [_oscillation(root)]
    if len(coefficients) != 3:
        return None
    a, b, c = coefficients
    if even:
        root = _root_of(b**2 - 4 * a * c)
        pair = [_oscillation(_neat((-b + sign * root) / (2 * a))) for sign in (1, -1)]
        other = _by_product(simplest(b / a), simplest(c / a))
        return min((pair, other), key=lambda two: size(two[0].frequency)) if other else pair
    decay = simplest(b / (2 * a))
    frequency = _root_of(c / a - decay**2)
    return [_Root(frequency, decay, -decay + sympy.I * frequency)]


def _by_product(total: Any, squared: Any) -> list[_Root]:
    """Return two undamped modes, from w1^2 + w2^2 = `total` and w1^2 w2^2 = `squared` for their frequencies w.

    With P = w1 w2 the frequencies are (sqrt(total + 2 P) -+ sqrt(total - 2 P))/2. This form is the shorter one if P
    contains no root, as for Foucault's pendulum. The list is empty if P may be imaginary.
    """
    product = _root_of(squared)
    if not product.is_positive:
        return []
    wide, narrow = (_root_of(total + sign * 2 * product) for sign in (1, -1))
    frequencies = [_neat(sympy.expand((wide - narrow) / 2)), _neat(sympy.expand((wide + narrow) / 2))]
    return [_Root(w, sympy.S.Zero, sympy.I * w) for w in frequencies]


def _oscillation(root: Any) -> _Root:
    """Return the undamped mode whose eigenvalue s has the square `root`."""
    frequency = _root_of(-root)
    return _Root(frequency, sympy.S.Zero, sympy.I * frequency)


def _root_of(square: Any) -> Any:
    """Return the square root of an expression, with square factors taken out of the root."""
    root = sympy.sqrt(_neat(square))
    if not _is_short(root):
        return root
    return min((root, sympy.sqrtdenest(root), root_of_square(square)), key=size)


def _is_short(expression: Any) -> bool:
    """Return True if an expression is short enough for SymPy to simplify, even after expansion."""
    return size(expression) <= LONGEST_SIMPLIFIED and size(sympy.expand(expression)) <= LONGEST_SIMPLIFIED


def _neat(expression: Any) -> Any:
    """Return the shortest of a few equivalent forms of an expression with roots."""
    candidates = [expression, simplest(expression), sympy.factor_terms(expression)]
    if _is_short(expression):
        candidates += [sympy.factor(expression), rational_below(expression)]
    return min(candidates, key=size)


def _shape(matrix: Any, skipped: int) -> Any:
    """Return a null vector of a matrix, scaled so that its first non-zero entry is 1, as the shape of a mode.

    `skipped` is the number of independent null vectors before it, which are the shapes of modes of equal frequency. The
    result is None if there are no more.
    """
    adjugate = matrix.adjugate()
    values = _values_of(matrix)
    sizes = [abs(number(x, values)) for x in adjugate]
    adjugate = adjugate.applyfunc(lambda x: x if abs(number(x, values)) > NULL_ENTRY * max(sizes) else sympy.S.Zero)
    for k in range(adjugate.cols):
        column = adjugate[:, k]
        if skipped == 0 and max(sizes) > NULL_ENTRY and not column.is_zero_matrix:
            break
    else:
        columns = matrix.nullspace(simplify=simplest, iszerofunc=is_zero)
        if skipped >= len(columns):
            return None
        column = columns[skipped]

    def shortest(entry: Any) -> Any:
        """Return an entry of the shape, simplified and without roots in the denominator."""
        return min(map(_neat, (entry, rational_below(sympy.together(entry)))), key=size)

    return (column / next(x for x in column if x != 0)).applyfunc(shortest)


def _numbers(lin: Linearization, values: Mapping[Any, Any]) -> tuple[list[_Root], list[Any]]:
    """Return roots and shapes as numbers, sorted by the magnitudes of real and imaginary parts of the frequencies."""
    mass, damping, stiffness = (numeric(x, values) for x in (lin.M, lin.C, lin.K))
    n = mass.shape[0]
    eigenvalues, vectors = np.linalg.eig(first_order_matrix(mass, damping, stiffness))
    largest = max(1e-300, float(np.abs(eigenvalues).max()))
    turning = [i for i in range(2 * n) if eigenvalues[i].imag > SMALL * largest]
    still = sorted(
        (i for i in range(2 * n) if abs(eigenvalues[i].imag) <= SMALL * largest), key=lambda i: eigenvalues[i].real
    )
    pairs = [(eigenvalues[i].conjugate(), i) for i in turning]
    pairs += [(eigenvalues[still[k]], still[-1 - k]) for k in range(len(still) // 2)]
    _, sizes, rows = np.linalg.svd(stiffness)
    rigid = list(rows[sizes <= SMALL * max(1e-300, sizes.max())])  # zero is a multiple eigenvalue with few eigenvectors
    listed = []
    for other, i in pairs:
        # A pair is complex conjugate, or has the lowest and the highest real eigenvalue, opposite ones without damping.
        value = eigenvalues[i]
        decay, frequency = -(value + other).real / 2, (value - other) / 2j
        shown = sympy.Float(frequency.real) if value.imag > SMALL * largest else sympy.I * sympy.Float(-frequency.imag)
        root = _Root(
            shown if abs(frequency) > SMALL * largest else sympy.S.Zero,
            sympy.Float(decay) if abs(decay) > SMALL * largest else sympy.S.Zero,
            value,
        )
        vector = rigid.pop() if rigid and abs(value) <= SMALL * largest else vectors[:n, i]
        # The largest entry of the shape is 1. It is real if all imaginary parts are rounding errors.
        entries = vector / vector[int(np.argmax(np.abs(vector) >= 0.999 * np.abs(vector).max()))]
        real = np.abs(entries.imag).max() < SMALL
        parts = [(sympy.Float(float(x.real)), sympy.Float(float(x.imag))) for x in entries]
        listed.append((root, sympy.Matrix([a if real else a + sympy.I * b for a, b in parts])))
    listed.sort(key=lambda mode: tuple(abs(float(part)) for part in mode[0].frequency.as_real_imag()))
    return [root for root, _ in listed], [shape for _, shape in listed]


@dataclass(frozen=True, eq=False)
class ModeShapes:
    """Shapes of m modes about an equilibrium as numbers, each scaled so that its largest component is 1.

    `components` (m, n) are the displacements of the n coordinates in each mode, in the order of `names`.
    `frequencies` (m,) are complex for modes that do not oscillate. `decay` (m,) are the decay rates. `points` maps
    the name of each stated position to its value at the equilibrium, (2,) or (3,). `displacements` maps it to the
    displacements of the position in the modes, (m, 2) or (m, 3).
    """

    statement: Statement
    names: tuple[str, ...]
    frequencies: FloatArray
    decay: FloatArray
    components: FloatArray
    points: Mapping[str, FloatArray]
    displacements: Mapping[str, FloatArray]


def mode_shapes(modes: Modes, statement: Statement) -> ModeShapes:
    """Return the shapes and frequencies of `modes` as numbers, at the stated values of the parameters.

    Raises StatementError if a parameter has no value.
    """
    form, lin = PlainForm(statement), modes.linearization
    constants = statement.defaults
    statement.require_parameters("shapes are drawn at values of the parameters, and")
    basis = np.array([[number(x, constants).real for x in row] for row in lin.basis.tolist()], dtype=float)
    raw = np.array([[number(x, constants) for x in shape] for shape in modes.shapes]) @ basis.T
    # The real part of each shape, after division by its largest component.
    largest = [row[int(np.argmax(np.abs(row)))] or 1.0 for row in raw]
    components = np.array([(row / x).real for row, x in zip(raw, largest, strict=True)])
    # The coordinates of the equilibrium as numbers.
    entries = [
        lin.at.get(q, lin.at.get(name, 0)) for q, name in zip(statement.coordinates, statement.names, strict=True)
    ]
    place = [sympy.Float(number(sympy.Integer(0) + x, constants).real, 17) for x in entries]
    by_symbol = dict(zip(form.q, place, strict=True))
    values = {**constants, **by_symbol, **dict.fromkeys(form.v, sympy.S.Zero)}
    points: dict[str, FloatArray] = {}
    displacements: dict[str, FloatArray] = {}
    for name, position in statement.positions.items():
        parts = [form.read(part) for part in position]
        slopes = np.array([[number(part.diff(q), values).real for q in form.q] for part in parts])
        points[name] = np.array([number(part, values).real for part in parts])
        displacements[name] = components @ slopes.T
    if points and any(ORIGIN in (link.start, link.end) for link in statement.links):
        size = len(next(iter(points.values())))
        points[ORIGIN], displacements[ORIGIN] = np.zeros(size), np.zeros((len(components), size))
    return ModeShapes(
        statement,
        statement.names,
        np.array([number(x, constants) for x in modes.frequencies]),
        np.array([number(x, constants).real for x in modes.decay]),
        components,
        points,
        displacements,
    )
