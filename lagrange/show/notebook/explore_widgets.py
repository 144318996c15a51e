"""Sliders in a notebook, over the picture that they move. ipywidgets is imported when somebody asks for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from lagrange.errors import StatementError
from lagrange.show.figures.style import style_of
from lagrange.show.notation.names import plain_text
from lagrange.show.notebook.exploration import Exploration
from lagrange.show.notebook.explored_picture import SHOWN_WIDTH
from lagrange.show.notebook.html_card import text
from lagrange.show.sliders import PARAMETER, Slider
from lagrange.show.units import with_unit
from lagrange.statement.number import flag, real_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.solution import Solution

PLACES = 400
"""Places of the slider of time; the whole run plays in 20 s at 20 a second."""
INTERVAL = 50
"""Milliseconds between two frames of a run that plays."""


LONGEST = 1.0
"""Seconds that one run may take behind sliders, before it ends with a message: nobody drags against a longer one."""


def explore(
    statement: Statement,
    sliders: Sequence[Slider],
    runs: Callable[..., Solution],
    *,
    t_end: float | None,
    method: Any,
    play: bool,
    style: str,
) -> Any:
    """Return the widgets of a system that `runs(t_end, initial, parameters=..., ...)` runs; see `System.explore`."""
    flag(play, "play")
    look = style_of(style)
    end = statement.run.t_end if t_end is None else real_number(t_end, "t_end, the time at which runs end,")
    find(statement.run.method or DEFAULT if method is None else method)

    def run(initial: Mapping[str, float], parameters: Mapping[str, float]) -> Solution:
        return runs(end, initial, parameters=parameters, method=method, max_wall=LONGEST)

    return explore_widgets(Exploration(statement, sliders, run, look), play=play)


def explore_widgets(exploration: Exploration, *, play: bool) -> Any:
    """Return the sliders above the picture and the message. Raises StatementError without ipywidgets."""
    try:
        import ipywidgets
    except ImportError as error:
        raise StatementError(
            "explore() draws its sliders with ipywidgets, which is not installed: pip install ipywidgets, which the "
            "extra notebook has, and start the kernel again."
        ) from error
    picture = ipywidgets.Image(value=exploration.picture, format="png", width=SHOWN_WIDTH)
    picture.layout.max_width = "100%"
    message = ipywidgets.HTML()

    def show() -> None:
        picture.value = exploration.picture
        message.value = _message(exploration)

    def changed(name: str) -> Callable[[Any], None]:
        def take(change: Any) -> None:
            exploration.change({name: float(change["new"])})
            show()

        return take

    sliders = []
    for slider in exploration.sliders:
        one = _slider(ipywidgets, slider)
        one.observe(changed(slider.name), names="value")
        sliders.append(one)
    time = ipywidgets.IntSlider(value=0, min=0, max=PLACES, description="time", readout=False)

    def moved(change: Any) -> None:
        exploration.move(change["new"] / PLACES)
        picture.value = exploration.picture

    time.observe(moved, names="value")
    row = [time]
    if play:
        player = ipywidgets.Play(value=0, min=0, max=PLACES, step=1, interval=INTERVAL)
        ipywidgets.jslink((player, "value"), (time, "value"))
        row = [player, time]
    show()
    title = ipywidgets.HTML(f"<b>{escape(plain_text(exploration.statement.name))}</b>")
    return ipywidgets.VBox([title, *sliders, ipywidgets.HBox(row), picture, message])


def _slider(ipywidgets: Any, slider: Slider) -> Any:
    """Return the widget of a slider. It has no steps: the browser would show the next one in place of the value."""
    label = with_unit(slider.name if slider.kind == PARAMETER else f"{slider.name} at t = 0", slider.unit)
    return ipywidgets.FloatSlider(
        value=slider.value,
        min=slider.low,
        max=slider.high,
        step=None,
        description=label,
        readout_format=".4g",
        continuous_update=True,
        style={"description_width": "11em"},
        layout=ipywidgets.Layout(width="32em", max_width="100%"),
    )


def _message(exploration: Exploration) -> str:
    """Return how the run ended, as HTML."""
    words = text(exploration.message)
    return words if exploration.complete else f"<b>The run did not get to its end.</b> {words}"
