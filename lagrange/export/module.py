"""Data of an exported file that all languages share: functions, tests, legal names, comments, and broken lines."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from typing import Any

from sympy import count_ops
from sympy.printing.str import StrPrinter

from lagrange.algorithm.constants import Outcome
from lagrange.procedure.form import Array, Procedure, Record, ReserveRecord, inner
from lagrange.program.program import Instruction, Program
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.text import Notation
from lagrange.statement.coordinate import name_of
from lagrange.statement.event import Event
from lagrange.statement.statement import Statement, unit_of
from lagrange.statement.vocabulary.letters import GREEK


@dataclass(frozen=True, eq=False)
class ExportedQuantity:
    """An exported function of time, state and the array p of values that depend on parameters alone.

    `results` are the names of its results in C order, `shape` is the shape of their array, and `unit` their common
    unit. `program` has the operations of the function, for languages without loops. `procedure` is the same function
    for the other languages. `about` describes the function in the exported file.
    """

    name: str
    about: str
    program: Program
    procedure: Procedure
    results: tuple[str, ...]
    shape: tuple[int, ...]
    unit: str = ""


@dataclass(frozen=True, eq=False)
class ExportedIntegrator:
    """An exported integrator: a function for one step, or for a run to an end time if `adaptive`.

    The exported function has the parameters of `procedure`.
    """

    name: str
    procedure: Procedure
    adaptive: bool


@dataclass(frozen=True, eq=False)
class ValueNames:
    """Names for values in an exported file: of the state, of parameters, and of matrix entries.

    `matrix` is the program whose results are the matrix entries of the linear system for the accelerations; `entries`
    are the names of these results. If `state` or `parameters` is empty, its values get no names.
    """

    state: tuple[str, ...]
    parameters: tuple[str, ...]
    entries: tuple[str, ...]
    matrix: Program

    def of(self, program: Program) -> dict[int, str]:
        """Return the names of values in a program, by the index of the instruction that computes or reads the value."""
        numbers: dict[Instruction, int] = {}
        entries, values = numbered(self.matrix, numbers), numbered(program, numbers)
        matrix = {entries[ref]: name for ref, name in zip(self.matrix.outputs, self.entries, strict=True)}
        stated = {"state": self.state, "parameter": self.parameters, "constant": (), "time": ()}
        names = {}
        for ref, instruction in enumerate(program.instructions):
            if instruction.op not in stated and values[ref] in matrix:
                names[ref] = matrix[values[ref]]
            elif instruction.place < len(stated.get(instruction.op, ())):
                names[ref] = stated[instruction.op][instruction.place]
        return names


def numbered(program: Program, numbers: dict[Instruction, int]) -> list[int]:
    """Return a number for each instruction of a program; instructions with equal values have the same number.

    `numbers` has the numbers of the instructions of earlier programs; new instructions are added to it.
    """
    result: list[int] = []
    for instruction in program.instructions:
        moved = instruction._replace(args=tuple(result[arg] for arg in instruction.args))
        result.append(numbers.setdefault(moved, len(numbers)))
    return result


@dataclass(frozen=True)
class Check:
    """The test of a quantity with k results at s states of 2n numbers.

    `times` is (s,), `states` (s, 2n), the expected `results` (s, k), and the `allowed` absolute errors (s, k).
    """

    name: str
    times: tuple[float, ...]
    states: tuple[tuple[float, ...], ...]
    results: tuple[tuple[float, ...], ...]
    allowed: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class StepCheck:
    """The test of an integrator, which starts from `state` (2n,) at `time` and has to reach `result` (2n,).

    `length` is the step, or the duration of a run with error control. `allowed` (2n,) are the allowed absolute errors.
    """

    name: str
    time: float
    length: float
    state: tuple[float, ...]
    result: tuple[float, ...]
    allowed: tuple[float, ...]


@dataclass(frozen=True)
class ExportedRun:
    """The run of the exported program `main` from the state `initial` (2n,) to `t_end`, with the tolerance `rtol`.

    `main` prints a table of `intervals` + 1 rows.
    """

    initial: tuple[float, ...]
    t_end: float
    intervals: int
    rtol: float


@dataclass(frozen=True, eq=False)
class SourceModule:
    """The content of an exported file, before it is written in a language.

    - `about` is the description of the system, or "". `statement` are lines of text about the system.
    - `state` and `parameters` are the names of the entries of the arrays `y` and `parameters`, as stated.
    - `values` are the values of the parameters, `inputs` the names of the parameters that may change during a run.
    - `units` are the stated units of state, parameters and t.
    - `names` are the names of values in the formulas.
    - `prepare` fills the array p of `prepared` numbers: the parameters, then all values that depend on parameters
      alone.
    - `divisors` computes the matrix entries by which formulas of the accelerations divide, to test them for zero.
    """

    name: str
    statement: tuple[str, ...]
    state: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    units: Mapping[str, str]
    names: ValueNames
    prepare: Procedure
    prepared: int
    quantities: tuple[ExportedQuantity, ...]
    integrators: tuple[ExportedIntegrator, ...] = ()
    checks: tuple[Check, ...] = ()
    step_checks: tuple[StepCheck, ...] = ()
    run: ExportedRun | None = None
    inputs: tuple[str, ...] = ()
    divisors: Program | None = None
    about: str = ""

    def quantity(self, name: str) -> ExportedQuantity | None:
        """Return a quantity by name, or None if it is not exported."""
        return next((candidate for candidate in self.quantities if candidate.name == name), None)

    @property
    def public(self) -> tuple[Procedure, ...]:
        """The procedures that a user calls, in order."""
        functions = [quantity.procedure for quantity in self.quantities]
        return (self.prepare, *functions, *(quantity.procedure for quantity in self.integrators))

    @property
    def procedures(self) -> tuple[Procedure, ...]:
        """All procedures of the file; callees come before their callers."""
        ordered: dict[Procedure, None] = {}
        for procedure in self.public:
            ordered |= dict.fromkeys((*procedure.callees, procedure))
        return tuple(ordered)


LONGEST_NAME = 63  # Longest name: the number of characters that C and Fortran distinguish


def ascii_name(name: str) -> str:
    """Return a name of ASCII letters, digits and underscores that begins with a letter: "θ1" becomes "theta1"."""
    spelled = "".join(map(spelled_letter, name))
    plain = re.sub(r"[^A-Za-z0-9]+", "_", spelled).strip("_")
    return (plain if plain[:1].isalpha() else f"x{plain}")[:LONGEST_NAME]


def spelled_letter(letter: str) -> str:
    """Return a letter in ASCII: a Greek letter by its name, an accented one without its accent."""
    bare = unicodedata.normalize("NFD", letter)[0]
    if bare in GREEK or bare.isascii():
        return GREEK.get(bare, bare)
    words = unicodedata.name(bare, "").split()
    return words[-1].lower() if words[:1] == ["GREEK"] else letter


def distinct(
    names: Sequence[str], reserved: Iterable[str] = (), *, key: Callable[[str], str] = lambda name: name
) -> tuple[str, ...]:
    """Return a distinct legal name for each of `names`; a name that is taken or reserved gets a number as suffix.

    Two names count as equal if `key` maps them to the same text: `str.lower` for a language that ignores case.
    """
    taken, legal_names = {key(word) for word in reserved}, []
    for name in names:
        plain = ascii_name(name)
        legal, count = plain, 2
        while key(legal) in taken:
            tail = f"_{count}"
            legal, count = plain[: LONGEST_NAME - len(tail)] + tail, count + 1
        taken.add(key(legal))
        legal_names.append(legal)
    return tuple(legal_names)


TEXT_WIDTH = 110  # Largest length of a line of comment, or of the head of a function, in exported files


DEFAULT_LINE_LENGTH = 120  # Default limit of characters per line, for languages without a limit


def continued(line: str, room: int = DEFAULT_LINE_LENGTH, mark: str = "") -> list[str]:
    """Return a statement as lines of at most `room` characters, broken at spaces; all but the last end with `mark`.

    A line without a space to break at stays longer.
    """
    indent, lines = " " * (len(line) - len(line.lstrip()) + 4), []
    while len(line) > room:
        cut = line.rfind(" ", len(indent), room - len(mark))
        if cut < 0:
            break
        lines.append(f"{line[:cut]} {mark}".rstrip())
        line = indent + line[cut + 1 :]
    return [*lines, line]


def number_lines(values: Iterable[str], indent: str, end: str = ",") -> list[str]:
    """Return number literals on indented lines of at most `TEXT_WIDTH` characters; `end`, a comma, follows each."""
    text = " ".join(f"{value}{end}" for value in values)
    return [f"{indent}{line}" for line in textwrap.wrap(text, TEXT_WIDTH - len(indent), break_long_words=False)]


TOGETHER, KEPT = "\N{NO-BREAK SPACE}", "\x1f"
"""A space at which no line is broken, and the character that replaces this space while lines are broken."""


def plain(text: str) -> str:
    """Return a text in ASCII that cannot end a comment; Greek letters are spelled by name."""
    spelled = "".join(map(spelled_letter, text))
    ascii_only = unicodedata.normalize("NFKD", spelled).encode("ascii", "replace").decode("ascii")
    printable = "".join(letter if letter.isprintable() else " " for letter in ascii_only)
    return printable.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def wrapped(text: str, width: int) -> list[str]:
    """Return a text as lines of at most `width` characters, at least one line; continuation lines are indented."""
    ascii_text = KEPT.join(map(plain, text.split(TOGETHER)))
    lines = textwrap.wrap(ascii_text, width, subsequent_indent="  ", break_long_words=False)
    return [line.replace(KEPT, " ") for line in lines] or [""]


def commented(text: str, mark: str, width: int = 110) -> list[str]:
    """Return a text as comment lines that begin with a mark, such as "//"."""
    return [f"{mark} {line}".rstrip() for line in wrapped(text, width - len(mark) - 1)]


TEST = (
    "The test: results at some states, computed with 40 digits. A result may be off by 1e-12 of itself; where it is a "
    "small difference of large numbers, by 1e-12 of the largest one at that state."
)
"""Comment at the top of an exported self-test: the compared results, and the allowed errors."""


def places(array: str, names: Sequence[str], element: str = "{0}[{1}]", first: int = 0) -> str:
    """Return the names of the entries of an array with their indices, such as "y[0] theta, y[1] theta_dot".

    `element` is the template of an entry in the language, and `first` the index of the first entry.
    """
    shown = [f"{element.format(array, k)}{TOGETHER}{name}" for k, name in enumerate(names, first)]
    return ", ".join(shown) or f"{array} is empty"


def named_places(module: SourceModule, array: str) -> Iterator[str]:
    """Yield lines of an exported Python file: names, indices and default values of states and parameters.

    `array` is the name of the array of parameters in the comments.
    """
    yield ""
    yield from commented(places("y", module.state), "#")
    yield from commented(places(array, module.parameters), "#")
    for name, names in (("STATE_NAMES", module.state), ("PARAMETER_NAMES", module.parameters)):
        yield f"{name} = {tuple(names)!a}"
    yield f"DEFAULT_PARAMETERS = {module.values!a}"
    yield from (f"{name} = {k}" for name, k in indices(module))
    yield ""


OUTCOMES: Mapping[Outcome, str] = {
    Outcome.DONE: "done",
    Outcome.PAUSED: "max_steps reached",
    Outcome.NON_FINITE: "the state is not finite",
    Outcome.SINGULAR: "a matrix is singular",
    Outcome.STEP_TOO_SMALL: "the step became too small",
    Outcome.DIVERGED: "Newton's method diverged",
    Outcome.UNPROJECTED: "the state could not be moved onto the constraints",
}
"""Meaning of the codes that integrators return."""


def statement_comment(module: SourceModule, mark: str) -> list[str]:
    """Return the comment at the top of a file, the statement of the system; each line begins with `mark`."""
    return [f"{mark} {plain(line)}".rstrip() for line in module.statement]


def statuses(regular: str, singular: str) -> str:
    """Return a comment for an exported file on the status that the functions of quantities return.

    `regular` and `singular` are the spellings of the status if all matrices are regular, and if a matrix is singular.
    """
    return (
        f"Each function of t, y and p returns {regular}, or {singular} where a matrix is singular to round-off: out is "
        "then not to be used."
    )


def outcome_codes() -> list[tuple[str, int, str]]:
    """Return the name, the number and the meaning of each code that integrators return, such as "NON_FINITE"."""
    return [(code.name, int(code), text) for code, text in OUTCOMES.items()]


def indices(module: SourceModule, first: int = 0) -> list[tuple[str, int]]:
    """Return pairs of a constant's name and an index of a state or a parameter: ("Y_THETA", 0), ("PARAMETER_M", 0).

    `first` is the index of the first entry of an array in the language.
    """
    named = [*((f"Y_{name}", k) for k, name in enumerate(module.state, first))]
    named += [(f"PARAMETER_{name}", k) for k, name in enumerate(module.parameters, first)]
    names = distinct([name for name, _ in named], key=str.upper)
    return [(name.upper(), k) for name, (_, k) in zip(names, named, strict=True)]


def about_of(module: SourceModule, procedure: Procedure) -> str:
    """Return the description of a public function; for a quantity, with the names of its results."""
    quantity = next((candidate for candidate in module.quantities if candidate.procedure is procedure), None)
    if quantity is None:
        return procedure.about
    return f"{quantity.about} out: {', '.join(quantity.results)}."


def sizes(module: SourceModule, prepared: int | None = None) -> list[tuple[str, int, str]]:
    """Return the lengths of all arrays as tuples (name, length, description of the entries).

    `prepared` is the length of p, the array of values that depend on parameters alone. None means `module.prepared`.
    """
    length = module.prepared if prepared is None else prepared
    return [
        ("state", len(module.state), "numbers in y: coordinates, then velocities"),
        ("parameters", len(module.parameters), "numbers in parameters"),
        ("prepared", max(length, 1), "numbers in p: parameters, and what depends on them alone"),
        *(
            (quantity.name, len(quantity.results), f"numbers in out of {quantity.name}")
            for quantity in module.quantities
        ),
    ]


def lengths(module: SourceModule, procedure: Procedure) -> dict[str, int]:
    """Return the number of entries that a public function uses of each array argument, by the argument's name."""
    arrays = {parameter.name: parameter.type for parameter in procedure.parameters if isinstance(parameter.type, Array)}
    sizes_by_name = {name: module.prepared if kind.size is None else kind.size for name, kind in arrays.items()}
    return {name: length for name, length in sizes_by_name.items() if length}


