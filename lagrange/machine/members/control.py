"""Branches and loops of members in parallel lanes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from lagrange.machine.llvm.emitter import literal
from lagrange.machine.llvm.iterations import joined, neutral
from lagrange.machine.llvm.operations import phi, spell, splat, type_of
from lagrange.machine.llvm.procedures import LIKELY
from lagrange.machine.members.operations import CHEAP
from lagrange.procedure.form import (
    CONSTANT,
    FLAG,
    PARTIAL,
    REAL,
    SUMS,
    WHOLE,
    Block,
    Each,
    Fold,
    Get,
    Leave,
    Let,
    Loop,
    Note,
    Repeat,
    Set,
    When,
    assigned,
    inner,
)

if TYPE_CHECKING:
    from lagrange.machine.members.printer import MemberPrinter

ALIVE = -1
"""Key of the mask of members that have not left the procedure, among the numbers of variables."""

SHORT_BRANCH = 8
"""Largest number of operations of a branch that are computed for all members, instead of branching."""

UNROLLED = 64
"""Largest total number of statements for which the iterations of an `each` are written out."""

Way = tuple[str, dict[int, str]]
"""An incoming edge of a join: its block, and the values of variables there."""


class ControlPrinter:
    """Prints branches and loops of a procedure."""

    def __init__(self, printer: MemberPrinter) -> None:
        self.p, self.e, self.lanes = printer, printer.e, printer.lanes

    def statement(self, statement: When | Loop | Repeat | Each) -> None:
        """Print a branch or a loop. Members that leave the procedure in it are masked out afterwards."""
        before = self.p.mask
        match statement:
            case When() if not self.p.differs(statement.condition):
                self.common_branch(statement)
            case When() if is_cheap(statement):
                self.chosen_branch(statement)
            case When():
                self.masked_branch(statement)
            case Loop():
                self.loop(statement)
            case Repeat():
                self.repeat(statement)
            case Each():
                self.each(statement)
        if self.p.open:
            self.p.mask = self.present(before, statement)

    def present(self, mask: str, statement: When | Loop | Repeat | Each) -> str:
        """Return the mask without the members that left the procedure in a statement."""
        if not self.p.spread.parting or not any(leaves(body) for body in inner(statement)):
            return mask
        return self.p.both(mask, self.p.held[ALIVE])

    # --- branches

    def common_branch(self, when: When) -> None:
        """Print a branch on a condition that is the same for all members."""
        p, e, name, before = self.p, self.e, self.e.fresh("if"), dict(self.p.held)
        mask = p.mask
        other = f"{name}.else" if when.otherwise else f"{name}.end"
        e.do(f"br i1 {p.values[when.condition]}, label %{name}.then, label %{other}")
        ways: list[Way] = [] if when.otherwise else [(e.block, before)]
        for label, body in ((f"{name}.then", when.then), (f"{name}.else", when.otherwise)):
            if not body and label != f"{name}.then":
                continue
            e.label(label)
            p.held, p.open, p.mask = dict(before), True, mask
            p.block(body)
            if p.open:
                ways.append((e.block, p.held))
                e.jump(f"{name}.end")
        p.open = bool(ways)
        if ways:
            e.label(f"{name}.end")
            p.held = self.meeting(before, ways)

    def chosen_branch(self, when: When) -> None:
        """Print a branch without jumps: both sides are computed, and each member selects its own."""
        p, before, mask = self.p, dict(self.p.held), self.p.mask
        condition = p.operand(when.condition, self.lanes)
        p.level += 1
        for negated, body in ((False, when.then), (True, when.otherwise)):
            if body:
                p.mask = p.without(mask, condition) if negated else p.both(mask, condition)
                p.block(body)
        p.level -= 1
        p.held = {ref: p.held[ref] for ref in before}

    def masked_branch(self, when: When) -> None:
        """Print a branch that only some members may take; a side without members is skipped."""
        p, mask = self.p, self.p.mask
        condition = p.operand(when.condition, self.lanes)
        taken = p.both(mask, condition)
        rest = p.without(mask, condition) if when.otherwise else ""
        self.passage(taken, when.then, likely=when.likely)
        if when.otherwise:
            self.passage(rest, when.otherwise, likely=None if when.likely is None else not when.likely)

    def passage(self, mask: str, body: Block, *, likely: bool | None) -> None:
        """Print statements for the members of a mask, skipped if it is empty."""
        p, e, name, before = self.p, self.e, self.e.fresh("some"), dict(self.p.held)
        e.do(f"br i1 {p.some(mask)}, label %{name}.then, label %{name}.end{LIKELY[likely]}")
        ways: list[Way] = [(e.block, before)]
        e.label(f"{name}.then")
        p.held, p.mask = dict(before), mask
        p.level += 1
        p.block(body)
        p.level -= 1
        ways.append((e.block, p.held))
        e.jump(f"{name}.end")
        e.label(f"{name}.end")
        p.held = self.meeting(before, ways)

    def meeting(self, known: dict[int, str], ways: Sequence[Way]) -> dict[int, str]:
        """Return the values of variables where control flow joins."""
        return {
            variable: phi(self.e, self.type(variable), [(block, held[variable]) for block, held in ways])
            for variable in known
        }

    def type(self, variable: int) -> str:
        """Return LLVM's type of a variable."""
        return type_of(self.p.kinds[variable], self.p.width(variable))

    # --- loops

    def loop(self, loop: Loop) -> None:
        """Print a loop over an index, until no member is left in it."""
        p, e = self.p, self.e
        own = p.differs(loop.start) or p.differs(loop.stop)
        lanes = p.width(loop.place)
        kind, start, name = type_of(WHOLE, lanes), p.operand(loop.start, lanes), e.fresh("loop")
        step = splat(e, str(loop.step), WHOLE, lanes)
        before = p.mask
        p.level += own
        with self.repeated(name, loop.body, [(f"%{name}.i", kind, start)]) as following:
            p.define(loop.place, f"%{name}.i", WHOLE)
            if own:
                index, stop = p.operand(loop.place, self.lanes), p.operand(loop.stop, self.lanes)
                inside = e.value(f"icmp slt {type_of(WHOLE, self.lanes)} {index}, {stop}")
                p.mask = p.both(self.present(before, loop), inside)
                test = p.some(p.mask)
            else:
                p.mask = self.present(before, loop)
                test = e.value(f"icmp slt i64 %{name}.i, {p.values[loop.stop]}")
                if p.mask != before:
                    test = e.value(f"and i1 {test}, {p.some(p.mask)}")
            e.do(f"br i1 {test}, label %{name}.body, label %{name}.end")
            following.append(f"add nsw {kind} %{name}.i, {step}")
        p.level -= own

    def repeat(self, repeat: Repeat) -> None:
        """Print a loop that repeats until the condition holds for no member."""
        p, e = self.p, self.e
        own, name, flags = p.differs(repeat.condition), e.fresh("loop"), type_of(FLAG, self.lanes)
        before = p.mask
        parts = leaves(repeat.body) and p.spread.parting
        carried = [(f"%{name}.m", flags, before)] if own else []
        p.level += own
        with self.repeated(name, (*repeat.test, *repeat.body), carried, repeat.body) as following:
            here = f"%{name}.m" if own else before
            p.mask = p.both(here, p.held[ALIVE]) if parts else here
            p.block(repeat.test)
            if own:
                p.mask = p.both(p.mask, p.operand(repeat.condition, self.lanes))
                test = p.some(p.mask)
                following.append(p.mask)
            else:
                test = p.values[repeat.condition]
                if parts:
                    test = e.value(f"and i1 {test}, {p.some(p.mask)}")
            e.do(f"br i1 {test}, label %{name}.body, label %{name}.end")
        p.level -= own

    @contextmanager
    def repeated(
        self, name: str, inside: Block, more: Sequence[tuple[str, str, str]], body: Block | None = None
    ) -> Iterator[list[str]]:
        """Print a loop around the body of the `with`, which prints the loop's head.

        The head branches to NAME.body and NAME.end. `more` lists names, types and first values of values that the loop
        carries besides variables. The `with` appends their next values, or the instructions that compute them at the
        end of the body.
        """
        p, e = self.p, self.e
        changing = [*assigned(inside), *((ref for ref in p.held if ref < 0) if leaves(inside) else ())]
        carried = [variable for variable in changing if variable in p.held]
        before, initial = e.block, dict(p.held)
        e.jump(f"{name}.head")
        e.label(f"{name}.head")
        hole = len(e.lines)
        e.lines += [""] * (len(carried) + len(more))
        for k, variable in enumerate(carried):
            p.held[variable] = f"%{name}.v{k}"
        following: list[str] = []
        yield following
        entered = dict(p.held)
        e.label(f"{name}.body")
        p.block(inside if body is None else body)
        back = p.open
        made = [text if text.startswith("%") else e.value(text) for text in following] if back else []
        end = e.block
        if back:
            e.jump(f"{name}.head")
        for k, (place, kind, first) in enumerate(more):
            again = f", [ {made[k]}, %{end} ]" if back else ""
            e.lines[hole + k] = f"  {place} = phi {kind} [ {first}, %{before} ]{again}"
        for k, variable in enumerate(carried):
            again = f", [ {p.held[variable]}, %{end} ]" if back else ""
            entry = f"[ {initial[variable]}, %{before} ]{again}"
            e.lines[hole + len(more) + k] = f"  %{name}.v{k} = phi {self.type(variable)} {entry}"
        p.held, p.open = entered, True
        e.label(f"{name}.end")

    # --- iterations

    def each(self, each: Each) -> None:
        """Print an `each`, one iteration after the other, because the lanes hold members."""
        p = self.p
        own = p.differs(each.iterations)
        widths = [p.width(fold.ref) for fold in each.folds]
        sums = [
            [splat(self.e, literal(neutral(fold)), REAL, lanes)] * (PARTIAL if fold.op in SUMS else 1)
            for fold, lanes in zip(each.folds, widths, strict=True)
        ]
        count = p.values[each.iterations]
        known = None if own or count.startswith("%") else int(count)
        if known is not None and (each.unrolled or known * (statements(each.body) + len(each.folds)) <= UNROLLED):
            for k in range(known):
                self.iteration(each, str(k))
                sums = [self.collected(*one) for one in zip(each.folds, sums, widths, strict=True)]
        else:
            sums = self.looped(each, sums, widths, own=own)
        for fold, found, lanes in zip(each.folds, sums, widths, strict=True):
            p.define(fold.ref, self.total(found, each.iterations, lanes), REAL)

    def iteration(self, each: Each, index: str) -> None:
        """Print an iteration."""
        p, outside = self.p, dict(self.p.held)
        p.define(each.place, index, WHOLE)
        p.block(each.body)
        p.held = {variable: p.held[variable] for variable in outside}

    def looped(self, each: Each, sums: list[list[str]], widths: Sequence[int], *, own: bool) -> list[list[str]]:
        """Print the iterations as a loop."""
        p, e, before = self.p, self.e, self.p.mask
        flat = [(type_of(REAL, lanes), one) for found, lanes in zip(sums, widths, strict=True) for one in found]
        name = e.fresh("each")
        head = e.block
        e.jump(f"{name}.head")
        e.label(f"{name}.head")
        hole = len(e.lines)
        e.lines += [""] * (len(flat) + 1)
        if own:
            vector = type_of(WHOLE, self.lanes)
            index = splat(e, f"%{name}.i", WHOLE, self.lanes)
            p.mask = p.both(before, e.value(f"icmp slt {vector} {index}, {p.values[each.iterations]}"))
            test = p.some(p.mask)
        else:
            test = e.value(f"icmp slt i64 %{name}.i, {p.values[each.iterations]}")
        e.do(f"br i1 {test}, label %{name}.body, label %{name}.end")
        e.label(f"{name}.body")
        inside, places = [], iter(range(len(flat)))
        for found in sums:
            inside.append([f"%{name}.s{next(places)}" for _ in found])
        p.level += own
        self.iteration(each, f"%{name}.i")
        after = [self.collected(*one) for one in zip(each.folds, inside, widths, strict=True)]
        if own:
            after = [
                [p.chosen(p.mask, new, old, REAL) for new, old in zip(*pair, strict=True)]
                for pair in zip(after, inside, strict=True)
            ]
        p.level -= own
        next_index = e.value(f"add nsw i64 %{name}.i, 1")
        end = e.block
        e.jump(f"{name}.head")
        e.lines[hole] = f"  %{name}.i = phi i64 [ 0, %{head} ], [ {next_index}, %{end} ]"
        made = [one for found in after for one in found]
        for k, ((kind, first), new) in enumerate(zip(flat, made, strict=True)):
            e.lines[hole + 1 + k] = f"  %{name}.s{k} = phi {kind} [ {first}, %{head} ], [ {new}, %{end} ]"
        p.mask = before
        e.label(f"{name}.end")
        return inside

    def collected(self, fold: Fold, found: Sequence[str], lanes: int) -> list[str]:
        """Return the partial results of a reduction after one more value.

        The first of them is the next that gets a value.
        """
        value = self.p.operand(fold.value, lanes)
        if fold.factor is None:
            new = joined(self.e, fold.op, found[0], value, lanes)
        else:
            factor = self.p.operand(fold.factor, lanes)
            new = spell(self.e, "fma", (REAL,) * 3, [value, factor, found[0]], lanes)
        return [*found[1:], new]

    def total(self, found: Sequence[str], count: int, lanes: int) -> str:
        """Return the result of a reduction. The last iteration i was added to partial sum i mod 4."""
        if len(found) == 1:
            return found[0]
        known = self.p.values[count]
        if not known.startswith("%"):
            return self.summed(found, int(known) % 2, lanes)
        even, odd = self.summed(found, 0, lanes), self.summed(found, 1, lanes)
        kind, width = type_of(WHOLE, self.p.width(count)), self.p.width(count)
        bit = self.e.value(f"and {kind} {known}, {splat(self.e, '1', WHOLE, width)}")
        test = self.e.value(f"icmp eq {kind} {bit}, {splat(self.e, '0', WHOLE, width)}")
        real = type_of(REAL, lanes)
        return self.e.value(f"select {type_of(FLAG, width)} {test}, {real} {even}, {real} {odd}")

    def summed(self, found: Sequence[str], odd: int, lanes: int) -> str:
        """Return the sum of partial sums: 0 and 1, 2 and 3, then both. `odd` is the parity of the number of terms."""
        a, b, c, d = (*found[-odd:], *found[:-odd]) if odd else found
        pairs = (spell(self.e, "add", (REAL, REAL), pair, lanes) for pair in ((a, b), (c, d)))
        return spell(self.e, "add", (REAL, REAL), list(pairs), lanes)


def leaves(block: Block) -> bool:
    """Return whether a block contains a statement that leaves the procedure."""
    return any(isinstance(one, Leave) or any(leaves(body) for body in inner(one)) for one in block)


def statements(block: Block) -> int:
    """Return the number of statements of a block, including nested ones."""
    return sum(1 + sum(statements(body) for body in inner(one)) for one in block)


def is_cheap(when: When) -> bool:
    """Return whether both sides of a branch cost less than testing whether any member takes them."""
    both = (*when.then, *when.otherwise)
    allowed = all(
        isinstance(one, (Get, Set, Note)) or (isinstance(one, Let) and (one.op in CHEAP or one.op == CONSTANT))
        for one in both
    )
    return allowed and sum(isinstance(one, Let) for one in both) <= SHORT_BRANCH
