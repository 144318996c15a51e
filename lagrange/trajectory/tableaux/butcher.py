"""An explicit Runge-Kutta method as data: a Butcher tableau, checked against its claims when it is built."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, cached_property
from itertools import zip_longest
from math import isfinite, prod
from string import ascii_lowercase
from typing import Any, TypeVar

from lagrange.errors import StatementError, shown
from lagrange.statement.expression import text, whole_number

Tree = tuple[Any, ...]
"""Type of a rooted tree, to which an order condition belongs: the sorted tuple of the subtrees of its root. A tree of
one node is the empty tuple."""

Coefficient = Fraction | float
Coefficients = tuple[Coefficient, ...]
Entry = TypeVar("Entry")

CONDITION_TOLERANCE = 1e-12
"""Relative tolerance with which a tableau of floats has to satisfy an order condition. A tableau of exact fractions
must satisfy it exactly."""

HIGHEST_CHECKED = 10
"""Highest order of a tableau that is checked. It has 1205 order conditions, and each further order has nearly three
times as many."""


def row(text: str) -> Coefficients:
    """Return the coefficients in a text such as ``"1/5 -3 0.25"``: exact fractions, or floats for decimals."""
    return tuple(float(word) if "." in word else Fraction(word) for word in text.split())


def rows(text: str) -> tuple[Coefficients, ...]:
    """Return the rows of coefficients in a text: one row per line, empty lines left out."""
    return tuple(row(line) for line in text.splitlines() if line.strip())


def triangle(entries: Sequence[Entry], first: int = 0) -> tuple[tuple[Entry, ...], ...]:
    """Return entries as rows of a triangle: the first row has `first` entries, each later row has one more.

    Entries are in order of rows. The matrix A of an explicit method has such rows.
    """
    lines: list[tuple[Entry, ...]] = []
    begin = 0
    while begin < len(entries) or not lines:
        end = begin + first + len(lines)
        lines.append(tuple(entries[begin:end]))
        begin = end
    return tuple(lines)


def chunks(entries: Coefficients, length: int) -> tuple[Coefficients, ...]:
    """Return the coefficients `entries`, in order, as rows of the given `length`."""
    return tuple(entries[begin : begin + length] for begin in range(0, len(entries), length))


def moved(tableau: ButcherTableau, f: Callable[[Any, Any], Any], t: Any, y: Any, h: Any) -> tuple[Any, ...]:
    """Return the state after a Runge-Kutta step of length h from (t, y), then the error estimates of the tableau.

    `f` is the right-hand side f(t, y). A tableau has no estimate, one or two.
    """
    slopes: list[Any] = []
    for row, c in zip(tableau.A, tableau.c, strict=True):
        stage = y + _weighted(row, slopes) * h if any(row) else y
        slopes.append(f(t + c * h if c else t, stage))
    new = y + _weighted(tableau.b, slopes) * h
    estimates = (tableau.error.weights, tableau.error.damping) if tableau.error else ()
    return new, *(_weighted(weights, slopes) * h for weights in estimates if weights)


def _weighted(weights: Coefficients, slopes: Sequence[Any]) -> Any:
    """Return the sum of slopes times weights. Slopes with the weight zero, or without a weight, are left out."""
    return sum(slope * (int(w) if w == int(w) else float(w)) for w, slope in zip(weights, slopes, strict=False) if w)


@dataclass(frozen=True)
class ErrorEstimate:
    """An embedded error estimate h sum_j weights[j] k_j, of which step control takes the scaled RMS norm.

    `order` is the order of the embedded solution: the norm shrinks as h**(order + 1). `damping` are the weights of a
    second, less accurate estimate, whose embedded solution has the order `damping_order`. Let e5 and e3 be the sums of
    squares of the two scaled estimates over the dim components. Then the norm is e5 / sqrt((e5 + 0.01 e3) dim), which
    shrinks as h**`control` (Hairer, Norsett, Wanner, Solving ODE I, II.10). `memory` is the exponent of the previous
    norm in step control, for methods whose authors use one (Hairer, Wanner, Solving ODE II, IV.2).
    """

    weights: Coefficients
    order: int
    damping: Coefficients = ()
    damping_order: int = 0
    memory: float = 0.0

    @property
    def control(self) -> int:
        """The exponent of h with which the norm of the error shrinks: the step factor is norm**(-1/control)."""
        return 2 * self.order - self.damping_order + 1 if self.damping else self.order + 1


@dataclass(frozen=True)
class DenseOutput:
    """The dense output of a tableau: y(t + theta h) = y + h sum_j b_j(theta) k_j for theta from 0 to 1.

    k_j are the slopes of the stages, and b_j(theta) = sum_m weights[j][m] theta**(m+1). `stages` are further rows of A
    that only the dense output needs, and `c` are their abscissae. `weights` has a row for each stage of the tableau,
    then for each further stage. `order` is the order for all theta. Evaluate the b_j first and then the sum of stages.
    For DOP853, whose weights reach 545, the rounding error is then 5e-14; Horner's rule on the summed stages has 2e-13
    (a pendulum, h = 1).
    """

    weights: tuple[Coefficients, ...]
    order: int
    stages: tuple[Coefficients, ...] = ()
    c: Coefficients = ()


@dataclass(frozen=True)
class ButcherTableau:
    """An explicit Runge-Kutta method of s stages k_i = f(t + c_i h, y + h sum_j A[i][j] k_j), y + h sum_i b_i k_i.

    `A` is strictly lower triangular: row i has i entries. `c` has the row sums of A; if given, it is checked against
    them. The constructor checks shapes, finiteness, row sums, every order condition up to `order`, and the order
    conditions of the embedded solutions and of the dense output for all theta. Raises StatementError with the condition
    that fails and its error.
    """

    name: str
    order: int
    A: tuple[Coefficients, ...]
    b: Coefficients
    c: Coefficients = ()
    error: ErrorEstimate | None = None
    dense: DenseOutput | None = None
    source: str = ""

    def __repr__(self) -> str:
        return f"<ButcherTableau {self.name}: order {self.order}, {self.stages} stages>"

    def __post_init__(self) -> None:
        self._check_kinds()
        self._check_shapes()
        sums = tuple(sum(line, Fraction(0)) for line in self.rows)
        object.__setattr__(self, "c", self.c or sums[: self.stages])
        if self.dense:
            object.__setattr__(self, "dense", replace(self.dense, c=self.dense.c or sums[self.stages :]))
        for i, (abscissa, derived) in enumerate(zip(self.abscissae, sums, strict=True)):
            self._check(f"c_{i + 1} is the sum of row {i + 1} of A,", abscissa, derived)
        for tree in self._elementary:
            if size(tree) <= self.order:
                self._check_tree("sum b_i", tree, self.b, Fraction(1, density(tree)))
        self._check_error()
        self._check_dense()

    def __hash__(self) -> int:
        # A method is looked up at every run, and hashing some hundred fractions takes as long as a short run.
        return hash((self.name, self.order))

    @property
    def stages(self) -> int:
        """The number s of stages of a step, without further stages that only the dense output needs."""
        return len(self.b)

    @property
    def fsal(self) -> bool:
        """True if the last stage is f(t + h, y_new), which is also the first stage of the next step."""
        return len(self.A) > 1 and self.A[-1] == self.b[:-1] and not self.b[-1]

    @property
    def rows(self) -> tuple[Coefficients, ...]:
        """The rows of A, then the rows of the further stages that only the dense output needs."""
        return self.A + (self.dense.stages if self.dense else ())

    @property
    def abscissae(self) -> Coefficients:
        """The fractions c of the step at which the stages in `rows` are evaluated."""
        return self.c + (self.dense.c if self.dense else ())

    def hermite(self) -> ButcherTableau:
        """Return this method with another dense output: the cubic Hermite path through both ends of the step.

        The path needs f(t + h, y_new). This is the last stage of some methods. Others get one more stage, which is
        the first stage of the next step.
        """
        extra = () if self.fsal else (self.b,)
        weights = []
        for j, b in enumerate((*self.b, *((Fraction(0),) * len(extra)))):
            start, end = int(j == 0), int(j == self.stages + len(extra) - 1)
            weights.append((Fraction(start), 3 * b - 2 * start - end, -2 * b + start + end))
        return replace(self, dense=DenseOutput(tuple(weights), min(self.order, 3), extra))

    @cached_property
    def _elementary(self) -> Mapping[Tree, Coefficients]:
        claims = [self.order, *([self.error.order] if self.error else []), *([self.dense.order] if self.dense else [])]
        return stage_weights(self.rows, max(claims))

    def _refuse(self, reason: str) -> StatementError:
        return StatementError(f"The tableau {shown(self.name)} is not what it claims: {reason}.")

    def _check_tree(self, what: str, tree: Tree, weights: Coefficients, expected: Fraction) -> None:
        values = self._elementary[tree]
        value = dot(weights, values)
        if value != expected:
            scale = dot(tuple(abs(float(w)) for w in weights), tuple(abs(float(v)) for v in values))
            condition = f"the condition of order {size(tree)}, {what} {formula(tree)}".rstrip() + f" = {expected},"
            self._check(condition, value, expected, max(1.0, float(scale)))

    def _check(self, condition: str, actual: Coefficient, expected: Coefficient, scale: float = 1.0) -> None:
        off = actual - expected
        exact = isinstance(off, Fraction)
        if not abs(float(off)) <= (0.0 if exact else CONDITION_TOLERANCE * scale):
            pair = (actual, expected) if exact else (f"{float(actual):.17g}", f"{float(expected):.17g}")
            raise self._refuse(f"{condition} fails by {float(off):.3g} ({pair[0]} instead of {pair[1]})")

    def _check_kinds(self) -> None:
        text(self.name, "name")
        object.__setattr__(self, "order", whole_number(self.order, "order", 0))
        rows = self.A if isinstance(self.A, tuple) else (None,)
        vectors = (*rows, self.b, self.c)
        if not all(isinstance(v, tuple) and all(isinstance(x, (int, float, Fraction)) for x in v) for v in vectors):
            raise self._refuse("b, c and the rows of A must be tuples of numbers; lg.methods.tableau() takes lists")
        for what, part, kind in (("error", self.error, ErrorEstimate), ("dense", self.dense, DenseOutput)):
            if part is not None and not isinstance(part, kind):
                raise self._refuse(f"{what} is {shown(part)} and not {kind.__name__}(...)")

    def _check_shapes(self) -> None:
        s = len(self.b)
        if s == 0 or self.order < 1:
            raise self._refuse("a method needs at least one stage and an order of at least 1")
        if self.order > HIGHEST_CHECKED:
            raise self._refuse(f"orders up to {HIGHEST_CHECKED} can be checked, not {self.order}")
        if len(self.A) != s:
            raise self._refuse(f"b has {s} weights and A has {len(self.A)} rows; both are one per stage")
        if self.c and len(self.c) != s:
            raise self._refuse(f"c has {len(self.c)} entries for {s} stages")
        for i, line in enumerate(self.rows):
            if len(line) != i:
                raise self._refuse(f"row {i + 1} of A has {len(line)} entries, not the {i} of an explicit method")
        vectors = [*self.rows, self.b, self.abscissae]
        if self.error:
            vectors += (embedded := [self.error.weights, *([self.error.damping] if self.error.damping else [])])
            if any(len(e) != s for e in embedded):
                raise self._refuse(f"its error weights are not one for each of the {s} stages")
        if self.dense:
            extra = len(self.dense.stages)
            if len(self.dense.c) not in (0, extra):
                raise self._refuse(f"its dense output has {len(self.dense.c)} abscissae for {extra} stages")
            vectors += self.dense.weights
            if (count := len(self.dense.weights)) != s + extra:
                raise self._refuse(f"its dense output has {count} rows of weights for {s + extra} stages")
        if not all(isfinite(value) for vector in vectors for value in vector):
            raise self._refuse("a coefficient is not a finite number")

    def _check_error(self) -> None:
        """Check that each embedded solution, with weights b - e, has its order: sum e_i Phi_i(tree) = 0.

        Raises StatementError with the condition that fails.
        """
        if not self.error:
            return
        for e, order in ((self.error.weights, self.error.order), (self.error.damping, self.error.damping_order)):
            for tree in self._elementary:
                if size(tree) <= order:
                    self._check_tree("sum e_i", tree, e, Fraction(0))

    def _check_dense(self) -> None:
        """Check that the dense output ends at the new state, b_j(1) = b_j, and that it has its order for all theta.

        The order conditions are sum_j b_j(theta) Phi_j(tree) = theta**size / gamma. Raises StatementError with the
        condition that fails.
        """
        if not self.dense:
            return
        ends = self.b + (Fraction(0),) * len(self.dense.stages)
        for j, (weights, end) in enumerate(zip(self.dense.weights, ends, strict=True)):
            size_of = max(1.0, *(abs(float(weight)) for weight in weights))
            self._check(f"the dense weight b_{j + 1}(1) = b_{j + 1}", sum(weights, Fraction(0)), end, size_of)
        columns = tuple(zip_longest(*self.dense.weights, fillvalue=Fraction(0)))
        for tree in self._elementary:
            for power, column in enumerate(columns, start=1):
                if size(tree) <= self.dense.order:
                    expected = Fraction(1, density(tree)) if power == size(tree) else Fraction(0)
                    self._check_tree(f"theta^{power} in sum b_i(theta)", tree, column, expected)


# Rooted trees: one for each order condition (Hairer, Norsett, Wanner, Solving ODE I, II.2).


@cache
def trees(order: int) -> tuple[Tree, ...]:
    """Return the rooted trees with `order` nodes. There are 1, 1, 2, 4, 9, 20, 48, 115, 286 trees of 1 to 9 nodes."""
    if order == 1:
        return ((),)
    return tuple(dict.fromkeys(grown for tree in trees(order - 1) for grown in _grafted(tree)))


def _grafted(tree: Tree) -> Iterator[Tree]:
    """Yield the trees that grow from a tree by one more leaf, at each of its nodes in turn."""
    yield ((), *tree)
    for index, child in enumerate(tree):
        for grown in _grafted(child):
            yield tuple(sorted((*tree[:index], grown, *tree[index + 1 :])))


@cache
def size(tree: Tree) -> int:
    """Return the number of nodes of a tree."""
    return 1 + sum(map(size, tree))


@cache
def density(tree: Tree) -> int:
    """Return the density gamma of a rooted tree: the order condition of the tree is sum_j b_j Phi_j = 1 / gamma."""
    return size(tree) * prod(map(density, tree))


def stage_weights(matrix: tuple[Coefficients, ...], order: int) -> Mapping[Tree, Coefficients]:
    """Return the weights Phi_j(tree) of the stages j, (stages,), for every tree with at most `order` nodes.

    The order condition of a tree is sum_j b_j Phi_j = 1/gamma. `matrix` has the rows of the lower triangle A of a
    tableau; row i has at least i entries. Weights are exact fractions. If an entry is a float, all become floats, with
    which the weights of order 9 take milliseconds only.
    """
    unit: Coefficient = Fraction(1)
    if any(isinstance(entry, float) for row in matrix for entry in row):
        matrix, unit = tuple(tuple(map(float, row)) for row in matrix), 1.0
    weights: dict[Tree, Coefficients] = {(): (unit,) * len(matrix)}
    fed: dict[Tree, Coefficients] = {}
    for level in range(1, order):
        for tree in trees(level):
            fed[tree] = tuple(dot(row, weights[tree]) for row in matrix)
        for tree in trees(level + 1):
            weights[tree] = tuple(prod(factors) for factors in zip(*(fed[child] for child in tree), strict=True))
    return weights


def dot(left: Coefficients, right: Coefficients) -> Coefficient:
    """Return the sum of products of two rows up to the end of the shorter one. It is exact if the entries are."""
    return sum((a * b for a, b in zip(left, right, strict=False) if a and b), Fraction(0))


def formula(tree: Tree) -> str:
    """Return the formula of a tree's elementary weight, such as ``c_i^2 a_ij c_j``, or "" for a single node."""
    letters = iter(ascii_lowercase[ascii_lowercase.index("i") :])
    return _formula(tree, next(letters), letters)


def _formula(tree: Tree, index: str, letters: Iterator[str]) -> str:
    leaves = tree.count(())
    parts = [f"c_{index}" + (f"^{leaves}" if leaves > 1 else "")] if leaves else []
    for child in tree:
        if child:
            letter = next(letters)
            parts.append(f"a_{index}{letter} {_formula(child, letter, letters)}")
    return " ".join(parts)
