"""Sliders in a notebook: the page of a system in a frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError, listing
from lagrange.machine.model import Model
from lagrange.page.player import in_frame
from lagrange.page.sliders import PARAMETER, RATE, STATE, asked_bounds, places, rates_at
from lagrange.page.web_page import page_of
from lagrange.show.figures.style import style_of
from lagrange.show.notation.symbols import plain_text
from lagrange.statement.expression import flag, real_number
from lagrange.statement.statement import Statement

MOST_SLIDERS = 12
"""Largest number of sliders of a system: more are hard to use."""

FRAME_WIDTH, FRAME_HEIGHT = 1100, 760
"""Size in pixels of the frame of a page; a notebook may be narrower."""


@dataclass(frozen=True)
class ExploredPage:
    """A page with sliders, `html`, which a notebook shows in a frame."""

    name: str
    html: str

    def _repr_html_(self) -> str:
        return in_frame(self.html, f"sliders of {self.name}", FRAME_WIDTH, FRAME_HEIGHT)

    def __repr__(self) -> str:
        return f"<sliders of {self.name}: a notebook shows them; system.to_page(path) writes a page>"


def explore(
    statement: Statement,
    model: Callable[[], Model],
    ranges: Any,
    named: Mapping[str, Any],
    *,
    t_end: float | None,
    play: bool,
    style: str,
) -> ExploredPage:
    """Return the page of a system with sliders: first the entries of the dict `ranges`, then the keywords `named`.

    Both map symbols or names to bounds (low, high). `model()` compiles the system. The end of the run is `t_end`, None
    for the stated one. `play` starts the motion at once, and `style` chooses the colours. Raises StatementError for
    unknown names, invalid bounds, no or too many sliders, and where no page can be made.
    """
    bounds = asked_bounds(statement, ranges) | asked_bounds(statement, named)
    if not bounds:
        adjustable = places(statement)
        raise StatementError(
            f"no slider was asked for: give bounds such as explore({next(iter(adjustable))}=(0, 2)), for one of "
            f"{listing(adjustable)}."
        )
    if len(bounds) > MOST_SLIDERS:
        raise StatementError(f"{len(bounds)} sliders were asked for, and there is room for {MOST_SLIDERS}.")
    flag(play, "play")
    look = style_of(style)
    end = statement.run.t_end if t_end is None else real_number(t_end, "t_end, the time at which runs end,")
    parameters, initial = starts_within(statement, bounds)
    page = page_of(model(), None, parameters, initial, bounds, t_end=end, play=play, style=look.name)
    return ExploredPage(plain_text(statement.name), page)


def starts_within(
    statement: Statement, bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return values of the sliders by name, of parameters and of the initial state: the stated ones within the bounds.

    A parameter without a value starts in the middle of its slider.
    """
    values: dict[str, dict[str, float]] = {PARAMETER: {}, STATE: {}, RATE: {}}
    stated: dict[str, Sequence[float | None]] = {
        PARAMETER: [statement.defaults.get(symbol) for symbol in statement.parameters],
        STATE: statement.initial,
        RATE: rates_at(statement, statement.initial),
    }
    adjustable = places(statement)
    for name, (low, high) in bounds.items():
        kind, index = adjustable[name]
        value = stated[kind][index]
        values[kind][name] = (low + high) / 2 if value is None else min(max(value, low), high)
    return values[PARAMETER], values[STATE] | values[RATE]
