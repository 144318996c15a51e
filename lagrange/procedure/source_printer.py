"""Printer of procedures as source text, such as C or Python: the part that all languages share.

The text of a value that is used once is inserted at its use, unless its operands change before that. Other values get
names. A language defines the look of operations, literals, arrays, records, branches and loops.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

from lagrange.procedure import form
from lagrange.procedure.form import CONSTANT, PARTIAL, REAL, SUMS, WHOLE, Array, Block, Callee, Kind, Procedure, Type
from lagrange.procedure.spelling import ATOM, Syntax
from lagrange.procedure.visit import Visitor, loop_depth, reads, uses_of, visits

INDICES = ("i", "j", "k", "l", "i5", "i6", "i7", "i8")
"""Names of loop indices, from the outermost on."""

LONGEST_VALUE = 60
"""Length in characters from which the text of a value is assigned to a name, not repeated where the value is used."""


class SourcePrinter(Visitor, Syntax):
    """Prints one procedure in a language; a subclass defines the form of its statements.

    `taken` are words of the language that are not used as names, except for parameters that have such a name.
    """

    def __init__(self, procedure: Procedure, taken: Iterable[str] = ()) -> None:
        self.procedure = procedure
        self.lines: list[str] = []
        self.texts: dict[int, tuple[int, str]] = {}
        """The text of each value, and its binding strength."""
        self.types: dict[int, Type] = {}
        """The types of arrays, records and functions, and the kinds of values."""
        parameter_names = [parameter.name for parameter in procedure.parameters]
        called = (self.function_name(callee) for callee in procedure.callees)
        reserved = (word for word in taken if word not in parameter_names)
        self.taken: dict[str, None] = dict.fromkeys(
            map(self.key, (*INDICES[: loop_depth(procedure.body)], *called, *reserved))
        )
        self.uses = uses_of(procedure.body)
        self.deferred: dict[int, None] = {}
        """The values that have not been printed yet, in order."""
        self.constants: dict[int, Any] = {}
        self.depth = 1
        self.loops = 0

    # --- parts that all languages share

    def function(self) -> str:
        """Return the source text of the procedure, as a function of the language."""
        self.name_parameters()
        self.block(self.procedure.body)
        lines = [*self.head(), *self.lines, *self.tail()]
        return "\n".join([*(part for line in lines for part in self.broken(line)), ""])

    def name_parameters(self) -> None:
        """Choose the names of the parameters."""
        for parameter in self.procedure.parameters:
            self.types[parameter.ref] = parameter.type
            self.name(parameter.ref, parameter.name)

    def function_name(self, procedure: Procedure) -> str:
        """Return the name under which a procedure is called in printed code."""
        return procedure.name

    def name(self, ref: int, stem: str = "") -> str:
        """Choose an unused name for the value with the id `ref`, and return it.

        `stem` is the preferred beginning of the name; by default it is the name of the value in the procedure.
        """
        name = self.legal(re.sub(r"\W", "_", stem or self.procedure.names.get(ref, f"x{ref}")))
        plain, count = name.strip("_"), 1
        while self.key(name) in self.taken:
            tail = f"{'_' * plain[-1:].isdigit()}{ref}{f'_{count}' * (count > 1)}"
            name, count = self.legal(plain[: self.longest - len(tail)] + tail), count + 1
        self.taken[self.key(name)] = None
        self.texts[ref] = ATOM, name
        return name

    @cached_property
    def unused(self) -> list[form.Parameter]:
        """The parameters that the procedure does not read."""
        read = reads(self.procedure.body)
        return [parameter for parameter in self.procedure.parameters if parameter.ref not in read]

    def key(self, name: str) -> str:
        """Return the form of a name by which the language compares names, for example in lower case."""
        return name

    def put(self, line: str) -> None:
        """Add a line to the text. Deferred values (expressions to be inserted at their use) are not printed first."""
        if line:
            self.lines.append(self.indent * self.depth + line)

    def write(self, line: str) -> None:
        """Print an assignment for each deferred value, then a statement that may change operands of these values.

        Otherwise the expression of a deferred value would be inserted at its use, which is after the statement.
        """
        self.settle()
        self.put(line)

    def settle(self) -> None:
        """Print an assignment for every deferred value, because the next line may change its operands.

        A deferred value is an expression that would otherwise be inserted where the value is used.
        """
        for ref in list(self.deferred):
            _, text = self.texts[ref]
            self.put(self.define(self.name(ref), self.kind(ref), text))
        self.deferred.clear()

    def kind(self, ref: int) -> Kind:
        """Return the kind of the value with the id `ref`."""
        kind = self.types[ref]
        assert isinstance(kind, Kind)
        return kind

    def array(self, ref: int) -> Array:
        """Return the type of the array with the id `ref`."""
        array = self.types[ref]
        assert isinstance(array, Array)
        return array

    def text(self, ref: int, least: int = 0) -> str:
        """Return the text of the value with the id `ref` as an operand.

        The text is in parentheses if its binding strength is below `least`.
        """
        self.deferred.pop(ref, None)
        level, text = self.texts[ref]
        return text if level >= least else f"({text})"

    def block(self, block: Block) -> None:
        """Print the statements of a block; an empty block gets a placeholder."""
        before = len(self.lines)
        for statement in block:
            self.statement(statement)
        self.deferred.clear()
        mark = self.comment("").strip()
        if all(line.lstrip().startswith(mark) for line in self.lines[before:]):
            self.put(self.empty())

    def inside(self, block: Block) -> None:
        """Print statements indented by one more level."""
        self.depth += 1
        self.block(block)
        self.depth -= 1

    @visits(form.SineCosine)
    def pair(self, pair: form.SineCosine) -> None:
        """Print a sine and a cosine."""
        self.let(form.Let(pair.sine, REAL, "sin", (pair.angle,)))
        self.let(form.Let(pair.cosine, REAL, "cos", (pair.angle,)))

    @visits(form.Reserve, form.ReserveRecord)
    def local_memory(self, statement: form.Reserve | form.ReserveRecord) -> None:
        """Print the declaration of a local array or record."""
        self.settle()
        if isinstance(statement, form.Reserve):
            self.types[statement.ref] = statement.array
            self.reserve(statement.ref, statement.array)
        else:
            self.types[statement.ref] = statement.record
            self.reserve_record(statement.ref, statement.record)

    @visits(form.Part)
    def part_of(self, part: form.Part) -> None:
        """Print the definition of a part of an array."""
        held = self.array(part.array)
        self.types[part.ref] = Array(held.kind, None, held.read, held.room)
        self.part(part)

    @visits(form.Declare, form.Get, form.Set)
    def variable(self, statement: form.VariableStatement) -> None:
        """Print the declaration, reading or assignment of a variable."""
        match statement:
            case form.Declare(ref=ref, kind=Kind() as kind, value=value):
                self.types[ref] = kind
                text = self.text(value)
                self.settle()
                self.put(self.declare(self.name(ref), kind, text))
            case form.Get(ref=ref, kind=Kind() as kind, variable=variable):
                self.made(ref, kind, ATOM, self.text(variable))
            case form.Set(variable=variable, value=value):
                self.write(self.assign(self.text(variable), self.text(value)))

    @visits(form.Leave)
    def left(self, leave: form.Leave) -> None:
        """Print the return from the procedure."""
        self.leave(leave.values)

    @visits(form.Note)
    def note(self, note: form.Note) -> None:
        """Print a comment."""
        self.settle()
        self.put(self.comment(note.text))

    @visits(form.Let)
    def let(self, let: form.Let) -> None:
        """Print an operation, or keep its text until its use."""
        if let.op == CONSTANT:
            self.constants[let.ref] = let.data
            self.types[let.ref] = let.kind
            self.texts[let.ref] = self.literals.spelled(let.kind, let.data)
            return
        self.made(let.ref, let.kind, *self.operation(let))

    def operation(self, let: form.Let) -> tuple[int, str]:
        """Return the text of an operation and its binding strength."""
        operator = self.operators.get(let.op)
        if operator is None:
            return ATOM, f"{self.function_of(let.op)}({', '.join(map(self.text, let.args))})"
        if let.op in self.greater and let.args[0] in self.constants:
            operator = operator._replace(text=self.greater[let.op])
        return operator.binds, operator.applied(self.text, let.args)

    def made(self, ref: int, kind: Kind, level: int, text: str) -> None:
        """Defer the text of a value to its only use, or print the definition of the value now.

        The definition is printed if the value has a name, several uses or a long text. A value that is not used is
        dropped. `ref` is the id of the value, and `level` the binding strength of the text.
        """
        self.types[ref] = kind
        if self.uses.get(ref, 0) == 1 and len(text) < LONGEST_VALUE and ref not in self.procedure.names:
            self.texts[ref], self.deferred[ref] = (level, text), None
        elif ref in self.uses:
            self.put(self.define(self.name(ref), kind, text))

    @visits(form.Load, form.Store, form.Read, form.Write)
    def memory(self, statement: form.Load | form.Store | form.Read | form.Write) -> None:
        """Print the read or write of an array or record."""
        match statement:
            case form.Load(ref=ref, kind=kind, array=array, place=index):
                self.made(ref, kind, ATOM, self.element(array, index))
            case form.Store(array=array, place=index, value=value):
                self.write(self.assign(self.element(array, index), self.text(value)))
            case form.Read(ref=ref, kind=kind, record=record, field=field):
                self.made(ref, kind, ATOM, self.member(record, field))
            case form.Write(record=record, field=field, value=value):
                self.write(self.assign(self.member(record, field), self.text(value)))

    @visits(form.When, form.Loop, form.Repeat, form.Each)
    def control(self, statement: form.ControlStatement) -> None:
        """Print a branch or a loop."""
        match statement:
            case form.When(condition=condition, then=then, otherwise=otherwise):
                self.write(self.opening("if", self.text(condition)))
                self.inside(then)
                if otherwise:
                    self.put(self.opening("else"))
                    self.inside(otherwise)
                self.put(self.closing("if"))
            case form.Loop(place=index, start=start, stop=stop, step=step, body=body):
                self.iterations(index, (self.text(start), self.text(stop, self.end_binds), str(step)), body, ())
            case form.Repeat(test=test, condition=condition, body=body):
                self.repeat(test, condition, body)
            case form.Each():
                self.each(statement)

    def repeat(self, test: Block, condition: int, body: Block) -> None:
        """Print a loop under a condition.

        `test` has the statements that compute the condition, which has the id `condition`. If one expression is not
        enough, `test` and a conditional break are printed at the beginning of an endless loop.
        """
        self.settle()
        before = len(self.lines)
        self.depth += 1
        for statement in test:
            self.statement(statement)
        lines = len(self.lines) > before
        if lines:
            _, text = self.operation(form.Let(-1, Kind.FLAG, "not", (condition,)))
            self.write(self.opening("if", text))
            self.depth += 1
            self.put(self.leaving_loop())
            self.depth -= 1
            self.put(self.closing("if"))
        self.depth -= 1
        head = self.opening("forever") if lines else self.opening("while", self.text(condition))
        self.lines.insert(before, self.indent * self.depth + head)
        self.inside(body)
        self.put(self.closing("while"))

    def iterations(self, index: int, bounds: tuple[str, str, str], body: Block, folds: Sequence[form.Fold]) -> None:
        """Print a loop over an index, with the reductions `folds`.

        `index` is the id of the index. `bounds` are the texts of the first index, of the bound, which is excluded,
        and of the step.
        """
        self.texts[index], self.types[index] = (ATOM, INDICES[self.loops]), WHOLE
        self.write(self.opening("for", INDICES[self.loops], *bounds))
        self.loops += 1
        self.inside(body)
        self.depth += 1
        for fold in folds:
            self.put(self.assign(*self.folded(fold, index)))
        self.depth -= 1
        self.loops -= 1
        self.put(self.closing("for"))

    def each(self, each: form.Each) -> None:
        """Print an `each` as a loop over its iterations. A sum has four partial sums in an array."""
        count = self.text(each.iterations, self.end_binds)
        for fold in each.folds:
            self.settle()
            self.begin_fold(fold)
        self.iterations(each.place, (self.literals.whole(0), count, "1"), each.body, each.folds)
        for fold in each.folds:
            self.types[fold.ref] = REAL
            self.end_fold(fold)

    def begin_fold(self, fold: form.Fold) -> None:
        """Print the initial values of the variables of a reduction."""
        self.types[fold.ref] = REAL
        if fold.op in SUMS:
            self.partial_sums(fold.ref)
        else:
            start = self.literals.real(0.0 if fold.op == "magnitude" else float("-inf"))
            self.put(self.declare(self.name(fold.ref), REAL, start))

    def end_fold(self, fold: form.Fold) -> None:
        """Print the definition of a sum as the total of its partial sums. Other reductions need no statement."""
        if fold.op in SUMS:
            held = [self.partial(fold.ref, str(k)) for k in range(PARTIAL)]
            total = f"({held[0]} + {held[1]}) + ({held[2]} + {held[3]})"
            self.put(self.define(self.name(fold.ref, f"sum{fold.ref}"), REAL, total))

    def partial_sums(self, ref: int) -> None:
        """Print the definition of the four partial sums of a reduction with the id `ref`, zero at first."""
        self.reserve(ref, Array(REAL, PARTIAL))
        for k in range(PARTIAL):
            self.put(self.assign(self.partial(ref, str(k)), self.literals.real(0.0)))

    def folded(self, fold: form.Fold, index: int) -> tuple[str, str]:
        """Return target and text of the assignment that adds the value of one more iteration to a reduction.

        `index` is the id of the loop index.
        """
        if fold.op in SUMS:
            target = self.partial(fold.ref, self.modulo(self.text(index)))
            product = self.operators["mul"].binds
            if fold.factor is None:
                return target, f"{target} + {self.text(fold.value, product)}"
            left, right = self.text(fold.value, product), self.text(fold.factor, product + 1)
            return target, f"{target} + {left} * {right}"
        name, value = self.text(fold.ref), self.text(fold.value)
        if fold.op == "most":
            greater = f"{self.text(fold.value, self.operators['less'].operands[1])} > {name}"
            select = self.operators["select"]
            return name, select.text.format(greater, self.text(fold.value, select.operands[1]), name)
        return name, f"{self.function_of(fold.op)}({name}, {value})"


def results_of(printer: SourcePrinter, call: form.Call) -> tuple[Kind, ...]:
    """Return the kinds of the results of a call."""
    if isinstance(call.callee, Procedure):
        return call.callee.numbers
    callee = printer.types[call.callee]
    assert isinstance(callee, Callee)
    return callee.results
