"""Write the page of a system."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.equations.derivation import Derivation
from lagrange.machine.model import Model
from lagrange.page.computed_motion import PAGE_STEPS, TOLERANCE, motion_source
from lagrange.page.document import (
    COMPUTED,
    PICTURES,
    as_json,
    colour_rules,
    hint,
    html,
    in_script,
    joined,
    legend,
    phase_choices,
    template,
)
from lagrange.page.formulas import FoldedFormulas, formulas, note, slider_groups
from lagrange.page.script_data import ENERGIES, description, rate_of
from lagrange.page.sliders import quaternion_rows, sliders
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notation.symbols import plain_text
from lagrange.statement.declare import initial_state
from lagrange.trajectory.constraints.consistent import complete_start


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
    derivation: Derivation | None,
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    asked: Mapping[Any, Any] | None,
    *,
    t_end: float | None = None,
    play: bool = True,
    style: str = "",
) -> str:
    """Return the page of a model, without formulas if it has no derivation.

    `t_end` sets the speed and the size of the picture, `style` is light or dark, or empty for that of the browser.
    """
    statement = model.statement
    end = statement.run.t_end if t_end is None else t_end
    state = np.array(initial_state({} if initial is None else initial, statement.coordinates, statement.initial))
    values = tuple(float(value) for value in model.parameter_array(parameters))
    start = complete_start(model, 0.0, state, np.array(values))
    found = sliders(model, values, tuple(start.tolist()), asked)
    motion = motion_source(model, parameters)
    data = description(statement, rate_of(end), ENERGIES[: 1 if statement.lagrangian_alone else 3])
    data |= {
        "parameters": list(motion.parameters),
        "initial": start.tolist(),
        "sliders": [{key: getattr(slider, key) for key in ("kind", "place", "value", "angle")} for slider in found],
        "quaternions": quaternion_rows(statement),
        "tolerance": TOLERANCE,
        "most_steps": PAGE_STEPS,
        "t_end": end,
        "play": play,
        "span": [bound if math.isfinite(bound) else None for bound in statement.span],
        "kept": model.equations.structure.energy_kept is True,
    }
    title = escape(plain_text(statement.name))
    parts = {
        "title": title,
        "about": escape(plain_text(statement.about)),
        "legend": legend(statement),
        "note": note(statement),
        "hint": hint(statement),
        "sliders": slider_groups(found, FoldedFormulas(statement)),
        "choices": phase_choices(statement),
        "formulas": "" if derivation is None else formulas(derivation),
        "look": f' data-style="{style}"' if style else "",
    }
    parts |= {"data": as_json(data), "style": colour_rules(statement) + template("page.css") + template("system.css")}
    scripts = {"shared": joined(*PICTURES, *COMPUTED), "module": in_script(motion.script)}
    return html("page.html", parts, scripts, trusted=True)
