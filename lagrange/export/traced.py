"""Write Python modules for libraries that trace functions, such as JAX and CasADi, and their tests.

A library provides the spelling of every operation, and the text of two functions. `_factored(order, *lower)` returns
the factors of a symmetric matrix, and whether it is singular. `_solved(factors, *right)` returns the solution of a
linear system as a list.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from lagrange.algorithm.linear.symmetric import PIVOT, PREFERENCE
from lagrange.export.module import TEXT_WIDTH, SourceModule, commented, distinct, named_places, statement_comment
from lagrange.export.programs import Script, filled, helpers, marked, test_text
from lagrange.export.straight_line import Language, StraightLinePrinter
from lagrange.export.target import Target
from lagrange.machine.python_source import LITERALS as PYTHON_LITERALS
from lagrange.machine.python_source import RAISING
from lagrange.procedure.spelling import Operator
from lagrange.program.program import Program, ProgramBlock

OPERATORS: Mapping[str, Operator] = {
    op: RAISING[op] for op in ("neg", "add", "sub", "mul", "div", "fma", "less", "less_equal", "equal")
}
"""Operations that are spelled with Python's operators, the same in every library."""

LITERALS = replace(PYTHON_LITERALS, infinity='float("inf")', nan='float("nan")')

SCRIPT = Script("traced", comment=marked("#"), literals=LITERALS)

ELIMINATION = filled("traced", "elimination", pivot=PIVOT, preference=PREFERENCE, largest=sys.float_info.max)
"""Text of Python functions that solve linear systems by elimination with row exchanges, in a form that can be traced.
They call `_where`, `_both`, `_either`, `_most`, `_sqrt` and `_fixed` of a library. `_fixed` marks a value that does not
contribute to derivatives."""


@dataclass(frozen=True)
class Library:
    """A library of array functions: its spellings, and the texts of its files.

    - `systems` is the text of the functions for linear systems.
    - `results` are the templates of a result that is a number, a vector or a matrix.
    - `setting` is a line at the top of a module.

    The other texts are templates in the library's file. `head` is the beginning of a file. `functions` are the two
    functions of a program: one with its name, and one with the suffix _checked, which also returns whether a mass
    matrix is singular. `use` explains how the functions of a module are called, and `alone` explains this for a single
    function. `evaluated` is the function with which the test calls others, `evaluated(function, times, states)`.
    """

    language: Language
    systems: str
    results: tuple[str, str, str]
    setting: str = ""

    def text(self, name: str, /, **fields: object) -> str:
        """Return the library's template `name` with its fields replaced by `fields`."""
        return filled(self.language.name.lower(), name, **fields)

    def text_before(self, *programs: Program) -> str:
        """Return the beginning of a file for these programs: imports, and the helper functions that they need."""
        used = dict.fromkeys(instruction.op for program in programs for instruction in program.instructions)
        systems = [self.systems.strip()] if "factor" in used else []
        return "\n\n\n".join([self.text("head"), *self.language.definitions(used), *systems])

    def source(self, program: Program, name: str, about: Sequence[str] = ()) -> str:
        """Return the text of a file with the functions of one program; `about` are lines of its docstring.

        Raises StatementError for an operation that the library does not have.
        """
        title = f"{name}(t, y, p) for {self.language.name}: {described(program)}."
        alone = self.text("alone", name=name)
        text = "\n".join([title, "", alone, *(("", *about) if about else ())])
        return f'"""{text}\n"""\n\n{self.text_before(program)}\n\n\n{self.printed(program, name, {})}\n'

    def module(self, module: SourceModule) -> str:
        """Return the text of a module with the functions of all quantities."""
        names = replace(module.names, state=(), parameters=(), entries=distinct(module.names.entries))
        head, *helpers = self.text_before(*(quantity.program for quantity in module.quantities)).split("\n\n\n")
        lines = [
            *statement_comment(module, "#"),
            "",
            *head.splitlines(),
            "",
            *([self.setting, ""] if self.setting else []),
            f"STATE = {len(module.state)}  # numbers in y: coordinates, then velocities",
            f"PARAMETERS = {len(module.parameters)}  # numbers in p",
            *named_places(module, "p"),
            *commented(" ".join(self.text("use").split()), "#"),
            *(line for text in helpers for line in ("", "", *text.splitlines())),
        ]
        for quantity in module.quantities:
            lines += ["", "", *commented(f"{quantity.about} Results: {', '.join(quantity.results)}.", "#")]
            lines += self.printed(quantity.program, quantity.name, names.of(quantity.program)).splitlines()
        return "\n".join([*lines, ""])

    def printed(self, program: Program, name: str, names: Mapping[int, str]) -> str:
        """Return the text of the two functions of a program: `name`, and the one with the suffix _checked.

        The second one also returns whether a mass matrix is singular. `names` maps the index of an instruction to the
        name of its value.
        """
        printer = StraightLinePrinter(program, self.language, names)
        lines: list[str] = []
        for letter, count in (("y", program.states), ("p", program.parameters)):
            if count:
                lines += bracketed("(", [f"{letter}{i}" for i in range(count)], f"{',' * (count == 1)}) = {letter}")
        for line in printer.values():
            before, opened, after = line.partition("(")
            lines += bracketed(before + opened, after[:-1].split(", "), ")") if line[0] in "fs" else [line]
        lines += bracketed("results = [", [printer.text(ref) for ref in program.outputs], "]")
        return self.text(
            "functions",
            name=name,
            described=described(program),
            body=textwrap.indent("\n".join(lines), "    "),
            singular=printer.status(),
            states=program.states,
            parameters=program.parameters,
            results=self.results[len(program.shape)].format(program.shape),
        )


