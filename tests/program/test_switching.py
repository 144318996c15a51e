"""Switches become sides of surfaces: none is left, and with the right sides the values are the same."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.program.lower import lower
from lagrange.program.switching import SWITCHES, Switched, switch

GRAPH = Graph()
x, y = (GRAPH.symbol(name, Binding.CONFIGURATION) for name in "xy")
v, w = (GRAPH.symbol(name, Binding.VELOCITY) for name in "vw")
t, c = GRAPH.symbol("t", Binding.TIME), GRAPH.symbol("c", Binding.PARAMETER)
STATES = [*itertools.product((-0.5, 0.25, 1.0), (-0.5, 1.0), (-1.0, 0.0), (2.0,), (-1.0, 1.5), (-0.5, 2.0))]
"""Values of x, y, v, w, t and c."""


def call(name: str, *args: Any) -> Node:
    return GRAPH.call(name, *(GRAPH.node(arg) for arg in args))


def piecewise(condition: Node, value: Node, otherwise: Node) -> Node:
    return GRAPH.piecewise([(condition, value)], otherwise)


def values(nodes: list[Node], state: Any, sides: list[Node], signs: list[float]) -> list[float]:
    """Return the values of nodes at x, y, v, w, t, c and the signs of surfaces."""
    program = lower("values", {"out": nodes}, {"y": (x, y, v, w)}, t, (c, *sides))
    with np.errstate(invalid="ignore"):  # of branches that are not taken
        return [float(value) for value in FLOATS.evaluate(program, state[4], state[:4], [state[5], *signs])]


def switches(node: Node) -> bool:
    """Return True if a node is a switch that does not depend on parameters and sides alone."""
    return node.kind is Kind.CALL and node.data in SWITCHES and any(a.binding > Binding.PARAMETER for a in node.args)


def same_without_switches(node: Node, surfaces: int) -> Switched:
    """Return the smooth form of a node, after a check that both are equal at all states."""
    result = switch(GRAPH, [node])
    assert len(result.surfaces) == len(result.sides) == surfaces
    assert not any(map(switches, reachable([result.smooth[node]])))
    for state in STATES:
        signs = [0.0] * surfaces
        for i, surface in enumerate(result.surfaces):  # a surface depends on those before it
            signs[i] = float(sp.sign(values([surface], state, list(result.sides), signs)[0]))
        assert values([result.smooth[node]], state, list(result.sides), signs) == values([node], state, [], []), state
    return result


def first_or_second_branch() -> Node:
    """Return an expression with log(x) in two branches, which both have x > 0."""
    positive, slope = call("less", 0, x), call("log", x)
    high = call("and", positive, call("less", 0, y))
    return piecewise(high, call("abs", slope), piecewise(positive, call("sign", slope), v))


def both_sides(name: str) -> Node:
    """Return two expressions with a condition: on a coordinate, and on a parameter and a coordinate."""
    return piecewise(call(name, x, y), v, w) + piecewise(call(name, c, y), v, t)


EXPRESSIONS: dict[str, tuple[Callable[[], Node], int]] = {
    **{f"{name}(x)": (partial(call, name, x), 1) for name in ("abs", "sign")},
    **{f"{name} of both": (partial(call, name, x, y), 1) for name in ("min", "max")},
    **{f"{name} of a parameter": (partial(call, name, x, c), 1) for name in ("min", "max")},
    **{name: (partial(both_sides, name), 2) for name in ("less", "less_equal", "equal")},
    "and": (lambda: piecewise(call("and", call("less", x, 0), call("less_equal", y, c)), v, t), 2),
    "or not": (lambda: piecewise(call("or", call("less", x, 0), call("not", call("less_equal", y, c))), v, t), 2),
    "a switch inside a switch": (lambda: call("max", call("abs", x - y), call("min", x, v)), 3),
    "a magnitude of a magnitude": (lambda: call("abs", call("abs", x - y) - c), 2),
    "a condition on magnitudes": (
        lambda: piecewise(call("less", call("abs", x - y), call("abs", v)), call("abs", x - y), call("abs", v)),
        3,
    ),
    "a function and its negative": (lambda: call("abs", x) * call("sign", -x), 1),
    "a difference and its negative": (lambda: call("sign", x - y) * call("abs", y - x), 1),
    "both orders": (lambda: piecewise(call("less", x, y), v, w) + piecewise(call("less", y, x), w, t), 1),
    "both extremes": (lambda: call("min", x, y) + 2 * call("max", x, y), 1),
    "a function in two branches": (first_or_second_branch, 3),
    "an angle and its sign": (lambda: call("atan2", y, x) + call("sign", call("atan2", y, x)), 2),
    "an angle to the right": (lambda: call("atan2", y, 2), 0),
    "an angle to the left": (lambda: call("atan2", y, -2), 1),
    "an angle of a fixed height": (lambda: call("atan2", c, x), 0),
}
"""An expression, and the number of its surfaces."""


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_each_switch_is_a_side(name: str) -> None:
    expression, surfaces = EXPRESSIONS[name]
    same_without_switches(expression(), surfaces)


def test_an_angle_on_its_cut_has_the_limit_from_the_side() -> None:
    result = switch(GRAPH, [call("atan2", y, x)])
    (start,) = result.starts.values()
    for height, (side, limit) in itertools.product((1e-17, -1e-17, 0.0), ((1.0, math.pi), (-1.0, -math.pi))):
        assert values([start], [-1.0, height, 0, 0, 0, 1], list(result.sides), [side]) == [limit]


def test_the_angle_of_an_event_has_a_surface() -> None:
    """The angle in an event has the surface of the same angle in the equations; a switch adds one for its sign."""
    angle = call("atan2", y, x)
    assert switch(GRAPH, [v, angle - 3]).surfaces == (y,)
    assert len(switch(GRAPH, [v + angle, angle - 3]).surfaces) == 1
    assert len(switch(GRAPH, [v, call("abs", angle) - 3]).surfaces) == 2


def test_a_whole_turn_within_a_period_needs_no_surface() -> None:
    """cos(3 a) is smooth at a jump of a by 2 pi; cos(a / 2), cos(c a) and a sum with the angle are not."""
    angle = call("atan2", y, x)
    for name, smooth in itertools.product(("sin", "cos", "tan"), (3 * angle, t - 2 * angle + 1)):
        assert not switch(GRAPH, [call(name, smooth) * v]).surfaces
    for jumping in (angle / 2, (angle + t) / 2, angle * c, angle**2, call("abs", angle)):
        assert switch(GRAPH, [call("cos", jumping)]).surfaces[0] is y
    assert len(switch(GRAPH, [call("sin", 3 * angle) * angle]).surfaces) == 1
