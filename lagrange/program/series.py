"""Series programs: the Taylor coefficients of a motion, order by order, as data that can be printed and checked.

Write x[k] for the k-th normalised Taylor coefficient of x(t). From dp/dt = f and dq/dt = v follow

    q[k] = v[k-1] / k                M0 v[k] = f[k-1] / k - p^[k]

where p^[k] is the coefficient of p computed with v[k] = 0, and M0 the mass matrix at the start. Every value between q,
v and p, f has a rule. The rule gives the coefficient of order k from coefficients of lower order and from the
arguments' coefficients of order k; `RULES` lists the rules. Order 0 is an ordinary program, `start`.

For every k from 1 to the highest order a machine

  1. computes q[k], and the values of the list `before`, which do not depend on an unknown of order k;
  2. for each stage, of which the velocities are the first: computes the values of its list `trials` with unknowns of
     zero, hence p^[k]; solves for the unknowns; then computes the values of its list `found`, hence f[k].

With a constant mass matrix M there is no p^: the rate of change of p - M v is counted among the forces.

Source: A. Jorba, M. Zou, Experimental Mathematics 14 (2005) 99-117, for the recurrences; the step through the mass
matrix of order 0 is that of implicit equations, J. D. Pryce, Numerical Algorithms 19 (1998) 195-211.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from lagrange.equations.solve_plan import SolvePlan
from lagrange.program.program import Program

LARGEST_POWER = 64
"""Largest whole exponent of a power that becomes products, which are also valid at zero. For larger exponents the rule
of powers is shorter.
"""

RULES: dict[str, tuple[int | None, int | None, str]] = {
    "coordinate": (0, 1, "q{0}[k] = v{0}[k-1] / k"),
    "unknown": (0, 1, "x{0}[k], from the solve of its stage"),
    "time": (0, 0, "1 at k = 1, else 0"),
    "constant": (0, 0, "0"),
    "linear": (None, None, "sum of c x[k]"),
    "mul": (2, 0, "sum of a[j] b[k-j]"),
    "square": (1, 0, "sum of a[j] a[k-j]"),
    "div": (2, 0, "(a[k] - sum over j > 0 of b[j] u[k-j]) / b[0]"),
    "inverse": (1, 0, "-sum over j > 0 of b[j] u[k-j] / b[0]"),
    "sqrt": (1, 0, "(a[k] - sum over 0 < j < k of u[j] u[k-j]) / 2 u[0]"),
    "power": (1, 1, "sum over j > 0 of (e j - (k-j)) a[j] u[k-j] / k a[0]"),
    "integral": (1, 1, "c w[k-1] / k"),
    "along": (2, 1, "c sum over j > 0 of j a[j] w[k-j] / k"),
    "against": (2, 0, "(a[k] - sum over 0 < j < k of j u[j] w[k-j] / k) / w[0]"),
    "choose": (2, 1, "a[k] if c else b[k]"),
}
"""Every rule: number of arguments, of coefficients (None: any number, or one for each argument), and formula of u[k].