class TracedTarget(Target):
    """Base class of targets that write a Python module for the library `library`, and a test of the module."""

    library: ClassVar[Library]
    contents = frozenset()
    shell = ("python {name}_{program}.py",)

    def file_name(self, module: SourceModule) -> str:
        """Return the name of the module's file without .py: the name of the model and of the library."""
        return f"{module.name}_{self.name}"

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the module and of the self-test by file name."""
        name, library = self.file_name(module), self.library
        test = test_text(module, SCRIPT, file=name, evaluated=library.text("evaluated"))
        return {f"{name}.py": library.module(module), f"{name}_test.py": test}


def language(name: str, operations: Mapping[str, Operator]) -> Language:
    """Return the spellings of the library `name`; `operations` are the spellings of its operations."""
    return Language(
        name=name,
        operations=operations,
        literals=LITERALS,
        helpers=helpers(name.lower()),
        factor="{name}, {other} = _factored({order}, {entries})",
        solve="{name} = _solved({other}, {entries})",
    )


def bracketed(before: str, items: Sequence[str], after: str) -> list[str]:
    """Return the lines of a Python list or call: `before`, such as "f(", the items, and `after`, such as ")".

    If one line would be too long, the items are on several indented lines.
    """
    line = f"{before}{', '.join(items)}{after}"
    if len(line) <= TEXT_WIDTH:
        return [line]
    inside = textwrap.wrap(", ".join(items), TEXT_WIDTH - 4, break_long_words=False, break_on_hyphens=False)
    return [before, *(f"    {line}" for line in inside), after]


def described(program: Program) -> str:
    """Return one line of a docstring that lists the results and the arguments of a program."""
    inputs = ", ".join(map(block, program.inputs))
    shape = f" as {list(program.shape)}" if len(program.shape) > 1 else ""
    return f"[{', '.join(map(block, program.results))}]{shape}, of y = [{inputs}] and p[{program.parameters}]"


def block(named: ProgramBlock) -> str:
    """Return the description of a block of inputs or results: its name, and its size in brackets."""
    return f"{named.name}[{named.size}]"
