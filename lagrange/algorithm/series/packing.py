"""Pack the values of a Taylor series into vectors: values with the same rule are computed together.

A chunk is a vector of values with the same rule at the same depth: 1, 2, 4 or 8 values, or a multiple of 4 values for
code with loops over the values. Its last lanes may repeat the last value. An operand is a vector of values that a chunk
reads. Unless it is another chunk, it is gathered from several chunks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from lagrange.algorithm.constants import WIDEST_VECTOR, whole_blocks
from lagrange.equations.solve_plan import SolvePlan
from lagrange.program.series import LAGGED, SUMS, SeriesProgram, SeriesRule, Stage


@dataclass(frozen=True)
class Operand:
    """A vector of series values that rules read. `values` are their indices in the series program, by lane.

    If `ranked`, the coefficient x[j] of order j is multiplied by j. The index `ZERO_LANE` means zero.
    """

    values: tuple[int, ...]
    ranked: bool = False


@dataclass(frozen=True)
class Chunk:
    """A vector of series values that one rule computes, with the operation `op`.

    `values` are the indices of the values by lane, of which the first `count` are distinct. `args` are the
    operands of the rule. `coefficients` has for each coefficient of the rule its indices in the table of
    constants, by lane.
    """

    op: str
    values: tuple[int, ...]
    count: int
    args: tuple[Operand, ...]
    coefficients: tuple[tuple[int, ...], ...]

    @property
    def whole(self) -> Operand:
        """The chunk's values as an operand of other rules."""
        return Operand(self.values)

    @cached_property
    def sums(self) -> tuple[tuple[Operand, Operand], ...]:
        """The sums of x[j] y[k-j] over 0 < j < k that the rule reads at order k, as operands (x, y)."""
        operands = (*self.args, self.whole)
        pairs = [[Operand(operands[f.argument].values, f.ranked) for f in pair] for pair in SUMS.get(self.op, ())]
        return tuple((x, y) for x, y in pairs)

    @property
    def direct(self) -> tuple[Operand, ...]:
        """The arguments that the rule reads at the order that it computes."""
        return tuple(arg for position, arg in enumerate(self.args) if LAGGED.get(self.op) != position)

    @property
    def divisor(self) -> Operand | None:
        """The operand that is the divisor of the rule; None if it does not divide. Its values at order 0 are used."""
        if self.op in ("div", "against"):
            return self.args[1]
        if self.op in ("inverse", "power"):
            return self.args[0]
        return self.whole if self.op == "sqrt" else None


@dataclass(frozen=True)
class PackedStage:
    """A linear system A x[k] = right[k-1] / k - left[k] for unknowns x at order k, packed into chunks.

    `unknowns` are the chunks of unknowns. The chunks `trial`, on which `left` depends, are computed with trial
    values of the unknowns. The chunks `found` are computed after the solution, from the unknowns. `left` and `right`
    have an operand for each chunk of unknowns, or None if all entries are zero. `system` is the linear system before
    packing.
    """

    unknowns: tuple[Chunk, ...]
    trial: tuple[Chunk, ...]
    found: tuple[Chunk, ...]
    left: tuple[Operand | None, ...]
    right: tuple[Operand | None, ...]
    system: Stage

    @property
    def plan(self) -> SolvePlan:
        """The plan for the solution of the linear system."""
        return self.system.plan

    @cached_property
    def rows(self) -> tuple[tuple[int, ...], ...]:
        """For each chunk of unknowns and each lane, the index of the unknown in the linear system."""
        indices = {value: i for i, value in enumerate(self.system.unknowns)}
        return tuple(tuple(indices[value] for value in chunk.values) for chunk in self.unknowns)


@dataclass(frozen=True)
class Packing:
    """A series program packed into chunks: vectors of values with one rule, in the order of evaluation.

    `stages` are the linear systems, and the chunks `before` are computed before all of them. `rates` are the operands
    of dq/dt. A chunk has up to `lanes` values.
    """

    program: SeriesProgram
    lanes: int
    coordinates: tuple[Chunk, ...]
    rates: tuple[Operand, ...]
    before: tuple[Chunk, ...]
    stages: tuple[PackedStage, ...]

    @cached_property
    def state(self) -> tuple[Chunk, ...]:
        """The chunks of the coordinates and of the velocities."""
        velocities = (chunk for chunk in self.unknowns if chunk.values[0] < self.program.states)
        return (*self.coordinates, *sorted(velocities, key=lambda chunk: chunk.values[0]))

    @cached_property
    def unknowns(self) -> tuple[Chunk, ...]:
        """The chunks of unknowns of all linear systems."""
        return tuple(chunk for stage in self.stages for chunk in stage.unknowns)

    @cached_property
    def place(self) -> dict[int, tuple[Chunk, int]]:
        """The chunk and the lane of each series value, by the index of the value."""
        chunks = (*self.coordinates, *self.unknowns, *self.computed)
        return {value: (chunk, lane) for chunk in chunks for lane, value in enumerate(chunk.values[: chunk.count])}

    @cached_property
    def computed(self) -> tuple[Chunk, ...]:
        """All chunks (vectors of values) that a rule computes, each once, in the order of evaluation."""
        return tuple(dict.fromkeys(chunk for part in self.parts for chunk in part))

    @property
    def parts(self) -> tuple[tuple[Chunk, ...], ...]:
        """The chunks that rules compute before all linear systems, then those before and after the solution of each."""
        return (self.before, *(part for stage in self.stages for part in (stage.trial, stage.found)))

    @cached_property
    def families(self) -> dict[Operand, int]:
        """The number of the family of each factor of the sums that rules read.

        Two factors are of one family if they occur in the same sum, or if a chain of sums with common factors
        connects them.
        """
        families: list[set[Operand]] = []
        for pair in (pair for chunk in self.computed for pair in chunk.sums):
            joined = set(pair).union(*(family for family in families if not family.isdisjoint(pair)))
            families = [*(family for family in families if family.isdisjoint(pair)), joined]
        return {factor: number for number, family in enumerate(families) for factor in family}


