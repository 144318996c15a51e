"""What a run has over time: rows of numbers with their names and units, as panels draw them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from lagrange.errors import StatementError, listing
from lagrange.mechanics.invariants import MOST_LINES, invariant_sizes
from lagrange.show.figures.panel import entry
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.latex import LatexNotation
from lagrange.show.notation.names import letter_of
from lagrange.show.notation.text import AsciiNotation
from lagrange.show.units import energy_unit, unit_of
from lagrange.statement.coordinate import row_label
from lagrange.statement.expression import expression as expression_of
from lagrange.statement.statement import Statement
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

PANELS = 28
"""More coordinates than this share panels."""

_SHORT = 10
"""A longer name stands above its panel and not beside it."""

_LONGEST, _WIDEST = 120, 50
"""Letters of a formula in LaTeX, and in plain text, that still fits above a panel."""

Values = Callable[["Solution"], FloatArray]
"""Values (r, N) of a solution at its N outputs."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """Rows over time in one panel: what they are called, in mathematics or words, their unit, and their values.

    `name` is what stands above the panel; where it is empty the one label stands beside it. Where `drift` is set the
    values are how far something that should be constant has moved, which is a statement about the steps.
    """

    name: str
    labels: tuple[str, ...]
    values: Values
    unit: str = ""
    drift: bool = False


def coordinates(solution: Solution, chosen: Sequence[str], *, merged: bool = False) -> list[Quantity]:
    """Return the chosen coordinates, one to a panel unless there are many, or all in one."""
    return _entries(solution, chosen, merged=merged, rate=False)


def velocities(solution: Solution, chosen: Sequence[str], *, merged: bool = False) -> list[Quantity]:
    """Return the velocities of the chosen coordinates, one to a panel unless there are many, or all in one."""
    return _entries(solution, chosen, merged=merged, rate=True)


def _entries(solution: Solution, chosen: Sequence[str], *, merged: bool, rate: bool) -> list[Quantity]:
    together = len(chosen) if merged else ceil(len(chosen) / PANELS)
    groups = [chosen[k : k + together] for k in range(0, len(chosen), together)]
    return [_group(solution.model.statement, group, rate=rate) for group in groups]


def _group(statement: Statement, names: Sequence[str], *, rate: bool) -> Quantity:
    keys = [f"{name}_dot" if rate else name for name in names]
    units = list(dict.fromkeys(unit_of(statement, key) for key in keys))
    return Quantity(
        _above(names, rate=rate),
        tuple(f"${entry(statement, key)}$" for key in keys),
        lambda run: np.array([run[key] for key in keys]),
        units[0] if len(units) == 1 else "",
    )


def _above(names: Sequence[str], *, rate: bool) -> str:
    """Return what stands above the panel of some coordinates or their velocities: nothing over a short label."""
    what = "velocity of " if rate else ""
    if len(names) > 1:
        return f"{'velocities' if rate else 'coordinates'} {names[0]} to {names[-1]}"
    return "" if len(names[0]) <= _SHORT else f"{what}{names[0]}"


def energies(solution: Solution) -> Quantity:
    """Return T, V and E = v.p - L, or E alone where a Lagrangian was stated and not its parts."""
    statement = solution.model.statement
    parts = [("T", statement.kinetic), ("V", statement.potential)]
    stated = [] if statement.lagrangian_alone else parts

    def values(run: Solution) -> FloatArray:
        return np.array([*(run.evaluate(part) for _, part in stated), run.energy])

    labels = (*(f"${name}$" for name, _ in stated), "$E$")
    return Quantity("energies" if stated else "energy", labels, values, energy_unit(statement))


def energy(solution: Solution) -> Quantity:
    """Return the drift of an energy that is conserved, else the energy; no row where some state has none."""
    if not solution.has_energy:
        return Quantity("energy: it has no value at some state of the run", (), lambda run: np.empty((0, len(run.t))))
    drift = solution.drift
    if not drift.conserved:
        title = f"energy ({drift.unkept})"
        return Quantity(title, ("$E$",), lambda run: run.energy[None], energy_unit(solution.model.statement))
    scale = drift.scale if drift.scale > 0 else 1.0
    title = f"energy drift: (E − E₀) relative to {drift.against}"
    return Quantity(title, ("$E$",), lambda run: (run.energy[None] - drift.first) / scale, "", drift=True)


def momenta(solution: Solution) -> Quantity | None:
    """Return how far the momenta of ignorable coordinates are from their first values; None where there are none."""
    found = list(solution.momentum_drift)[:MOST_LINES]
    if not found:
        return None
    title = f"drift of {listing(found)} relative to the largest term"
    labels = tuple(f"${letter_of(name)}$" for name in found)
    return Quantity(title, labels, lambda run: np.array([run.momentum_drift[name] for name in found]), "", drift=True)


def invariants(solution: Solution) -> list[Quantity]:
    """Return how far each conserved quantity is from its first value, relative to the size of its terms."""
    sizes = invariant_sizes(solution.model, solution.t, solution.y, solution.parameters_at(solution.t))
    return [_invariant(name, values[0], sizes[name]) for name, values in solution.invariants.items()]


def _invariant(name: str, first: float, size: float) -> Quantity:
    scale, against = (size, " relative to the size of its terms") if size > 0 else (1.0, ", which is 0 at every output")

    def values(run: Solution) -> FloatArray:
        return np.asarray((run.invariants[name][None] - first) / scale)

    return Quantity(f"drift of {name}{against}", (name,), values, "", drift=True)


def multipliers(solution: Solution) -> list[Quantity]:
    """Return the multiplier of each constraint."""
    names = list(solution.multipliers)
    if not names:
        raise StatementError(f"{solution.model.statement.name} has no constraints, and so no multipliers to plot.")
    return [_multiplier(name) for name in names]


def _multiplier(name: str) -> Quantity:
    title = "" if len(name) <= _SHORT else f"multiplier of {name}"
    label = rf"$\lambda_{{{letter_of(name, literal=True)}}}$"
    return Quantity(title, (label,), lambda run: run.multipliers[name][None])


def violation(solution: Solution) -> Quantity:
    """Return the largest violation of the constraints, relative to the sizes of their terms."""
    if not solution.model.statement.constraints:
        raise StatementError(
            f"{solution.model.statement.name} has no constraints, and so no violation of them to plot."
        )
    title = "largest violation of a constraint, relative to its terms"
    return Quantity(title, ("violation",), lambda run: run.constraint_error[None], "", drift=True)


def expression(solution: Solution, given: Any) -> Quantity:
    """Return a SymPy expression in coordinates, velocities, accelerations, multipliers, parameters and t."""
    label = row_label(given)
    if label in solution.names:
        return _group(solution.model.statement, [label.removesuffix("_dot")], rate=label.endswith("_dot"))
    formula = expression_of(given, "what")
    solution.evaluate(formula)  # refuses what the system does not have
    text = formula_label(solution.model.statement, formula)
    return Quantity(text, (text,), lambda run: run.evaluate(formula)[None])


def formula_label(statement: Statement, given: Any) -> str:
    """Return an expression as mathematics that Matplotlib can set, or as short text."""
    formula = f"${Typesetter(statement, LatexNotation()).write(given)}$"
    if len(formula) <= _LONGEST and "\\begin" not in formula:
        return formula
    text = Typesetter(statement, AsciiNotation()).write(given)
    return text if len(text) <= _WIDEST else f"{text[:_WIDEST]} ..."
