"""Series programs: the Taylor coefficients of a motion, order by order, as a record that can be printed and checked.

Write x[k] for the k-th normalised Taylor coefficient of x(t). From dp/dt = f and dq/dt = v follow

    q[k] = v[k-1] / k                M0 v[k] = f[k-1] / k - p^[k]

where p^[k] is the coefficient of p computed with v[k] = 0, and M0 the mass matrix at the start. Every value between
q, v and p, f has a rule that gives its coefficient of order k from those of lower order and from its arguments'
coefficients of order k; the rules are listed in `RULES`. Order 0 is an ordinary program, `start`.

For every k from 1 to the order wanted a machine

  1. finds q[k], and the values of the `configuration` list, which need no velocity of order k;
  2. finds the values of the `trial` list with v[k] = 0, hence p^[k], and solves for v[k] (a constant mass matrix
     needs no p^: the rate of what p has beside M v is counted among the forces);
  3. finds the values of the `velocity` list, hence f[k].

Source: A. Jorba, M. Zou, Experimental Mathematics 14 (2005) 99-117, for the recurrences; the step through the mass
matrix of order 0 is that of implicit equations, J. D. Pryce, Numerical Algorithms 19 (1998) 195-211.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from lagrange.errors import LagrangeError
from lagrange.program.program import Program

RULES: dict[str, tuple[int | None, int | None, str]] = {
    "coordinate": (0, 1, "q{0}[k] = v{0}[k-1] / k"),
    "velocity": (0, 1, "v{0}[k], from the mass matrix"),
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
"""Every rule: number of arguments, number of coefficients (None: any; as many as arguments), and u[k] in words.

`along` is du = c w da, and `against` is w du = da; the second argument of `along` and that of `integral` are read at
orders below k only, so that they may stand later in the list.
"""

LAGGED = {"integral": 0, "along": 1}
"""Which argument of a rule is read below order k only (beside its order 0)."""


class Rule(NamedTuple):
    """How one value's coefficients follow; `coefficients` are places in the table of constants, or a coordinate."""

    op: str
    args: tuple[int, ...] = ()
    coefficients: tuple[int, ...] = ()


@dataclass(frozen=True)
class SeriesProgram:
    """The series of a motion of n coordinates.

    `constants` gives the table of coefficients; `numbers` has the value of each that is known now, else None. `start`
    gives, for `started`, the values of order 0. The lower triangles of the mass matrix, block by block, follow behind
    the one or, if it is constant, the other. Both take the parameters, then the `sides` of the switching surfaces (see
    `lagrange.program.switching`), which have the signs of what `surfaces` gives; `start` takes the table as well, and
    its state is [q, v] and what rounding lost of it. `momenta` and `forces` say which values are p, up to a constant,
    and f (None: zero); `watched` those of the surfaces and events.
    """

    name: str
    dimension: int
    sides: int
    surfaces: Program
    constants: Program
    numbers: tuple[float | None, ...]
    rules: tuple[Rule, ...]
    start: Program
    started: tuple[int, ...]
    momenta: tuple[int | None, ...]
    forces: tuple[int | None, ...]
    watched: tuple[int | None, ...]
    blocks: tuple[tuple[int, ...], ...]
    constant_mass: bool

    def __post_init__(self) -> None:
        for problem in _problems(self):
            raise LagrangeError(f"series program {self.name} is malformed: {problem}")

    @property
    def diagonal(self) -> bool:
        """Whether the mass matrix is diagonal."""
        return len(self.blocks) == self.dimension

    @cached_property
    def moving(self) -> frozenset[int]:
        """The values whose coefficient of order k depends on v[k]."""
        found: set[int] = set()
        for i, rule in enumerate(self.rules):
            if rule.op == "velocity" or any(arg in found for arg in self.direct(i)):
                found.add(i)
        return frozenset(found)

    def direct(self, i: int) -> tuple[int, ...]:
        """Return the arguments of a value that are read at order k itself."""
        op, args, _ = self.rules[i]
        return tuple(arg for place, arg in enumerate(args) if LAGGED.get(op) != place)

    @cached_property
    def configuration(self) -> tuple[int, ...]:
        """The values to find before v[k] is known, in order."""
        return tuple(i for i in self._all_needed if i not in self.moving)

    @cached_property
    def trial(self) -> tuple[int, ...]:
        """The values to find with v[k] = 0 for the sake of p^[k], in order; the velocities are not among them."""
        if self.constant_mass:
            return ()
        needed = self._needed([p for p in self.momenta if p is not None])
        return tuple(i for i in needed if i in self.moving and self.rules[i].op != "velocity")

    @cached_property
    def velocity(self) -> tuple[int, ...]:
        """The values to find once v[k] is known, in order: all that f or a later order needs, and what is watched."""
        wanted = [value for value in (*self.forces, *self.watched) if value is not None]
        needed = self._needed([*wanted, *sorted(self.kept | self.ranked | self.lagged)])
        return tuple(i for i in needed if i in self.moving and self.rules[i].op != "velocity")

    @cached_property
    def kept(self) -> frozenset[int]:
        """The values whose lower orders are read, as they are."""
        return kept_values(self.rules)

    @cached_property
    def ranked(self) -> frozenset[int]:
        """The values whose lower orders are read times their order, j x[j]."""
        found: set[int] = set()
        for i, (op, args, _) in enumerate(self.rules):
            if op == "along":
                found.add(args[0])
            elif op == "against":
                found.add(i)
            elif op == "power":
                found.add(args[0])
        return frozenset(found)

    @cached_property
    def lagged(self) -> frozenset[int]:
        """The values whose coefficient of the order before is read."""
        return lagged_values(self.rules)

    @property
    def convolutions(self) -> int:
        """The number of sums over lower orders; see the function of this name."""
        return convolutions(self.rules)

    @cached_property
    def _all_needed(self) -> list[int]:
        outputs = [i for i in (*self.momenta, *self.forces, *self.watched) if i is not None]
        return self._needed([*outputs, *sorted(self.kept | self.ranked | self.lagged)])

    def _needed(self, outputs: list[int]) -> list[int]:
        """Return what the outputs are computed from at the same order, arguments first."""
        marked = set(outputs)
        for i in range(len(self.rules) - 1, -1, -1):
            if i in marked:
                marked.update(self.direct(i))
        return sorted(marked)

    def __str__(self) -> str:
        lines = [f"{self.name}: {self.dimension} coordinates, mass matrix of blocks {list(map(len, self.blocks))}"]
        lines += [f"  c{i} = {number:.17g}" for i, number in enumerate(self.numbers) if number is not None]
        for title, members in (("before", self.configuration), ("trial", self.trial), ("after", self.velocity)):
            lines.append(f"{title}:")
            lines += [f"  %{i} = {_shown(self.rules[i])}" for i in members]
        for title, outputs in (("p", self.momenta), ("f", self.forces), ("watched", self.watched)):
            lines.append(f"{title}: " + " ".join("0" if output is None else f"%{output}" for output in outputs))
        return "\n".join(lines)


