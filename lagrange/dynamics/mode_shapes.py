"""The shapes of modes as numbers, on the coordinates and on the stated positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from lagrange.errors import StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.mechanics.modes import Modes
from lagrange.mechanics.plain_form import PlainForm, number
from lagrange.statement.declare import ORIGIN
from lagrange.statement.statement import Statement


@dataclass(frozen=True, eq=False)
class ModeShapes:
    """Shapes of m modes about an equilibrium, each scaled so that its largest component is 1.

    `components` (m, n) are the displacements of the n coordinates in each mode, in the order of `names`.
    `frequencies` (m,) are complex for modes that do not oscillate. `decay` (m,) are the decay rates. `points` maps
    the name of each stated position to its value at the equilibrium, (2,) or (3,). `displacements` maps it to the
    displacements of the position in the modes, (m, 2) or (m, 3).
    """

    statement: Statement
    names: tuple[str, ...]
    frequencies: FloatArray
    decay: FloatArray
    components: FloatArray
    points: Mapping[str, FloatArray]
    displacements: Mapping[str, FloatArray]


def mode_shapes(modes: Modes, statement: Statement) -> ModeShapes:
    """Return the shapes and frequencies of symbolic `modes` as numbers, at the stated values of the parameters.

    Raises StatementError where a parameter has no value.
    """
    form, lin = PlainForm(statement), modes.linearization
    constants = statement.defaults
    missing = [p.name for p in statement.parameters if p not in statement.defaults]
    if missing:
        raise StatementError(
            f"shapes are drawn at values of the parameters, and {listing(missing)} "
            f"{'has' if len(missing) == 1 else 'have'} none: state {statement.name} with "
            f"parameters={{{missing[0]!r}: 1.0}}."
        )
    basis = np.array([[number(x, constants).real for x in row] for row in lin.basis.tolist()], dtype=float)
    raw = np.array([[number(x, constants) for x in shape] for shape in modes.shapes]) @ basis.T
    # The real part of each shape, after division by its largest component.
    largest = [row[int(np.argmax(np.abs(row)))] or 1.0 for row in raw]
    components = np.array([(row / x).real for row, x in zip(raw, largest, strict=True)])
    # The coordinates of the equilibrium as numbers.
    entries = [
        lin.at.get(q, lin.at.get(name, 0)) for q, name in zip(statement.coordinates, statement.names, strict=True)
    ]
    place = [sympy.Float(number(sympy.Integer(0) + x, constants).real, 17) for x in entries]
    by_symbol = dict(zip(form.q, place, strict=True))
    values = {**constants, **by_symbol, **dict.fromkeys(form.v, sympy.S.Zero)}
    points: dict[str, FloatArray] = {}
    displacements: dict[str, FloatArray] = {}
    for name, position in statement.positions.items():
        parts = [form.read(part) for part in position]
        slopes = np.array([[number(part.diff(q), values).real for q in form.q] for part in parts])
        points[name] = np.array([number(part, values).real for part in parts])
        displacements[name] = components @ slopes.T
    if points and any(ORIGIN in (link.start, link.end) for link in statement.links):
        size = len(next(iter(points.values())))
        points[ORIGIN], displacements[ORIGIN] = np.zeros(size), np.zeros((len(components), size))
    return ModeShapes(
        statement,
        statement.names,
        np.array([number(x, constants) for x in modes.frequencies]),
        np.array([number(x, constants).real for x in modes.decay]),
        components,
        points,
        displacements,
    )
