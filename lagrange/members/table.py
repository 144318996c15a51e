"""The initial values of all members of an ensemble, from arrays, grids and random samples, and from common values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.euler_lagrange import node_of
from lagrange.errors import StatementError, counted, listing, shown, suggestion
from lagrange.graph.evaluate import doubles
from lagrange.machine.model import Model
from lagrange.members.results import Starts
from lagrange.statement.coordinate import name_of
from lagrange.statement.declare import initial_state, state_rows
from lagrange.statement.expression import MOST_NUMBERS, check_once, one_of, real_array, real_number, whole_number
from lagrange.statement.parameters import label_of, table_of
from lagrange.statement.rotation import check_start, in_symbols, inertia_in_parameters, rotation_of, set_rates
from lagrange.statement.space import check_triangle
from lagrange.trajectory.trajectory import FloatArray

MemberNumbers = NDArray[np.int64]
"""Type of an array of indices of members in an ensemble, from 0 on."""

MOST_MEMBERS = 10**12
"""Largest number of members of a grid. At 1 us each they take eleven days, with 10 TB of results."""


@dataclass(frozen=True, eq=False, repr=False)
class Varied:
    """The values of coordinates, velocities and parameters that vary between the members of an ensemble.

    `stated` has an array of values for each key (coordinate, velocity, parameter, or its name). If `crossed` is False,
    the array has one value for each member. If it is True, for a grid, the array has the values on the key's axis; the
    members are all combinations, and the last axis varies fastest. `drawn` describes how random values were sampled.
    """

    stated: Mapping[Any, FloatArray]
    drawn: tuple[Mapping[str, Any], ...] = ()
    crossed: bool = False

    @cached_property
    def axes(self) -> Mapping[str, FloatArray | MemberNumbers]:
        """The values on each axis, by name. The axes of a grid are its keys.

        Without a grid there is one axis, "member", with the indices of all members.
        """
        if self.crossed:
            return {label_of(key): values for key, values in self.stated.items()}
        return {"member": np.arange(len(next(iter(self.stated.values()))))}

    def values(self, key: Any, which: MemberNumbers) -> FloatArray:
        """Return the values (m,) of `key`, one of the varying keys, for the members with the indices `which` (m,)."""
        if not self.crossed:
            return self.stated[key][which]
        axis = self.keys.index(key)
        stride = math.prod(self.shape[axis + 1 :])
        return self.stated[key][which // stride % self.shape[axis]]

    @property
    def keys(self) -> tuple[Any, ...]:
        """The keys that vary: coordinates, velocities, parameters, or their names."""
        return tuple(self.stated)

    def __getitem__(self, key: Any) -> FloatArray:
        """Return the values (members,) of a key. Raises StatementError for a key that does not vary."""
        by_label = {label_of(varying): varying for varying in self.keys}
        label = one_of(label_of(key), by_label, "{given} does not vary between members; the varying keys are {known}.")
        return self.values(by_label[label], np.arange(len(self)))

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of values on each axis. The product of these numbers is the number of members."""
        return tuple(len(values) for values in self.axes.values())

    def __len__(self) -> int:
        return math.prod(self.shape)

    def __repr__(self) -> str:
        names = ", ".join(label_of(key) for key in self.keys)
        return f"<{'Grid' if self.crossed else 'Arrays'} of {len(self)} members: {names}>"


def grid(axes: Mapping[Any, Any]) -> Varied:
    """Return every combination of the values of some axes, for `lagrange.ensemble`; the last key varies fastest.

    `axes` maps coordinates, velocities, parameters or their names to a tuple (low, high, count), for equally spaced
    values with both ends, or to a list or an array of values. Raises StatementError for an axis without values.
    """
    named = _named(axes, "axes", "coordinate, velocity or parameter to (low, high, count)")
    by_key = {key: axis_values(label_of(key), axis) for key, axis in named}
    members = math.prod(len(values) for values in by_key.values())
    if members > MOST_MEMBERS:
        raise StatementError(
            f"the grid has {members:.3g} members: give fewer values; at most {MOST_MEMBERS:.0e} are possible."
        )
    return Varied(by_key, crossed=True)


