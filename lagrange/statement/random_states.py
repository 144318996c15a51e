"""Draw random states, times and parameters, at which formulas are tested. Project states onto constraints.

The samples have typical magnitudes, so that terms of the equations rarely vanish or dominate.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, TypeVar

import sympy
from sympy.core.function import AppliedUndef

from lagrange.statement.expression import parts_first
from lagrange.statement.statement import Statement

ORDINARY = math.log(300.0)
"""Natural logarithm of the largest magnitude that counts as 1. Samples of order one suit magnitudes of 1/300 to 300."""

EXTREME = math.log(1e100)
"""Natural logarithm of the largest magnitude. Magnitudes stay within 1e-100 and 1e100, so that their squares are
doubles."""

Form = dict[Any, float]
"""Monomial: the power of each symbol, and under the key `UNIT` the natural logarithm of the coefficient."""

UNIT = sympy.S.One


class Scales:
    """Typical magnitudes of the coordinates and velocities of a statement, as functions of its parameters.

    Assumption: all terms of a sum have the same magnitude, and arguments of functions have magnitude 1. These
    conditions are linear equations for the logarithms of the magnitudes.
    """

    def __init__(self, statement: Statement) -> None:
        unknowns = (*statement.coordinates, *statement.velocities)
        self._index = {unknown: k for k, unknown in enumerate(unknowns)}
        self._forms: dict[Any, Form] = {}
        self._monomials: list[Form] = []
        stated = (statement.lagrangian, *statement.forces, statement.dissipation)
        for expression in (*stated, *(constraint.expression for constraint in statement.constraints)):
            for node in parts_first(expression, self._forms, children):
                self._forms[node] = self._form(node)

    def sizes(self, parameters: Mapping[Any, float], start: Sequence[float] = ()) -> tuple[float, ...]:
        """Return typical magnitudes (2n,) of coordinates and velocities, for these values of the parameters.

        Magnitudes between 1/300 and 300 are returned as 1. If the equations do not determine a magnitude, it is that of
        the same entry of the state `start`, or 1 if there is no `start` or the entry is zero.
        """
        logarithms = {p: math.log(abs(x)) for p, x in parameters.items() if x and math.isfinite(x)}
        rows: list[tuple[dict[int, float], float]] = []
        for form in self._monomials:
            powers = {self._index[symbol]: power for symbol, power in form.items() if symbol in self._index}
            known = [(s, power) for s, power in form.items() if s is not UNIT and s not in self._index]
            # A row is left out if one of its parameters is zero or has no value.
            unit = form.get(UNIT, 0.0) + sum(power * logarithms.get(symbol, math.nan) for symbol, power in known)
            if powers and math.isfinite(unit):
                rows.append((powers, unit))
        solution = _Solution(rows)
        for k, value in enumerate(start):
            if value:
                solution.determine(k, math.log(abs(value)))
        for k in self._index.values():
            solution.determine(k, 0.0)
        bounded = (max(-EXTREME, min(EXTREME, solution.sizes[k])) for k in self._index.values())
        return tuple(1.0 if abs(size) <= ORDINARY else math.exp(size) for size in bounded)

    def _form(self, node: Any) -> Form:
        parts = [self._forms[child] for child in children(node)]
        if not parts:
            if not node.is_number:
                return {node: 1.0}
            size = abs(float(node)) if node.is_finite and node.is_real else 0.0
            return {UNIT: math.log(size)} if size else {UNIT: -math.inf}
        if isinstance(node, sympy.Mul):
            return _product(parts)
        if isinstance(node, sympy.Pow) and node.exp.is_number:
            return {symbol: power * float(node.exp) for symbol, power in parts[0].items()}
        if isinstance(node, (sympy.Abs, sympy.Max, sympy.Min, sympy.Add, *RELATIONS)):
            # Terms of a sum get the magnitude of the first one, preferably a term without unknowns.
            parts.sort(key=lambda part: any(symbol in self._index for symbol in part))
            self._monomials += [_product([part, {s: -power for s, power in parts[0].items()}]) for part in parts[1:]]
            return parts[0]
        if isinstance(node, sympy.Function) and not isinstance(node, (sympy.Piecewise, sympy.sign)):
            self._monomials += parts
        return {UNIT: 0.0} if not isinstance(node, sympy.Piecewise) else parts[0]


def children(node: Any) -> tuple[Any, ...]:
    """Return the operands of a node. A leaf has none; for a Piecewise, values and conditions alternate."""
    if isinstance(node, (AppliedUndef, sympy.Derivative, sympy.Symbol)):
        return ()
    if isinstance(node, sympy.Piecewise):
        return tuple(part for pair in node.args for part in (pair.expr, pair.cond))
    return tuple(node.args)


# SymPy's classes of inequalities
RELATIONS = (sympy.StrictLessThan, sympy.LessThan, sympy.StrictGreaterThan, sympy.GreaterThan)


def _product(parts: Sequence[Form]) -> Form:
    """Return the product of monomials as a monomial."""
    product: Form = {}
    for part in parts:
        for symbol, power in part.items():
            product[symbol] = product.get(symbol, 0.0) + power
    return {symbol: power for symbol, power in product.items() if power or symbol is UNIT}


class _Solution:
    """Solver of linear equations for the logarithms of magnitudes, one unknown after another.

    A row (powers, unit) is the equation: sum of power * unknown, plus unit, is 0. `powers` maps indices of unknowns to
    powers. `sizes` has the logarithms found so far. An equation gives its last unknown as soon as all others are known.
    """

    def __init__(self, rows: Sequence[tuple[Mapping[int, float], float]]) -> None:
        self.sizes: dict[int, float] = {}
        self._rows = rows
        self._waiting: dict[int, list[int]] = {}
        for k, (powers, _) in enumerate(rows):
            for unknown in powers:
                self._waiting.setdefault(unknown, []).append(k)
        self._left = [len(powers) for powers, _ in rows]
        for powers, unit in rows:
            if len(powers) == 1:
                for unknown, power in powers.items():
                    self.determine(unknown, -unit / power)

    def determine(self, unknown: int, size: float) -> None:
        """Set the logarithm of the unknown with index `unknown` to `size`, unless it is known.

        Also compute all unknowns that follow from it.
        """
        if unknown in self.sizes:
            return
        self.sizes[unknown] = size
        fresh = deque([unknown])
        while fresh:
            for k in self._waiting.get(fresh.popleft(), ()):
                self._left[k] -= 1
                if self._left[k] == 1:
                    fresh += self._last(k)

    def _last(self, k: int) -> list[int]:
        """Solve equation number `k` for its only unknown without a value. Return [index of this unknown].

        Return [] if all unknowns of the equation have values.
        """
        powers, unit = self._rows[k]
        last = [unknown for unknown in powers if unknown not in self.sizes]
        for unknown in last:
            total = sum(power * self.sizes[other] for other, power in powers.items() if other in self.sizes)
            self.sizes[unknown] = -(unit + total) / powers[unknown]
        return last


@dataclass(frozen=True)
class SamplePoint:
    """State (q, v), time t and values of all parameters, at which formulas are evaluated.

    `kind` is a phrase on how the point was chosen, for messages.
    """

    q: tuple[float, ...]
    v: tuple[float, ...]
    t: float
    parameters: Mapping[Any, float]
    kind: str

    def describe(self, names: Sequence[str], digits: int = 17) -> str:
        """Return the point as text for messages: ``theta = 0.3, theta_dot = -1.2, t = 0.5, m = 1``.

        `names` are those of the coordinates, and `digits` is the number of significant digits.
        """
        pairs = [*zip(names, self.q, strict=True), *((f"{a}_dot", x) for a, x in zip(names, self.v, strict=True))]
        pairs += [("t", self.t), *((p.name, x) for p, x in self.parameters.items())]
        return ", ".join(f"{name} = {float(value):.{digits}g}" for name, value in pairs)


@dataclass(frozen=True)
class SampleKind:
    """Rule for random points. `state` is "initial", for states near the initial one, or "order one".

    `parameters` is "default", "near default" or "order one". `name` describes the rule in messages.
    """

    name: str
    state: str
    parameters: str


SAMPLE_KINDS = (
    SampleKind("near the initial state", "initial", "default"),
    SampleKind("everything of order one", "order one", "order one"),
    SampleKind("of order one, parameters near their defaults", "order one", "near default"),
    SampleKind("near the initial state, parameters near their defaults", "initial", "near default"),
    SampleKind("everything of order one", "order one", "order one"),
)
"""Kinds of random points, used in turn.

