"""From graph to series program: every node becomes a value with a rule for its Taylor coefficients.

Functions are integrated: s = sin(a) follows from s' = cos(a) a'. If a' is a combination of velocities, the product
cos(a) a' is also a value with a rule; a Lagrangian in Cartesian positions contains this product already. Products of
many factors are split so that their parts are shared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import combinations
from types import MappingProxyType

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Exact, Graph, Kind, Node, Substitution, reachable
from lagrange.program.series import LARGEST_POWER, SeriesRule
from lagrange.statement.run_settings import CHECKED_EVERY, check_time
from lagrange.statement.vocabulary.functions import ELEMENTARY

LONGEST_SHARED = 12
"""Longest product whose pairs of factors are counted, to share them with other products. A longer product is multiplied
from the left.
"""


class RecurrenceBuilder:
    """Builds series values for graph nodes: each is a Taylor series with a rule for its coefficients.

    A node gets one series value, which other rules name by its index. `nodes` has for each value the node that computes
    it at order 0, or None. `rate` has the nodes of dq/dt; if it is empty, these are the velocities v. `unknowns` maps
    the symbols that a linear system determines, except velocities, to their index among all unknowns. `integrals` maps
    other symbols to their derivatives. The rate of sin(a - b) is cos(a - b) (a' - b'). With `termwise` its terms are
    multiplied out, because cos(a - b) a' may exist already.
    """

    def __init__(
        self,
        graph: Graph,
        q: Sequence[Node],
        v: Sequence[Node],
        time: Node,
        outputs: Sequence[Node],
        *,
        rate: Sequence[Node] = (),
        termwise: bool = False,
        unknowns: Mapping[Node, int] = MappingProxyType({}),
        integrals: Mapping[Node, Node] = MappingProxyType({}),
    ) -> None:
        self.graph = graph
        self.termwise = termwise
        self.q, self.v, self.time = tuple(q), tuple(v), time
        self.rules: list[SeriesRule] = []
        self.nodes: list[Node | None] = []
        self.offsets: list[Node | None] = []
        self.numbers: dict[tuple[SeriesRule, Node | None], int] = {}
        self.values: dict[Node, int] = {}
        self.constants: dict[Node, int] = {}
        self.rates: dict[Node, Node | None] = {}
        self.starts: dict[Node, Node] = {}
        self.speed = dict(zip(self.q, rate or self.v, strict=True)) | graph.rates | dict(integrals)
        for i, node in enumerate(self.q):
            self.values[node] = self.add(SeriesRule("coordinate", (), (i,)), node)
        for i, node in enumerate(self.v):
            self.values[node] = self.add(SeriesRule("unknown", (), (i,)), node)
        for node, index in unknowns.items():
            self.values[node] = self.add(SeriesRule("unknown", (), (index,)), node)
        self.values[time] = self.add(SeriesRule("time"), time)
        order = [node for node in reachable(outputs) if node.binding > Binding.PARAMETER]
        self.pairs = self._pairs(order)
        for node in [node for node in order if node in integrals]:
            self.integral(node, integrals)
        for node in order:
            # Products get a value only where another node uses them: a sum takes the constant factor of a product into
            # its own coefficients. A reciprocal in a product becomes a division, and gets no value either.
            if node.kind is not Kind.PRODUCT and not _is_divisor(node):
                self.value(node)

    def _pairs(self, order: Sequence[Node]) -> Counter[tuple[Node, Node]]:
        """Return for each pair of factors a weight: the number of products that contain it.

        `order` are all nodes. A product of exactly two factors adds a large weight, because the series of its pair
        exists in any case. The same weight is added for cos(q) and sin(q) times the velocity, which the series of
        sin(q) and cos(q) need.
        """
        counts: Counter[tuple[Node, Node]] = Counter()
        for node in order:
            if node.kind is Kind.PRODUCT:
                # The factors that are not constant, those of coordinates alone first.
                moving = (a for a in node.args if a.binding > Binding.PARAMETER)
                factors = sorted(moving, key=lambda f: (f.binding, f.id))
                weight = len(order) if len(factors) == 2 else 1
                pairs = combinations(factors, 2) if len(factors) <= LONGEST_SHARED else ()
                counts.update(dict.fromkeys(pairs, weight))
            elif node.kind is Kind.CALL and node.data in ("sin", "cos"):
                rate = self.rate(node.args[0])
                terms = () if rate is None else rate.args if self.termwise and rate.kind is Kind.SUM else (rate,)
                calls = [self.graph.call(name, node.args[0]) for name in ("sin", "cos")]
                counts.update({(call, term): len(order) for call in calls for term in terms})
        return counts

    def add(self, rule: SeriesRule, node: Node | None, constant: Node | None = None) -> int:
        """Return the index of the series value with the given rule; an equal value is reused.

        `node` computes the value at order 0, or is None if no rule reads the value at order 0. `constant` is a term
        of order 0 that is not part of the rule: x - 1 and x - 2 are two values.
        """
        key = rule, constant
        if key not in self.numbers:
            if not len(self.rules) % CHECKED_EVERY:
                check_time()
            self.numbers[key] = len(self.rules)
            self.rules.append(rule)
            self.nodes.append(node)
            self.offsets.append(constant)
        return self.numbers[key]

    def reserve(self, node: Node) -> int:
        """Return the index of a new series value for a node.

        Its rule is set later, so that the rule may read the value itself.
        """
        self.rules.append(SeriesRule("constant"))
        self.nodes.append(node)
        self.offsets.append(None)
        self.values[node] = len(self.rules) - 1
        return self.values[node]

    def constant(self, node: Node | Exact) -> int:
        """Return the index of a constant in the table of constants of the series. A missing constant is added."""
        node = self.graph.node(node)
        return self.constants.setdefault(node, len(self.constants))

    def value(self, node: Node) -> int:
        """Return the index of the series value of a node that varies in time, or of a constant force."""
        if node not in self.values:
            self.values[node] = self._make(node)
        return self.values[node]

    def _make(self, node: Node) -> int:
        if node.binding <= Binding.PARAMETER:
            return self.add(SeriesRule("constant"), node, node)
        if node.kind is Kind.SUM:
            terms = [(c, arg) for c, arg in zip(node.data[1], node.args, strict=True)]
            return self.linear([*terms, (node.data[0], self.graph.one)], node)
        if node.kind is Kind.PRODUCT:
            scale, moving = self.split(node)
            return (
                moving
                if scale is self.graph.one
                else self.add(SeriesRule("linear", (moving,), (self.constant(scale),)), node, self.graph.zero)
            )
        if node.kind is Kind.POWER:
            return self.power(node)
        if node.kind is Kind.CALL:
            return FUNCTION_RULES[node.data](self, node)
        raise AssertionError(f"{node} has no series")

    def linear(self, terms: Iterable[tuple[Exact, Node]], node: Node) -> int:
        """Return the index of the series value of `node`, the linear combination of `terms`.

        Constant terms enter at order 0 only.
        """
        merged: dict[int, Node] = {}
        constant = self.graph.zero
        for coefficient, arg in terms:
            if arg.binding <= Binding.PARAMETER:
                constant = self.graph.sum(((1, constant), (coefficient, arg)))
                continue
            scale, moving = self.split(arg)
            term = self.graph.sum(((coefficient, scale),))
            merged[moving] = merged[moving] + term if moving in merged else term
        items = [(arg, c) for arg, c in merged.items() if c is not self.graph.zero]
        if not items:
            return self.add(SeriesRule("constant"), node, constant)
        args, scales = zip(*items, strict=True)
        return self.add(SeriesRule("linear", args, tuple(self.constant(c) for c in scales)), node, constant)

    def split(self, node: Node) -> tuple[Node, int]:
        """Return a node as a constant factor, and the index of the series value of its other factors' product."""
        if node.kind is not Kind.PRODUCT or node in self.values:
            return self.graph.one, self.value(node)
        scale = self.graph.product([a for a in node.args if a.binding <= Binding.PARAMETER])
        over = [a for a in node.args if a.binding > Binding.PARAMETER]
        under = [a for a in over if _is_divisor(a) and a not in self.values]
        over = [a for a in over if a not in under]
        if not under or not over:
            return scale, self.product([*over, *under])
        value = self.product(over)
        for divisor in under:
            quotient = self.node_of(value) / divisor.args[0]
            value = self.add(SeriesRule("div", (value, self.value(divisor.args[0]))), quotient)
        return scale, value

    def product(self, factors: Sequence[Node]) -> int:
        """Return the index of the series value of the product of `factors`, nodes that vary in time.

        The factors are multiplied two by two, beginning with the pairs that most products need.
        """
        rest = sorted(factors, key=lambda f: (f.binding, f.id))
        while len(rest) > 2:
            near = combinations(rest if len(rest) <= LONGEST_SHARED else rest[:2], 2)
            first, second = max(near, key=lambda pair: (self.pairs[pair], -pair[1].binding, -pair[0].id, -pair[1].id))
            rest = [f for f in rest if f is not first and f is not second]
            joined = self.graph.product((first, second))
            self.values.setdefault(joined, self.multiply(self.value(first), self.value(second)))
            rest.append(joined)
        if len(rest) == 1:
            return self.value(rest[0])
        return self.multiply(*map(self.value, rest))

    def multiply(self, a: int, b: int) -> int:
        """Return the index of the series value that is the product of the values with the indices a and b."""
        node = self.node_of(a) * self.node_of(b)
        if a == b:
            return self.add(SeriesRule("square", (a,)), node)
        return self.add(SeriesRule("mul", (min(a, b), max(a, b))), node)

    def node_of(self, value: int) -> Node:
        """Return the node that computes the series value with the index `value` at order 0."""
        return known_node(self.nodes[value])

    def power(self, node: Node) -> int:
        """Return the index of the series value of `node`, a power with a constant exponent."""
        base, exponent = node.args[0], node.data
        a = self.value(base)
        if isinstance(exponent, int) and 2 <= exponent <= LARGEST_POWER:
            half = self.value(self.graph.power(base, exponent // 2))
            square = self.multiply(half, half)
            return self.multiply(square, a) if exponent % 2 else square
        if exponent == -1:
            return self.add(SeriesRule("inverse", (a,)), node)
        if exponent == Fraction(1, 2):
            return self.add(SeriesRule("sqrt", (a,)), node)
        return self.add(SeriesRule("power", (a,), (self.constant(exponent),)), node)

    def rate(self, node: Node) -> Node | None:
        """Return da/dt if the node a is a linear combination of coordinates with constant coefficients.

        Otherwise return None.
        """
        if node not in self.rates:
            self.rates[node] = self._rate(node)
        return self.rates[node]

    def _rate(self, node: Node) -> Node | None:
        if node in self.speed:
            return self.speed[node]
        if node.kind is Kind.PRODUCT:
            moving = [a for a in node.args if a.binding > Binding.PARAMETER]
            rate = self.rate(moving[0]) if len(moving) == 1 else None
            steady = [a for a in node.args if a.binding <= Binding.PARAMETER]
            return None if rate is None else self.graph.product([*steady, rate])
        if node.kind is not Kind.SUM:
            return None
        terms = []
        for coefficient, arg in zip(node.data[1], node.args, strict=True):
            rate = self.graph.zero if arg.binding <= Binding.PARAMETER else self.rate(arg)
            if rate is None:
                return None
            terms.append((coefficient, rate))
        return self.graph.sum(terms)

    def integrate(self, value: int, a: Node, w: int, sign: int = 1) -> None:
        """Set the rule of the reserved series value with index `value`, called u: u' = sign * w * a'.

        a is a node, and w the index of another series value.
        """
        rate = self.rate(a)
        if rate is None:
            self.rules[value] = SeriesRule("along", (self.value(a), w), (self.constant(sign),))
            return
        if self.termwise and rate.kind is Kind.SUM and len(rate.args) > 1:
            whole = self.linear(self.split_rate(rate, w), self.node_of(w) * rate)
            self.rules[value] = SeriesRule("integral", (whole,), (self.constant(sign),))
            return
        scale, moving = (rate, None) if rate.binding <= Binding.PARAMETER else self.split(rate)
        product = w if moving is None else self.multiply(moving, w)
        self.rules[value] = SeriesRule("integral", (product,), (self.constant(self.graph.sum(((sign, scale),))),))

    def integral(self, node: Node, rates: Mapping[Node, Node]) -> None:
        """Add the series value of the symbol `node`, the integral of its derivative `rates[node]`.

        `rates` maps symbols to their derivatives. Symbols inside the derivative get series values in the same way.
        """
        waiting = [node]
        reserved: dict[Node, int] = {}
        while waiting:
            symbol = waiting.pop()
            if symbol not in self.values:
                reserved[symbol] = self.reserve(symbol)
                waiting += [inner for inner in reachable([rates[symbol]]) if inner in rates]
        for symbol, value in reserved.items():
            self.rules[value] = SeriesRule("integral", (self.value(rates[symbol]),), (self.constant(1),))

    def split_rate(self, rate: Node, w: int) -> list[tuple[Exact, Node]]:
        """Return the terms of rate * w as pairs (coefficient, node), where w is the index of a series value.

        `rate` is a sum of nodes. The product of each of its terms with w becomes a series value.
        """
        terms = []
        for coefficient, node in [*zip(rate.data[1], rate.args, strict=True), (rate.data[0], self.graph.one)]:
            scale, moving = (node, None) if node.binding <= Binding.PARAMETER else self.split(node)
            value = w if moving is None else self.multiply(moving, w)
            product = self.node_of(value)
            self.values.setdefault(product, value)
            terms.append((coefficient, self.graph.product((scale, product))))
        return [(c, node) for c, node in terms if c]

    def initial(self, table: Sequence[Node], low: Mapping[int, Node]) -> list[Node | None]:
        """Return for every series value the node that computes it at order 0, with the constants from `table`.

        The rules of higher orders read the same table. If constants were rounded in another way, G m1 m2 would differ
        by a unit in the last place between a force and its derivatives. This error would have the same sign at every
        step, and the error of the energy would grow in proportion to time. `low` maps the indices of coordinates and
        velocities to symbols of their rounding errors. These errors enter differences of coordinates, so that bodies
        may move together far from the origin.
        """
        nodes: list[Node | None] = []
        replaced = Substitution()
        for rule, node, offset in zip(self.rules, self.nodes, self.offsets, strict=True):
            if node is None:
                nodes.append(None)
                continue
            if node in self.starts:
                start = replaced(self.starts[node])
            elif rule.op == "linear":
                pairs = zip(rule.coefficients, rule.args, strict=True)
                terms = [(1, table[c] * known_node(nodes[arg])) for c, arg in pairs]
                if len(rule.args) > 1 and all(arg in low for arg in rule.args):
                    pairs = zip(rule.coefficients, rule.args, strict=True)
                    terms += [(1, table[c] * low[arg]) for c, arg in pairs]
                start = self.graph.sum(terms if offset is None else [*terms, (1, offset)])
            else:
                start = replaced(node)
            nodes.append(start)
            if start is not node:
                replaced.replace(node, start)
        return nodes


def known_node(node: Node | None) -> Node:
    """Return `node`, which computes a value at order 0. Raises AssertionError if it is None."""
    if node is None:
        raise AssertionError("the value at order 0 of an integral without a start is read")
    return node


def _is_divisor(node: Node) -> bool:
    return node.kind is Kind.POWER and node.data == -1


FunctionRule = Callable[["RecurrenceBuilder", Node], int]


def _pair(names: tuple[str, str], signs: tuple[int, int]) -> FunctionRule:
    """Return the rule builder of two functions, each the derivative of the other up to sign, such as sin and cos.

    The rule builder adds the rules for the Taylor coefficients of both functions to a `RecurrenceBuilder`. `names`
    are the functions, and `signs` the signs of their derivatives.
    """

    def build(b: RecurrenceBuilder, node: Node) -> int:
        a = node.args[0]
        first, second = (b.graph.call(name, a) for name in names)
        if first not in b.values:
            b.value(a)
            sine, cosine = b.reserve(first), b.reserve(second)
            b.integrate(sine, a, cosine, signs[0])
            b.integrate(cosine, a, sine, signs[1])
        return b.values[node]

    return build


def _against(slope: Callable[[Node], Node], sign: int = 1) -> FunctionRule:
    """Return the rule builder of a function u = F(a) whose rate follows from slope(a) * u' = sign * a'.

    The rule builder adds the rule for the Taylor coefficients of u to a `RecurrenceBuilder`. Examples are log and
    asin, with the derivative 1 / slope(a). The sign is -1 for acos.
    """

    def build(b: RecurrenceBuilder, node: Node) -> int:
        a = node.args[0]
        w = b.value(slope(a))
        if sign > 0:
            return b.add(SeriesRule("against", (b.value(a), w)), node)
        mirrored = b.add(SeriesRule("linear", (b.value(a),), (b.constant(-1),)), -a)
        return b.add(SeriesRule("against", (mirrored, w)), node)

    return build


def _by_derivative(b: RecurrenceBuilder, node: Node) -> int:
    """Return the index of the series value u = F(a), with the rule u' = w a'.

    w is the derivative of the function F, which may contain u. `node` is F(a).
    """
    a = node.args[0]
    b.value(a)
    value = b.reserve(node)
    b.integrate(value, a, b.value(ELEMENTARY[node.data].partial(node, a)))
    return value


def _hyperbolic_tangent(b: RecurrenceBuilder, node: Node) -> int:
    """Return the index of the series value u = tanh(a), by u' = (1 - u**2) a'."""
    # At order 0, 1 - u**2 is 4 exp(-2|a|) for large |a|. The difference would be rounded to zero, and the series would
    # be constant.
    tail = b.graph.call("exp", -2 * b.graph.call("abs", node.args[0]))
    b.starts[1 - node**2] = 4 * tail / (1 + tail) ** 2
    return _by_derivative(b, node)


def _atan2(b: RecurrenceBuilder, node: Node) -> int:
    """Return the index of the series value u = atan2(y, x), by (x**2 + y**2) u' = x y' - y x'."""
    y, x = node.args
    w = b.value(x**2 + y**2)
    terms = [_swept(b, a, other, sign) for a, other, sign in ((y, x, 1), (x, y, -1)) if a.binding > Binding.PARAMETER]
    area = (
        terms[0] if len(terms) == 1 else b.add(SeriesRule("linear", tuple(terms), (b.constant(1),) * len(terms)), None)
    )
    return b.add(SeriesRule("against", (area, w)), node)


def _swept(b: RecurrenceBuilder, a: Node, w: Node, sign: int) -> int:
    """Return the index of a series value that is, up to a constant, `sign` times the integral of w da."""
    if w.binding <= Binding.PARAMETER:
        return b.add(SeriesRule("linear", (b.value(a),), (b.constant(b.graph.sum(((sign, w),))),)), None)
    return b.add(SeriesRule("along", (b.value(a), b.value(w)), (b.constant(sign),)), None)


def _pow(b: RecurrenceBuilder, node: Node) -> int:
    """Return the index of the series value of `node`, a power with an exponent that may vary.

    If the exponent varies, the power is computed as exp(exponent * log(base)).
    """
    base, exponent = node.args
    if exponent.binding <= Binding.PARAMETER:
        return b.add(SeriesRule("power", (b.value(base),), (b.constant(exponent),)), node)
    logarithm = b.graph.product((exponent, b.graph.call("log", base)))
    b.value(logarithm)
    value = b.reserve(node)
    b.integrate(value, logarithm, value)
    return value


def _piecewise(b: RecurrenceBuilder, node: Node) -> int:
    """Return the index of the series value of `node`: the value of its first branch whose condition holds.

    The conditions are constant along a series.
    """
    value = b.value(node.args[-1])
    rest = node.args[-1]
    for condition, chosen in list(zip(node.args[:-1:2], node.args[1::2], strict=True))[::-1]:
        if condition.binding > Binding.PARAMETER:
            raise AssertionError("a condition of a series is about sides")
        rest = b.graph.piecewise([(condition, chosen)], rest)
        value = b.add(SeriesRule("choose", (b.value(chosen), value), (b.constant(condition),)), rest)
    return value


def _refuse(_: RecurrenceBuilder, node: Node) -> int:
    raise StatementError(
        f"{node.data} has no Taylor series here: take the method dop853, or write the expression without {node.data}."
    )


FUNCTION_RULES: dict[str, FunctionRule] = {
    **{
        call.name: _by_derivative if call.slope is None else _against(call.slope, call.sign)
        for call in ELEMENTARY.values()
    },
    "sin": _pair(("sin", "cos"), (1, -1)),
    "cos": _pair(("sin", "cos"), (1, -1)),
    "sinh": _pair(("sinh", "cosh"), (1, 1)),
    "cosh": _pair(("sinh", "cosh"), (1, 1)),
    "tanh": _hyperbolic_tangent,
    "atan2": _atan2,
    "pow": _pow,
    "piecewise": _piecewise,
    **dict.fromkeys(("abs", "sign", "min", "max", "less", "less_equal", "equal", "and", "or", "not"), _refuse),
    **dict.fromkeys(("pi", "e", "nan"), _refuse),
}
"""Functions that add the series of a graph function, by its name. Functions that switch have been replaced, and
constants are never passed.
"""
