"""Switches become sides of surfaces: none is left, and with the right sides the values are the same."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
import sympy as sp

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.program.lower import lower
from lagrange.program.switching import SWITCHES, Switched, switch
from lagrange.program.taylor import series_program
from tests.models import k, laws, m, stated, x, y


class Place:
    """A graph with two coordinates, a velocity, time and a parameter, and expressions on them."""

    def __init__(self) -> None:
        self.graph = Graph()
        self.x, self.y = (self.graph.symbol(name, Binding.CONFIGURATION) for name in "xy")
        self.v, self.w = (self.graph.symbol(name, Binding.VELOCITY) for name in "vw")
        self.t = self.graph.symbol("t", Binding.TIME)
        self.c = self.graph.symbol("c", Binding.PARAMETER)

    def call(self, name: str, *args: Any) -> Node:
        return self.graph.call(name, *(self.graph.node(arg) for arg in args))

    def values(self, nodes: list[Node], state: Any, sides: list[Node], at: list[float]) -> list[float]:
        """Return the nodes' values at x, y, v, w, t, c and the sides."""
        program = lower("values", {"out": nodes}, {"y": (self.x, self.y, self.v, self.w)}, self.t, (self.c, *sides))
        return [float(value) for value in FLOATS.evaluate(program, state[4], state[:4], [state[5], *at])]

    def check(self, node: Node, surfaces: int) -> Switched:
        """Hold a node against its smooth form on all sides, on every combination of some values."""
        found = switch(self.graph, [node])
        assert len(found.surfaces) == len(found.sides) == surfaces
        assert all(side.binding is Binding.PARAMETER for side in found.sides)
        assert not [n for n in reachable(found.outputs) if moving_switch(n)]
        for state in itertools.product((-0.5, 0.25, 1.0), (-0.5, 1.0), (-1.0, 0.0), (2.0,), (-1.0, 1.5), (-0.5, 2.0)):
            at: list[float] = [0.0] * surfaces
            for i, surface in enumerate(found.surfaces):  # a surface knows only of those before it
                at[i] = float(sp.sign(self.values([surface], state, list(found.sides), at)[0]))
            smooth = self.values(list(found.outputs), state, list(found.sides), at)
            assert smooth == self.values([node], state, [], []), state
        return found


def moving_switch(node: Node) -> bool:
    """Whether a node switches by what is not a parameter; conditions about sides may stay."""
    return node.kind is Kind.CALL and node.data in SWITCHES and any(a.binding > Binding.PARAMETER for a in node.args)


def test_each_switch_is_a_side() -> None:
    p = Place()
    for name in ("abs", "sign"):
        p.check(p.call(name, p.x), 1)
    for name in ("min", "max"):
        p.check(p.call(name, p.x, p.y), 1)
        p.check(p.call(name, p.x, p.c), 1)
    for name in ("less", "less_equal", "equal"):
        p.check(p.graph.piecewise([(p.call(name, p.x, p.y), p.v)], p.w), 1)
        p.check(p.graph.piecewise([(p.call(name, p.c, p.y), p.v)], p.t), 1)


def test_conditions_that_are_joined() -> None:
    p = Place()
    first, second = p.call("less", p.x, 0), p.call("less_equal", p.y, p.c)
    for condition in (p.call("and", first, second), p.call("or", first, p.call("not", second))):
        p.check(p.graph.piecewise([(condition, p.v), (first, p.x * p.y)], p.t), 2)


def test_switches_inside_switches() -> None:
    p = Place()
    inner = p.call("abs", p.x - p.y)
    p.check(p.call("max", inner, p.call("min", p.x, p.v)), 3)
    p.check(p.call("abs", inner - p.c), 2)
    p.check(p.call("sign", p.graph.piecewise([(p.call("less", p.x, p.t), inner)], -p.v)) * inner, 3)
    p.check(p.graph.piecewise([(p.call("less", inner, p.call("abs", p.v)), inner)], p.call("abs", p.v)), 3)


def test_a_surface_and_its_negative_are_one() -> None:
    p = Place()
    p.check(p.call("abs", p.x) * p.call("sign", -p.x), 1)
    p.check(p.call("min", p.x, p.y) + 2 * p.call("max", p.x, p.y), 1)
    p.check(p.call("sign", p.x - p.y) * p.call("abs", p.y - p.x), 1)
    p.check(p.graph.piecewise([(p.call("less", p.x, p.y), p.v)], p.call("max", p.y, p.x)), 1)


