"""Write the page of a system."""

from __future__ import annotations

import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from lagrange.equations.derivation import Derivation
from lagrange.machine.model import Model
from lagrange.page.description import description
from lagrange.page.document import (
    Document,
    FoldedFormulas,
    colour_rules,
    formulas,
    hint,
    legend,
    note,
    phase_choices,
    slider_groups,
)
from lagrange.page.motion import motion_source
from lagrange.page.sliders import sliders
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.files.template import as_json
from lagrange.show.notation.names import plain_text
from lagrange.statement.declare import initial_state

LEAST_COLOURS = 3
"""Least number of colours: the lines of the plot of energies."""


def write_page(
    model: Model,
    derivation: Derivation,
    path: str | os.PathLike[str],
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    asked: Mapping[Any, Any] | None,
) -> Path:
    """Write the page of a model, whole or not at all, and return its path; see `System.to_page`."""
    return write_atomically(
        path, lambda file: file.write(page_of(model, derivation, parameters, initial, asked).encode())
    )


def page_of(
    model: Model,
    derivation: Derivation,
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    asked: Mapping[Any, Any] | None,
) -> str:
    """Return the page of a model."""
    statement = model.statement
    start = initial_state({} if initial is None else initial, statement.coordinates, statement.initial)
    values = tuple(float(value) for value in model.parameter_array(parameters))
    found = sliders(model, values, start, asked)
    motion = motion_source(model, parameters)
    data = description(statement, model.equations.structure, motion, start, found)
    title = escape(plain_text(statement.name))
    parts = {
        "title": title,
        "about": escape(plain_text(statement.about)),
        "legend": legend(statement),
        "note": note(statement),
        "hint": hint(statement),
        "sliders": slider_groups(found, FoldedFormulas(statement)),
        "choices": phase_choices(statement),
        "formulas": formulas(derivation),
    }
    count = max(len(statement.positions), len(statement.names), LEAST_COLOURS)
    return Document(parts, motion.script, as_json(data), colour_rules(count)).html()