Numbers near the initial state are those of actual runs. With everything of order one, no term is 20 orders of magnitude
smaller than another, as a planet's is beside the sun's in SI units. Parameters away from their defaults distinguish m1
from m2 if both are 1, and show terms with a parameter c = 0.
"""

DRAWS_PER_KIND = 40
"""Number of points of one kind that are tried before the next kind."""


Move = tuple[float, float, float]
"""(x, r, s): an entry of a state is x + s r, where x is the old entry or 0, r a random number and s a magnitude."""


_scales_of = lru_cache(maxsize=4)(Scales)
"""Return the typical magnitudes of a statement. Cached, because an analysis creates hundreds of samplers."""


@lru_cache(maxsize=16)
def _sizes(statement: Statement, parameters: tuple[float, ...], start: tuple[float, ...]) -> tuple[float, ...]:
    """Return typical magnitudes (2n,). Cached, because samplers with the same seed draw the same parameters."""
    return _scales_of(statement).sizes(dict(zip(statement.parameters, parameters, strict=True)), start)


class Sampler:
    """Generator of random points of a statement. The same seed gives the same points."""

    def __init__(self, statement: Statement, seed: int) -> None:
        self.statement = statement
        self._draw = random.Random(seed)
        n = len(statement.coordinates)
        self._initial = (statement.initial[:n], statement.initial[n:])

    def point(self, kind: SampleKind, attempt: int = 0) -> SamplePoint:
        """Return a random point of a kind. `attempt` counts the attempts from 0.

        Points near the initial state get ten times closer to it after each four attempts.
        """
        near = kind.state == "initial"
        if near:
            amplitude = 0.3 * 0.1 ** (attempt // 4)
            moves = [self._near(values, amplitude) for values in self._initial]
        else:
            moves = [[(0.0, self._of_order_one(), 1.0) for _ in values] for values in self._initial]
        t = self._draw.uniform(0.1, 2.0) * (max(0.1, self.statement.run.t_end / 2) if near else 1.0)
        parameters = self._parameters(kind.parameters)
        start = tuple(self.statement.initial) if near else ()
        q, v = self._placed(moves, _sizes(self.statement, tuple(parameters.values()), start))
        return SamplePoint(q, v, self._within(t), parameters, kind.name)

    def initial(self) -> SamplePoint:
        """Return the initial state at t = 0, with the default parameters."""
        q, v = self._initial
        return SamplePoint(q, v, self._within(0.0), self._parameters("default"), "the initial state")

    def far(self) -> SamplePoint:
        """Return a point with numbers of very different magnitudes, to test branches that are rarely taken."""
        moves = [
            [(x if self._draw.random() < 0.5 else 0.0, self._of_order_one() * self._magnitude(), 1.0) for x in values]
            for values in self._initial
        ]
        t = abs(self._of_order_one()) * self._magnitude()
        parameters = self._parameters(self._draw.choice(("default", "near default", "order one")))
        q, v = self._placed(moves, _sizes(self.statement, tuple(parameters.values()), ()))
        return SamplePoint(q, v, self._within(t), parameters, "far and wide")

    def _placed(
        self, moves: Sequence[Sequence[Move]], scales: Sequence[float]
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return q and v of a random state. An entry with the move (x, r, s) is x + s r.

        `moves` has the moves of q and the moves of v. Each of the `scales` (2n,) that is not 1 replaces s of its entry.
        """
        every = zip([*moves[0], *moves[1]], scales, strict=True)
        state = tuple(entry + (size if scale == 1.0 else scale) * x for (entry, x, size), scale in every)
        return state[: len(moves[0])], state[len(moves[0]) :]

    def _within(self, t: float) -> float:
        """Return t if the given functions of time are defined there, else another time at which they are."""
        first, last = self.statement.span
        return t if first <= t <= last else first + (last - first) * (0.2 + 0.6 * t / (1.0 + t))

    def _near(self, values: Sequence[float], amplitude: float) -> list[Move]:
        largest = max(1.0, *map(abs, values))
        # An entry that is zero moves by a random magnitude between 1 and the largest entry.
        sizes = [abs(x) or 10.0 ** self._draw.uniform(0.0, math.log10(largest)) for x in values]
        moves = [amplitude * self._of_order_one() for _ in values]
        return [
            (x + size * move, 0.0, 1.0) if x else (0.0, move, size)
            for x, move, size in zip(values, moves, sizes, strict=True)
        ]

    def _parameters(self, how: str) -> dict[Any, float]:
        values = {}
        for symbol in self.statement.parameters:
            default = self.statement.defaults.get(symbol)
            if default is not None and how == "default":
                values[symbol] = default
            elif default and how == "near default":
                values[symbol] = default * self._draw.uniform(0.7, 1.4)
            else:
                size = self._draw.uniform(0.4, 1.8)
                negative = not symbol.is_positive and (default < 0 if default else self._draw.random() < 0.5)
                values[symbol] = -size if negative else size
        return values

    def _of_order_one(self) -> float:
        return self._draw.uniform(0.2, 1.7) * (1.0 if self._draw.random() < 0.5 else -1.0)

    def _magnitude(self) -> float:
        return math.pow(10.0, self._draw.uniform(-3.0, 3.0))