def test_the_cut_of_an_angle_is_a_surface() -> None:
    """At order 0 on y = 0 it has the limit from the side; an x that is a positive number has no cut."""
    p = Place()
    angle = p.call("atan2", p.y, p.x)
    found = p.check(angle + p.call("sign", angle), 2)
    assert found.expressions[0] is p.y
    (start,) = (found.starts[node] for node in found.starts)
    for state in ([-1.0, 1e-17, 0, 0, 0, 1], [-1.0, -1e-17, 0, 0, 0, 1], [-1.0, 0.0, 0, 0, 0, 1]):
        for side, limit in ((1.0, math.pi), (-1.0, -math.pi), (0.0, math.pi)):
            assert p.values([start], state, list(found.sides), [side, 0.0]) == [limit]
    p.check(p.call("atan2", p.y, 2), 0)
    p.check(p.call("atan2", p.y, -2), 1)
    p.check(p.call("atan2", p.c, p.x), 0)


def test_the_angle_of_an_event_has_no_surface() -> None:
    """Unless the equations have it too, or a switch asks for its sign."""
    p = Place()
    angle = p.call("atan2", p.y, p.x)
    assert not switch(p.graph, [p.v], [angle - 3]).surfaces
    assert len(switch(p.graph, [p.v + angle], [angle - 3]).surfaces) == 1
    assert len(switch(p.graph, [p.v], [p.call("abs", angle) - 3]).surfaces) == 2


def test_a_whole_turn_within_a_period_needs_no_surface() -> None:
    """cos(3 a) is smooth where a jumps by 2 pi; cos(a / 2), cos(c a) and an angle beside it are not."""
    p = Place()
    angle = p.call("atan2", p.y, p.x)
    for name, smooth in itertools.product(("sin", "cos", "tan"), (3 * angle, angle, p.t - 2 * angle + 1, -angle)):
        assert not switch(p.graph, [p.call(name, smooth) * p.v]).surfaces
    for jumping in (angle / 2, angle * p.c, angle * p.v, angle**2, p.call("abs", angle)):
        assert switch(p.graph, [p.call("cos", jumping)]).surfaces[0] is p.y
    assert len(switch(p.graph, [p.call("sin", 3 * angle) * angle]).surfaces) == 1
    inner = p.call("atan2", p.call("atan2", p.y, p.x), p.x)
    assert len(switch(p.graph, [p.call("cos", inner)]).surfaces) == 1


def test_what_depends_on_parameters_alone_stays() -> None:
    p = Place()
    node = p.call("abs", p.c) * p.x + p.graph.piecewise([(p.call("less", p.c, 0), p.v)], p.w)
    assert p.check(node, 0).outputs == (node,)


def test_the_right_side_of_a_surface_is_zero_on_it() -> None:
    p = Place()
    found = switch(p.graph, [p.call("abs", p.x), p.call("sign", p.x), p.call("min", p.x, 0)])
    assert p.values(list(found.outputs), [0.0, 0, 0, 0, 0, 1], list(found.sides), [0.0]) == [0.0, 0.0, 0.0]


def test_the_surfaces_of_a_system_are_found_once() -> None:
    """Forces, momenta and masses share the sides: friction, a wall, a cubic spring, and a pulse with two ends."""
    program, switched = series_program(laws("friction"))
    shown = sorted(str(laws("friction").express(surface)) for surface in switched.surfaces)
    assert shown == ["1 - t", "1 - y(t)", "Derivative(x(t), t)", "t - 2", "y(t)"] and program.sides == 5


@pytest.mark.parametrize("inertia", [1 + sp.Abs(x), sp.Piecewise((2, x < 0), (1, True))])
def test_a_mass_matrix_that_switches(inertia: Any) -> None:
    statement = stated(kinetic=m * inertia * x.dot**2 / 2 + y.dot**2 / 2, potential=k * x * y, coordinates=[x, y])
    program, switched = series_program(euler_lagrange(statement))
    assert program.sides == 1 and len(switched.surfaces) == 1
    assert program.stages[0].plan.moving != isinstance(inertia, sp.Piecewise)