def convolutions(rules: Sequence[Rule]) -> int:
    """Return the number of half sums over lower orders, the measure of what an order costs; a square is half a sum."""
    weight = {"mul": 2, "div": 2, "inverse": 2, "power": 4, "along": 2, "against": 2, "square": 1, "sqrt": 1}
    return sum(weight.get(rule.op, 0) for rule in rules)


def kept_values(rules: Sequence[Rule]) -> frozenset[int]:
    """Return the values whose lower orders some rule reads."""
    found: set[int] = set()
    for i, (op, args, _) in enumerate(rules):
        if op in ("mul", "square"):
            found.update(args)
        elif op in ("div", "inverse", "power"):
            found.update((args[-1], i))
        elif op == "sqrt":
            found.add(i)
        elif op in ("along", "against"):
            found.add(args[1])
    return frozenset(found)


def lagged_values(rules: Sequence[Rule]) -> frozenset[int]:
    """Return the values that are integrated."""
    return frozenset(rule.args[0] for rule in rules if rule.op == "integral")


def _shown(rule: Rule) -> str:
    if rule.op in ("coordinate", "velocity"):
        return f"{rule.op} {rule.coefficients[0]}"
    if rule.op == "linear":
        return "linear " + " + ".join(f"c{c} %{arg}" for c, arg in zip(rule.coefficients, rule.args, strict=True))
    return " ".join([rule.op, *(f"%{arg}" for arg in rule.args), *(f"c{c}" for c in rule.coefficients)])


def _problems(program: SeriesProgram) -> Iterator[str]:
    for i, (op, args, coefficients) in enumerate(program.rules):
        if op not in RULES:
            yield f"%{i} has the unknown rule {op}"
            return
        arguments, constants, _ = RULES[op]
        if arguments is not None and len(args) != arguments:
            yield f"%{i} = {op} has {len(args)} arguments"
        if len(coefficients) != (len(args) if constants is None else constants):
            yield f"%{i} = {op} has {len(coefficients)} coefficients"
        size = program.dimension if op in ("coordinate", "velocity") else len(program.numbers)
        if any(not 0 <= c < size for c in coefficients):
            yield f"%{i} = {op} has a coefficient that is not there"
        if any(not 0 <= arg < len(program.rules) for arg in args):
            yield f"%{i} = {op} reads a value that is not there"
        elif any(arg >= i for arg in program.direct(i)):
            yield f"%{i} = {op} reads a later value at its own order"
    sizes = [len(program.numbers), len(program.started)]
    sizes[0 if program.constant_mass else 1] += sum(len(b) * (len(b) + 1) // 2 for b in program.blocks)
    if [len(program.constants.outputs), len(program.start.outputs)] != sizes:
        yield "the start does not give every value of order 0 and the mass matrix"
    if len(program.surfaces.outputs) != max(program.sides, 1):
        yield "there is not one side for each surface"
    outputs = [i for i in (*program.forces, *program.watched) if i is not None]
    if any(not 0 <= i < len(program.rules) for i in (*outputs, *program.momenta) if i is not None):
        yield "an output is no value"
    if not len(program.momenta) == len(program.forces) == program.dimension:
        yield "there is not one momentum and one force for each coordinate"
    missing = (program.kept | program.lagged).union(outputs).difference(program.started)
    if missing:
        yield f"%{min(missing)} has no value of order 0"
    if sorted(i for block in program.blocks for i in block) != list(range(program.dimension)):
        yield "the blocks of the mass matrix do not cover the coordinates"
