"""Nodes and graphs of expressions. Nodes are simplified when they are built, and equal expressions are one node.

A `Graph` owns its nodes. Its methods simplify locally (fold constants, drop zeros, merge equal terms and factors, take
out a common factor), and return an existing node if one fits. Arguments are always older than the node that uses them.
So sorting by `id` is a topological order, and no traversal needs recursion.
"""

from __future__ import annotations

import enum
import math
import threading
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from numbers import Rational
from operator import attrgetter, itemgetter
from typing import Any, TypeAlias

from lagrange.errors import StatementError
from lagrange.statement.run_settings import CHECKED_EVERY, check_time
from lagrange.statement.vocabulary.functions import EVEN, EXACT, FOLDS, FUNCTIONS, ODD

Exact: TypeAlias = int | Fraction
Rows: TypeAlias = "Sequence[Sequence[Node]]"

LARGEST_POWER = 4096
"""Largest exponent of a constant that is computed exactly. Larger powers do not fit into a double, and are refused."""

LONGEST_FLAT = 16
"""Largest number of factors of a product that is merged into another product. Without this limit, products in products
would have derivatives whose size grows by a factor for each level."""

LONGEST_PRODUCT = 4 * LONGEST_FLAT
"""Largest number of factors in one node. A longer product becomes a product of products. Otherwise its n derivatives
would be n products of n - 1 factors each."""

_ADDING = threading.Lock()  # Lock for adding a node, since threads that run one model share its graph


class Binding(enum.IntEnum):
    """Latest kind of quantity on which a node depends, in the order constant, parameter, time, q, v, acceleration.

    Nodes up to PARAMETER are computed once per run.
    """

    CONSTANT = 0
    PARAMETER = 1
    TIME = 2
    CONFIGURATION = 3
    VELOCITY = 4
    ACCELERATION = 5


class Kind(enum.Enum):
    """Kinds of nodes. The comment after each kind says what `data` of such a node contains."""

    CONSTANT = "constant"  # The exact value
    SYMBOL = "symbol"  # The name
    SUM = "sum"  # (constant, coefficients), with one coefficient per argument
    PRODUCT = "product"  # None, since the factors are the arguments
    POWER = "power"  # The exact exponent
    CALL = "call"  # The function's name
    FACTOR = "factor"  # (n, (i, ...)): a symmetric matrix, lower triangle by rows, whose pivots i are negative
    SOLVE = "solve"  # n, the number of unknowns; the arguments are a factor and the right-hand side
    COMPONENT = "component"  # i, the index of an entry of a SOLVE


class Node:
    """Expression in a graph, which exists only once there. Nodes are created by methods of `Graph`, never directly.

    `kind` is the operation, `args` are its argument nodes, and `data` is explained in `Kind`. `binding` and the bits
    `depends` tell on which quantities and symbols the expression depends. `id` is the index of the node in its graph.
    """

    __slots__ = ("args", "binding", "data", "depends", "graph", "id", "kind")

    def __init__(
        self, graph: Graph, kind: Kind, args: tuple[Node, ...], data: Any, binding: Binding, depends: int
    ) -> None:
        self.graph = graph
        self.id = len(graph.nodes)
        self.kind = kind
        self.args = args
        self.data = data
        self.binding = binding
        self.depends = depends

    def __repr__(self) -> str:
        shown = "" if self.data is None else f" {self.data}"
        return f"<%{self.id} {self.kind.value}{shown} {[arg.id for arg in self.args]}>"

    def __add__(self, other: Node | Exact | float) -> Node:
        return self.graph.sum(((1, self), (1, self.graph.node(other))))

    __radd__ = __add__

    def __sub__(self, other: Node | Exact | float) -> Node:
        return self.graph.sum(((1, self), (-1, self.graph.node(other))))

    def __rsub__(self, other: Exact | float) -> Node:
        return self.graph.sum(((-1, self), (1, self.graph.node(other))))

    def __mul__(self, other: Node | Exact | float) -> Node:
        if not isinstance(other, (Node, int, float, Rational)):
            return NotImplemented  # Python then tries the product of the other class, as for h * f(t, y)
        return self.graph.product((self, self.graph.node(other)))

    __rmul__ = __mul__

    def __truediv__(self, other: Node | Exact | float) -> Node:
        return self.graph.product((self, self.graph.power(self.graph.node(other), -1)))

    def __rtruediv__(self, other: Exact | float) -> Node:
        return self.graph.product((self.graph.node(other), self.graph.power(self, -1)))

    def __pow__(self, exponent: Node | Exact | float) -> Node:
        if isinstance(exponent, Node):
            return self.graph.call("pow", self, exponent)
        return self.graph.power(self, exact(exponent))

    def __neg__(self) -> Node:
        return self if self is self.graph.zero else self.graph.sum(((-1, self),))


