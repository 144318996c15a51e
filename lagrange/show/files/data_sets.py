"""Rows over time as pandas and xarray have them, which are optional, and arrays of files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    import pandas
    import xarray


def data_frame(t: FloatArray, rows: Mapping[str, FloatArray], attributes: Mapping[str, Any]) -> pandas.DataFrame:
    """Return rows (N,) as columns of a DataFrame, copied. Raises StatementError without pandas."""
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise _missing("to_pandas", "pandas") from error
    columns = {name: row.copy() for name, row in rows.items()}
    frame = pandas.DataFrame(columns, index=pandas.Index(t, name="t"))
    frame.attrs.update(attributes)
    return frame


def data_set(t: FloatArray, rows: Mapping[str, FloatArray], attributes: Mapping[str, Any]) -> xarray.Dataset:
    """Return rows (N,) as variables of a Dataset over t, copied; attributes are texts and numbers alone.

    Raises StatementError without xarray.
    """
    try:
        import xarray
    except ModuleNotFoundError as error:
        raise _missing("to_xarray", "xarray") from error
    kept = {key: value for key, value in attributes.items() if isinstance(value, (str, int, float))}
    return xarray.Dataset({name: ("t", row.copy()) for name, row in rows.items()}, coords={"t": t}, attrs=kept)


def event_arrays(times: Sequence[FloatArray], states: Sequence[FloatArray]) -> dict[str, FloatArray]:
    """Return the times (k,) and states (k, 2n) of each event by the names that they have in a file."""
    found = {f"t_event_{i}": event for i, event in enumerate(times)}
    return found | {f"y_event_{i}": event for i, event in enumerate(states)}


def _missing(method: str, package: str) -> StatementError:
    return StatementError(
        f"{method}() needs {package}, which is not installed: pip install pandas xarray, or in a checkout "
        "pip install '.[data]'."
    )


def finite(value: Any) -> float | None:
    """Return a number as JSON has it: None where it is not finite, or not known."""
    return None if value is None or not math.isfinite(value) else float(value)
