"""Export a run as tables for pandas and xarray, CSV, NumPy arrays, a picture, or a folder with several files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from lagrange.errors import StatementError
from lagrange.show.files.atomic_file import Writer, write_atomically, write_rows, write_together
from lagrange.show.files.picture import picture
from lagrange.show.interpolated_states import stored_between
from lagrange.statement.coordinate import multiplier
from lagrange.statement.scene.writer import scene_text
from lagrange.trajectory.contact.history import ContactRun
from lagrange.trajectory.measures.times_and_points import times_at
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    import pandas
    import xarray


def data_frame(t: FloatArray, rows: Mapping[str, FloatArray], attributes: Mapping[str, Any]) -> pandas.DataFrame:
    """Return a DataFrame over t (N,) with copies of the `rows` (N,) as columns, by name, and with `attributes`.

    Raises StatementError without pandas.
    """
    with optional_package("pandas", "to_pandas"):
        import pandas
    columns = {name: row.copy() for name, row in rows.items()}
    frame = pandas.DataFrame(columns, index=pandas.Index(t, name="t"))
    frame.attrs.update(attributes)
    return frame


def data_set(t: FloatArray, rows: Mapping[str, FloatArray], attributes: Mapping[str, Any]) -> xarray.Dataset:
    """Return a Dataset over t (N,) with copies of the rows (N,) as variables.

    Only texts and numbers among `attributes` are kept. Raises StatementError without xarray.
    """
    with optional_package("xarray", "to_xarray"):
        import xarray
    kept = {key: value for key, value in attributes.items() if isinstance(value, (str, int, float))}
    return xarray.Dataset({name: ("t", row.copy()) for name, row in rows.items()}, coords={"t": t}, attrs=kept)


@contextmanager
def optional_package(package: str, method: str) -> Iterator[None]:
    """Return a context manager for the import of an optional package, "pandas" or "xarray".

    It raises StatementError if `package` is not installed. `method` is the name of the method in the message.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise StatementError(
            f"{method}() needs {package}, which is not installed: pip install pandas xarray, or in a checkout "
            "pip install '.[data]'."
        ) from error


def write_csv(solution: Solution, path: str | os.PathLike[str], rate: float | None, t: ArrayLike | None) -> Path:
    """Write the states of a run as CSV: at the outputs, at `rate` states per unit of time, or at the times `t`.

    At most one of `rate` and `t` is not None. Raises StatementError if both are given.
    """
    if rate is not None and t is not None:
        raise StatementError("rate and t are both given, and each sets the times of the lines: give one of the two.")
    times = times_at(solution.trajectory, rate) if rate is not None else t
    return write_atomically(path, partial(_csv, solution if times is None else solution.sampled(times)))


def write_folder(solution: Solution, folder: str | os.PathLike[str]) -> list[Path]:
    """Write the table, the picture and, last, the card of a run into a folder, and return their paths.

    The card is a JSON file with the status of the run, its method and its settings.
    """
    files: dict[str, Writer | None] = {
        "trajectory.csv": partial(_csv, solution),
        "trajectory.png": picture(solution.plot) if len(solution.t) else None,
        "card.json": lambda file: file.write(json.dumps(solution.card(), indent=2, allow_nan=False).encode() + b"\n"),
    }
    return write_together(folder, files)


def _csv(solution: Solution, file: BinaryIO) -> None:
    columns = columns_of(solution)
    write_rows(file, ("t", *columns), [solution.t.tolist(), *(row.tolist() for row in columns.values())])


def columns_of(solution: Solution) -> dict[str, FloatArray]:
    """Return the columns of the table of a run by name, (N,) each, with a value for each output.

    The columns are the entries of the state, the parameters that events change, and the multipliers as lambda[name].
    """
    rows = dict(zip(solution.names, solution.y, strict=True)) | _changed_parameters(solution)
    return rows | {str(multiplier(name)): row for name, row in solution.multipliers.items()}


def _changed_parameters(solution: Solution) -> dict[str, FloatArray]:
    history, along = solution.trajectory.history, solution.parameters_at(solution.t)
    if history is None or not isinstance(along, np.ndarray):
        return {}
    changed = np.flatnonzero(np.ptp(history.values, axis=0))
    return {solution.model.statement.parameters[i].name: along[i] for i in changed}


def arrays_of_run(solution: Solution) -> dict[str, Any]:
    """Return the arrays that describe a run, by the names that they have in an npz archive."""
    run, model = solution.trajectory, solution.model
    texts = {"card": json.dumps(solution.card()), "statement": scene_text(model.statement)}
    arrays: dict[str, Any] = {"t": run.t, "y": run.y, "names": np.array(solution.names)}
    arrays |= {name: np.array(text) for name, text in texts.items()}
    for name, events in (("t_event", run.t_events), ("y_event", run.y_events)):
        arrays |= {f"{name}_{i}": array for i, array in enumerate(events)}
    arrays |= stored_between(run)
    if run.history is not None:
        arrays |= {f"history_{name}": array for name, array in vars(run.history).items()}
    if run.contacts is not None:
        contacts = ContactRun(model, run, run.contacts, model.parameter_array(solution.parameters))
        arrays |= {f"contact_{name}": array for name, array in contacts.arrays().items()}
    if solution.multipliers:
        arrays |= {
            "multipliers": np.stack([*solution.multipliers.values()]),
            "constraints": np.array([*solution.multipliers]),
            "constraint_error": solution.constraint_error,
        }
    arrays["energy"] = solution.energy if solution.has_energy else np.full(len(run.t), np.nan)
    return arrays
