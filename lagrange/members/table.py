"""The members of an ensemble as a table: common values, and values that vary between members."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.equations.euler_lagrange import node_of
from lagrange.errors import StatementError, counted, listing, shown, suggestion
from lagrange.graph.evaluate import doubles
from lagrange.machine.model import Model
from lagrange.members.chunk import Starts
from lagrange.members.varied import MemberNumbers, Varied
from lagrange.statement.coordinate import name_of
from lagrange.statement.declare import initial_state, state_rows
from lagrange.statement.expression import real_array, real_number
from lagrange.statement.parameters import label_of
from lagrange.statement.rotation import check_start, in_symbols, inertia_in_parameters, rotation_of, set_rates
from lagrange.statement.space import check_triangle
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class MemberTable:
    """The initial values of all members of an ensemble: a common state (2n,) and parameters (k,), and what varies.

    `varied` has the values of each key that varies: a coordinate, velocity, parameter, or its name. Three dicts say
    where a key is used. `rows` maps the index of an entry of the state to its key, `columns` the index of a
    parameter, and `rates` a rate of a rotation.
    """

    varied: Varied
    state: FloatArray
    parameters: FloatArray
    rows: Mapping[int, Any]
    rates: Mapping[Any, Any]
    columns: Mapping[int, Any]
    coordinates: tuple[Any, ...]

    def __len__(self) -> int:
        return len(self.varied)

    @property
    def varying(self) -> bool:
        """True if parameters vary between members."""
        return bool(self.columns)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The names of the coordinates, velocities and parameters that vary."""
        return tuple(label_of(key) for key in self.varied.keys)

    def starts(self, which: MemberNumbers) -> Starts:
        """Return the initial values, states and parameters, of the members with the indices `which` (m,)."""
        states = np.repeat(self.state[None], len(which), axis=0)
        for row, key in self.rows.items():
            states[:, row] = self.varied.values(key, which)
        set_rates(states, self.coordinates, {rate: self.varied.values(key, which) for rate, key in self.rates.items()})
        parameters = np.repeat(self.parameters[None], len(which) if self.columns else 1, axis=0)
        for column, key in self.columns.items():
            parameters[:, column] = self.varied.values(key, which)
        return Starts(states, parameters)


def member_table(model: Model, initial: Any, parameters: Any) -> MemberTable:
    """Return the table of an ensemble's members from the arguments `initial` and `parameters` of the user.

    Each may be a dict from key to number or array, or a grid or a sample, which may have keys of both kinds. Raises
    StatementError for arrays of different lengths and for unknown names.
    """
    statement = model.statement
    sources: list[Varied] = []
    plain: dict[str, dict[Any, Any]] = {}
    for what, argument in (("initial", initial), ("parameters", parameters)):
        plain[what], varying = _divided(what, argument)
        sources += varying
    if not sources:
        raise StatementError(
            "no value varies between members: give an array in initial or in parameters, or lg.grid(...), or "
            "lg.sample(...)."
        )
    varied = _together(sources)
    rows, rates, columns = _places(model, varied)
    labels = {label_of(key) for key in varied.keys}
    twice = next((label_of(key) for values in plain.values() for key in values if label_of(key) in labels), None)
    if twice is not None:
        raise StatementError(f"{twice} has both varying values and a single value: leave one of them out.")
    state = np.array(initial_state(plain["initial"], statement.coordinates, statement.initial))
    first = {statement.parameters[i]: float(varied.values(key, np.zeros(1, int))[0]) for i, key in columns.items()}
    values = model.parameter_array({**plain["parameters"], **first})
    for column, key in columns.items():
        symbol = statement.parameters[column]
        if symbol.is_nonnegative:  # a negative value is refused, as in a single run
            model.parameter_values({**dict.fromkeys(statement.parameters, 1.0), symbol: varied.lowest(key)})
    table = MemberTable(varied, state, values, rows, rates, columns, statement.coordinates)
    if statement.rotations:
        starts = table.starts(np.arange(min(len(table), MOST_CHECKED)))
        check_start(statement.coordinates, starts.states.T)
        _check_moments(model, starts.parameters)
    return table