def columns(module: SourceModule) -> str:
    """Return the header line of the table that `main` writes: the names of its columns."""
    return ",".join(["t", *map(plain, module.state)])


def run_of(module: SourceModule) -> tuple[ExportedRun, ExportedIntegrator]:
    """Return the run of the exported program `main`, and its integrator, the first one with error control.

    The module must have a run.
    """
    assert module.run is not None
    return module.run, next(integrator for integrator in module.integrators if integrator.adaptive)


def records_of(procedures: Sequence[Procedure]) -> list[Record]:
    """Return the types of records (structs) that the procedures use, each once."""
    records: dict[Record, None] = {}
    for procedure in procedures:
        records |= dict.fromkeys(
            parameter.type for parameter in procedure.parameters if isinstance(parameter.type, Record)
        )
        blocks = [procedure.body]
        while blocks:
            for statement in blocks.pop():
                if isinstance(statement, ReserveRecord):
                    records[statement.record] = None
                blocks += inner(statement)
    return list(records)


COMMENT_WIDTH = 104

INPUTS = (
    "the last parameters. Prepared numbers do not depend on them: these entries of p may be changed before every call. "
    "A run keeps them constant."
)
"""Comment for an exported file on the inputs: the known functions of time whose values the caller sets."""

LONG_TERM = 300
"""Terms with more operations than this are printed in SymPy's order: textbook order takes seconds for thousands of
operations."""