MOST_DRAWS = 16
"""Largest number of random states at which a formula is tested. The formula may have no value at some states."""

ALL_KINDS = (*SAMPLE_KINDS[1:4], SAMPLE_KINDS[0])
"""Kinds of random states, used in turn: states of order one come first."""

NEAR_INITIAL = (SAMPLE_KINDS[3],)
"""Kind of states near the initial one, for formulas that hold on one branch only."""

Point = TypeVar("Point")
Value = TypeVar("Value")


def random_points(
    statement: Statement, seed: int, draws: int = MOST_DRAWS, kinds: Sequence[SampleKind] = ALL_KINDS
) -> Iterator[SamplePoint]:
    """Yield `draws` random points, of each of the `kinds` in turn. The same `seed` gives the same points."""
    sampler = Sampler(statement, seed)
    return (sampler.point(kinds[attempt % len(kinds)], attempt) for attempt in range(draws))


def usable(samples: Iterable[Point], value: Callable[[Point], Value | None]) -> Iterator[Value]:
    """Yield the values of the function `value` at samples. A sample where the value is None is skipped."""
    return (result for result in map(value, samples) if result is not None)


def holds(samples: Iterable[Point], judge: Callable[[Point], bool | None], count: int) -> bool | None:
    """Return True if `judge` is true at `count` samples, and False as soon as it is false at one.

    Samples where `judge` returns None do not count. The result is None if too few other samples exist.
    """
    judged = 0
    for verdict in islice(usable(samples, judge), count):
        if not verdict:
            return False
        judged += 1
    return True if judged == count else None


