"""Print programs as straight-line functions, for exports to languages without integrators such as Fortran and Julia.

A `Language` has the spellings of a language. The file of a language adds the text around functions and modules. This
module makes legal names and exact literals, so no text of a user is executed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lagrange.errors import StatementError
from lagrange.export.elimination import ROWS, Statements, body, factored, solved
from lagrange.export.module import ExportedQuantity, SourceModule, ascii_name, distinct, indices
from lagrange.export.target import SOLVED
from lagrange.procedure.form import FLAG, REAL
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.procedure.source_printer import LONGEST_VALUE
from lagrange.procedure.spelling import ATOM, Operator
from lagrange.program.program import GIVEN, Instruction, Program, ProgramBlock, uses_of
from lagrange.statement.vocabulary.functions import CONDITIONS as FLAGS

CONDITIONS: Mapping[str, tuple[int, ...]] = {"select": (0,), "and": (0, 1), "or": (0, 1), "not": (0,)}
"""Indices of operands that are conditions (true or false), by operation."""

SYSTEMS = ("factor", "solve", "component")
STRUCTURE = (*GIVEN, *SYSTEMS)  # Operations without a spelling: reading of arguments, and linear systems

GENERATED = re.compile(r"(?:[xfsd]|singular)\d+")
"""Pattern of the names that the printer makes for values, factors, solutions and conditions."""


@dataclass(frozen=True, kw_only=True)
class Language(Statements):
    """The spellings of a language, or of a library of Python, as templates.

    - `operations` has a template for every operation.
    - `helpers` maps an operation to a definition that a file contains if it uses the operation. `needs` maps an
      operation to other operations that its definition uses.
    - `define` assigns a value to a new name. Its field {type} is one of the two `types`, of numbers and of conditions.
    - `condition` converts a number to a condition, and `number` a condition to a number; None for no conversion.
    - `factor` and `solve` are the lines that factor a matrix and solve a linear system. `matrix` declares a matrix
      and `entry` sets an entry; if `entry` is empty, `factor` takes all entries.
    - `factored` and `solved` are the head and the end of the functions that these lines call.
    - `reserved` are words that values may not have as names. Two names with the same `key` are the same in the
      language.
    """

    name: str
    helpers: Mapping[str, str]
    factor: str
    solve: str
    define: str = "{name} = {value}"
    types: tuple[str, str] = ("", "")
    condition: Operator | None = None
    number: Operator | None = None
    matrix: str = ""
    reserved: Sequence[str] = ()
    needs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    key: Callable[[str], str] = str
    factored: tuple[str, str] = ("", "")
    solved: tuple[str, str] = ("", "")

    def definitions(self, ops: Iterable[str]) -> list[str]:
        """Return the helper definitions that functions with the operations `ops` need, ordered by operation."""
        needed = {need for op in ops for need in (op, *self.needs.get(op, ()))}
        return [self.helpers[op] for op in sorted(needed) if op in self.helpers]

    def systems(self, ops: Iterable[str]) -> Iterator[str]:
        """Yield the lines of the two functions that factor a matrix and solve a linear system, if `ops` need them.

        A blank line follows each function.
        """
        if "factor" in ops:
            for function, (head, end) in ((factored, self.factored), (solved, self.solved)):
                yield from head.splitlines()
                yield from body(function, self)
                yield from (end, "")


class StraightLinePrinter:
    """Prints the instructions of a program in a language; a value that is read more than once gets a name.

    `names` maps the index of an instruction to the name of its value. Entries of the state and parameters without a
    name are called y0 and p0; the surrounding text defines these names. `kept` maps the index of an instruction whose
    value depends on parameters alone to the index of that value in the array p. `parameters` is the name of the array
    of parameters. Raises StatementError for an operation that the language lacks.
    """

    def __init__(
        self,
        program: Program,
        language: Language,
        names: Mapping[int, str] | None = None,
        kept: Mapping[int, int] | None = None,
        parameters: str = "p",
    ) -> None:
        self.program, self.language, self.names, self.kept = program, language, names or {}, kept or {}
        self.lines: list[str] = []
        self.declared: list[tuple[str, str, tuple[int, ...]]] = []
        """Local variables: the type, the name and the dimensions of each."""
        self.texts: dict[int, tuple[int, str]] = {}
        self.vectors: dict[int, str] = {}
        self.constants: dict[int, float | bool] = {}
        self.needed: dict[str, None] = {}
        """Printed operations, as keys; "condition" is the conversion of a number to a condition."""
        self.singular: list[str] = []
        """Names of the conditions that are true if a matrix is singular."""
        self.uses, self.parameters = uses_of(program), parameters
        self.unused = dict.fromkeys(("t", "y", parameters))
        """Arguments that no line reads."""
        for instruction in program.instructions:
            if instruction.op not in STRUCTURE and instruction.op not in language.operations:
                raise StatementError(
                    f"{program.name} contains {instruction.op}, which {language.name} does not have: state the system "
                    "without it, or choose another target."
                )

    def values(self) -> list[str]:
        """Return the lines of code that compute the outputs of the program, without indentation."""
        for i in self._read():
            self._value(i, self.program.instructions[i])
        return self.lines

    def _read(self) -> list[int]:
        """Return the indices of the instructions to print: entries of the state, then of parameters, then the others.

        These are the instructions that the outputs need, without those whose values are entries of the array p.
        """
        refs: dict[int, None] = {}
        todo = list(self.program.outputs)
        while todo:
            ref = todo.pop()
            if ref in self.kept:
                self.texts[ref] = ATOM, self.element("p", self.kept[ref])
            elif ref not in refs:
                refs[ref] = None
                todo += self.program.instructions[ref].args
        for ref in sorted(self.texts.keys() & self.names.keys()):
            self._define(ref, self.names[ref], self.texts[ref][1])
        order = {"state": 0, "parameter": 1}
        code = self.program.instructions
        return sorted(
            refs, key=lambda ref: (order.get(code[ref].op, 2), code[ref].place if code[ref].op in order else ref)
        )

    def element(self, array: str, index: int) -> str:
        """Return the text of an entry of an argument array; `index` counts from 0 in every language."""
        self.unused.pop(array, None)
        return self.language.element.format(array, index + self.language.first)

    def _value(self, i: int, instruction: Instruction) -> None:
        match instruction.op:
            case "state" | "parameter" if i not in self.names:
                self.texts[i] = ATOM, f"{'y' if instruction.op == 'state' else 'p'}{instruction.place}"
            case "state" | "parameter":
                array = "y" if instruction.op == "state" else self.parameters
                self._define(i, self.names[i], self.element(array, instruction.place))
            case "time":
                self.unused.pop("t", None)
                self.texts[i] = ATOM, "t"
            case "constant":
                self.constants[i] = instruction.value
                self.texts[i] = self.language.literals.spelled(REAL, instruction.value)
            case "component":
                name = self.vectors[instruction.args[0]]
                self.texts[i] = ATOM, self.language.element.format(name, instruction.place + self.language.first)
            case "factor":
                self._factor(i, instruction)
            case "solve":
                self.vectors[i] = f"s{i}"
                self.declared.append(("real", f"s{i}", (instruction.order or len(instruction.args) - 1,)))
                right = ", ".join(self.text(ref) for ref in instruction.args[1:])
                self._system(
                    self.language.solve, f"s{i}", len(instruction.args) - 1, self.vectors[instruction.args[0]], right
                )
            case _:
                self._operation(i, instruction)

    def _factor(self, i: int, instruction: Instruction) -> None:
        """Print the factorization of a symmetric matrix, instruction number `i`."""
        name, n, language = f"f{i}", instruction.order, self.language
        self.needed["factor"] = None
        self.vectors[i] = name
        self.singular.append(f"singular{i}")
        self.declared += [("real", name, (n + ROWS, n)), ("flag", f"singular{i}", ())]
        entries = ", ".join(self.text(ref) for ref in instruction.args)
        if language.entry:
            self._system(language.matrix, name, n)
            for k, ref in enumerate(instruction.args):
                row = int(((8 * k + 1) ** 0.5 - 1) / 2)
                if self.constants.get(ref, 1.0) != 0.0:
                    column = k - row * (row + 1) // 2
                    entry = language.entry.format(name, row + language.first, column + language.first)
                    self.lines.append(language.stored(entry, self.text(ref)))
        self._system(language.factor, name, n, f"singular{i}", entries)

    def _system(self, template: str, name: str, order: int, other: str = "", entries: str = "") -> None:
        fields = {"name": name, "order": order, "rows": order + ROWS}
        self.lines += template.format(**fields, other=other, entries=entries).splitlines()

    def _operation(self, i: int, instruction: Instruction) -> None:
        """Print instruction number `i`, or store its text if only one other operation reads the value."""
        kind = FLAG if instruction.op in FLAGS else REAL
        if all(arg in self.constants for arg in instruction.args):
            # A compiler may refuse constant expressions that overflow, such as 1.0/0.0.
            with np.errstate(all="ignore"):
                self.constants[i] = OPERATIONS[instruction.op](*(self.constants[arg] for arg in instruction.args))
            self.texts[i] = self.language.literals.spelled(kind, self.constants[i])
            return
        operator = self.language.operations[instruction.op]
        self.needed[instruction.op] = None
        conditions = CONDITIONS.get(instruction.op, ())
        texts = [
            self.condition(arg, least) if k in conditions else self.number(arg, least)
            for k, (arg, least) in enumerate(
                zip(instruction.args, operator.operands or (0,) * len(instruction.args), strict=True)
            )
        ]
        self.texts[i] = operator.binds, operator.text.format(*texts)
        if i in self.names or self.uses[i] > 1 or len(self.texts[i][1]) >= LONGEST_VALUE:
            self._define(i, self.names.get(i, f"x{i}"), self.texts[i][1], kind is FLAG)

    def _define(self, i: int, name: str, value: str, flag: bool = False) -> None:
        self.declared.append(("flag" if flag else "real", name, ()))
        self.lines.append(self.language.define.format(name=name, value=value, type=self.language.types[flag]))
        self.texts[i] = ATOM, name

    def number(self, ref: int, least: int = 0) -> str:
        """Return the text of value `ref` as a number, in parentheses if its precedence is below `least`.

        A condition becomes one or zero.
        """
        flag = self.program.instructions[ref].op in FLAGS
        return self.text(ref, least, self.language.number if flag else None)

    def condition(self, ref: int, least: int = 0) -> str:
        """Return the text of value `ref` as a condition, in parentheses if its precedence is below `least`.

        A nonzero number is true.
        """
        if self.program.instructions[ref].op in FLAGS:
            return self.text(ref, least)
        self.needed["condition"] = None
        return self.text(ref, least, self.language.condition)

    def text(self, ref: int, least: int = 0, operator: Operator | None = None) -> str:
        """Return the text of value number `ref`, in parentheses if its precedence is below `least`.

        With `operator` it is the text of this operator applied to the value.
        """
        binds, text = self.texts[ref]
        if operator is not None:
            binds, text = operator.binds, operator.text.format(self.text(ref, (operator.operands or (0,))[0]))
        return text if binds >= least else f"({text})"

    def status(self, more: Sequence[int] = ()) -> str:
        """Return the text of the condition that a matrix is singular.

        `more` are the indices of values that are further conditions, joined by "or".
        """
        either = self.language.operations["or"]
        parts = [(ATOM, name) for name in self.singular] + [self.texts[ref] for ref in more]
        level, condition = parts[0] if parts else (ATOM, self.language.literals.flags[0])
        for part in parts[1:]:
            texts = [
                text if binds >= least else f"({text})"
                for (binds, text), least in zip(((level, condition), part), either.operands or (0, 0), strict=True)
            ]
            level, condition = either.binds, either.text.format(*texts)
        return condition


def with_outputs(
    program: Program, code: tuple[Instruction, ...], outputs: tuple[int, ...], hoisted: int = 0
) -> Program:
    """Return a copy of a program with the instructions `code` and the results `outputs`.

    The first `hoisted` of these instructions depend only on parameters.
    """
    return replace(
        program,
        instructions=code,
        hoisted=hoisted,
        outputs=outputs,
        results=(ProgramBlock("values", len(outputs)),),
        shape=(len(outputs),),
        returned=(),
    )


# --- values that depend on parameters alone


class Hoisted:
    """Values of `programs` that depend on parameters alone, and their places in the array p.

    The array p, of length `size`, has the parameters, then these values. The outputs of `program` are the values,
    followed by flags. A flag is true if a result of the program `divisors` that depends on parameters alone is zero.
    `kept` maps each program to {index of an instruction: index of its value in p}. Values of linear systems are left
    out, because factors are not numbers.
    """

    def __init__(self, programs: Sequence[Program], parameters: int, divisors: Program | None) -> None:
        self.kept: dict[Program, dict[int, int]] = {}
        merged: dict[Instruction, int] = {}
        indices: dict[int, int] = {}
        tested: dict[int, None] = {}
        for program in programs:
            table: dict[int, int] = {}
            for i, instruction in enumerate(program.instructions[: program.hoisted]):
                if instruction.op not in SYSTEMS and all(arg in table for arg in instruction.args):
                    moved = instruction._replace(args=tuple(table[arg] for arg in instruction.args))
                    table[i] = merged.setdefault(moved, len(merged))
            read = [
                arg for i, instruction in enumerate(program.instructions) if i not in table for arg in instruction.args
            ]
            kept = self.kept[program] = {}
            for i in dict.fromkeys((*read, *program.outputs)):
                if i in table and program.instructions[i].op not in ("constant", "parameter", *FLAGS):
                    kept[i] = indices.setdefault(table[i], parameters + len(indices))
            if program is divisors:
                tested = dict.fromkeys(table[ref] for ref in program.outputs if ref in table)
        self.size, zero = parameters + len(indices), len(merged)
        code = tuple(merged)
        if divisors is not None:
            tests = (Instruction("equal", (ref, zero)) for ref in tested)
            code = (*merged, Instruction("constant", value=0.0), *tests)
        outputs = (*indices, *range(zero + 1, len(code)))
        self.program = with_outputs(Program("prepare", (), parameters, (), 0, (), (), (0,)), code, outputs)


def checked(program: Program, divisors: Program) -> Program:
    """Return `program` with one more result, which is true if a divisor is zero and another result is not finite.

    The program `divisors` computes the matrix entries by which formulas of the accelerations divide. A zero divisor
    alone is not an error, because a simplified formula may not contain it.
    """
    code: dict[Instruction, int] = {}
    tables: tuple[list[int], list[int]] = ([], [])

    def put(instruction: Instruction) -> int:
        return code.setdefault(instruction, len(code))

    def add(*parts: Sequence[Instruction]) -> None:
        for table, part in zip(tables, parts, strict=True):
            for instruction in part:
                table.append(put(instruction._replace(args=tuple(table[arg] for arg in instruction.args))))

    add(program.instructions[: program.hoisted], divisors.instructions[: divisors.hoisted])
    hoisted = len(code)
    add(program.instructions[program.hoisted :], divisors.instructions[divisors.hoisted :])
    results = [tables[0][ref] for ref in program.outputs]
    zero = put(Instruction("constant", value=0.0))
    total, known = zero, list(code)
    for ref in results:
        if known[ref].op not in GIVEN:
            total = put(Instruction("add", (total, ref))) if total != zero else ref
    nothing = put(Instruction("mul", (zero, total)))
    not_finite = put(Instruction("not", (put(Instruction("equal", (nothing, zero))),)))
    singular = [put(Instruction("equal", (tables[1][ref], zero))) for ref in divisors.outputs]
    either = singular[0]
    for ref in singular[1:]:
        either = put(Instruction("or", (either, ref)))
    outputs = (*results, put(Instruction("and", (not_finite, either))))
    return with_outputs(program, tuple(code), outputs, hoisted)


@dataclass(frozen=True, eq=False)
class PrintedFunction:
    """The text of a printed function, in parts.

    `lines` are the lines of its body. `status` is the text of the condition that a matrix is singular. `needed` are
    the operations whose definitions the file needs, as keys. `declared` has the type, the name and the dimensions of
    each local variable. `unused` are the arguments that the function does not read.
    """

    lines: list[str]
    status: str
    needed: Mapping[str, None]
    declared: list[tuple[str, str, tuple[int, ...]]]
    unused: tuple[str, ...]


class PrintedFunctions:
    """Prints the functions of a module in a language: one for each quantity, and `prepare`, which fills the array p.

    With `statuses` the functions also test the divisors in their formulas, and report a zero as a singular matrix.
    """

    def __init__(self, module: SourceModule, language: Language, *, statuses: bool = True) -> None:
        self.module, self.language = module, language
        self.needed: dict[str, None] = {}
        """Operations that the printed functions use; "factor" if they solve linear systems."""
        self.divisors = module.divisors if statuses else None
        self.programs = {quantity.name: quantity.program for quantity in module.quantities}
        if self.divisors is not None:
            self.programs |= {
                name: checked(program, self.divisors) for name, program in self.programs.items() if name in SOLVED
            }
        listed = [*self.programs.values(), *([self.divisors] if self.divisors else [])]
        self.hoisted = Hoisted(listed, len(module.parameters), self.divisors)
        stated = (*module.state, *module.parameters, *module.names.entries)
        taken = [
            *language.reserved,
            *(name for name, _ in indices(module)),
            *(instruction for instruction in map(ascii_name, stated) if GENERATED.fullmatch(language.key(instruction))),
        ]
        names, first = distinct(stated, taken, key=language.key), len(module.state)
        last = first + len(module.parameters)
        self.names = replace(module.names, state=names[:first], parameters=names[first:last], entries=names[last:])

    def quantity(self, quantity: ExportedQuantity) -> PrintedFunction:
        """Return the printed function that computes an exported quantity, and writes its values into `out`."""
        program = self.programs[quantity.name]
        printer = StraightLinePrinter(program, self.language, self.names.of(program), self.hoisted.kept[program])
        return self._function(printer, "out", range(len(quantity.results)))

    def prepare(self) -> PrintedFunction:
        """Return the printed function that writes the parameters, and all values that depend on them alone, into p."""
        hoisted, count = self.hoisted, len(self.module.parameters)
        printer = StraightLinePrinter(
            hoisted.program, self.language, self.names.of(hoisted.program), parameters="parameters"
        )
        printer.lines += [self._stored("p", k, printer.element("parameters", k)) for k in range(count)]
        return self._function(printer, "p", range(count, hoisted.size))

    def _function(self, printer: StraightLinePrinter, array: str, indices: Sequence[int]) -> PrintedFunction:
        printer.values()
        stored, flags = printer.program.outputs[: len(indices)], printer.program.outputs[len(indices) :]
        lines = [self._stored(array, k, printer.number(ref)) for k, ref in zip(indices, stored, strict=True)]
        self.needed |= printer.needed
        status = printer.status(flags)
        written = [*printer.lines, *lines]
        unused = (*printer.unused, *([] if written else [array]))
        return PrintedFunction(written, status, printer.needed, printer.declared, unused)

    def _stored(self, array: str, index: int, value: str) -> str:
        name = self.language.element.format(array, index + self.language.first)
        return self.language.stored(name, value)
