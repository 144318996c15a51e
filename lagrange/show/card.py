"""The status card of a run, its printed summary: method, steps, drifts and message, as data, as text, and as HTML."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from lagrange.errors import counted, listing
from lagrange.show.notebook.html_card import image, pairs
from lagrange.statement.coordinate import row_label
from lagrange.statement.display import duration, text_table
from lagrange.statement.rotation import quaternion_rows
from lagrange.statement.statement import unit_of
from lagrange.trajectory.measures.conservation import drift_lines
from lagrange.trajectory.solution import Solution

MOST_CHANGES = 3  # Number of parameter changes on the card; `solution.parameter_changes` has all of them


def card_of(solution: Solution) -> dict[str, Any]:
    """Return the data of the status card of a run, as a dict for JSON; numbers that are not finite are None."""
    drift = {**asdict(solution.drift), "relative": solution.drift.relative} if solution.has_energy else {}
    energy = {key: _finite(value) if isinstance(value, float) else value for key, value in drift.items()}
    card: dict[str, Any] = {
        "system": solution.model.statement.name,
        "target": solution.model.target,
        "status": solution.status.value,
        "complete": solution.status.complete,
        "message": solution.message,
        "method": solution.method,
        "form": solution.trajectory.form,
        "step": _finite(solution.trajectory.step),
        "rtol": _finite(solution.trajectory.rtol),
        "atol": _finite(solution.trajectory.atol),
        "steps": solution.steps,
        "rejected": solution.trajectory.rejected,
        "evaluations": solution.evaluations,
        "wall": _finite(solution.wall),
        "events": [len(times) for times in solution.t_events],
        "outputs": len(solution.t),
        "t_start": _finite(solution.trajectory.span[0]),
        "t_end": _finite(solution.trajectory.span[1]),
        "energy": energy or None,  # the energy may have no value
        "constraints": solution.constraint_drift.card if solution.constraint_drift else None,
        "lengths": {name: _finite(error) for name, error in _lengths(solution).items()},
        "stiff": solution.stiff.sentence() if solution.stiff else None,
        "units": {name: unit for name in (*solution.names, "t") if (unit := unit_of(solution.model.statement, name))},
        "parameters": {row_label(key): _finite(value) for key, value in solution.parameters.items()},
    }
    if solution.contacts:
        card["contacts"] = {
            name: {"impacts": len(contact.impacts), "rests": list(contact.rests), "mode": str(contact.mode[-1])}
            for name, contact in solution.contacts.items()
            if len(solution.t)
        }
        card["energy_lost"] = _finite(solution.energy_lost[-1]) if len(solution.t) else None
    if solution.parameter_changes:
        card["changes"] = [{"t": _finite(t), "parameters": values} for t, values in solution.parameter_changes]
    for when, column in (("initial", 0), ("final", -1)):
        card[when] = {
            name: _finite(row[column]) for name, row in zip(solution.names, solution.y, strict=True) if len(row)
        }
    return card


def _finite(value: Any) -> float | None:
    """Return a value as a number for JSON; None if it is not finite or not known."""
    return None if value is None or not isfinite(value) else float(value)


def _lengths(solution: Solution) -> dict[str, float]:
    """Return the largest difference from 1 of the length of each rotation's quaternion, by name of the rotation."""
    if not len(solution.t):
        return {}
    return {
        each.name: float(np.abs(np.linalg.norm(solution.y[rows], axis=0) - 1).max())
        for each, rows, _ in quaternion_rows(solution.model.statement.coordinates)
    }


def card_text(solution: Solution) -> str:
    """Return the status card of a run as a table for a terminal."""
    return f"{_heading(solution)}\n{text_table(('', ''), [*_lines(solution)])}"


def card_html(solution: Solution) -> str:
    """Return the status card of a run as an HTML table for a notebook, with the plot of the run under it."""
    heading = _heading(solution)
    drawn = image(solution.plot(), f"plot of {heading}") if len(solution.t) else ""
    return pairs(heading, [*_lines(solution)]) + drawn


def _heading(solution: Solution) -> str:
    return f"{solution.model.statement.name}: {solution.status.value}"


def _lines(solution: Solution) -> Iterator[tuple[str, str]]:
    """Yield the lines of the status card of a run as pairs (label, text)."""
    run, unit = solution.trajectory, unit_of(solution.model.statement, "t")
    begun, reached = run.span
    yield "method", ", ".join(part for part in (run.method, run.form) if part)
    if run.step is not None:
        yield "step", f"{run.step:.6g}"
    elif run.rtol is not None:
        atol = "follows the scale" if run.atol is None else f"= {run.atol:g}"
        yield "tolerances", f"rtol = {run.rtol:g}, atol {atol}"
    outputs = counted(len(run.t), "output") if len(run.t) else "no outputs"
    yield "time", f"{begun:.6g} to {reached:.6g}{f' {unit}' if unit else ''}, {outputs}"
    yield "steps", f"{run.steps} ({run.rejected} rejected), {counted(run.evaluations, 'evaluation')}"
    if solution.model.statement.lagrangian != 0:
        unknown = "not known: it has no value at some state of the run"
        drift = solution.drift.sentence() if solution.has_energy else unknown
        yield "energy drift" if solution.model.conservative else "energy", drift
    yield from drift_lines(solution.momentum_drift)
    for name, error in _lengths(solution).items():
        yield f"quaternion of {name}", f"length differs from 1 by at most {error:.1e}"
    if solution.constraint_drift:
        yield "constraint drift", solution.constraint_drift.sentence()
    if solution.contacts and len(solution.t):
        for name, contact in solution.contacts.items():
            yield f"contact {name}", f"{counted(len(contact.impacts), 'impact')}, {contact.mode[-1]} at the end"
        yield "energy lost", f"{solution.energy_lost[-1]:.6g}"
    if run.t_events:
        counts = (f"event {i}: {counted(len(times), 'time')}" for i, times in enumerate(run.t_events))
        yield "events", ", ".join(counts)
    if changes := solution.parameter_changes:
        changed = [
            f"{listing(f'{name} = {value:.6g}' for name, value in values.items())} from t = {t:.6g}"
            for t, values in changes[:MOST_CHANGES]
        ]
        left = len(changes) - MOST_CHANGES
        yield "parameters", listing(changed + ([counted(left, "later change")] if left > 0 else []))
    if solution.stiff:
        yield "stiffness", solution.stiff.sentence()
    yield "wall time", duration(run.wall)
    yield "message", run.message