def axis_values(label: str, axis: Any) -> FloatArray:
    """Return the values (count,) of an axis of a grid, which the user gives as (low, high, count), a list or an array.

    `label` names the axis in messages. Raises StatementError for an axis without values.
    """
    if isinstance(axis, tuple):
        if len(axis) != 3:
            raise StatementError(
                f"the axis {label} is {shown(axis)}: give (low, high, count), or a list of values, such as [0.0, 1.0]."
            )
        low, high = (real_number(end, f"an end of {label}") for end in axis[:2])
        count = whole_number(axis[2], f"the number of values of {label}", 1, MOST_NUMBERS)
        if count == 1 and low != high:
            raise StatementError(
                f"the axis {label} has 1 value between {low:g} and {high:g}, and both ends belong to it: give at least "
                f"2, or the value itself, such as [{low:g}]."
            )
        with np.errstate(all="ignore"):
            values = np.linspace(low, high, count)
    else:
        values = real_array(axis, label)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise StatementError(f"the axis {label} is {shown(axis)}: give (low, high, count), or a list of finite values.")
    return values


METHODS = ("sobol", "latin", "random")

MOST_DIMENSIONS = 21201
"""Largest number of keys that vary in a Sobol sample: the largest dimension of the sequence for which direction numbers
exist."""


