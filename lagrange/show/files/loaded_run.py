"""Read a Solution from the npz file that `solution.to_npz` wrote."""

from __future__ import annotations

import json
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.errors import StatementError, counted, listing, shown, with_type
from lagrange.machine.model import Model
from lagrange.statement.expression import printable
from lagrange.statement.scene.scene_reader import stored_statement
from lagrange.statement.statement import Statement
from lagrange.trajectory.contact.history import stored_history
from lagrange.trajectory.dense_output import OutputPath
from lagrange.trajectory.integrator import MEMORY_DIVISOR, machine_memory
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, ParameterHistory, Status, Trajectory

MOST_ARRAYS = 10_000  # Largest number of arrays in a file: a run has about ten, and two for each event

UNREADABLE = (
    *(ValueError, KeyError, TypeError, AttributeError, IndexError, ArithmeticError, RuntimeError, MemoryError),
    *(EOFError, SyntaxError, UnicodeError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""Errors that NumPy, zipfile, json and SymPy raise for data that are not in their format."""


def arrays_of(path: str | os.PathLike[str], most: float) -> dict[str, Any]:
    """Return the arrays in an npz file by name.

    Raises StatementError for a path that is not a file, for a file that is not an npz archive, and for arrays of more
    than `most` bytes together, which are not read.
    """
    try:
        file = Path(path)
        mode = file.stat().st_mode
        if not stat.S_ISREG(mode):
            kind = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
            raise StatementError(f"{_named(path)} is {kind}: give a file that solution.to_npz wrote.")
        with zipfile.ZipFile(file) as archive:
            sizes = [info.file_size for info in archive.infolist()]
        if len(sizes) > MOST_ARRAYS or sum(sizes) > most:
            raise StatementError(
                f"{_named(path)} has {counted(len(sizes), 'array')} of {sum(sizes):.3g} bytes together, and a run from "
                f"a file may have {MOST_ARRAYS} of {most:.3g} bytes, a quarter of the memory: write a run with fewer "
                "outputs."
            )
        with np.load(file, allow_pickle=False) as arrays:
            known = dict(arrays)
        for name, value in known.items():
            if not isinstance(value, np.ndarray):
                raise ValueError(f"its entry {name} is not an array")
        return known
    except StatementError:
        raise
    except OSError as error:
        raise StatementError(
            f"{_named(path)} cannot be read ({error.strerror or error}): check the path and its permissions."
        ) from error
    except UNREADABLE as error:
        reason = str(error) or type(error).__name__
        raise StatementError(f"{_named(path)} is not a file that solution.to_npz wrote ({reason[:120]}).") from error


def _named(path: Any) -> str:
    return shown(os.fspath(path), 120)


NEEDED = ("t", "y", "names", "card", "statement")  # Arrays that every file of a run contains

OUTPUTS_ALONE = "a file has the outputs of a run alone. Ask at these times, or run the system again."


def loaded_run(path: Any, model_of: Callable[[Statement, str], Model]) -> Solution:
    """Return the run in a file that `to_npz` wrote. `model_of(statement, target)` compiles the model.

    Raises StatementError for a file that `to_npz` did not write.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise StatementError(f"the path is {with_type(path)}: give the path of a file.")
    arrays = arrays_of(path, machine_memory() / MEMORY_DIVISOR)
    missing = [name for name in NEEDED if name not in arrays]
    if missing:
        raise StatementError(
            f"{os.fspath(path)!r} is not a run that to_npz wrote: it lacks {listing(missing)}. Give a file of "
            "solution.to_npz(path)."
        )
    try:
        statement, card = stored_statement(str(arrays["statement"])), json.loads(str(arrays["card"]))
        model = model_of(statement, card["target"])
        return Solution(_trajectory(arrays, card, model), model, model.parameter_values(card["parameters"]))
    except StatementError as error:
        raise StatementError(f"{os.fspath(path)!r} cannot be used: {error}") from error
    except UNREADABLE as error:
        raise StatementError(
            f"{os.fspath(path)!r} is not a run that to_npz wrote ({type(error).__name__}: {str(error)[:120]})."
        ) from error


def _trajectory(arrays: Mapping[str, Any], card: Mapping[str, Any], model: Model) -> Trajectory:
    """Return the trajectory of a run from the arrays in its file.

    `card` is a dict with the rest: the status, the method, tolerances and numbers of steps. Raises StatementError
    where the states do not fit the model.
    """
    t, y = arrays["t"], arrays["y"]
    if y.shape != (len(model.layout.names()), len(t)):
        raise StatementError(
            f"it has states of shape {y.shape} at {len(t)} times, for a system with {listing(model.layout.names())}."
        )
    events, prefix = range(len(card["events"])), "contact_"
    contacts = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
    return Trajectory(
        t=t,
        y=y,
        status=Status(card["status"]),
        message=printable(card["message"], "its message"),
        method=printable(card["method"], "its method"),
        steps=card["steps"],
        rejected=card["rejected"],
        evaluations=card["evaluations"],
        wall=card["wall"],
        span=(card["t_start"], card["t_end"]),
        dense=_known(arrays, t, y),
        form=printable(card["form"], "its form"),
        t_events=tuple(arrays[f"t_event_{i}"] for i in events),
        y_events=tuple(arrays[f"y_event_{i}"] for i in events),
        step=card["step"],
        rtol=card["rtol"],
        atol=card["atol"],
        history=_history(arrays, model),
        contacts=stored_history(contacts, model.statement.contacts) if model.statement.contacts else None,
    )


def _history(arrays: Mapping[str, Any], model: Model) -> ParameterHistory | None:
    """Return the parameters along a run from the `arrays` of its file, or None if no event changed them."""
    if "history_begins" not in arrays:
        return None
    names = ("history_begins", "history_values", "history_added")
    if missing := [name for name in names if name not in arrays]:
        raise StatementError(f"it lacks {listing(missing)}, the parameters that events have set.")
    history = ParameterHistory(*(arrays[name] for name in names))
    if history.values.shape[1:] != (len(model.statement.parameters),):
        raise StatementError(f"it has {history.values.shape[1:]} parameters after events, not those of its system.")
    return history


def _known(arrays: Mapping[str, Any], t: FloatArray, y: FloatArray) -> OutputPath:
    """Return the states in the file of a run with their times: the outputs `y` at `t`, and states between the outputs.

    `arrays` are the arrays in the file. Older files have no states between outputs.
    """
    t_between, y_between = arrays.get("t_between", np.empty(0)), arrays.get("y_between", np.empty((len(y), 0)))
    if y_between.shape != (len(y), len(t_between)):
        raise StatementError(f"it has states of shape {y_between.shape} at {len(t_between)} times between its outputs.")
    times = np.concatenate([t, t_between])
    order = np.argsort(times if len(t) < 2 or t[-1] >= t[0] else -times, kind="stable")
    return OutputPath(times[order], np.hstack([y, y_between])[:, order], None, OUTPUTS_ALONE)