def _check_moments(model: Model, parameters: FloatArray) -> None:
    """Raise StatementError for members whose moments of inertia violate the triangle inequality.

    `parameters` (m, k) are those of the members.
    """
    statement, equations = model.statement, model.equations
    point = dict(zip(equations.parameters, parameters.T, strict=True))
    for name in statement.rotations:
        rows = inertia_in_parameters(statement.kinetic, name)
        if rows is not None:
            entries = [node_of(entry, statement, equations) for row in rows for entry in row]
            check_triangle(doubles(entries, point, len(parameters)).T.reshape(-1, 3, 3), name)


MOST_CHECKED = 100_000
"""Largest number of members whose rotations are checked: their initial states and moments of inertia."""


def _places(model: Model, varied: Varied) -> tuple[dict[int, Any], dict[Any, Any], dict[int, Any]]:
    """Return the keys that vary, by index in the state, by rate of a rotation, and by index of a parameter.

    Raises StatementError for an unknown key.
    """
    statement = model.statement
    rows, by_name = state_rows(statement.coordinates), {p.name: i for i, p in enumerate(statement.parameters)}
    turned = map(rotation_of, statement.rotations)
    rates = {key: f for each in turned for f in (*each.body, *each.space) for key in (f, name_of(f))}
    of_state, of_rates, of_parameters = dict[int, Any](), dict[Any, Any](), dict[int, Any]()
    for key in varied.keys:
        label = label_of(key)
        if key in rows:
            of_state[rows[key]] = key
        elif key in rates:
            of_rates[rates[key]] = key
        elif label in by_name:
            of_parameters[by_name[label]] = key
        else:
            labels = in_symbols((name for name in rows if isinstance(name, str)), statement.rotations)
            names = [*labels, *by_name]
            raise StatementError(
                f"{label!r} varies, and is not a coordinate, velocity or parameter of {statement.name}; they are "
                f"{listing(names)}.{suggestion(label, names)}"
            )
    return of_state, of_rates, of_parameters


def _divided(what: str, argument: Any) -> tuple[dict[Any, Any], list[Varied]]:
    """Divide one argument of the user, and return the values that all members share, by key, and those that vary.

    `what` is the name of the argument, for messages.
    """
    if argument is None:
        return {}, []
    if isinstance(argument, Varied):
        return {}, [argument]
    if not isinstance(argument, Mapping):
        raise StatementError(
            f"{what} is {shown(argument)}: give a dict from name to number or array, or lg.grid(...), or "
            "lg.sample(...)."
        )
    plain, arrays = {}, {}
    for key, value in argument.items():
        # Numbers of NumPy and SymPy, and arrays without dimensions, are one value for all members.
        if isinstance(value, (list, tuple, range)) or (hasattr(value, "__array__") and bool(getattr(value, "ndim", 0))):
            arrays[key] = _values(label_of(key), value)
        else:
            real_number(value, label_of(key))
            plain[key] = value
    return plain, [Varied({key: values}) for key, values in arrays.items()]


def _values(label: str, array_like: Any) -> FloatArray:
    """Return the values (members,) of the key `label` from an array or list of the user.

    Raises StatementError for other shapes and for values that are not finite.
    """
    values = real_array(array_like, label)
    if values.ndim != 1:
        raise StatementError(
            f"{label} has an array of shape {values.shape}: give (members,), a value for each, or lg.grid(...)."
        )
    if not len(values):
        raise StatementError(f"{label} has an array without values: give one for each member.")
    if not np.isfinite(values).all():
        index = int(np.argmin(np.isfinite(values)))
        raise StatementError(f"{label} is {values[index]} for member {index}: give finite values.")
    return values


def _together(sources: list[Varied]) -> Varied:
    """Return the varying values of several `sources` (arrays, grids, samples) as one object.

    All must have the same number of members. Raises StatementError for different numbers, or for a key in two
    sources.
    """
    if len(sources) == 1:
        return sources[0]
    lengths = {label_of(key): len(source) for source in sources for key in source.keys}
    if len(set(lengths.values())) > 1:
        text = listing(f"{label} has {counted(length, 'value')}" for label, length in lengths.items())
        raise StatementError(
            f"{text}: give arrays of one length, a value for each member, or, for all combinations, one lg.grid(...) "
            "of all that varies."
        )
    keys = [label_of(key) for source in sources for key in source.keys]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice is not None:
        raise StatementError(f"the values of {twice} are given twice: give them once.")
    every = np.arange(len(sources[0]))
    drawn = tuple(description for source in sources for description in source.drawn)
    return Varied({key: source.values(key, every) for source in sources for key in source.keys}, drawn)