CORRECTIONS = 40
"""Largest number of Newton corrections of a state. Near the constraints each correction doubles the correct digits."""

Numbers = list[Any]


def onto_constraints(
    q: Numbers,
    v: Numbers,
    residuals_at: Callable[[int, Numbers, Numbers], tuple[Numbers, Sequence[Numbers]]],
    solve: Callable[[Any, Numbers], Iterable[Any]],
    tolerance: Any,
) -> tuple[Numbers, Numbers] | None:
    """Return q and v moved onto the constraints by the shortest Newton corrections; None if they do not converge.

    `residuals_at(level, q, v)` returns residuals (m,) and the rows of their gradient (m, n). At level 0 these are
    residuals of the coordinates, which are moved first, and at level 1 of the velocities. `solve` solves m linear
    equations. The last correction changes an entry x by at most `tolerance` (1 + |x|). Exceptions of the two
    callables are passed on.
    """
    state = [q, v]
    for level in (0, 1):
        for _ in range(CORRECTIONS):
            residuals, rows = residuals_at(level, *state)
            square = [[sum(a * b for a, b in zip(row, other, strict=True)) for other in rows] for row in rows]
            weights = list(solve(square, residuals)) if rows else []
            x = state[level]
            change = [sum(row[j] * weight for row, weight in zip(rows, weights, strict=True)) for j in range(len(x))]
            x = state[level] = [a - b for a, b in zip(x, change, strict=True)]
            if all(abs(b) <= tolerance * (1 + abs(a)) for a, b in zip(x, change, strict=True)):
                break
        else:
            return None
    return state[0], state[1]
