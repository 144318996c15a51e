"""Series rules of each function of the graph: its value is the integral of its derivative."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Node
from lagrange.program.series import SeriesRule
from lagrange.statement.vocabulary.elementary import ELEMENTARY

if TYPE_CHECKING:
    from lagrange.program.recurrence import RecurrenceBuilder

FunctionRule = Callable[["RecurrenceBuilder", Node], int]


def _pair(names: tuple[str, str], signs: tuple[int, int]) -> FunctionRule:
    """Two functions that are each other's derivative up to a sign, such as sin and cos."""

    def build(b: RecurrenceBuilder, node: Node) -> int:
        a = node.args[0]
        first, second = (b.graph.call(name, a) for name in names)
        if first not in b.values:
            b.value(a)
            one, other = b.reserve(first), b.reserve(second)
            b.integrate(one, a, other, signs[0])
            b.integrate(other, a, one, signs[1])
        return b.values[node]

    return build


def _exponential(b: RecurrenceBuilder, node: Node) -> int:
    b.value(node.args[0])
    value = b.reserve(node)
    b.integrate(value, node.args[0], value)
    return value


def _tangent(sign: int) -> FunctionRule:
    """U' = (1 + sign u**2) a'."""

    def build(b: RecurrenceBuilder, node: Node) -> int:
        b.value(node.args[0])
        value = b.reserve(node)
        square = b.multiply(value, value)
        slope = b.graph.sum(((sign, node**2),), 1)
        w = b.add(SeriesRule("linear", (square,), (b.constant(sign),)), slope, b.graph.one)
        b.values.setdefault(slope, w)
        if sign < 0:
            b.starts[slope] = _flatness(node.args[0])
        b.integrate(value, node.args[0], w)
        return value

    return build


def _flatness(a: Node) -> Node:
    """Return 1 - tanh(a)**2 without the difference: far out it is 4 exp(-2|a|), of which tanh itself keeps nothing.

    A series that began with 0 there would not know that the function ever changes.
    """
    tail = a.graph.call("exp", -2 * a.graph.call("abs", a))
    return 4 * tail / (1 + tail) ** 2


def _against(slope: Callable[[Node], Node], sign: int = 1) -> FunctionRule:
    """slope(a) u' = a'; the negative of that for acos."""

    def build(b: RecurrenceBuilder, node: Node) -> int:
        a = node.args[0]
        w = b.value(slope(a))
        if sign > 0:
            return b.add(SeriesRule("against", (b.value(a), w)), node)
        mirrored = b.add(SeriesRule("linear", (b.value(a),), (b.constant(-1),)), -a)
        return b.add(SeriesRule("against", (mirrored, w)), node)

    return build


def _error_function(b: RecurrenceBuilder, node: Node) -> int:
    """U' = 2/sqrt(pi) exp(-a**2) a'."""
    a = node.args[0]
    b.value(a)
    w = b.value(ELEMENTARY["erf"].partial(node, a))
    value = b.reserve(node)
    b.integrate(value, a, w)
    return value


def _atan2(b: RecurrenceBuilder, node: Node) -> int:
    """(x**2 + y**2) u' = x y' - y x'."""
    y, x = node.args
    w = b.value(x**2 + y**2)
    terms = []
    for a, other, sign in ((y, x, 1), (x, y, -1)):
        if a.binding > Binding.PARAMETER:
            terms.append(_swept(b, a, other, sign))
    area = (
        terms[0] if len(terms) == 1 else b.add(SeriesRule("linear", tuple(terms), (b.constant(1),) * len(terms)), None)
    )
    return b.add(SeriesRule("against", (area, w)), node)


def _swept(b: RecurrenceBuilder, a: Node, w: Node, sign: int) -> int:
    """Return sign times the integral of w da, up to a constant."""
    if w.binding <= Binding.PARAMETER:
        return b.add(SeriesRule("linear", (b.value(a),), (b.constant(b.graph.sum(((sign, w),))),)), None)
    return b.add(SeriesRule("along", (b.value(a), b.value(w)), (b.constant(sign),)), None)


def _pow(b: RecurrenceBuilder, node: Node) -> int:
    """Return base ** exponent, by the rule of powers for a constant exponent, else exp(exponent log(base))."""
    base, exponent = node.args
    if exponent.binding <= Binding.PARAMETER:
        return b.add(SeriesRule("power", (b.value(base),), (b.constant(exponent),)), node)
    inner = b.graph.product((exponent, b.graph.call("log", base)))
    b.value(inner)
    value = b.reserve(node)
    b.integrate(value, inner, value)
    return value


def _piecewise(b: RecurrenceBuilder, node: Node) -> int:
    """Return the branch of the first condition that holds; conditions are constant along a series."""
    value = b.value(node.args[-1])
    rest = node.args[-1]
    for condition, chosen in list(zip(node.args[:-1:2], node.args[1::2], strict=True))[::-1]:
        if condition.binding > Binding.PARAMETER:
            raise AssertionError("a condition of a series is about sides")
        rest = b.graph.piecewise([(condition, chosen)], rest)
        value = b.add(SeriesRule("choose", (b.value(chosen), value), (b.constant(condition),)), rest)
    return value


def _refuse(_: RecurrenceBuilder, node: Node) -> int:
    raise StatementError(f"{node.data} has no Taylor series: it should have become a side of a surface.")


FUNCTION_RULES: dict[str, FunctionRule] = {
    "sin": _pair(("sin", "cos"), (1, -1)),
    "cos": _pair(("sin", "cos"), (1, -1)),
    "sinh": _pair(("sinh", "cosh"), (1, 1)),
    "cosh": _pair(("sinh", "cosh"), (1, 1)),
    "exp": _exponential,
    "tan": _tangent(1),
    "tanh": _tangent(-1),
    **{one.name: _against(one.slope, one.sign) for one in ELEMENTARY.values() if one.slope is not None},
    "erf": _error_function,
    "atan2": _atan2,
    "pow": _pow,
    "piecewise": _piecewise,
    **dict.fromkeys(("abs", "sign", "min", "max", "less", "less_equal", "equal", "and", "or", "not"), _refuse),
    **dict.fromkeys(("pi", "e", "nan"), _refuse),
}
"""Builder of the series of each function. Switches were replaced by sides before, and constants are never passed."""
