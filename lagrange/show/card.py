"""The status card of a run as data, and lines of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from lagrange.errors import counted
from lagrange.show.files.data_sets import finite
from lagrange.show.rows import row_label
from lagrange.show.units import unit_of
from lagrange.trajectory.trajectory import FloatArray, Trajectory

if TYPE_CHECKING:
    from lagrange.show.solution import Solution


def card_of(solution: Solution) -> dict[str, Any]:
    """Return the card, ready for JSON; numbers that are not finite are None."""
    card: dict[str, Any] = {
        "system": solution.model.statement.name,
        "target": solution.model.target,
        "status": solution.status.value,
        "complete": solution.status.complete,
        "message": solution.message,
        "method": solution.method,
        "form": solution.trajectory.form,
        "step": finite(solution.trajectory.step),
        "rtol": finite(solution.trajectory.rtol),
        "atol": finite(solution.trajectory.atol),
        "steps": solution.steps,
        "rejected": solution.trajectory.rejected,
        "evaluations": solution.evaluations,
        "wall": finite(solution.wall),
        "events": [len(times) for times in solution.t_events],
        "outputs": len(solution.t),
        "t_start": finite(solution.trajectory.span[0]),
        "t_end": finite(solution.trajectory.span[1]),
        "energy": _energy(solution),
        "constraints": solution.constraint_drift.card if solution.constraint_drift else None,
        "stiff": solution.stiff.sentence() if solution.stiff else None,
        "units": {name: unit for name in (*solution.names, "t") if (unit := unit_of(solution.model.statement, name))},
        "parameters": {row_label(key): finite(value) for key, value in solution.parameters.items()},
    }
    for when, column in (("initial", 0), ("final", -1)):
        card[when] = {
            name: finite(row[column]) for name, row in zip(solution.names, solution.y, strict=True) if len(row)
        }
    return card


def _energy(solution: Solution) -> dict[str, Any] | None:
    """Return how the energy went, None where it has no value."""
    if not solution.has_energy:
        return None
    drift = {**asdict(solution.drift), "relative": solution.drift.relative}
    return {key: finite(value) if isinstance(value, float) else value for key, value in drift.items()}


def setting_lines(run: Trajectory) -> list[tuple[str, str]]:
    """Return the line with the step or the tolerances of a run, if its method has any."""
    if run.step is not None:
        return [("step", f"{run.step:.6g}")]
    if run.rtol is None:
        return []
    atol = "follows the scale" if run.atol is None else f"= {run.atol:g}"
    return [("tolerances", f"rtol = {run.rtol:g}, atol {atol}")]


def event_lines(times: Sequence[FloatArray]) -> list[tuple[str, str]]:
    """Return the line with how often each event occurred, if there are any."""
    if not times:
        return []
    counts = (f"event {i}: {counted(len(found), 'time')}" for i, found in enumerate(times))
    return [("events", ", ".join(counts))]
