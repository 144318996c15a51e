"""Pages that a notebook shows for reports, conserved quantities, equilibria, modes, linearizations, Hamiltonians."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import sympy

from lagrange.errors import counted
from lagrange.evidence.report import HEADINGS, Report
from lagrange.mechanics.conserved import Conserved
from lagrange.mechanics.equilibria import Equilibrium
from lagrange.mechanics.grading.comparison import EquationsComparison
from lagrange.mechanics.hamilton import Hamiltonian
from lagrange.mechanics.linearization import Linearization
from lagrange.mechanics.modes import Modes
from lagrange.show.notation.sections import ExpressionRows, Formula, ShownQuantity
from lagrange.show.notation.text import markdown_text
from lagrange.show.notebook.page_writer import MOST_SHOWN_OPERATIONS, PageWriter, Part, bold, folded, joined, left_out
from lagrange.statement.display import notebook_page

EXPRESSION = "`.expression` has it."
STABILITY = {True: "stable", False: "unstable", None: "stability not decided"}


@notebook_page.register
def report_page(report: Report) -> str:
    """Return the Markdown page of a check `report`: its verdict, with the table of comparisons under it.

    The table is folded if all comparisons pass.
    """
    head, *remarks = report.remarks()
    rows = [" | ".join(map(markdown_text, row.cells())) for row in report.rows]
    wrong = [f"| {text.replace('FAILS', '**FAILS**')} |" for text in rows]
    table = "\n".join([f"| {' | '.join(HEADINGS)} |", "|---" * len(HEADINGS) + "|", *wrong])
    verdict = f"{bold(report.title())}: {markdown_text(head)}"
    listed = "\n".join(f"- {markdown_text(remark.strip())}" for remark in remarks)
    parts: list[Part] = [("the verdict", verdict), ("the remarks", listed)]
    shown = folded(f"the {counted(len(rows), 'quantity').replace('quantitys', 'quantities')} compared", table)
    return joined([*parts, ("the table", shown if report else table)], "`print(report)` has all of it.")


@notebook_page.register
def comparison_page(comparison: EquationsComparison) -> str:
    """Return the Markdown page of a comparison of a student's equations with those of a system.

    It has the verdict, and a state at which the equations do not hold.
    """
    verdict = f"{bold('Right' if comparison else 'Wrong')}: {markdown_text(comparison.message)}"
    if not comparison.counterexample:
        return verdict
    values = "\n".join(f"| {markdown_text(name)} | {x:.6g} |" for name, x in comparison.counterexample.items())
    state = folded("a state at which it does not hold", f"| | value |\n|---|---|\n{values}")
    return joined([("the verdict", verdict), ("the state", state)], "`comparison.counterexample` has it.")


def conserved_parts(conserved: Conserved, writer: PageWriter) -> Iterator[Part]:
    """Yield the conserved quantity as a formula, and the reason why it is conserved."""
    name = f"{bold(conserved.name)}: {markdown_text(conserved.reason)}"
    yield conserved.name, f"{name}\n\n{writer.short(Formula((conserved.expression,)), conserved.name, EXPRESSION)}"


def equilibrium_parts(equilibrium: Equilibrium, writer: PageWriter) -> Iterator[Part]:
    """Yield one part of a page: the coordinates of the equilibrium, its stability with the reason, and its energy."""
    free = [q for q, x in equilibrium.coordinates.items() if q == x]
    values = {q: x for q, x in {**equilibrium.coordinates, **equilibrium.velocities}.items() if q != x}
    where = [writer.values(values)] if values else []
    where += [f"any {', '.join(map(writer.inline, free))}"] if free else []
    condition = "" if equilibrium.condition == sympy.true else f", where ${writer.condition(equilibrium.condition)}$"
    verdict = f"{STABILITY[equilibrium.stable]}: {markdown_text(equilibrium.reason)}"
    verdict += f" The energy there is {writer.inline(equilibrium.energy)}."
    yield "an equilibrium", f"{bold('Equilibrium')} {'; '.join(where)}{condition}, {verdict}"


def _modes(modes: Modes, writer: PageWriter) -> Iterator[Part]:
    """Yield parts of a page: the stability of the modes, then the frequency and the shape of each mode."""
    names = ", ".join(map(writer.inline, modes.coordinates))
    yield "the modes", f"{bold('Modes')} in {names}, {STABILITY[modes.stable]}: {markdown_text(modes.reason)}"
    for k, (frequency, decay, shape) in enumerate(zip(modes.frequencies, modes.decay, modes.shapes, strict=True), 1):
        slower = "" if decay == 0 else f",\\quad \\text{{decay }} {writer.side(_rounded(decay))}"
        name = f"mode {k}"
        if sum(int(x.count_ops()) for x in (frequency, *shape) if isinstance(x, sympy.Basic)) > MOST_SHOWN_OPERATIONS:
            yield name, left_out(name, "it is too long", "`.shapes` has it.")
            continue
        column = writer.side(ExpressionRows(tuple((_rounded(x),) for x in shape)))
        letter, number = f"\\omega_{{{k}}}", _number(frequency, modes, writer)
        rate = f"{letter} = {writer.side(_rounded(frequency))}"
        if len(rate) + len(column) < 160:  # the formula fits into a line
            yield name, f"$$\n{rate}{number}{slower},\\qquad {column}\n$$"
        else:
            head = f"{bold(f'Mode {k}')} ${letter}{number}$" if number else bold(f"Mode {k}")
            yield name, f"{head}\n\n$$\n{rate}{slower}\n$$\n\n$$\n{column}\n$$"


def _number(frequency: Any, modes: Modes, writer: PageWriter) -> str:
    """Return the LaTeX of "about" and the numerical value of a frequency of `modes`, to append to its formula.

    The result is "" if the frequency contains no symbol, and if one of its symbols has no value.
    """
    value = sympy.N(frequency.subs(modes.linearization.statement.defaults))
    if not (modes.symbolic and value.is_number and frequency.free_symbols):
        return ""
    return f" \\approx {writer.side(_rounded(value))}"


def _linearization(linear: Linearization, writer: PageWriter) -> Iterator[Part]:
    """Yield parts of the page of `linear`: its point, the matrices M, C and K, and the matrix of the inputs."""
    yield "the point", f"{bold('Linearization')} at {writer.values(linear.at)}. {markdown_text(linear.note)}"
    for name, matrix in {"M": linear.M, "C": linear.C, "K": linear.K, "input_matrix": linear.input_matrix}.items():
        if not len(matrix):
            continue
        if sum(int(x.count_ops()) for x in matrix) > MOST_SHOWN_OPERATIONS or max(matrix.shape) > 8:
            yield name, left_out(name, f"it has {matrix.rows} rows", f"`.{name}` has it.")
            continue
        letter = "F" if name == "input_matrix" else name
        rows = tuple(tuple(_rounded(x) for x in matrix.row(i)) for i in range(matrix.rows))
        yield name, f"$$\n{letter} = {writer.side(ExpressionRows(rows))}\n$$"


MOST_SIMPLIFIED = 60
"""Largest number of operations of a Hamiltonian whose equations are simplified for a notebook. That of the double
pendulum has 56, and takes 1 s."""


def _hamiltonian(hamiltonian: Hamiltonian, writer: PageWriter) -> Iterator[Part]:
    """Yield parts of a page: the Hamiltonian H, and Hamilton's equations unless H is too long."""
    energy = hamiltonian.expression
    yield (
        "the Hamiltonian",
        f"{bold('Hamiltonian')}\n\n{writer.short(Formula((ShownQuantity('H'), energy)), 'H', EXPRESSION)}",
    )
    if (size := int(energy.count_ops())) <= MOST_SIMPLIFIED:
        yield "Hamilton's equations", writer.equations("Hamilton's equations", hamiltonian.equations())
    else:
        why = f"H has {size} operations, whose derivatives take long to simplify"
        yield "", left_out("Hamilton's equations", why, "`print(*hamiltonian.equations(), sep='\\n')` has them.")


