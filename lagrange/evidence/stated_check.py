"""The check of a stated system: its models on both machines, and the textbook derivation of its accelerations."""

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
"""Coordinates up to which a check compares with the textbook derivation, which takes some 10 s for 300."""


def check_stated(system: Stated, target: str, points: int, seed: int) -> Report:
    """Check a system; see `lagrange.System.check`."""
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
    """Return the accelerations of the textbook derivation, or a note that they are too large to be derived.

    `prescribed` are the values of given functions and their derivatives.
    """
    if len(system.statement.coordinates) > MOST_DERIVED:
        limit = f"which is done up to {MOST_DERIVED} coordinates."
        return None, (f"not compared with the textbook derivation, {limit}",)
    try:
        return {q: a.xreplace(prescribed) for q, a in system.derivation().accelerations.items()}, ()
    except StatementError as refusal:
        return None, (f"not compared with the textbook derivation: {refusal}",)