def exact(value: Exact | float) -> Exact:
    """Return the value as an int if it is whole, else as a Fraction. A float has its exact binary value."""
    if isinstance(value, int):
        return value
    if isinstance(value, float) and not math.isfinite(value):
        raise StatementError(
            f"the expression contains {value}, which is not a finite number: look for a division by zero."
        )
    fraction = Fraction(value)
    return fraction.numerator if fraction.denominator == 1 else fraction


class Graph:
    """Expression graph with hash-consing, which creates all its nodes."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._table: dict[tuple[Any, ...], Node] = {}
        self._symbols = 0
        # Time derivatives of symbols that depend on time alone: 1 for time, and the rates of inputs.
        self.rates: dict[Node, Node] = {}
        self.zero, self.one = self.constant(0), self.constant(1)

    def _intern(self, kind: Kind, args: tuple[Node, ...], data: Any) -> Node:
        key = (kind, data, *map(id, args))
        if key in self._table:
            return self._table[key]
        if not len(self.nodes) % CHECKED_EVERY:
            check_time()
        depends, binding = 0, Binding.CONSTANT
        for arg in args:
            depends |= arg.depends
            if arg.binding > binding:
                binding = arg.binding
        with _ADDING:
            if key not in self._table:
                self.nodes.append(Node(self, kind, args, data, binding, depends))
                self._table[key] = self.nodes[-1]
        return self._table[key]

    def node(self, value: Node | Exact | float) -> Node:
        """Return a node unchanged, and a number as a constant node."""
        return value if isinstance(value, Node) else self.constant(value)

    def constant(self, value: Exact | float) -> Node:
        """Return the constant node with this exact value."""
        return self._intern(Kind.CONSTANT, (), exact(value))

    def symbol(self, name: str, binding: Binding) -> Node:
        """Return the symbol node `name`: the existing one, or a new one with this `binding`."""
        key = (Kind.SYMBOL, name)
        with _ADDING:
            if key not in self._table:
                self.nodes.append(Node(self, Kind.SYMBOL, (), name, binding, 1 << self._symbols))
                self._table[key] = self.nodes[-1]
                self._symbols += 1
        return self._table[key]

    def sum(self, terms: Iterable[tuple[Exact, Node]], constant: Exact = 0) -> Node:
        """Return the node of constant + sum of coefficient * node. `terms` are pairs (coefficient, node)."""
        merged: dict[Node, Exact] = {}
        for coefficient, node in terms:
            if node.kind is Kind.CONSTANT:
                constant = constant + coefficient * node.data
                continue
            if node.kind is Kind.SUM and len(node.args) == 1 and not node.data[0]:
                coefficient, node = coefficient * node.data[1][0], node.args[0]
            merged[node] = merged[node] + coefficient if node in merged else coefficient
        if len(merged) > 1:
            constant = constant + self._join_squares(merged)
        items = sorted(((node.id, node, exact(c)) for node, c in merged.items() if c), key=itemgetter(0))
        constant = exact(constant)
        if not items:
            return self.constant(constant)
        if constant == 0 and len(items) > 1:
            return self._factored([(node, c) for _, node, c in items])
        if constant == 0 and items[0][2] == 1:
            return items[0][1]
        return self._intern(Kind.SUM, tuple(node for _, node, _ in items), (constant, tuple(c for _, _, c in items)))

    def _join_squares(self, terms: dict[Node, Exact]) -> Exact:
        """Replace pairs of terms c r sin(a)**2 + c r cos(a)**2 by c r, in place. c is a coefficient, and r a product.

        If r is a constant, the pair is removed instead. Return the sum of those constants c r.
        """
        constant: Exact = 0
        for node in [node for node in terms if _square_of(node, "sin") is not None]:
            sine = _square_of(node, "sin")
            coefficient = terms.get(node, 0)
            if sine is None or not coefficient:
                continue
            cosine = self.power(self.call("cos", sine.args[0].args[0]), 2)
            rest = [factor for factor in _factors(node) if factor is not sine]
            twin = self.product([cosine, *rest])
            if terms.get(twin) != coefficient:
                continue
            del terms[node], terms[twin]
            joined = self.product(rest)
            if joined.kind is Kind.CONSTANT:
                constant = constant + coefficient * joined.data
            else:
                terms[joined] = terms.get(joined, 0) + coefficient
        return constant

    def _factored(self, items: list[tuple[Node, Exact]]) -> Node:
        """Return the sum of terms (node, coefficient) with their common factors taken out.

        If they have no common factor, a common coefficient is taken out.
        """
        first = items[0][1]
        scale: Exact = first if all(abs(c) == abs(first) for _, c in items) else 1
        common = list(_factors(items[0][0]))
        for node, _ in items[1:]:
            factors = _factors(node)
            common = [factor for factor in common if factor in factors]
            if not common:
                break
        if common:
            rest = [(c, self.product([f for f in _factors(node) if f not in common])) for node, c in items]
            return self.product([*common, self.sum(rest)])
        coefficients = tuple(c if scale == 1 else exact(Fraction(c) / scale) for _, c in items)
        node = self._intern(Kind.SUM, tuple(node for node, _ in items), (0, coefficients))
        return node if scale == 1 else self._intern(Kind.SUM, (node,), (0, (scale,)))

    def product(self, factors: Iterable[Node]) -> Node:
        """Return the product of the nodes, with equal factors merged into powers."""
        coefficient: Exact = 1
        exponents: dict[Node, Exact] = {}
        stack = list(factors)
        while stack:
            node = stack.pop()
            if node.kind is Kind.CONSTANT:
                coefficient = coefficient * node.data
            elif node.kind is Kind.PRODUCT and len(node.args) <= LONGEST_FLAT:
                stack.extend(node.args)
            elif node.kind is Kind.SUM and len(node.args) == 1 and not node.data[0]:
                coefficient = coefficient * node.data[1][0]
                stack.append(node.args[0])
            else:
                base, exponent = (node.args[0], node.data) if node.kind is Kind.POWER else (node, 1)
                exponents[base] = exponents[base] + exponent if base in exponents else exponent
        if coefficient == 0:
            return self.zero
        args = [self.power(base, exact(e)) for base, e in exponents.items() if e]
        if any(not _is_irreducible(arg) for arg in args):
            return self.product([self.constant(coefficient), *args])
        args.sort(key=attrgetter("binding", "id"))
        if not args:
            return self.constant(coefficient)
        if len(args) > LONGEST_PRODUCT:
            groups = (tuple(args[k : k + LONGEST_FLAT + 1]) for k in range(0, len(args), LONGEST_FLAT + 1))
            return self.product([self.constant(coefficient), *(self._intern(Kind.PRODUCT, g, None) for g in groups)])
        whole = args[0] if len(args) == 1 else self._intern(Kind.PRODUCT, tuple(args), None)
        if coefficient == 1:
            return whole
        return self._intern(Kind.SUM, (whole,), (0, (exact(coefficient),)))

    def power(self, base: Node, exponent: Exact) -> Node:
        """Return the node of base ** exponent. The exponent is an int or a Fraction."""
        if exponent == 0:
            return self.one
        if exponent == 1:
            return base
        if isinstance(exponent, int):
            if base.kind is Kind.CONSTANT:
                return self.constant(_constant_power(base.data, exponent))
            if base.kind is Kind.POWER:
                return self.power(base.args[0], exact(base.data * exponent))
            if base.kind is Kind.PRODUCT:
                return self.product([self.power(arg, exponent) for arg in base.args])
            if base.kind is Kind.SUM and len(base.args) == 1 and not base.data[0]:
                scale = _constant_power(base.data[1][0], exponent)
                return self.product((self.constant(scale), self.power(base.args[0], exponent)))
            if base.kind is Kind.CALL and base.data == "abs" and exponent % 2 == 0:
                return self.power(base.args[0], exponent)
        elif (parts := self._squares(base)) is not None:
            return self.product([self.power(part, exact(n * exponent)) for part, n in parts])
        if base.kind is Kind.CONSTANT and base.data in (0, 1) and exponent > 0:
            return base
        return self._intern(Kind.POWER, (base,), exponent)

    def _squares(self, base: Node) -> list[tuple[Node, int]] | None:
        """Return pairs (part, n) whose powers part**n have the product `base`, or None.

        It is None unless all factors that change are even powers. A factor changes if it depends on more than
        parameters. Its part is an absolute value, so that (x**2)**e becomes |x|**(2 e). The Taylor series of sqrt(x**2)
        itself would continue as x beyond x = 0.
        """
        if _is_scaled(base) and base.data[1][0] > 0:
            parts = self._squares(base.args[0])
            return None if parts is None else [(self.constant(base.data[1][0]), 1), *parts]
        moving = [factor for factor in _factors(base) if factor.binding > Binding.PARAMETER]
        rest = [(factor, 1) for factor in _factors(base) if factor not in moving]
        if not moving or any(f.kind is not Kind.POWER or f.data % 2 for f in moving):
            return None
        return [*rest, *((self.call("abs", factor.args[0]), factor.data) for factor in moving)]

    def call(self, name: str, *args: Node) -> Node:
        """Return the value of the function `name`, a key of `FUNCTIONS`, at the arguments. Constants are folded."""
        function = FUNCTIONS[name]
        if function.arity is not None and len(args) != function.arity:
            raise StatementError(f"{name} takes {function.arity} arguments, not {len(args)}.")
        if name == "pow" and args[1].kind is Kind.CONSTANT:
            return self.power(args[0], args[1].data)
        if args and all(arg.kind is Kind.CONSTANT for arg in args):
            values = tuple(arg.data for arg in args)
            if (name, *values) in EXACT:
                return self.constant(EXACT[(name, *values)])
            if name in FOLDS:
                return self.constant(FOLDS[name](*values))
        if name in EVEN or name in ODD:
            scale, rest = (args[0].data[1][0], args[0].args[0]) if _is_scaled(args[0]) else (1, args[0])
            if scale < 0:
                mirrored = self.call(name, self.sum(((-scale, rest),)))
                return mirrored if name in EVEN else -mirrored
        return self._intern(Kind.CALL, args, name)

    def piecewise(self, branches: Sequence[tuple[Node, Node]], otherwise: Node | None = None) -> Node:
        """Return the value of the first branch (condition, value) whose condition holds, else `otherwise` or NaN."""
        last = self.call("nan") if otherwise is None else otherwise
        if all(value is last for _, value in branches):
            return last
        flat = [node for pair in branches for node in pair]
        return self._intern(Kind.CALL, (*flat, last), "piecewise")

    def solve(self, matrix: Rows, right: Sequence[Node], negative: Sequence[int] = ()) -> list[Node]:
        """Return the unknowns x of matrix * x = right, one node each, for a symmetric matrix.

        Only the lower triangle is used. `negative` has the indices of the pivots that are negative.
        """
        n = len(right)
        if n == 1:
            return [self.zero if right[0] is self.zero else right[0] / matrix[0][0]]
        triangle = tuple(matrix[i][j] for i in range(n) for j in range(i + 1))
        factor = self._intern(Kind.FACTOR, triangle, (n, tuple(negative)))
        return self.solve_with(factor, right)

    def solve_with(self, factor: Node, right: Sequence[Node]) -> list[Node]:
        """Return the unknowns x of matrix * x = right, one node each. `factor` is the node of the factored matrix."""
        if all(node is self.zero for node in right):
            return [self.zero] * len(right)
        return self.components(self._intern(Kind.SOLVE, (factor, *right), factor.data[0]))

    def components(self, solution: Node) -> list[Node]:
        """Return the unknowns of a linear system, one node each; `solution` is its node, of the kind SOLVE."""
        return [self._intern(Kind.COMPONENT, (solution,), i) for i in range(solution.data)]


def reachable(outputs: Iterable[Node], mask: int = -1, excluded: Collection[Node] = ()) -> list[Node]:
    """Return the nodes on which the outputs depend, outputs included, arguments before the nodes that use them.

    With a bit `mask` of symbols, only nodes that depend on one of these symbols are returned. Nodes in `excluded` are
    left out, and so are nodes that only they need.
    """
    visited: set[Node] = set(excluded)
    stack = [node for node in outputs if mask == -1 or node.depends & mask]
    while stack:
        node = stack.pop()
        if node not in visited:
            visited.add(node)
            stack.extend(arg for arg in node.args if mask == -1 or arg.depends & mask)
    return sorted(visited.difference(excluded), key=attrgetter("id"))


def _is_scaled(node: Node) -> bool:
    return node.kind is Kind.SUM and len(node.args) == 1 and not node.data[0]


def _is_irreducible(node: Node) -> bool:
    """Return True if a node stays one factor when it is multiplied by other nodes.

    A constant, a multiple of a node and a short product are divided into their factors instead.
    """
    short = node.kind is Kind.PRODUCT and len(node.args) <= LONGEST_FLAT
    return not (short or node.kind is Kind.CONSTANT or _is_scaled(node))


def _factors(node: Node) -> tuple[Node, ...]:
    return node.args if node.kind is Kind.PRODUCT else (node,)


def _square_of(node: Node, name: str) -> Node | None:
    """Return the factor f(a)**2 of a product, where f is the function `name`. None without such a factor."""
    for factor in _factors(node):
        if factor.kind is Kind.POWER and factor.data == 2:
            base = factor.args[0]
            if base.kind is Kind.CALL and base.data == name:
                return factor
    return None


def _constant_power(base: Exact, exponent: int) -> Exact:
    if base == 0 and exponent < 0:
        raise StatementError("the expression divides by zero: look for a denominator that is zero.")
    if abs(exponent) > LARGEST_POWER and abs(base) != 1 and base != 0:
        raise StatementError(
            f"the constant {base}**{exponent} is out of range of floating-point numbers: choose other units."
        )
    return exact(Fraction(base) ** exponent)


def rebuild(node: Node, args: Sequence[Node]) -> Node:
    """Return a node of the same kind and data as `node` with the arguments `args`, simplified as all new nodes."""
    graph = node.graph
    if all(new is old for new, old in zip(args, node.args, strict=True)):
        return node
    if node.kind is Kind.SUM:
        return graph.sum(zip(node.data[1], args, strict=True), node.data[0])
    if node.kind is Kind.PRODUCT:
        return graph.product(args)
    if node.kind is Kind.POWER:
        return graph.power(args[0], node.data)
    if node.kind is Kind.CALL and node.data == "piecewise":
        return graph.piecewise(list(zip(args[:-1:2], args[1::2], strict=True)), args[-1])
    if node.kind is Kind.CALL:
        return graph.call(node.data, *args)
    return graph._intern(node.kind, tuple(args), node.data)


def substitute(outputs: Iterable[Node], replacements: Mapping[Node, Node]) -> list[Node]:
    """Return the outputs with some nodes, usually symbols, replaced: {node: replacement}."""
    outputs = list(outputs)
    table = dict(replacements)
    for node in reachable(outputs, excluded=replacements.keys()):
        table[node] = rebuild(node, [table[arg] for arg in node.args])
    return [table[node] for node in outputs]


class Substitution:
    """Callable that replaces nodes by others. Replacements may be added between calls. Rebuilt nodes are cached."""

    def __init__(self) -> None:
        self._replaced: dict[Node, Node] = {}
        self._table: dict[Node, Node] = {}

    def __call__(self, node: Node) -> Node:
        """Return the node after all replacements that were added."""
        table = self._table
        missing: set[Node] = set()
        stack = [node]
        while stack:
            inner = stack.pop()
            if inner not in table and inner not in missing:
                missing.add(inner)
                stack.extend(inner.args)
        for inner in sorted(missing, key=lambda inner: inner.id):
            table[inner] = rebuild(inner, [table[arg] for arg in inner.args])
        return table[node]

    def replace(self, node: Node, other: Node) -> None:
        """Replace `node` by `other` in later calls."""
        self._replaced[node] = other
        if self._table.get(node, other) is not other:
            # Cached nodes that contain this node were built from its old value.
            self._table = dict(self._replaced)
        self._table[node] = other


@dataclass(frozen=True)
class _Split:
    """Sum that contains another one: `ratio` times the sum `part`, plus the terms `rest`, pairs (coefficient, node)."""

    ratio: Exact
    part: Node
    rest: tuple[tuple[Exact, Node], ...]


def share_sums(graph: Graph, outputs: Sequence[Node]) -> list[Node]:
    """Return the outputs rebuilt so that a sum uses the longest other sum whose terms it contains.

    In a chain of links, the position of link k is stated as a sum of k terms. SymPy flattens each of these sums, so
    they overlap without sharing a node, and every derivative repeats their terms. Here S = a + b + c + d becomes P + d,
    where P = a + b + c is a separate sum. The cost falls from quadratic to linear in the length of the chain.
    """
    order = reachable(outputs)
    splits = _splits([node for node in order if node.kind is Kind.SUM and len(node.args) > 1])
    if not splits:
        return list(outputs)
    built: dict[Node, Node] = {}
    for node in order:
        for part in _unbuilt_parts(node, splits, built):
            if part in splits:
                split = splits[part]
                rest = [(c, built[term]) for c, term in split.rest]
                built[part] = graph.sum([(split.ratio, built[split.part]), *rest], part.data[0])
            else:
                built[part] = rebuild(part, [built[arg] for arg in part.args])
    return [built[node] for node in outputs]


def _unbuilt_parts(node: Node, splits: dict[Node, _Split], built: dict[Node, Node]) -> list[Node]:
    """Return the sum `node`, the sum that it contains, the sum that this one contains, and so on, the shortest first.

    `splits` has the contained sum of each sum that has one. The chain ends before a sum that is already in `built`.
    """
    chain: list[Node] = []
    while node not in built:
        chain.append(node)
        if node not in splits:
            break
        node = splits[node].part
    return chain[::-1]


def _splits(sums: list[Node]) -> dict[Node, _Split]:
    """Return {sum: split} for those of `sums` that contain another one, as 2*x + 2*y + z contains x + y.

    A split has a multiple of the longest contained sum, which has no constant, and the other terms.
    """
    occurrences = Counter(term for node in sums for term in node.args)
    # Sums are looked up by their rarest term. With a term that all sums have, all pairs would be compared.
    by_rarest: dict[Node, list[Node]] = {}
    splits: dict[Node, _Split] = {}
    for node in sorted(sums, key=lambda s: (len(s.args), s.id)):
        terms = dict(zip(node.args, node.data[1], strict=True))
        parts = [part for term in terms for part in by_rarest.get(term, ())]
        for part in sorted(parts, key=lambda p: (-len(p.args), p.id)):
            split = _split(terms, part)
            if split is not None:
                splits[node] = split
                break
        if node.data[0] == 0:
            by_rarest.setdefault(min(node.args, key=occurrences.__getitem__), []).append(node)
    return splits


def _split(terms: dict[Node, Exact], part: Node) -> _Split | None:
    """Return the sum `terms`, {node: coefficient}, as a multiple of the sum `part` plus other terms, or else None."""
    if any(term not in terms for term in part.args):
        return None
    coefficients = dict(zip(part.args, part.data[1], strict=True))
    ratio = Fraction(terms[part.args[0]]) / coefficients[part.args[0]]
    if any(terms[term] != ratio * c for term, c in coefficients.items()):
        return None
    rest = tuple((c, term) for term, c in terms.items() if term not in coefficients)
    return _Split(exact(ratio), part, rest)
