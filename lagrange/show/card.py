"""The status card of a run: as data, as text, and as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from lagrange.errors import counted, listing
from lagrange.mechanics.conserved import drift_lines
from lagrange.show.files.run_files import finite
from lagrange.show.notebook.html_card import image, pairs
from lagrange.show.terminal import duration, text_table
from lagrange.show.units import unit_of
from lagrange.statement.coordinate import row_label
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Trajectory

MOST_CHANGES = 3
"""Number of parameter changes on the card; `solution.parameter_changes` has all of them."""


def card_of(solution: Solution) -> dict[str, Any]:
    """Return the data of the card as a dict for JSON; numbers that are not finite are None."""
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
    if solution.contacts:
        card["contacts"] = {
            name: {"impacts": len(contact.impacts), "rests": list(contact.rests), "mode": str(contact.mode[-1])}
            for name, contact in solution.contacts.items()
            if len(solution.t)
        }
        card["energy_lost"] = finite(solution.energy_lost[-1]) if len(solution.t) else None
    if solution.parameter_changes:
        card["changes"] = [{"t": finite(t), "parameters": values} for t, values in solution.parameter_changes]
    for when, column in (("initial", 0), ("final", -1)):
        card[when] = {
            name: finite(row[column]) for name, row in zip(solution.names, solution.y, strict=True) if len(row)
        }
    return card


def _energy(solution: Solution) -> dict[str, Any] | None:
    """Return the data of the energy for the card, or None if the energy has no value."""
    if not solution.has_energy:
        return None
    drift = {**asdict(solution.drift), "relative": solution.drift.relative}
    return {key: finite(value) if isinstance(value, float) else value for key, value in drift.items()}


def card_text(solution: Solution) -> str:
    """Return the card as a table for a terminal."""
    return f"{_heading(solution)}\n{text_table(('', ''), _lines(solution))}"


def card_html(solution: Solution) -> str:
    """Return the card as an HTML table for a notebook, with the plot under it."""
    heading = _heading(solution)
    drawn = image(solution.plot(), f"plot of {heading}") if len(solution.t) else ""
    return pairs(heading, _lines(solution)) + drawn


def _heading(solution: Solution) -> str:
    return f"{solution.model.statement.name}: {solution.status.value}"


def _lines(solution: Solution) -> list[tuple[str, str]]:
    """Return the lines of the card as pairs (label, text)."""
    run, unit = solution.trajectory, unit_of(solution.model.statement, "t")
    begun, reached = run.span
    outputs = counted(len(run.t), "output") if len(run.t) else "no outputs"
    unknown = "not known: it has no value at some state of the run"
    return [
        ("method", ", ".join(part for part in (run.method, run.form) if part)),
        *_setting_lines(run),
        ("time", f"{begun:.6g} to {reached:.6g}{f' {unit}' if unit else ''}, {outputs}"),
        ("steps", f"{run.steps} ({run.rejected} rejected), {counted(run.evaluations, 'evaluation')}"),
        (
            "energy drift" if solution.model.conservative else "energy",
            solution.drift.sentence() if solution.has_energy else unknown,
        ),
        *drift_lines(solution.momentum_drift),
        *([("constraint drift", solution.constraint_drift.sentence())] if solution.constraint_drift else []),
        *_contact_lines(solution),
        *_event_lines(run.t_events),
        *_change_lines(solution.parameter_changes),
        *([("stiffness", solution.stiff.sentence())] if solution.stiff else []),
        ("wall time", duration(run.wall)),
        ("message", run.message),
    ]


def _contact_lines(solution: Solution) -> list[tuple[str, str]]:
    """Return lines on contacts: the impacts of each and its state at the end, and the total dissipated energy."""
    if not solution.contacts or not len(solution.t):
        return []
    lines = [
        (f"contact {name}", f"{counted(len(contact.impacts), 'impact')}, {contact.mode[-1]} at the end")
        for name, contact in solution.contacts.items()
    ]
    return [*lines, ("energy lost", f"{solution.energy_lost[-1]:.6g}")]


def _setting_lines(run: Trajectory) -> list[tuple[str, str]]:
    """Return the line with the step or the tolerances of a run; empty if its method has neither."""
    if run.step is not None:
        return [("step", f"{run.step:.6g}")]
    if run.rtol is None:
        return []
    atol = "follows the scale" if run.atol is None else f"= {run.atol:g}"
    return [("tolerances", f"rtol = {run.rtol:g}, atol {atol}")]


def _change_lines(changes: Sequence[tuple[float, Mapping[str, float]]]) -> list[tuple[str, str]]:
    """Return the line with the parameters set by events: the first changes, and the number of the others.

    `changes` are pairs of a time and the new values by name. Without changes the list is empty.
    """
    changed = [
        f"{listing(f'{name} = {value:.6g}' for name, value in values.items())} from t = {t:.6g}"
        for t, values in changes[:MOST_CHANGES]
    ]
    left = len(changes) - MOST_CHANGES
    more = [f"{counted(left, 'later change')}"] if left > 0 else []
    return [("parameters", listing(changed + more))] if changed else []


def _event_lines(times: Sequence[FloatArray]) -> list[tuple[str, str]]:
    """Return the line with the number of occurrences of each event; empty without events."""
    if not times:
        return []
    counts = (f"event {i}: {counted(len(occurrences), 'time')}" for i, occurrences in enumerate(times))
    return [("events", ", ".join(counts))]
