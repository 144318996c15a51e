"""Parts of a step program: the laws of motion that a step evaluates, and its actions on numbered vectors."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from lagrange.graph.node import Exact, Kind, Node

Combination = tuple[tuple[int, Node], ...]
"""A linear combination of vectors: pairs (number of the vector, coefficient). State vectors come first, then results of
calls and solves, in order."""


def parts(combination: Combination, h: Node) -> tuple[Combination, tuple[tuple[int, Exact], ...]]:
    """Split a combination in two, by the coefficients of its vectors.

    The first part has any coefficients; the second has exact coefficients, and its sum is multiplied by h.
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
    """Return an exact number as the sum of two doubles, to twice the digits of one."""
    return float(number), float(number - Fraction(float(number)))


@dataclass(frozen=True)
class Law:
    """The function that a step evaluates, such as the right-hand side or the momenta and forces.

    `states`, `arguments` and `results` are numbers of vectors: of the state, of the arguments of a call and of its
    results. `quantity` is the name of the model's quantity that a call evaluates, `derivative` that of its derivative
    by the arguments. `inputs` is the number of vectors of n numbers that both read.
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
        """Return the size of a state, if the quantity reads `numbers` numbers."""
        return 2 * numbers // self.inputs


LAWS = {
    "rhs": Law(1, 1, 1, "rhs", "jacobian"),
    "accelerations": Law(2, 1, 1, "rhs"),
    "momentum": Law(2, 2, 2, "momentum", "momentum_jacobian"),
    "constrained": Law(2, 3, 5, "constrained", "constrained_jacobian", 3),
    "local": Law(2, 3, 4, "local", "", 3),
}
"""The laws by name: y' = f(t, y) of y = [q, v]; a(t, q), which must not depend on velocities, for methods that move
coordinates and velocities in turn; p, f = g(t, q, v), the momenta p = dL/dv and the forces f with dp/dt = f; and p, f,
c, phi, psi = g(t, q, v, lambda) with the forces c = G^T lambda of constraints, these themselves and their rates, all
padded to n entries: see `lagrange.program.constraints`; and dQ/dt, dV/dt, q, v = g(t, Q, V, start), the derivatives of
a local state about the coordinates at the start of a step, and the state that it represents: see
`lagrange.program.local`."""


@dataclass(frozen=True, eq=False)
class LawCall:
    """One evaluation of the law at a time and its arguments; `first` is the number of its first result."""

    time: Node
    arguments: tuple[Combination, ...]
    first: int

    @property
    def argument(self) -> Combination:
        """The first argument of the call. Only laws of momenta have a second one."""
        return self.arguments[0]


@dataclass(frozen=True, eq=False)
class Solve:
    """Unknown vectors, numbered from `first`, at which residuals are zero.

    `calls` are those inside the residuals, which may depend on the unknowns but not on each other. `guesses` start
    Newton's method where there is nothing to extrapolate from, and `preparation` are the calls that they need.
    `predicted` continues the unknowns of the step before, which have the same numbers; without it equal steps are
    extrapolated by a polynomial.
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
        """Return the factors with which an unknown enters an argument of the calls."""
        return [
            factor for call in self.calls for vector, factor in call.arguments[place] if vector == self.first + unknown
        ]


@dataclass(frozen=True, eq=False)
class Damp:
    """The vector (I - factor J)^-1 times a combination, where J is the Jacobian that the solve `of` used last."""

    result: int
    of: int
    factor: Node
    vector: Combination


Action = LawCall | Solve | Damp
