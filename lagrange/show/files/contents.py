"""What a file of a run has: columns over the outputs, and the arrays of an archive."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.show.files.data_sets import event_arrays
from lagrange.show.measures.between import stored_between
from lagrange.statement.multiplier import multiplier
from lagrange.statement.stored import stored
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from lagrange.show.solution import Solution


def columns_of(solution: Solution) -> dict[str, FloatArray]:
    """Return the rows of the state by name, then parameters that events have changed, and multipliers as lambda[name].

    Each has a value for each output, (N,).
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
    """Return the arrays of an archive by name; see `Solution.to_npz`."""
    run, model = solution.trajectory, solution.model
    texts = {"card": json.dumps(solution.card()), "statement": json.dumps(stored(model.statement))}
    arrays: dict[str, Any] = {"t": run.t, "y": run.y, "names": np.array(solution.names)}
    arrays |= {name: np.array(text) for name, text in texts.items()}
    arrays |= event_arrays(run.t_events, run.y_events) | stored_between(run)
    if run.history is not None:
        arrays |= {f"history_{name}": array for name, array in vars(run.history).items()}
    if solution.multipliers:
        arrays |= {
            "multipliers": np.stack([*solution.multipliers.values()]),
            "constraints": np.array([*solution.multipliers]),
            "constraint_error": solution.constraint_error,
        }
    arrays["energy"] = solution.energy if solution.has_energy else np.full(len(run.t), np.nan)
    return arrays