ZERO_LANE = -1
"""Index in an operand for a lane whose value is always zero."""


def pack(program: SeriesProgram, lanes: int) -> Packing:
    """Return a series program packed into vectors of up to `lanes` values that are computed by one rule."""
    packer = _Packer(program, lanes)
    groups = _groups(program, packer.level)
    coordinates = tuple(packer.chunks("coordinate", list(range(program.dimension))))
    unknowns = [packer.unknowns(stage) for stage in program.stages]
    made = {group: packer.chunks(group.op, members) for group, members in groups.items()}

    def part(stage_number: int, kind: str = "") -> tuple[Chunk, ...]:
        chosen = (group for group in made if group.stage == stage_number and (not kind or getattr(group, kind)))
        return tuple(chunk for group in chosen for chunk in made[group])

    stages = tuple(
        PackedStage(
            chunks,
            part(stage_number, "trial"),
            part(stage_number, "found"),
            _outputs(chunks, stage, stage.left),
            _outputs(chunks, stage, stage.right),
            stage,
        )
        for stage_number, (stage, chunks) in enumerate(zip(program.stages, unknowns, strict=True), 1)
    )
    rates = tuple(Operand(tuple(program.rates[value] for value in chunk.values)) for chunk in coordinates)
    return Packing(program, lanes, coordinates, rates, part(0), stages)


def depth_first(packing: Packing, chunks: Sequence[Chunk]) -> tuple[Chunk, ...]:
    """Return chunks in an order of evaluation in which values are read soon after they are computed.

    Chunks whose sums share factors, directly or through other sums, are adjacent. Each chunk comes after those
    that its rule reads.
    """
    families = packing.families
    unvisited = sorted(chunks, key=lambda chunk: families.get(chunk.sums[0][0], 0) if chunk.sums else len(families))
    ordered, inside, unvisited = dict[Chunk, None](), set(chunks), unvisited[::-1]
    while unvisited:
        chunk = unvisited[-1]
        read = (packing.place[value][0] for arg in chunk.direct for value in arg.values if value != ZERO_LANE)
        missing = [each for each in read if each in inside and each not in ordered]
        if missing and chunk not in ordered:
            unvisited += missing[::-1]
        else:
            ordered[unvisited.pop()] = None
    return tuple(ordered)


def _groups(program: SeriesProgram, level: Sequence[tuple[int, int]]) -> dict[_Group, list[int]]:
    """Return the groups of values that can be in one vector, by their common properties.

    The groups are in the order of evaluation. `level` has for each value a pair that orders the evaluation, as
    `levels` returns it.
    """
    trials, founds = ([frozenset(part) for part in parts] for parts in (program.trials, program.found))
    groups: dict[_Group, list[int]] = {}
    for i in sorted({*program.before}.union(*trials, *founds)):
        rule = program.rules[i]
        if rule.op not in ("coordinate", "unknown"):
            kind = len(rule.args) if rule.op == "linear" else 0
            choice = rule.coefficients if rule.op == "choose" else ()
            stage = program.depth[i]
            trial, found = stage > 0 and i in trials[stage - 1], stage > 0 and i in founds[stage - 1]
            group = _Group(stage, *level[i], rule.op, kind, choice, trial, found)
            groups.setdefault(group, []).append(i)
    return dict(sorted(groups.items()))


def _outputs(chunks: Sequence[Chunk], stage: Stage, outputs: Sequence[int | None]) -> tuple[Operand | None, ...]:
    """Return the values `outputs` of a linear system as operands, one for each chunk of unknowns.

    `outputs` has the index of a value for each unknown, or None for zero. An operand whose values are all zero is
    None.
    """
    known = {value: ZERO_LANE if i is None else i for value, i in zip(stage.unknowns, outputs, strict=True)}
    operands = (Operand(tuple(known[value] for value in chunk.values)) for chunk in chunks)
    return tuple(None if all(i == ZERO_LANE for i in operand.values) else operand for operand in operands)


