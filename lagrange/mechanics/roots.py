"""Solve equations for real roots: in symbols, one unknown after another, or numerically from many starts.

In symbols every factor of an equation is a branch. A factor is solved if it is linear in an unknown, or of degree two
in the unknown, its sine or its cosine. If no such factor is left, polynomial equations of low degree are solved
together. If that fails, no solution is returned at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy

from lagrange.equations.terms import printable, with_known_signs
from lagrange.graph.differentiate import tangents
from lagrange.graph.evaluate import doubles
from lagrange.graph.node import Binding, Graph
from lagrange.graph.sympy_nodes import Translator
from lagrange.machine.backend import FloatArray
from lagrange.mechanics.plain_form import prescribed, simplest, size

MOST_BRANCHES = 64  # Largest number of branches that are followed; n factors in each of n equations make n^n
LONGEST_EQUATION = 400  # Largest number of operations in an equation that is factored

LONGEST_SYSTEM = 500
"""Largest number of operations in equations that are solved in symbols. Those of seven attracting bodies take minutes,
without success."""

HIGHEST_DEGREE = 8  # Largest product of the degrees of polynomial equations that are solved together, by Groebner bases

LONGEST_VALUE = 100
"""Largest number of operations in a root of polynomial equations: longer ones take minutes to simplify."""


class GivenUpError(Exception):
    """Raised if equations cannot be solved in symbols by the methods of this module."""


def solved(equations: Sequence[Any], unknowns: Sequence[Any]) -> list[dict[Any, Any]] | None:
    """Return all real solutions {unknown: value} of equations e = 0 in symbols, or None if they are not found.

    An unknown that stays arbitrary has no entry in a solution.
    """
    if sum(map(size, equations)) > LONGEST_SYSTEM:
        return None
    try:
        solutions = _follow([e for e in equations if e != 0], tuple(unknowns), {}, [MOST_BRANCHES])
    except GivenUpError:
        return None
    distinct: list[dict[Any, Any]] = []
    for values in solutions:
        if values in distinct or any(_is_complex(x) for x in values.values()):
            continue
        # A root of the numerators may also be a root of the denominators, where the forces are infinite.
        if not any(e.xreplace(values).has(sympy.zoo, sympy.nan, sympy.oo) for e in equations):
            distinct.append(values)
    return distinct


def _is_complex(value: Any) -> bool:
    """Return True if a value is infinite, or is complex for all values of the parameters."""
    if value.is_extended_real is False or value.has(sympy.zoo, sympy.nan, sympy.oo):
        return True
    return bool(value.is_number) and abs(complex(printable(value).evalf(20)).imag) > 1e-12


def _follow(
    equations: Sequence[Any], unknowns: tuple[Any, ...], known_values: dict[Any, Any], branches_left: list[int]
) -> list[dict[Any, Any]]:
    """Return the solutions {unknown: value} of equations in the remaining `unknowns`, solved one after another.

    `known_values` are the values of unknowns that were solved before; each solution includes them. `branches_left` is a
    list with one entry, the number of branches that may still be tried. Raises GivenUpError if an equation is too long
    or no branch is left.
    """
    remaining = []
    for equation in equations:
        numerator = sympy.numer(sympy.together(simplest(equation)))
        if numerator == 0 or simplest(numerator) == 0:
            continue
        if not numerator.has(*unknowns):
            return []  # a condition on the parameters, false for nearly all of their values
        if size(numerator) > LONGEST_EQUATION:
            raise GivenUpError
        remaining.append(numerator)
    if not remaining:
        return [known_values]
    for equation in sorted(remaining, key=lambda e: (sum(e.has(x) for x in unknowns), size(e))):
        steps = _steps(equation, unknowns)
        if steps is None:
            continue
        solutions = []
        for unknown, value in steps:
            branches_left[0] -= 1
            if branches_left[0] < 0:
                raise GivenUpError
            table = {unknown: value}
            earlier = {x: simplest(with_known_signs(known.xreplace(table))) for x, known in known_values.items()}
            others = [with_known_signs(e.xreplace(table)) for e in remaining if e is not equation]
            rest = tuple(x for x in unknowns if x != unknown)
            solutions += _follow(others, rest, {**earlier, **table}, branches_left)
        return solutions
    return _together(remaining, unknowns, known_values)


def _steps(equation: Any, unknowns: Sequence[Any]) -> list[tuple[Any, Any]] | None:
    """Return [(unknown, value)] for the roots of all factors of an equation, or None if a factor cannot be solved."""
    solutions: list[tuple[Any, Any]] = []
    try:
        factors = [factor for factor, _ in sympy.factor_list(equation)[1]]
    except sympy.PolynomialError:  # SymPy takes no exponentials with opposite exponents, as in exp(x - y) - exp(y - x)
        return None
    for factor in factors:
        present = [x for x in unknowns if factor.has(x)]
        if not present or (factor.is_Pow and not factor.exp.is_positive):
            continue
        step = _of_one(factor, present[0]) if len(present) == 1 else _linear(factor, present)
        if step is None:
            return None
        solutions += step
    return solutions


def _linear(factor: Any, present: Sequence[Any]) -> list[tuple[Any, Any]] | None:
    """Return [(unknown, value)] for a factor of an equation that is linear in an unknown, or None for other factors.

    The coefficient of the unknown must contain no unknowns. A factor sin(a - b) gives two values of a. `present` are
    the unknowns in the factor.
    """
    for x in present:
        slope = sympy.expand(factor.diff(x))
        if slope != 0 and not slope.has(*present):
            return [(x, simplest(-factor.xreplace({x: sympy.S.Zero}) / slope))]
    for sign in (1, -1):
        # sin(a - b) = 0, as between two links
        if isinstance(factor, sympy.sin) and factor.args[0].diff(present[0]) == sign:
            rest = sympy.expand(factor.args[0] - sign * present[0])
            return [(present[0], -sign * rest), (present[0], sympy.pi - sign * rest)]
    return None


def _of_one(factor: Any, x: Any) -> list[tuple[Any, Any]] | None:
    """Return [(x, value)] for the roots of a factor of an equation, whose only unknown is x; None if not solved."""
    functions = sorted((f for f in factor.atoms(sympy.sin, sympy.cos, sympy.tan) if f.has(x)), key=str)
    if not functions:
        roots = _roots(factor, x)
        return None if roots is None else [(x, root) for root in roots]
    argument, *others = dict.fromkeys(f.args[0] for f in functions)
    if others:
        whole = sympy.expand_trig(factor)
        arguments = dict.fromkeys(f.args[0] for f in whole.atoms(sympy.sin, sympy.cos) if f.has(x))
        return None if len(arguments) > 1 else _steps(sympy.expand(whole), [x])
    slope = argument.diff(x)
    if slope.has(x) or slope == 0:
        return None
    unknown = sympy.Symbol("place", real=True)
    polynomial = factor.xreplace({functions[0]: unknown})
    if len(functions) == 1 and not polynomial.has(x):
        roots = _roots(polynomial, unknown)
        angles = None if roots is None else [a for root in roots for a in _inverse(functions[0], root)]
    else:
        angles = _tangent(factor, argument)
    if angles is None:
        return None
    shift = argument.xreplace({x: sympy.S.Zero})
    turns = range(int(abs(slope))) if slope.is_Integer else range(1)
    return [(x, (angle - shift + 2 * sympy.pi * k) / slope) for angle in angles for k in turns]


def _inverse(function: Any, value: Any) -> list[Any]:
    """Return the angles in one period 2 pi at which a sine, cosine or tangent equals `value`; [] if there are none."""
    if value.is_number and not isinstance(function, sympy.tan) and abs(complex(value)) > 1:
        return []
    if isinstance(function, sympy.cos):
        angle = sympy.acos(value)
        return [angle] if value in (1, -1) else [angle, -angle]
    if isinstance(function, sympy.sin):
        angle = sympy.asin(value)
        return [angle] if value in (1, -1) else [angle, sympy.pi - angle]
    return [sympy.atan(value), sympy.atan(value) + sympy.pi]


def _tangent(factor: Any, argument: Any) -> list[Any] | None:
    """Return the two values of `argument`, in one period, at which a factor a sin(argument) + b cos(argument) is zero.

    The result is None if the factor does not have this form.
    """
    s, c = sympy.sin(argument), sympy.cos(argument)
    first, second = sympy.Symbol("first"), sympy.Symbol("second")
    whole = sympy.expand(factor.xreplace({s: first, c: second}))
    a, b = whole.diff(first), whole.diff(second)
    if a == 0 or any(part.has(first, second, *argument.free_symbols) for part in (a, b)):
        return None
    if sympy.expand(whole - a * first - b * second) != 0:
        return None
    angle = sympy.atan(simplest(-b / a))
    return [angle, angle + sympy.pi]


def _roots(polynomial: Any, x: Any) -> list[Any] | None:
    """Return the roots of a polynomial in x, or None if a factor has a degree above two."""
    if not polynomial.is_polynomial(x):
        return None
    values: list[Any] = []
    for factor, _ in sympy.factor_list(polynomial, x)[1]:
        if not factor.has(x):
            continue  # SymPy lists the square root of a parameter as a factor
        coefficients = sympy.Poly(factor, x).all_coeffs()
        if len(coefficients) == 2:
            values.append(simplest(-coefficients[1] / coefficients[0]))
        elif len(coefficients) == 3:
            a, b, c = coefficients
            root = sympy.sqrt(simplest(b**2 - 4 * a * c))
            values += [simplest((-b + sign * root) / (2 * a)) for sign in (1, -1)]
        else:
            return None
    return values


def _together(equations: Sequence[Any], unknowns: Sequence[Any], known_values: dict[Any, Any]) -> list[dict[Any, Any]]:
    """Return the solutions {unknown: value} of polynomial equations of low degree, which are solved together.

    `known_values` are the values of unknowns that were solved before; each solution includes them. Raises GivenUpError
    for other equations, and for roots that may be complex or are too long.
    """
    present = [x for x in unknowns if any(e.has(x) for e in equations)]
    if not all(e.is_polynomial(*present) for e in equations) or len(equations) != len(present):
        raise GivenUpError
    degree = sympy.prod(sympy.Poly(e, *present).total_degree() for e in equations)
    if degree > HIGHEST_DEGREE:
        raise GivenUpError
    for factor, _ in sympy.factor_list(equations[0], present[0])[1] if len(present) == 1 else ():
        # Formulas for real roots contain complex numbers, unless the degree is two, or the factor is a x^n + b.
        terms = sympy.Poly(factor, present[0]) if factor.has(present[0]) else None
        if terms is not None and len(terms.terms()) > 2 and terms.degree() > 2:
            raise GivenUpError
    solutions = []
    for solution in sympy.solve(list(equations), present, dict=True):
        if len(solution) != len(present) or any(x.has(*present) for x in solution.values()):
            raise GivenUpError
        for x in solution.values():
            # It cannot be decided whether a long value, or one with I, is real.
            if size(x) > LONGEST_VALUE or (x.has(sympy.I) and not (x.is_number and _is_complex(x))):
                raise GivenUpError
        solutions.append({**known_values, **{x: sympy.sqrtdenest(simplest(value)) for x, value in solution.items()}})
    return solutions


STARTS = 256  # Number of starting points of a numerical search
NEWTON_STEPS = 60  # Largest number of Newton steps from each start; near a root five suffice
CONVERGED_STEP = 1e-9  # Largest last Newton step at convergence, relative to 1 plus the largest unknown
SMALL = 1e-8  # Largest residual at a root, relative to the typical residuals at the starts

WITHIN = 1e-3
"""Largest distance of a root, estimated as residual/derivative at the end of Newton's method, relative to 1 plus the
largest unknown. Points far out, where residuals decay without a zero, are no roots."""

SAME_ROOT = 1e-6  # Largest distance of end points that are the same root, relative to 1 plus the largest unknown

FLAT = 1e-6
"""Ratio of the smallest to the largest singular value of the Jacobian at a root, below which the root is multiple, such
as y = 0 of y^3."""

SAME_FLAT = 1e-3
"""Largest distance of end points that are the same multiple root, relative to 1 plus the largest unknown. It exceeds
SAME_ROOT, because rounding of y^3 leaves y uncertain by about 1e-4. The point of smallest residual is kept."""


def numeric_roots(
    equations: Sequence[Any], unknowns: Sequence[Any], start: FloatArray, angles: Sequence[bool], helpers: int = 0
) -> list[FloatArray]:
    """Return the real solutions (k,) of equations e = 0 that Newton's method finds from many starts, sorted.

    `start` (k,) is the first start. `angles` (k,) is true for unknowns of period 2 pi. There are k + `helpers`
    unknowns: the last ones, such as multipliers, are left out of the solutions.
    """
    k, turning = len(start), np.array(angles, dtype=bool)
    scale = np.where(turning, 1.0, max(1.0, float(np.abs(start).max(initial=0.0))))
    # The starts are `start`, zero, and random points: angles between -pi and pi, others of the order of their scale.
    draw = np.random.default_rng(0)
    sizes = scale[:, None] * 10.0 ** draw.uniform(-1.0, 1.0, STARTS)
    turns = draw.uniform(-np.pi, np.pi, (k, STARTS))
    starts = np.where(turning[:, None], turns, sizes * draw.normal(size=(k, STARTS)))
    starts[:, 0], starts[:, 1] = start, 0.0
    scale = np.concatenate([scale, np.full(helpers, np.inf)])
    system = _NumericEquations(equations, unknowns)
    with np.errstate(all="ignore"):
        x, good = system.newton(np.vstack([starts, np.zeros((helpers, STARTS))]), scale)
        residuals, slopes = system.at(x)
        largest, steepest = np.abs(residuals).max(axis=0), np.abs(slopes).max(axis=(1, 2))
        near = largest < WITHIN * steepest * (1 + np.abs(x).max(axis=0))
        near |= (largest == 0) & (np.abs(x) <= scale[:, None]).all(axis=0)  # a root at a corner may have no slope
    ends, flat = list[FloatArray](), list[bool]()
    for i in sorted(np.flatnonzero(good & near), key=lambda i: float(largest[i])):
        root, sizes = _wrapped(x[:k, i], turning), np.linalg.svd(slopes[i], compute_uv=False)
        level = bool(sizes[-1] <= FLAT * sizes[0])
        distances = (np.abs(_wrapped(root - end, turning)).max() / (1 + np.abs(end).max()) for end in ends)
        if not any(d <= (SAME_FLAT if level and f else SAME_ROOT) for d, f in zip(distances, flat, strict=True)):
            ends.append(root)
            flat.append(level)
    return sorted(ends, key=lambda end: [round(float(value), 6) for value in end])


def _wrapped(x: FloatArray, turning: Any) -> FloatArray:
    """Return the values x of unknowns with angles reduced to (-pi, pi], and values below 1e-12 replaced by zero.

    `turning` is true for unknowns that are angles.
    """
    turns = np.ceil(x / (2 * np.pi) - 0.5 - 1e-9)
    wrapped = np.where(turning, x - 2 * np.pi * turns, x)
    return np.where(np.abs(wrapped) < 1e-12, 0.0, wrapped)


class _NumericEquations:
    """Equations e = 0, and their derivatives by the unknowns, evaluated in doubles at many points at once."""

    def __init__(self, equations: Sequence[Any], unknowns: Sequence[Any]) -> None:
        graph = Graph()
        self.symbols = [graph.symbol(f"unknown {i}", Binding.CONFIGURATION) for i in range(len(unknowns))]
        translate = Translator(graph, dict(zip(unknowns, self.symbols, strict=True)))
        self.values = [translate(prescribed(printable(equation))) for equation in equations]
        columns = [tangents(self.values, {x: graph.one}) for x in self.symbols]
        self.slopes = [column(value) for value in self.values for column in columns]

    def at(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (m, N) of m equations, and their Jacobians (N, m, k), at N points x (k, N)."""
        m, (k, columns) = len(self.values), x.shape
        rows = doubles([*self.values, *self.slopes], dict(zip(self.symbols, x, strict=True)), columns)
        return rows[:m], np.moveaxis(rows[m:].reshape(m, k, columns), 2, 0)

    def newton(self, x: FloatArray, longest: FloatArray) -> tuple[FloatArray, Any]:
        """Run Newton's method from each of N starts x (k, N); return the end points (k, N) and a mask (N,).

        The mask is true where the method converged. A step changes each unknown by at most its entry in `longest` (k,).
        """
        good, limit = np.zeros(x.shape[1], dtype=bool), 0.0
        for _ in range(NEWTON_STEPS):
            r, slopes = self.at(x)
            sizes = np.where(np.isfinite(r), np.abs(r), np.nan)
            limit = limit or SMALL * max(1e-300, *(np.nanmedian(row) for row in sizes if np.isfinite(row).any()))
            sound = np.isfinite(r).all(axis=0) & np.isfinite(slopes).all(axis=(1, 2))
            step = np.zeros_like(x)
            if sound.any():
                step[:, sound] = (np.linalg.pinv(slopes[sound], rcond=1e-10) @ r.T[sound][:, :, None])[:, :, 0].T
            short = np.abs(step).max(axis=0) <= CONVERGED_STEP * (1 + np.abs(x).max(axis=0))
            good = sound & short & (np.abs(r).max(axis=0) <= limit)
            if good.all():
                break
            largest = np.abs(step / longest[:, None]).max(axis=0)
            x = x - step * np.minimum(1.0, 1.0 / np.maximum(largest, 1e-300))
        return x, good