LICENSE = "BSD-3-Clause"  # License of the texts of this package in exported files; the equations belong to the user


def generator() -> str:
    """Return the name and the version of this package."""
    return f"lagrange {version('lagrange-mechanics')}"


def statement_lines(statement: Statement, events: Sequence[Event] = ()) -> Iterator[str]:
    """Yield the statement of a system as lines for a comment: name, version, license, energies, forces, constraints.

    Events, coordinates, and parameters with values and units follow. Known functions of time appear by name.
    """
    inputs = [symbol.name for symbol, _ in statement.inputs]
    statement = statement.open_form or statement
    write = _writer(statement)
    yield from wrapped(f"{statement.name}: equations of motion, made by {generator()}", COMMENT_WIDTH)
    yield f"SPDX-License-Identifier: {LICENSE}"
    if statement.about:
        yield from wrapped(statement.about, COMMENT_WIDTH)
    yield ""
    if statement.kinetic is None or statement.potential is None:
        yield from _formula("L", write(statement.lagrangian))
    else:
        yield from _formula("T", write(statement.kinetic))
        yield from _formula("V", write(statement.potential))
    for name, force in zip(statement.names, statement.forces, strict=True):
        if force != 0:
            yield from _formula(f"force on {name}", write(force))
    if statement.dissipation != 0:
        yield from _formula("D", write(statement.dissipation))
    for constraint in statement.constraints:
        yield from _formula(f"constraint {constraint.name}", f"{write(constraint.expression)} = 0")
    for motion in statement.known_motions:
        yield from wrapped(
            motion if isinstance(motion, str) else f"{name_of(motion[0])} = {write(motion[1])}", COMMENT_WIDTH
        )
    for k, event in enumerate(events):
        yield from _formula(f"event{k}", f"{write(event.expression)}{_event_note(event, write)}")
    yield ""
    values = [_with_unit(statement, p.name, statement.defaults.get(p)) for p in statement.parameters]
    for title, parts in (
        ("coordinates", [_with_unit(statement, name) for name in statement.names]),
        ("parameters", values),
    ):
        yield from wrapped(f"{title}: {', '.join(parts) or 'none'}", COMMENT_WIDTH)
    if inputs:
        yield from wrapped(f"inputs: {', '.join(inputs)}: {INPUTS}", COMMENT_WIDTH)