def sample(ranges: Mapping[Any, Any], count: int, *, seed: int = 0, method: str = "sobol") -> Varied:
    """Return random values of `count` members, for `lagrange.ensemble`. The same seed gives the same values.

    `ranges` maps coordinates, velocities, parameters or their names to (low, high), for a uniform distribution, or to a
    distribution of `scipy.stats`, such as `norm(1.0, 0.1)`. `method` is "sobol" for a scrambled Sobol sequence, "latin"
    for a Latin hypercube, or "random" for independent values. Source: `scipy.stats.qmc`. Raises StatementError for a
    range without values.
    """
    from scipy.stats import qmc  # Importing it takes as long as all other imports of a run.

    start = whole_number(seed, "seed", 0)
    one_of(method, METHODS, "method is {given}; the methods of a sample are {known}.")
    entries = list(_named(ranges, "ranges", "coordinate, velocity or parameter to (low, high)"))
    members = whole_number(count, "count, the number of members,", 1, MOST_NUMBERS // len(entries))
    if method == "sobol" and len(entries) > MOST_DIMENSIONS:
        raise StatementError(
            f"ranges has {len(entries)} entries, but Sobol's sequence has at most {MOST_DIMENSIONS}: give "
            "method='latin'."
        )
    generator = np.random.default_rng(start)
    if method == "sobol":
        whole = qmc.Sobol(len(entries), seed=generator).random_base2(max(members - 1, 1).bit_length())
        probabilities = whole[:members]
    elif method == "latin":
        probabilities = qmc.LatinHypercube(len(entries), seed=generator).random(members)
    else:
        probabilities = generator.random((members, len(entries)))
    values = {
        key: _drawn(label_of(key), distribution, part)
        for (key, distribution), part in zip(entries, probabilities.T, strict=True)
    }
    return Varied(values, ({"sample": method, "seed": start, "of": [label_of(key) for key in values]},))


def _drawn(label: str, distribution: Any, probabilities: FloatArray) -> FloatArray:
    """Return the random values (m,) of the key `label`: quantiles of `distribution` at random `probabilities` (m,).

    `distribution` is a range (low, high), for a uniform distribution, or a distribution of `scipy.stats`. Raises
    StatementError for anything else, and for values that are not finite.
    """
    quantile = getattr(distribution, "ppf", None)
    if callable(quantile):
        try:
            # At probability 0, which a sequence may contain, a normal distribution has no value.
            quantiles = quantile(np.clip(probabilities, 2.0**-53, 1.0 - 2.0**-53))
        except (TypeError, ValueError, ArithmeticError) as error:
            raise StatementError(
                f"the distribution of {label} gives no values: {error}. Give one number for each parameter of the "
                "distribution."
            ) from error
        values = real_array(quantiles, f"the distribution of {label}")
        if values.shape != probabilities.shape:
            raise StatementError(
                f"the distribution of {label} returns values of shape {values.shape} for probabilities of shape "
                f"{probabilities.shape}: give a distribution with one number for each parameter."
            )
    elif isinstance(distribution, (tuple, list)) and len(distribution) == 2:
        low, high = (real_number(end, f"an end of {label}") for end in distribution)
        if not low < high:
            raise StatementError(f"the range of {label} goes from {low:g} to {high:g}: give (low, high), low first.")
        values = low + (high - low) * probabilities
    else:
        raise StatementError(
            f"the range of {label} is {shown(distribution)}: give (low, high), or a distribution of scipy.stats."
        )
    if not np.isfinite(values).all():
        first = float(values[np.argmin(np.isfinite(values))])
        raise StatementError(
            f"the distribution of {label} gives {first} as a value: give a distribution of finite values."
        )
    return values


def _named(mapping: Any, what: str, entries: str) -> Any:
    """Check a dict that the user passes as an argument, and return its (key, value) pairs.

    `what` is the name of the argument, and `entries` says what it maps to what, both for messages. Raises
    StatementError for an empty dict, and for a key given twice, such as a coordinate and its name.
    """
    table = table_of(mapping, what, entries)
    if not table:
        raise StatementError(f"{what} is empty: give a dict from {entries}.")
    check_once([label_of(key) for key in table], what)
    return table.items()


@dataclass(frozen=True, eq=False)
class MemberTable:
    """The initial values of all members of an ensemble: common values, and those that vary between members.

    `state` (2n,) and `parameters` (k,) are the common values. `varied` has the values of each key that varies: a
    coordinate, velocity, parameter, or its name. Three dicts state what a key replaces: `rows` maps the index of a
    state entry to a key, `columns` the index of a parameter, and `rates` a rate of a rotation.
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
        """Return the initial states and the parameters of the members with the indices `which` (m,)."""
        states = np.repeat(self.state[None], len(which), axis=0)
        for row, key in self.rows.items():
            states[:, row] = self.varied.values(key, which)
        set_rates(states, self.coordinates, {rate: self.varied.values(key, which) for rate, key in self.rates.items()})
        parameters = np.repeat(self.parameters[None], len(which) if self.columns else 1, axis=0)
        for column, key in self.columns.items():
            parameters[:, column] = self.varied.values(key, which)
        return Starts(states, parameters)


def member_table(model: Model, initial: Any, parameters: Any) -> MemberTable:
    """Return the initial values of an ensemble's members, from the user's arguments `initial` and `parameters`.

    Each may be a dict from key to number or array, a grid, or a sample. A grid or sample may have initial values and
    parameters together. Raises StatementError for arrays of different lengths and for unknown names.
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
            model.parameter_values(
                {**dict.fromkeys(statement.parameters, 1.0), symbol: float(varied.stated[key].min())}
            )
    table = MemberTable(varied, state, values, rows, rates, columns, statement.coordinates)
    if statement.rotations:
        starts = table.starts(np.arange(min(len(table), MOST_CHECKED)))
        check_start(statement.coordinates, starts.states.T)
        point = dict(zip(model.equations.parameters, starts.parameters.T, strict=True))
        for name in statement.rotations:
            if (inertia := inertia_in_parameters(statement.kinetic, name)) is not None:
                entries = [node_of(entry, statement, model.equations) for row in inertia for entry in row]
                check_triangle(doubles(entries, point, len(starts.parameters)).T.reshape(-1, 3, 3), name)
    return table


MOST_CHECKED = 100_000
"""Largest number of members whose initial rotations and moments of inertia are checked. In a larger ensemble only the
first members are checked."""


def _places(model: Model, varied: Varied) -> tuple[dict[int, Any], dict[Any, Any], dict[int, Any]]:
    """Return three dicts that state what the values of each varying key replace.

    The first dict maps the index of a state entry to its key, the second a rate of rotation, and the third the index of
    a parameter. Raises StatementError for a key that is none of these.
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
    """Divide a user's argument into common values and varying values of the members; return both.

    The common values are a dict {key: number}. `argument` is a dict, a grid, a sample or None, and messages call it
    `what`. Raises StatementError for anything else.
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
    """Return the values (members,) of the key `label` from `array_like`, an array or list of the user.

    Raises StatementError for an array that is empty or has another shape, and for values that are not finite.
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
    """Return the varying values of all `sources` (arrays, grids, samples) as one object.

    Raises StatementError if they have different numbers of members, or if a key is in two of them.
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
