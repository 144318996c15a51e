"""Replace abs, sign, min, max and conditions by smooth expressions that hold on one side of each switching surface.

A series is valid on one side of a surface only. The value of a switch depends on the sign of some smooth g(q, v, t).
Each g gets a symbol, its side: 1 where g > 0, -1 where g < 0 and 0 while g stays zero. The sides are constants of the
series: abs(a) is side * a, sign(a) is the side itself, and a condition is a condition on sides. The driver of the
series watches each g, ends a step on its surface, and continues with the other side. In a branch that is not taken, g
counts as 1.

atan2(y, x), into which Mod is rewritten, jumps by 2 pi where y = 0 and x < 0: there y = 0 is a surface. The series is
smooth through the jump; only its value at order 0 depends on the side. At y = 0, y has the sign of the side: -0.0 for
-1.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass

from lagrange.graph.branches import either, may_lack_value, one_elsewhere, read_when
from lagrange.graph.node import Binding, Exact, Graph, Kind, Node, reachable, rebuild
from lagrange.statement.vocabulary.functions import CONDITIONS

SWITCHES = frozenset(("abs", "sign", "min", "max", "less", "less_equal", "equal"))
"""Functions that switch. `and`, `or`, `not` and `piecewise` are not included: they only combine conditions."""


@dataclass(frozen=True, eq=False)
class Switched:
    """Expressions without switches: `smooth` maps the stated nodes to expressions in `sides`.

    A side is a symbol for the sign of one of the switching functions `surfaces`: 1, -1 or 0. `expressions` has the same
    functions as in the statement, with the switches inside them. `stated` has them with the value 1 in all branches in
    which they are not evaluated. `starts` maps each angle that jumps on a surface to its value at order 0, which
    depends on the side of the surface.
    """

    smooth: Mapping[Node, Node]
    surfaces: tuple[Node, ...]
    sides: tuple[Node, ...]
    stated: tuple[Node, ...]
    expressions: tuple[Node, ...]
    starts: Mapping[Node, Node]


def switch(graph: Graph, outputs: Sequence[Node]) -> Switched:
    """Replace every switch that depends on the motion by an expression in the side (the sign) of its surface.

    Switches of parameters alone remain. Steps also end at jumps of an atan2 in an event, which is one of the
    outputs. Its series is smooth through the jump, and would not show zeros after the jump.
    """
    switches = _Switches(graph, read_when(graph, outputs), _with_sides(outputs))
    table: dict[Node, Node] = {}
    switches.smooth(outputs, table)
    conditions = [switches.condition(i) for i in range(len(switches.sides))]
    switches.smooth(conditions, table)
    return Switched(
        smooth={node: table[node] for node in outputs},
        surfaces=tuple(one_elsewhere(g, table[c]) for g, c in zip(switches.surfaces, conditions, strict=True)),
        sides=tuple(switches.sides),
        stated=tuple(one_elsewhere(g, c) for g, c in zip(switches.expressions, conditions, strict=True)),
        expressions=tuple(switches.expressions),
        starts=switches.starts,
    )


class _Switches:
    """Replaces each switch by a smooth expression, and collects the surfaces on which the switches change.

    A surface is the zero set of a node g, and its side is the sign of g. The smooth expressions contain a symbol for
    each side. The nodes g and -g have one surface.
    """

    def __init__(self, graph: Graph, read: Callable[[Node], Node], sided: Container[Node]) -> None:
        self.graph, self.read, self.sided = graph, read, sided
        self.lacking: dict[Node, bool] = {}
        self.surfaces: list[Node] = []
        self.sides: list[Node] = []
        self.expressions: list[Node] = []
        self.conditions: list[Node] = []
        self.known: dict[Node, tuple[int, Node]] = {}
        self.starts: dict[Node, Node] = {}

    def smooth(self, outputs: Sequence[Node], table: dict[Node, Node]) -> None:
        """Add each node on which the outputs depend to `table`, as {node: its expression without switches}."""
        for node in reachable(outputs, excluded=table.keys()):
            args = [table[arg] for arg in node.args]
            if node.kind is Kind.CALL and node.data in SWITCHES and any(a.binding > Binding.PARAMETER for a in args):
                table[node] = self.replace(node, args)
            else:
                table[node] = rebuild(node, args)
                if node in self.sided and _has_cut(table[node]):
                    self.cut(table[node], node)

    def cut(self, angle: Node, stated: Node) -> None:
        """Make y of an `angle` atan2(y, x) a switching surface, so that steps end where the angle jumps.

        At y = 0 the angle is its limit from the present side. `stated` is the angle as in the statement.
        """
        y, x = angle.args
        side = self.side(y, stated.args[0], self.read(stated))
        self.starts[angle] = self.graph.call("atan2", side * self.graph.call("abs", y), x)

    def condition(self, surface: int) -> Node:
        """Return the condition under which the function of switching surface number `surface` has a value.

        The result is the condition of the branch that contains the function, or 1 (true) if the function always has a
        value.
        """
        undefined = may_lack_value(self.expressions[surface], self.lacking)
        return self.conditions[surface] if undefined else self.graph.one

    def side(self, g: Node, stated: Node, when: Node) -> Node:
        """Return the sign of g: a symbol, its negative if the surface -g exists, or the sign of a constant.

        `stated` is g with the switches inside it, and `when` the condition under which g is evaluated.
        """
        if g.binding <= Binding.PARAMETER:
            return self.graph.call("sign", g)
        if g not in self.known:
            index = len(self.sides)
            symbol = self.graph.symbol(f"side {index}", Binding.PARAMETER)
            self.surfaces.append(g)
            self.sides.append(symbol)
            self.expressions.append(stated)
            self.conditions.append(when)
            self.known[g] = index, symbol
            self.known[-g] = index, -symbol
        index, side = self.known[g]
        self.conditions[index] = either(self.conditions[index], when)
        return side

    def replace(self, node: Node, args: Sequence[Node]) -> Node:
        """Return the smooth form of the switch `node`: an expression in the side (the sign) of its surface.

        `args` are its arguments in smooth form.
        """
        graph, name, when = self.graph, node.data, self.read(node)
        if name in ("abs", "sign"):
            side = self.side(args[0], node.args[0], when)
            return side if name == "sign" else side * args[0]
        side = self.side(args[0] - args[1], node.args[0] - node.args[1], when)
        if name in CONDITIONS:
            return graph.call(name, side, graph.zero)
        first, second = args if name == "min" else args[::-1]
        return graph.piecewise([(graph.call("less_equal", side, graph.zero), first)], second)


def _with_sides(outputs: Sequence[Node]) -> Mapping[Node, None]:
    """Return the nodes of the outputs at whose jumps a step must end.

    The angle in sin(3*atan2(y, x)) is left out if it is used nowhere else: it may jump by 2 pi.
    """
    nodes: dict[Node, None] = {}
    waiting = [*outputs]
    while waiting:
        node = waiting.pop()
        if node not in nodes:
            nodes[node] = None
            is_periodic = node.kind is Kind.CALL and node.data in ("sin", "cos", "tan")
            for arg in node.args:
                waiting += _without_turns(arg) if is_periodic else [arg]
    return nodes


def _without_turns(a: Node) -> list[Node]:
    """Return the terms of an argument of a periodic function, including those of nested sums.

    A whole multiple of an angle atan2(y, x) is replaced by y and x, because the function ignores jumps by 2 pi.
    """
    nodes: list[Node] = []
    terms: list[tuple[Exact, Node]] = [(1, a)]
    while terms:
        times, term = terms.pop()
        if term.kind is Kind.SUM:
            terms += [(times * inner, arg) for inner, arg in zip(term.data[1], term.args, strict=True)]
        else:
            whole = isinstance(times, int) and term.kind is Kind.CALL and term.data == "atan2"
            nodes += term.args if whole else [term]
    return nodes


def _has_cut(node: Node) -> bool:
    """Return True for an atan2(y, x) that may jump along the motion: x is not known to be positive."""
    if node.kind is not Kind.CALL or node.data != "atan2":
        return False
    y, x = node.args
    return y.binding > Binding.PARAMETER and not (x.kind is Kind.CONSTANT and x.data > 0)