def _event_note(event: Event, write: Callable[[Any], str]) -> str:
    """Return the text after the expression of an event: its direction, its reset, and whether it ends the run."""
    notes = [{1: "rising", -1: "falling"}[event.direction]] if event.direction else []
    if event.terminal > 0:
        notes.append(f"terminal at occurrence {event.terminal}")
    notes += [f"reset {write(key)} to {write(value)}" for key, value in event.reset.items()]
    if not notes:
        return ""
    return f" ({', '.join(notes)}{'; the reset is not exported' if event.reset else ''})"


def _writer(statement: Statement) -> Callable[[Any], str]:
    """Return the function that writes an expression as text: in textbook order, or a long one in SymPy's order."""
    booklike = cache(lambda: Typesetter(statement, Notation()))
    printer, plain = StrPrinter({"order": "none"}), statement.plain

    def named(fallback: Callable[[Any], str]) -> Callable[[Any], str]:
        return lambda node: plain[node].name if node in plain else fallback(node)

    # Long expressions are not rewritten in plain symbols first: SymPy needs seconds for that.
    printer._print_AppliedUndef = named(printer._print_Function)
    printer._print_Derivative = named(printer.emptyPrinter)

    def write(expression: Any) -> str:
        if count_ops(expression) <= LONG_TERM:
            return booklike().write(expression)
        return str(printer.doprint(expression))

    return write


def _formula(name: str, text: str) -> list[str]:
    return wrapped(f"{name} = {text}", COMMENT_WIDTH)


def _with_unit(statement: Statement, name: str, value: float | None = None) -> str:
    written, unit = "" if value is None else f" = {value!r}", unit_of(statement, name)
    return f"{name}{written} [{unit}]" if unit else f"{name}{written}"
