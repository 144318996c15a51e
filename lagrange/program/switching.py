"""Switching surfaces: abs, sign, min, max and conditions made smooth by saying on which side of each surface it is.

A series holds on one side of a surface only. Every switch is a question about the sign of some smooth g(q, v, t);
here each g gets a symbol, its side, that is 1 where g > 0, -1 where g < 0 and 0 while g stays zero. With the sides
as run-time constants abs(a) is side * a, sign(a) is the side itself and a condition is one about sides. Who runs the
series watches each g, ends a step on its surface, and goes on with the other side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lagrange.graph.functions import CONDITIONS
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.graph.rebuild import rebuild

SWITCHES = frozenset(("abs", "sign", "min", "max", "less", "less_equal", "equal"))
"""The functions that switch; `and`, `or`, `not` and `piecewise` only pass on what conditions say."""


@dataclass(frozen=True, eq=False)
class Switched:
    """Expressions made smooth: `outputs` in terms of `sides`, one symbol for each of the `surfaces`."""

    outputs: tuple[Node, ...]
    surfaces: tuple[Node, ...]
    sides: tuple[Node, ...]


def switch(graph: Graph, outputs: Sequence[Node]) -> Switched:
    """Replace every switch that moves by its side; what depends on parameters alone stays as it is."""
    switches = _Switches(graph)
    table: dict[Node, Node] = {}
    for node in reachable(outputs):
        args = [table[arg] for arg in node.args]
        if node.kind is Kind.CALL and node.data in SWITCHES and any(a.binding > Binding.PARAMETER for a in args):
            table[node] = switches.replace(node.data, args)
        else:
            table[node] = rebuild(node, args)
    return Switched(tuple(table[node] for node in outputs), tuple(switches.surfaces), tuple(switches.sides))


class _Switches:
    """The surfaces found so far; a surface and its negative are one."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.surfaces: list[Node] = []
        self.sides: list[Node] = []
        self.known: dict[Node, Node] = {}

    def side(self, g: Node) -> Node:
        """Return the side of g > 0: a symbol, its negative if -g is known, or the sign of a constant."""
        if g.binding <= Binding.PARAMETER:
            return self.graph.call("sign", g)
        if g not in self.known:
            symbol = self.graph.symbol(f"side {len(self.sides)}", Binding.PARAMETER)
            self.surfaces.append(g)
            self.sides.append(symbol)
            self.known[g] = symbol
            self.known[-g] = -symbol
        return self.known[g]

    def replace(self, name: str, args: Sequence[Node]) -> Node:
        """Return a switch in terms of sides."""
        graph = self.graph
        if name in ("abs", "sign"):
            side = self.side(args[0])
            return side if name == "sign" else side * args[0]
        side = self.side(args[0] - args[1])
        if name in CONDITIONS:
            return graph.call(name, side, graph.zero)
        first, second = args if name == "min" else args[::-1]
        return graph.piecewise([(graph.call("less_equal", side, graph.zero), first)], second)
