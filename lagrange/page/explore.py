"""Sliders in a notebook: the page of a system in a frame, or, where no page can be made, sliders that run in Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from lagrange.errors import LagrangeError, StatementError, listing
from lagrange.machine.model import Model
from lagrange.page.animation import animate
from lagrange.page.player import in_frame
from lagrange.page.script_data import METHOD, NoPage
from lagrange.page.sliders import PARAMETER, RATE, STATE, Slider, asked_bounds, places, rates_at
from lagrange.page.web_page import page_of
from lagrange.show.figures.style import style_of
from lagrange.show.notation.symbols import plain_text
from lagrange.show.notebook.html_card import text
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.expression import flag, real_number
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.statement.statement import Statement
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.solution import Solution

MOST_SLIDERS = 12
"""Largest number of sliders of a system: more are hard to use."""

SLIDER_RUN_SECONDS = 1.0
"""Longest time of a run for sliders in Python, in seconds, before it ends with a message."""

FRAME_WIDTH, FRAME_HEIGHT = 1100, 760
"""Size in pixels of the frame of a page; a notebook may be narrower."""


def explored_sliders(statement: Statement, ranges: Any, named: Mapping[str, Any]) -> list[Slider]:
    """Return the sliders: first the entries of the dict `ranges`, by symbol or name, then the keywords `named`.

    Raises StatementError for a name that is not a parameter, coordinate or velocity, and for invalid bounds.
    """
    bounds = asked_bounds(statement, ranges) | asked_bounds(statement, named)
    adjustable = places(statement)
    if not bounds:
        raise StatementError(
            f"no slider was asked for: give bounds such as explore({next(iter(adjustable))}=(0, 2)), for one of "
            f"{listing(adjustable)}."
        )
    if len(bounds) > MOST_SLIDERS:
        raise StatementError(f"{len(bounds)} sliders were asked for, and there is room for {MOST_SLIDERS}.")
    sliders = []
    starts = {STATE: statement.initial, RATE: rates_at(statement, statement.initial)}
    for name, (low, high) in bounds.items():
        kind, index = adjustable[name]
        value = statement.defaults.get(statement.parameters[index]) if kind == PARAMETER else starts[kind][index]
        start = (low + high) / 2 if value is None else min(max(value, low), high)
        sliders.append(Slider(name, kind, index, start, low, high, unit_of(statement, name), chosen=True))
    return sliders


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
    sliders: Sequence[Slider],
    model: Callable[[], Model],
    run: Callable[..., Solution],
    *,
    t_end: float | None,
    method: Any,
    play: bool,
    style: str,
) -> Any:
    """Return the page of a system with these sliders, or sliders that run in Python if no page can be made.

    `model()` compiles the system, and `run(t_end, initial, parameters=..., ...)` runs it with `method` to `t_end`;
    None stands for the stated method and end. `play` starts the motion at once, and `style` chooses the colours.
    """
    flag(play, "play")
    look = style_of(style)
    end = statement.run.t_end if t_end is None else real_number(t_end, "t_end, the time at which runs end,")
    find(statement.run.method or DEFAULT_METHOD if method is None else method)
    name = plain_text(statement.name)
    try:
        if method is not None and method != METHOD:
            raise NoPage(f"a page computes with {METHOD}, and method = {method!r} is asked for.")
        initial, parameters = _values(sliders, {slider.name: slider.value for slider in sliders})
        bounds = {slider.name: (slider.low, slider.high) for slider in sliders}
        page = page_of(model(), None, parameters, initial, bounds, t_end=end, play=play, style=look.name)
    except NoPage as reason:
        sentence = f"{str(reason)[0].upper()}{str(reason)[1:]}"
        return _widgets(statement, sliders, run, end, method, look.name, f"{sentence} The sliders run in Python.")
    return ExploredPage(name, page)


def _values(sliders: Sequence[Slider], values: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the `values` of the sliders as two dicts by name: first initial values, then parameters."""
    initial = {slider.name: values[slider.name] for slider in sliders if slider.kind != PARAMETER}
    return initial, {slider.name: values[slider.name] for slider in sliders if slider.kind == PARAMETER}


def _widgets(
    statement: Statement,
    sliders: Sequence[Slider],
    run: Callable[..., Solution],
    end: float,
    method: Any,
    style: str,
    reason: str,
) -> Any:
    """Return sliders above the animation of a run, which runs again for each change of a slider, and a message below.

    A run is made by `run` with `method`, and ends at the time `end`. `reason` says why there is no page. Raises
    StatementError without ipywidgets.
    """
    try:
        import ipywidgets
    except ImportError as error:
        raise StatementError(
            f"{reason} They need ipywidgets, which is not installed: pip install ipywidgets, which the extra notebook "
            "has, and start the kernel again."
        ) from error
    picture, message = ipywidgets.HTML(), ipywidgets.HTML()
    widgets = {slider.name: _slider(ipywidgets, slider) for slider in sliders}

    def show(_: Any = None) -> None:
        initial, parameters = _values(sliders, {name: float(widget.value) for name, widget in widgets.items()})
        try:
            solution = run(end, initial, parameters=parameters, method=method, max_wall=SLIDER_RUN_SECONDS)
            picture.value = animate(solution, style=style)._repr_html_()
        except LagrangeError as refusal:
            message.value = f"<b>The run did not get to its end.</b> {text(str(refusal))}"
            return
        early = "" if solution.status.complete else "<b>The run did not get to its end.</b> "
        message.value = early + text(solution.message)

    for widget in widgets.values():
        widget.observe(show, names="value")
    show()
    title = ipywidgets.HTML(f"<b>{escape(plain_text(statement.name))}</b><p>{text(reason)}</p>")
    return ipywidgets.VBox([title, *widgets.values(), picture, message])


def _slider(ipywidgets: Any, slider: Slider) -> Any:
    """Return the widget of a slider. The widget has no steps, because the browser would round the value to a step."""
    label = with_unit(slider.name if slider.kind == PARAMETER else f"{slider.name} at t = 0", slider.unit)
    return ipywidgets.FloatSlider(
        value=slider.value,
        min=slider.low,
        max=slider.high,
        step=None,
        description=label,
        readout_format=".4g",
        continuous_update=False,
        style={"description_width": "11em"},
        layout=ipywidgets.Layout(width="32em", max_width="100%"),
    )
