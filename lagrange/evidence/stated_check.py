"""The check of a stated system: its compiled models on both targets, and its textbook accelerations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lagrange.errors import StatementError, listing
from lagrange.evidence.check import check
from lagrange.evidence.report import Report
from lagrange.evidence.sample import solved_statement
from lagrange.machine.model import Stated

MOST_DERIVED = 100
"""Largest number of coordinates for which the textbook derivation is compared; it takes about 10 s for 300."""


def check_stated(system: Stated, target: str, points: int, seed: int) -> Report:
    """Return the report on a system compiled for `target`; `lagrange.System.check` describes the arguments."""
    model = system.compile(target, check=False)
    statement = solved_statement(model)
    if statement is not model.statement:
        names = listing(repr(constraint.name) for constraint in statement.constraints)
        report = check_stated(system.from_statement(statement), target, points, seed)
        return replace(report, notes=(*report.notes, f"checked with {names} alone: other constraints follow."))
    other = system.compile("numpy" if target == "llvm" else "llvm", check=False)
    textbook, notes = _textbook(system, dict(model.statement.prescribed))
    report = check(model, textbook=textbook, other=other, points=points, seed=seed)
    return replace(report, notes=(*report.notes, *notes))


def _textbook(system: Stated, prescribed: Mapping[Any, Any]) -> tuple[Mapping[Any, Any] | None, tuple[str, ...]]:
    """Return the accelerations of the textbook derivation and notes; None and a note if they are too large to derive.

    `prescribed` maps functions of time and their derivatives to their values.
    """
    if len(system.statement.coordinates) > MOST_DERIVED:
        limit = f"which is done up to {MOST_DERIVED} coordinates."
        return None, (f"not compared with the textbook derivation, {limit}",)
    try:
        return {q: a.xreplace(prescribed) for q, a in system.derivation().accelerations.items()}, ()
    except StatementError as refusal:
        return None, (f"not compared with the textbook derivation: {refusal}",)
