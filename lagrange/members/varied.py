"""Values that vary between members: arrays, grids (products of arrays), and samples of distributions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import StatementError, shown
from lagrange.statement.expression import MOST_NUMBERS, check_once, one_of, real_array, real_number, whole_number
from lagrange.statement.parameters import label_of, table_of
from lagrange.trajectory.trajectory import FloatArray

MemberNumbers = NDArray[np.int64]
"""Numbers of members, from 0 on."""


MOST_MEMBERS = 10**12
"""Largest number of members of a grid. At 1 us each they take eleven days, with 10 TB of results."""


@dataclass(frozen=True, eq=False, repr=False)
class Varied:
    """The values of coordinates, velocities and parameters that vary between the members of an ensemble.

    `stated` has an array of values for each key. Without `crossed` it has one value for each member. With `crossed`,
    for a grid, it has the points of the key's axis; the members are all combinations, and the last axis varies
    fastest. `drawn` describes how random values were sampled.
    """

    stated: Mapping[Any, FloatArray]
    drawn: tuple[Mapping[str, Any], ...] = ()
    crossed: bool = False

    @cached_property
    def axes(self) -> Mapping[str, FloatArray | MemberNumbers]:
        """The independent axes by name: for a grid its keys with their values, else one axis of member indices."""
        if self.crossed:
            return {label_of(key): values for key, values in self.stated.items()}
        return {"member": np.arange(len(next(iter(self.stated.values()))))}

    def values(self, key: Any, which: MemberNumbers) -> FloatArray:
        """Return the values (m,) of a key that varies, for the members with the indices `which` (m,)."""
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
        label = one_of(label_of(key), by_label, "{given} does not vary between the members; what varies is {known}.")
        return self.values(by_label[label], np.arange(len(self)))

    def lowest(self, key: Any) -> float:
        """Return the smallest value of a key that varies."""
        return float(self.stated[key].min())

    @property
    def shape(self) -> tuple[int, ...]:
        """The numbers of values on the axes: their product is the number of members."""
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
        raise StatementError(f"the grid has {members:.3g} members: give fewer values; {MOST_MEMBERS:.0e} are possible.")
    return Varied(by_key, crossed=True)


def axis_values(label: str, axis: Any) -> FloatArray:
    """Return the values of an axis, which the user gives as (low, high, count) or as a list or array.

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
"""Largest dimension of Sobol's sequence, for which direction numbers exist."""


def sample(ranges: Mapping[Any, Any], count: int, *, seed: int = 0, method: str = "sobol") -> Varied:
    """Return random values of `count` members, for `lagrange.ensemble`. The same seed gives the same values.

    `ranges` maps coordinates, velocities, parameters or their names to (low, high), for a uniform distribution, or to
    a distribution of `scipy.stats`, such as `norm(1.0, 0.1)`. `method` is "sobol" for a scrambled Sobol sequence,
    "latin" for a Latin hypercube, or "random" for independent values. Source: `scipy.stats.qmc`. Raises StatementError
    for a range without values.
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
    """Return quantiles (m,) of a user's range (low, high) or distribution, at `probabilities` (m,).

    `label` is the name of what varies, for messages.
    """
    quantile = getattr(distribution, "ppf", None)
    if callable(quantile):
        # At probability 0, which a sequence may contain, a normal distribution has no value.
        values = _quantiles(label, quantile, np.clip(probabilities, 2.0**-53, 1.0 - 2.0**-53))
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


def _quantiles(label: str, quantile: Callable[[FloatArray], Any], probabilities: FloatArray) -> FloatArray:
    """Return the quantiles (m,) of a distribution at `probabilities` (m,), checked for errors and shape.

    `quantile` is the distribution's function from probabilities to values. `label` is the name of what varies.
    """
    what = f"the distribution of {label}"
    try:
        quantiles = quantile(probabilities)
    except (TypeError, ValueError, ArithmeticError) as error:
        raise StatementError(
            f"{what} gives no values: {error}. Give one number for each parameter of the distribution."
        ) from error
    values = real_array(quantiles, what)
    if values.shape != probabilities.shape:
        raise StatementError(
            f"{what} returns values of shape {values.shape} for probabilities of shape {probabilities.shape}: give a "
            "distribution with one number for each parameter."
        )
    return values


def _named(mapping: Any, what: str, entries: str) -> Any:
    """Return the (key, value) entries of a dict that the user gives.

    `what` is the name of the argument, and `entries` describes its entries, for messages. Raises StatementError for
    an empty dict, or for a key given twice.
    """
    table = table_of(mapping, what, entries)
    if not table:
        raise StatementError(f"{what} is empty: give a dict from {entries}.")
    check_once([label_of(key) for key in table], what)
    return table.items()