`along` is du = c w da, and `against` is w du = da. The second argument of `along` and that of `integral` are read at
orders below k only, so that these values may come later in the list.
"""

LAGGED = {"integral": 0, "along": 1}
"""For each rule, the index of the argument that is not read at order k, only at lower orders and at order 0."""


OWN = -1
"""Argument number in a rule for the value that the rule computes."""


class Factor(NamedTuple):
    """One factor x in the sum of x[j] y[k-j] over orders 0 < j < k that a rule reads at order k.

    `argument` is the position of x among the arguments of the rule, or `OWN` for the computed value itself. If
    `ranked`, x[j] is multiplied by j.
    """

    argument: int
    ranked: bool = False


_FIRST, _SECOND, _ITSELF = Factor(0), Factor(1), Factor(OWN)

SUMS: dict[str, tuple[tuple[Factor, Factor], ...]] = {
    "mul": ((_FIRST, _SECOND),),
    "square": ((_FIRST, _FIRST),),
    "div": ((_SECOND, _ITSELF),),
    "inverse": ((_FIRST, _ITSELF),),
    "sqrt": ((_ITSELF, _ITSELF),),
    "power": ((Factor(0, ranked=True), _ITSELF), (_FIRST, _ITSELF)),
    "along": ((Factor(0, ranked=True), _SECOND),),
    "against": ((Factor(OWN, ranked=True), _SECOND),),
}
"""For each operation of a rule, the factors (x, y) of the sums of x[j] y[k-j] over 0 < j < k that it reads."""


class SeriesRule(NamedTuple):
    """Recurrence of one value's Taylor coefficients: operation, arguments, and indices in the table of constants.

    `args` are the indices of the argument values. If the operation is "unknown", `coefficients` has the index of the
    unknown among all unknowns instead of indices of constants.
    """

    op: str
    args: tuple[int, ...] = ()
    coefficients: tuple[int, ...] = ()


@dataclass(frozen=True)
class Stage:
    """The linear system A x[k] = right[k-1] / k - left[k] of each order k, with left[k] computed for x[k] = 0.

    `unknowns`, `left` and `right` have the index of a value for each equation; None is zero. For velocities, `left`
    are the momenta up to a constant, and `right` the forces. `plan` describes the structure and the solution of A,
    the matrix of order 0.
    """

    unknowns: tuple[int, ...]
    left: tuple[int | None, ...]
    right: tuple[int | None, ...]
    plan: SolvePlan


@dataclass(frozen=True)
class SeriesProgram:
    """Taylor series of a motion of `dimension` coordinates: rules for all orders, and programs for order 0.

    `rules` has the rule of each series value; other fields name values by their index. Rules read a table of
    constants, which the program `constants` computes. `numbers` has each constant that is a number, and None for each
    that depends on parameters.

    The program `start` computes the values `started` at order 0, then the lower triangles of the matrices of the
    `stages`; `constants` computes matrices that are constant. Both programs take the parameters, then the sides,
    which are the signs of the results of `surfaces`, the switching functions (`lagrange.program.switching`). `start`
    also takes the table. Its state is [q, v] and the rounding errors of q and v.

    `rates` are the values of dq/dt; `watched` are the values of the surfaces and events. `values` computes the
    watched values from a state, the parameters and the sides. `projection` computes the corrections of a state onto
    the constraints.
    """

    name: str
    dimension: int
    sides: int
    surfaces: Program
    constants: Program
    numbers: tuple[float | None, ...]
    rules: tuple[SeriesRule, ...]
    start: Program
    started: tuple[int, ...]
    rates: tuple[int, ...]
    stages: tuple[Stage, ...]
    watched: tuple[int | None, ...]
    values: Program
    projection: Program | None = None

    @property
    def states(self) -> int:
        """Length of a state: coordinates and velocities."""
        return len(self.rates) + self.dimension

    @cached_property
    def depth(self) -> tuple[int, ...]:
        """For each value, the number of stages (linear systems) that are solved at each order before it is known."""
        solved = {unknown: number for number, stage in enumerate(self.stages, 1) for unknown in stage.unknowns}
        depths: list[int] = []
        for i in range(len(self.rules)):
            depths.append(solved.get(i, max((depths[arg] for arg in self.direct(i)), default=0)))
        return tuple(depths)

    def direct(self, i: int) -> tuple[int, ...]:
        """Return the arguments of value number i that its rule reads at the same order.

        To compute the coefficient of order k of the value, the rule reads their coefficients of order k. An argument
        that is read at order k - 1 only is left out.
        """
        op, args, _ = self.rules[i]
        return tuple(arg for position, arg in enumerate(args) if LAGGED.get(op) != position)

    @cached_property
    def before(self) -> tuple[int, ...]:
        """Indices of the series values to compute at each order before any linear system is solved, in order."""
        return tuple(i for i in self._needed(self._outputs(left=True)) if not self.depth[i])

    @cached_property
    def trials(self) -> tuple[tuple[int, ...], ...]:
        """For each stage, indices of the series values to compute before its linear system is solved, in order.

        The system's unknowns count as zero in them, because its right-hand side is computed from them.
        """
        sides = ([value for value in stage.left if value is not None] for stage in self.stages)
        return tuple(self._at(self._needed(values), solved) for solved, values in enumerate(sides, 1))

    @cached_property
    def found(self) -> tuple[tuple[int, ...], ...]:
        """For each stage, indices of the series values to compute after its linear system is solved, in order.

        They are read at the same order or a later one.
        """
        needed = self._needed(self._outputs(left=len(self.stages) > 1))
        return tuple(self._at(needed, solved) for solved in range(1, len(self.stages) + 1))

    def _at(self, values: Sequence[int], solved: int) -> tuple[int, ...]:
        """Return the series values, among the indices `values`, that are first known after `solved` linear systems.

        Unknowns of linear systems are left out.
        """
        return tuple(i for i in values if self.depth[i] == solved and self.rules[i].op != "unknown")

    def _outputs(self, *, left: bool) -> list[int]:
        """Return the indices of dq/dt, watched functions, and all values that linear systems or later orders read.

        With `left` the result includes the momenta, which are the left sides of the linear systems.
        """
        named = [value for stage in self.stages for value in (*(stage.left if left else ()), *stage.right)]
        kept = kept_values(self.rules) | kept_values(self.rules, ranked=True) | lagged_values(self.rules)
        return [value for value in (*named, *self.watched, *self.rates, *sorted(kept)) if value is not None]

    @cached_property
    def watched_degree(self) -> int:
        """Highest power of the state in any watched value. Watched values are switching functions and event functions.

        A series of lower order may lack the term of this power.
        """
        degrees: list[int] = []
        for op, args, _ in self.rules:
            powers = [degrees[arg] if arg < len(degrees) else 0 for arg in args]
            if op == "mul":
                degrees.append(sum(powers))
            elif op == "square":
                degrees.append(2 * powers[0])
            else:
                degrees.append(LARGEST_POWER if op == "power" else max(powers, default=1))
        return max((degrees[value] for value in self.watched if value is not None), default=0)

    @cached_property
    def hides_growth(self) -> bool:
        """True if the series contain exp, tanh, sinh or cosh.

        The series of these functions may begin far below other series and exceed them later.
        """
        return any(instruction.op in ("exp", "tanh", "sinh", "cosh") for instruction in self.start.instructions)

    @cached_property
    def may_cross(self) -> bool:
        """True if the radius of convergence must not limit steps: for constraints without exp, tanh, sinh or cosh.

        Two motions of a constrained system may cross at a configuration. Near it rounding errors of the constraints
        make the coefficients grow as if the radius were the time to the crossing. Steps within this radius would
        never pass it.
        """
        return any(stage.plan.multipliers for stage in self.stages) and not self.hides_growth

    def _needed(self, outputs: list[int]) -> list[int]:
        """Return the indices `outputs`, and the indices of all values that they read at the same order.

        All are indices of series values, in the order of computation.
        """
        marked = set(outputs)
        for i in range(len(self.rules) - 1, -1, -1):
            if i in marked:
                marked.update(self.direct(i))
        return sorted(marked)


def convolutions(rules: Sequence[SeriesRule]) -> int:
    """Return the cost of one order of the series: twice the number of sums over lower orders.

    The sum of a square counts half, because its terms occur in pairs.
    """
    return sum(1 if a == b else 2 for rule in rules for a, b in SUMS.get(rule.op, ()))


def kept_values(rules: Sequence[SeriesRule], *, ranked: bool = False) -> frozenset[int]:
    """Return the indices of the series values whose coefficients of lower orders some rule reads.

    If `ranked`, these are the values whose coefficients x[j] are read multiplied by the order j.
    """
    return frozenset(
        i if factor.argument == OWN else rule.args[factor.argument]
        for i, rule in enumerate(rules)
        for factors in SUMS.get(rule.op, ())
        for factor in factors
        if factor.ranked == ranked
    )


def integrated(rules: Sequence[SeriesRule], rates: Sequence[int]) -> tuple[int, ...]:
    """Return the indices, among `rates` (the series values of dq/dt), of values that a rule computes.

    The other values are unknowns of a linear system.
    """
    return tuple(rate for rate in rates if rules[rate].op != "unknown")


def lagged_values(rules: Sequence[SeriesRule]) -> frozenset[int]:
    """Return the indices of the integrands of integrals: a rule of order k reads them at order k - 1 only."""
    return frozenset(rule.args[0] for rule in rules if rule.op == "integral")
