"""Parts of a step program: the laws (functions of the model) that a step evaluates, and actions on numbered vectors."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from lagrange.graph.node import Exact, Kind, Node

Combination = tuple[tuple[int, Node], ...]
"""A linear combination of vectors: pairs (number of the vector, coefficient). State vectors come first, then results of
calls and solves, in order."""


def parts(combination: Combination, h: Node) -> tuple[Combination, tuple[tuple[int, Exact], ...]]:
    """Split a linear combination in two.

    The first part has coefficients of any form. The second has exact numbers as coefficients; its sum is multiplied by
    the step size h.
    """
    plain, scaled = [], []
    for vector, node in combination:
        if node is h:
            scaled.append((vector, 1))
        elif node.kind is Kind.SUM and node.args == (h,) and not node.data[0]:
            scaled.append((vector, node.data[1][0]))
        else:
            plain.append((vector, node))
    return tuple(plain), tuple(scaled)


def in_doubles(number: Exact) -> tuple[float, float]:
    """Return an exact number as a pair of doubles whose sum has about 32 digits."""
    return float(number), float(number - Fraction(float(number)))


@dataclass(frozen=True)
class Law:
    """The function of the model that a step evaluates, such as the right-hand side.

    `states`, `arguments` and `results` count vectors of n numbers: those of the state, the arguments of a call, and its
    results. `quantity` names the model's quantity that a call evaluates; `derivative` names its derivative by the
    arguments. `inputs` is the number of vectors that both quantities read.
    """

    states: int
    arguments: int
    results: int
    quantity: str
    derivative: str = ""
    inputs: int = 2

    @property
    def through_memory(self) -> bool:
        """True if calls pass arrays, for states of any size.

        A law with multipliers has too many numbers for registers.
        """
        return self.inputs > 2

    def dimension(self, numbers: int) -> int:
        """Return the length of a state vector, for a quantity that reads `numbers` numbers."""
        return 2 * numbers // self.inputs


LAWS = {
    "rhs": Law(1, 1, 1, "rhs", "jacobian"),
    "accelerations": Law(2, 1, 1, "rhs"),
    "momentum": Law(2, 2, 2, "momentum", "momentum_jacobian"),
    "constrained": Law(2, 3, 5, "constrained", "constrained_jacobian", 3),
    "local": Law(2, 3, 4, "local", "", 3),
}
"""The laws by name.

`rhs`: y' = f(t, y) with y = [q, v].

`accelerations`: a(t, q), independent of velocities, for methods that advance coordinates and velocities in turn.

`momentum`: p, f = g(t, q, v), with momenta p = dL/dv and forces f, so that dp/dt = f.

`constrained`: p, f, c, phi, psi = g(t, q, v, lambda), with constraint forces c = G^T lambda, the constraints phi and
their rates psi, all padded to n entries (`lagrange.program.constraints`).

`local`: dQ/dt, dV/dt, q, v = g(t, Q, V, start), with a local state (Q, V) about the coordinates `start`
(`lagrange.program.local`).
"""


@dataclass(frozen=True, eq=False)
class LawCall:
    """One evaluation of the law at a time and its arguments. Its results are numbered from `first`."""

    time: Node
    arguments: tuple[Combination, ...]
    first: int

    @property
    def argument(self) -> Combination:
        """The first argument of the call. Only laws with two state vectors have a second one."""
        return self.arguments[0]


@dataclass(frozen=True, eq=False)
class Solve:
    """Unknown vectors, numbered from `first`, that make the residuals zero.

    `calls` are the calls inside the residuals; they may depend on the unknowns but not on each other. `guesses` are the
    start values of Newton's method if no previous steps can be extrapolated; `preparation` are the calls that the
    guesses need. `predicted` extrapolates the unknowns of the previous step, which have the same numbers. Without it,
    steps of equal size are extrapolated by a polynomial.
    """

    first: int
    preparation: tuple[LawCall, ...]
    guesses: tuple[Combination, ...]
    calls: tuple[LawCall, ...]
    residuals: tuple[Combination, ...]
    predicted: tuple[Combination, ...] = ()

    @property
    def count(self) -> int:
        """Number of unknown vectors."""
        return len(self.residuals)

    def reach(self, unknown: int, place: int) -> list[Node]:
        """Return the coefficients of an unknown in the first or second argument (`place` 0 or 1) of all calls."""
        return [
            factor for call in self.calls for vector, factor in call.arguments[place] if vector == self.first + unknown
        ]


@dataclass(frozen=True, eq=False)
class Damp:
    """The vector (I - factor J)^-1 times a combination. J is the Jacobian that the solve numbered `of` used last."""

    result: int
    of: int
    factor: Node
    vector: Combination


Action = LawCall | Solve | Damp
