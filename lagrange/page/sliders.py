"""Sliders of a page: bounds chosen by the user, which are checked, and default bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.dynamics.axes import TURN, angles
from lagrange.errors import RunError, StatementError, listing, shown, suggestion
from lagrange.machine.model import Model
from lagrange.show.units import unit_of
from lagrange.statement.coordinate import name_of
from lagrange.statement.declare import state_rows
from lagrange.statement.expression import entries, real_number
from lagrange.statement.parameters import label_of
from lagrange.statement.rotation import rotation_of
from lagrange.statement.space import body_rates
from lagrange.statement.statement import Statement

PARAMETER, STATE, RATE = "parameter", "state", "rate"
"""Kinds of sliders: for a parameter, an entry of the initial state, or an initial rate about an axis of a body."""

EXAMPLE = (0.5, 2.0)
"""Example of bounds in an error message."""


@dataclass(frozen=True)
class Slider:
    """A value that a slider changes, with its bounds `low` and `high`.

    `kind` says whether it is a parameter, an entry of the initial state, or a rate of a body. `place` is its index
    among the parameters, in the initial state, or among the rates about the axes of all bodies, three for each body.
    `chosen` is true if the user chose it by name; `angle` is true if the value is in radians.
    """

    name: str
    kind: str
    place: int
    value: float
    low: float
    high: float
    unit: str
    chosen: bool
    angle: bool = False


def places(statement: Statement) -> dict[str, tuple[str, int]]:
    """Return the (kind, index) of each value that may have a slider, by name: parameters, rates and the state."""
    parameters = {p.name: (PARAMETER, index) for index, p in enumerate(statement.parameters)}
    rates = {name_of(rate): (RATE, index) for index, rate in enumerate(_rates_of(statement))}
    return parameters | rates | {name: (STATE, index) for index, name in enumerate(statement.state_names)}


def _rates_of(statement: Statement) -> list[Any]:
    """Return the symbols of the rates of rotation about the axes of all bodies, three for each body."""
    return [rate for name in statement.rotations for rate in rotation_of(name).body]


def quaternion_rows(statement: Statement) -> list[list[int]]:
    """Return for each body the rows of its quaternion in the state."""
    return [[statement.coordinates.index(q) for q in rotation_of(name).quaternion] for name in statement.rotations]


def rates_at(statement: Statement, state: Sequence[float]) -> list[float]:
    """Return the rates of rotation about the axes of all bodies at a state (2n,), three for each body."""
    n, rates = len(statement.coordinates), list[float]()
    for rows in quaternion_rows(statement):
        rates += body_rates([state[row] for row in rows], [state[n + row] for row in rows])
    return rates


def asked_bounds(statement: Statement, asked: Any) -> dict[str, tuple[float, float]]:
    """Return the bounds of the sliders that the user chose, by name. `asked` is a dict by symbol or name.

    Raises StatementError for a name that is not a parameter, coordinate or velocity, and for invalid bounds.
    """
    if asked is None:
        return {}
    if not isinstance(asked, Mapping):
        raise StatementError(
            f"{shown(asked)} says no sliders: give a dict from names to bounds, such as {{'l': {EXAMPLE}}}."
        )
    states = statement.state_names
    rows = {key: states[row] for key, row in state_rows(statement.coordinates).items()}
    rates = {key: name_of(rate) for rate in _rates_of(statement) for key in (rate, name_of(rate))}
    names = {**{key: p.name for p in statement.parameters for key in (p, p.name)}, **rates, **rows}
    result: dict[str, tuple[float, float]] = {}
    for key, pair in asked.items():
        name = names.get(key)
        if name is None:
            known = list(places(statement))
            raise StatementError(
                f"there is no slider of {shown(label_of(key))}, which is not a parameter, coordinate or velocity of "
                f"{statement.name}: they are {listing(known)}.{suggestion(label_of(key), known)}"
            )
        result[name] = _bounds(name, pair)
    return result


def _bounds(name: str, pair: Any) -> tuple[float, float]:
    listed = None if isinstance(pair, (str, bytes, Mapping, set, frozenset)) else entries(pair, f"the slider of {name}")
    if listed is None or len(listed) != 2:
        raise StatementError(
            f"the slider of {name} is {shown(pair)}: give its lower and its upper bound, such as {EXAMPLE}."
        )
    low, high = (real_number(bound, f"a bound of the slider of {name}") for bound in listed)
    if low == high:
        such = (-1.0, 1.0) if low == 0 else tuple(sorted((low / 2, low * 2)))
        raise StatementError(
            f"the slider of {name} goes from {low:g} to {high:g}, and has no room to move: give a lower and an upper "
            f"bound, such as {such}."
        )
    if low > high:
        raise StatementError(
            f"the slider of {name} goes from {low:g} to {high:g}: give the lower bound first, ({high:g}, {low:g})."
        )
    return low, high


NICE = (1.0, 2.0, 3.0, 5.0, 10.0)
"""First digits of default bounds."""

LOWEST, HIGHEST = 0.1, 3.0
"""Bounds of a parameter as multiples of its value. A lower bound of zero would often leave a system without inertia."""

COORDINATE_RANGE = 0.9
"""Half-range of a coordinate with a nonzero start, as a fraction of its value: its sign stays the same."""


def sliders(
    model: Model, parameters: tuple[float, ...], initial: tuple[float, ...], asked: Mapping[Any, Any] | None
) -> tuple[Slider, ...]:
    """Return a slider for each parameter and each entry of the initial state, those in `asked` first.

    `asked` maps symbols or names to bounds (low, high). For a body the sliders change its rates about its axes, not its
    quaternion, unless `asked` names entries of the quaternion. Raises StatementError for unknown names, and for bounds
    that do not contain the present value.
    """
    statement = model.statement
    bounds = asked_bounds(statement, asked)
    every = [
        *_parameters(statement, parameters),
        *_states(model, parameters, initial),
        *_body_rates(statement, initial),
    ]
    n = len(statement.names)
    inner = {row + shift for rows in quaternion_rows(statement) for row in rows for shift in (0, n)}
    by_name = {
        slider.name: slider
        for slider in every
        if slider.name in bounds or slider.kind != STATE or slider.place not in inner
    }
    for name, (low, high) in bounds.items():
        slider = by_name[name]
        if not low <= slider.value <= high:
            raise StatementError(
                f"the slider of {name} goes from {low:g} to {high:g}, and {name} is {slider.value:g}: give bounds that "
                "hold it, or another value."
            )
        by_name[name] = replace(slider, low=low, high=high, chosen=True)
    return (*(by_name[name] for name in bounds), *(slider for slider in by_name.values() if not slider.chosen))


def _body_rates(statement: Statement, initial: tuple[float, ...]) -> Iterator[Slider]:
    values = rates_at(statement, initial)
    most = nice(2 * max(map(abs, values), default=0.0) or 1.0)
    for index, (rate, value) in enumerate(zip(_rates_of(statement), values, strict=True)):
        yield Slider(name_of(rate), RATE, index, value, -most, most, "", chosen=False)


def _parameters(statement: Statement, values: tuple[float, ...]) -> Iterator[Slider]:
    for index, (symbol, value) in enumerate(zip(statement.parameters, values, strict=True)):
        low, high = parameter_bounds(value)
        unit = unit_of(statement, symbol.name)
        yield Slider(symbol.name, PARAMETER, index, value, low, high, unit, chosen=False, angle=False)


def parameter_bounds(value: float) -> tuple[float, float]:
    """Return the bounds of a parameter: a tenth to three times its value, or 0 to 1 for the value zero."""
    if value == 0:
        return 0.0, 1.0
    low, high = sorted(
        (
            math.copysign(nice(LOWEST * abs(value)), value),
            math.copysign(nice(HIGHEST * abs(value)), value),
        )
    )
    return low, high


def nice(size: float) -> float:
    """Return a positive number with one digit, such as 0.3, that is at least `size` up to rounding."""
    if not math.isfinite(1 / size):
        return size
    unit = 10.0 ** math.floor(math.log10(size))
    first = next(digit for digit in NICE if size <= digit * unit * (1 + 1e-9))
    return float(f"{first * unit:.1g}")


def _states(model: Model, parameters: tuple[float, ...], initial: tuple[float, ...]) -> Iterator[Slider]:
    statement = model.statement
    n = len(statement.names)
    circular = angles(statement)
    rates = _rates(model, parameters, initial)
    free = [abs(value) for angle, value in zip(circular, initial, strict=False) if not angle]
    usual = max(free, default=0.0) or 1.0
    for index, (angle, name) in enumerate(zip(circular, statement.names, strict=True)):
        value = initial[index]
        half = TURN / 2 if angle else nice(usual) if value == 0 else COORDINATE_RANGE * abs(value)
        middle = TURN * round(value / TURN) if angle else value
        unit = unit_of(statement, name)
        yield Slider(name, STATE, index, value, middle - half, middle + half, unit, chosen=False, angle=angle)
        speed, name = initial[n + index], f"{name}_dot"
        length = 1.0 if angle else usual
        most = nice(2 * abs(speed) or math.sqrt(abs(rates[index]) * length) or usual)
        unit = unit_of(statement, name)
        yield Slider(name, STATE, n + index, speed, -most, most, unit, chosen=False, angle=False)


def _rates(model: Model, parameters: tuple[float, ...], initial: tuple[float, ...]) -> list[float]:
    """Return the initial accelerations, (n,), which set the bounds of velocities that start at zero.

    They are all zero if the model cannot compute them, because the page itself reports that.
    """
    values = dict(zip(model.statement.parameters, parameters, strict=True))
    try:
        rates = model.rhs(0.0, np.array(initial), values)[model.layout.v]
    except RunError:
        return [0.0] * len(model.layout.rates)
    return [float(rate) if math.isfinite(rate) else 0.0 for rate in rates]
