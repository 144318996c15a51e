"""Follow equilibria along a parameter, with their eigenvalues and stability, for bifurcation diagrams.

Formulas of equilibria are evaluated at every value. Equilibria without formulas are searched numerically at three
values, the first, a middle one and the last, and followed from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.dynamics.axes import angles, difference
from lagrange.dynamics.runs import Report
from lagrange.errors import StatementError, counted
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.equilibria import Equilibrium, equilibria
from lagrange.mechanics.plain_form import number
from lagrange.mechanics.stability import eigenvalue_path, without_growth
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status

SAME_EQUILIBRIUM = 1e-6
"""Distance below which two equilibria are the same, relative to 1 plus their size."""


@dataclass(frozen=True, eq=False)
class EquilibriumBranch:
    """An equilibrium along a parameter: `coordinates` (k, n) and `eigenvalues` (k, 2n), NaN where it does not exist.

    `values` (k,) are the values of the parameter, with additional values where a formula begins or ceases to hold.
    `formula` maps coordinates to expressions; it is empty if the equilibrium was found numerically.
    """

    values: FloatArray
    coordinates: FloatArray
    eigenvalues: FloatArray
    formula: dict[Any, Any]

    @property
    def stable(self) -> FloatArray:
        """Stability, (k,): 0 if an eigenvalue has a positive real part, 1 if none has, NaN without an equilibrium.

        The value 1 is necessary for stability, but not sufficient.
        """
        exists = np.isfinite(self.eigenvalues).all(axis=1)
        return np.where(exists, without_growth(self.eigenvalues).astype(float), np.nan)


@dataclass(frozen=True, eq=False)
class BranchesData:
    """The `branches` of equilibria at `values` (k,) of a parameter.

    `axis` is the name of the coordinate that the picture shows. `status` is SUCCESS, or INTERRUPTED after Ctrl-C, and
    `message` gives the number of branches.
    """

    statement: Statement
    parameter: str
    values: FloatArray
    branches: tuple[EquilibriumBranch, ...]
    axis: str
    status: Status
    message: str


TIP = 12  # Number of values added next to a value at which a formula begins to hold


def equilibrium_branches(
    model: Model, parameter: str, values: FloatArray, progress: Report | None = None
) -> BranchesData:
    """Return the branches of equilibria at values (k,) of a parameter.

    `progress` is called with the number of finished searches. Raises StatementError if there is no equilibrium.
    """
    statement = model.statement
    symbol = next(p for p in statement.parameters if p.name == parameter)
    anchors = list(dict.fromkeys((0, len(values) // 2, len(values) - 1)))
    branches: list[EquilibriumBranch] = []
    interrupted, refusal = False, ""
    turns = angles(statement)
    try:
        for count, anchor in enumerate(anchors):
            anchored = model.with_defaults({symbol: float(values[anchor])})
            try:
                anchor_equilibria = equilibria(anchored.statement, None)
            except StatementError as error:
                refusal = str(error)
                continue
            for equilibrium in anchor_equilibria:
                refusal = _add(branches, equilibrium, anchored, (parameter, values, anchor), turns) or refusal
            if progress is not None:
                progress(float(count + 1))
            if all(equilibrium.exact for equilibrium in anchor_equilibria):
                break
    except KeyboardInterrupt:
        interrupted = True
    if not branches and not interrupted:
        raise StatementError(refusal or f"{statement.name} has no equilibrium at these values of {parameter}.")
    words = f"{counted(len(branches), 'branch')} of equilibria.".replace("branchs", "branches")
    return BranchesData(
        statement=statement,
        parameter=parameter,
        values=values,
        branches=tuple(branches),
        axis=_axis(statement, branches),
        status=Status.INTERRUPTED if interrupted else Status.SUCCESS,
        message=f"interrupted: {words[:-1]} were computed and are kept." if interrupted else words,
    )


def _add(
    branches: list[EquilibriumBranch],
    equilibrium: Equilibrium,
    model: Model,
    along: tuple[str, FloatArray, int],
    turns: tuple[bool, ...],
) -> str:
    """Follow an equilibrium along a parameter, and append its branch to `branches` unless it is already there.

    Returns the reason if there are no eigenvalues, as at a jump of a force, else "". `along` has the name of the
    parameter, its values, and the index of the value at which the equilibrium was found. From this value it is followed
    in both directions. `turns` has True for each coordinate that is an angle.
    """
    refusal = ""
    statement, (parameter, values, anchor) = model.statement, along
    n = len(statement.coordinates)
    if equilibrium.exact:
        values = _with_ends(equilibrium, statement, parameter, values)
    coordinates = np.full((len(values), n), np.nan)
    eigenvalues = np.full((len(values), 2 * n), complex("nan"))
    ways = (
        [np.arange(len(values))] if equilibrium.exact else [np.arange(anchor, len(values)), np.arange(anchor, -1, -1)]
    )
    for way in ways:
        try:
            path = eigenvalue_path(statement, parameter, values[way], equilibrium.at, model)
        except StatementError as error:
            if statement.constraints:
                raise StatementError(str(error)) from error
            refusal = str(error)
            continue
        coordinates[way], eigenvalues[way] = path.equilibria, path.eigenvalues
    if not np.isfinite(coordinates).any():
        return refusal
    for other in branches:
        if len(other.values) != len(values) or (other.values != values).any():
            continue
        both = np.isfinite(other.coordinates).all(axis=1) & np.isfinite(coordinates).all(axis=1)
        distance = np.abs(difference(other.coordinates[both], coordinates[both], turns))
        alone = np.isfinite(coordinates).all(axis=1) & ~np.isfinite(other.coordinates).all(axis=1)
        if both.any() and not alone.any() and (distance <= SAME_EQUILIBRIUM * (1 + np.abs(coordinates[both]))).all():
            return ""
    branches.append(
        EquilibriumBranch(values, coordinates, eigenvalues, dict(equilibrium.coordinates) if equilibrium.exact else {})
    )
    return ""


def _with_ends(equilibrium: Equilibrium, statement: Statement, parameter: str, values: FloatArray) -> FloatArray:
    """Return the `values` of a parameter, with more values where an equilibrium begins or ceases to exist.

    There its coordinates may have an infinite slope, as a square root has. So the distances of the additional values
    from such a value grow as squares. `parameter` is the name of the parameter.
    """
    chosen = next(p for p in statement.parameters if p.name == parameter)

    def exists(value: float) -> bool:
        coordinates = [number(x, {**statement.defaults, chosen: value}) for x in equilibrium.at.values()]
        return all(x == x and abs(x.imag) < 1e-12 for x in coordinates)

    real = [exists(value) for value in values.tolist()]
    more = []
    for a, b, before, after in zip(values[:-1].tolist(), values[1:].tolist(), real[:-1], real[1:], strict=True):
        if before is after:
            continue
        outside, inside = (a, b) if after else (b, a)
        for _ in range(50):
            middle = outside + (inside - outside) / 2
            outside, inside = (outside, middle) if exists(middle) else (middle, inside)
        rest = b if after else a
        more += (inside + (rest - inside) * np.linspace(0.0, 1.0, TIP, endpoint=False) ** 2).tolist()
    order = 1 if values[-1] >= values[0] else -1
    return np.array(sorted({*values.tolist(), *more}, key=lambda value: order * value))


def _axis(statement: Statement, branches: Sequence[EquilibriumBranch]) -> str:
    """Return the name of the coordinate in which the `branches` differ most, for the vertical axis of the diagram.

    Without branches it is the first coordinate.
    """
    if not branches:
        return statement.names[0]
    whole = np.concatenate([branch.coordinates for branch in branches])
    whole = whole[np.isfinite(whole).all(axis=1)]
    return statement.names[int(np.argmax(np.ptp(whole, axis=0)))]