class _Group(NamedTuple):
    """Key of a group: the common properties of the values of one vector, in the order of their evaluation."""

    stage: int
    sums: int
    depth: int
    op: str
    arguments: int
    choice: tuple[int, ...]
    trial: bool
    found: bool


def widths(count: int, lanes: int) -> list[int]:
    """Return the widths of the vectors of up to `lanes` lanes that hold `count` values."""
    sizes = [lanes] * (count // lanes)
    rest = count % lanes
    if rest:
        sizes.append(1 << (rest - 1).bit_length() if rest <= WIDEST_VECTOR else whole_blocks(rest, 4))
    return sizes


class _Packer:
    """Packs values of a series program that are computed by the same operation into chunks, short vectors.

    The values of a group are ordered so that their operands are in the same order.
    """

    def __init__(self, program: SeriesProgram, lanes: int) -> None:
        self.program, self.lanes = program, lanes
        self.level = levels(program)
        self.position: dict[int, int] = {}

    def unknowns(self, stage: Stage) -> tuple[Chunk, ...]:
        """Return the chunks of the unknowns of a linear system. Velocities have separate chunks.

        Multipliers are sorted by the number of unknowns in their equations, then by these unknowns. So the number of
        gathered operands does not depend on the order in which constraints are stated.
        """
        coupled: dict[int, list[int]] = {}
        for i, j in sorted(stage.plan.present or ()):
            coupled.setdefault(i, []).append(j)
            coupled.setdefault(j, []).append(i)
        velocities: list[int] = []
        others: list[tuple[int, list[int], int]] = []
        for index, value in enumerate(stage.unknowns):
            if value < self.program.states:
                velocities.append(value)
            else:
                columns = coupled.get(index, []) if index in stage.plan.multipliers else []
                others.append((len(columns), sorted(columns), value))
        return (*self.chunks("unknown", velocities), *self.chunks("unknown", [value for *_, value in sorted(others)]))

    def chunks(self, op: str, members: list[int]) -> list[Chunk]:
        """Return the chunks into which the group `members` of values with the operation `op` is divided."""
        rules = {i: self.canonical(self.program.rules[i]) for i in members}
        # Values whose operands have equal positions keep their order.
        members, chunks = sorted(members, key=lambda i: [self.at(arg) for arg in rules[i].args[::-1]]), []
        for width in widths(len(members), self.lanes):
            chosen, members = members[:width], members[width:]
            padded = chosen + [chosen[-1]] * (width - len(chosen))
            for value in chosen:
                self.position[value] = len(self.position)
            lanes = [rules[i] for i in padded]
            args = tuple(Operand(args) for args in zip(*(rule.args for rule in lanes), strict=True))
            coefficients = tuple(zip(*(rule.coefficients for rule in lanes), strict=True))
            chunks.append(Chunk(op, tuple(padded), len(chosen), args, coefficients))
        return chunks

    def canonical(self, rule: SeriesRule) -> SeriesRule:
        """Return a rule with its exchangeable arguments sorted by the order in which they are computed.

        The argument that is computed last comes first in a product, and last in a linear combination.
        """
        if rule.op == "mul":
            return rule._replace(args=tuple(sorted(rule.args, key=lambda i: (self.level[i], self.at(i)), reverse=True)))
        if rule.op == "linear":
            pairs = zip(rule.args, rule.coefficients, strict=True)
            args, coefficients = zip(*sorted(pairs, key=lambda p: (self.level[p[0]], self.at(p[0]))), strict=True)
            return SeriesRule("linear", args, coefficients)
        return rule

    def at(self, value: int) -> int:
        """Return the position of a series value among the packed values.

        A value that is not packed yet has a position after all packed ones.
        """
        return self.position.get(value, len(self.program.rules) + value)


def levels(program: SeriesProgram) -> list[tuple[int, int]]:
    """Return for each value of a series program its level, a pair of counts that orders the evaluation.

    The first count is the length of the longest chain of values, up to this one, whose rules have sums over lower
    orders. The second count is the number of linear combinations after the last value of that chain. Values of one
    level can be computed together. Unknowns of linear systems are last.
    """
    pairs: list[tuple[int, int]] = []
    for i, rule in enumerate(program.rules):
        before = [pairs[arg] for arg in program.direct(i)]
        sums = max((level for level, _ in before), default=0)
        if rule.op == "unknown":
            pairs.append((len(program.rules), 0))
        elif rule.op == "linear":
            pairs.append((sums, max((depth for level, depth in before if level == sums), default=0) + 1))
        else:
            pairs.append((sums + 1, 0))
    return pairs