def _rounded(value: Any) -> Any:
    """Return the expression `value` with its decimal numbers rounded to six digits; exact numbers are unchanged."""
    if not isinstance(value, sympy.Expr):
        return value
    return value.xreplace({decimal: sympy.Float(f"{float(decimal):.6g}") for decimal in value.atoms(sympy.Float)})


def _register(kind: type, parts: Callable[[Any, PageWriter], Iterator[Part]], instead: str) -> None:
    """Register the notebook page for results of the class `kind`; `parts(result, writer)` yields its parts.

    A sentence replaces a part that is too long. It ends with `instead`, which says where the values are.
    """

    def page(result: Any) -> str:
        statement = (result.linearization if isinstance(result, Modes) else result).statement
        return joined(parts(result, PageWriter(statement)), instead)

    notebook_page.register(kind, page)


_register(Conserved, conserved_parts, EXPRESSION)
_register(Equilibrium, equilibrium_parts, "its fields have it.")
_register(Modes, _modes, "`.frequencies` and `.shapes` have all.")
_register(Linearization, _linearization, "its fields `.M`, `.C`, `.K`, `.A` and `.B` have all.")
_register(Hamiltonian, _hamiltonian, "`.expression`, `.momenta` and `.equations()` have all.")


class ResultList(list[Any]):
    """A list of conserved quantities or equilibria; a notebook shows each as a formula, with the reason for it."""

    def _repr_markdown_(self) -> str | None:
        if not self:
            return None
        writer = PageWriter(self[0].statement)
        parts = conserved_parts if isinstance(self[0], Conserved) else equilibrium_parts
        return joined((part for record in self for part in parts(record, writer)), "the fields of the record have it.")
