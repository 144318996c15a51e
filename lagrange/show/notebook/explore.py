"""Sliders in a notebook with a picture of the run. ipywidgets is imported at first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.errors import LagrangeError, StatementError, listing
from lagrange.show.animation.axis import around
from lagrange.show.figures.new_figure import SCREEN_DPI, new_figure
from lagrange.show.figures.space import View, spring, view_of
from lagrange.show.figures.style import Style, colours, dress, on_paper, style_of
from lagrange.show.notation.names import letters, plain_text
from lagrange.show.notebook.html_card import text
from lagrange.show.sliders import PARAMETER, Slider, asked_bounds, places
from lagrange.show.units import length_unit, unit_of, with_unit
from lagrange.statement.declare import ORIGIN
from lagrange.statement.number import flag, real_number
from lagrange.statement.statement import SPRING, Statement
from lagrange.trajectory.measures.points import fixed_points, points_at
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


MOST_SLIDERS = 12
"""Most sliders of a picture: more are hard to use."""


def explored_sliders(statement: Statement, given: Any, named: Mapping[str, Any]) -> list[Slider]:
    """Return the sliders: first those of a dict by symbol or name, then those given by keyword.

    Raises StatementError for a name that is not a parameter, coordinate or velocity, and for invalid bounds.
    """
    bounds = asked_bounds(statement, given) | asked_bounds(statement, named)
    known = places(statement)
    if not bounds:
        raise StatementError(
            f"no slider was asked for: give bounds such as explore({next(iter(known))}=(0, 2)), of {listing(known)}."
        )
    if len(bounds) > MOST_SLIDERS:
        raise StatementError(f"{len(bounds)} sliders were asked for, and there is room for {MOST_SLIDERS}.")
    found = []
    for name, (low, high) in bounds.items():
        kind, place = known[name]
        value = statement.initial[place] if kind != PARAMETER else statement.defaults.get(statement.parameters[place])
        start = (low + high) / 2 if value is None else min(max(value, low), high)
        found.append(Slider(name, kind, place, start, low, high, unit_of(statement, name), chosen=True))
    return found


SAMPLES = 1500
"""Points of a curve: about three for each pixel of time. More would be slow, and invisible."""

_SIZE, _DPI = (8.4, 3.7), 120
_LEFT, _RIGHT = (0.085, 0.15, 0.37, 0.74), (0.57, 0.15, 0.4, 0.74)
SHOWN_WIDTH = round(SCREEN_DPI * _SIZE[0])
"""Width of the picture in pixels of a notebook."""

_ROOM = 0.08
"""Empty room around the curves, as a part of their range."""
_TOO_SMALL = 0.45
"""Limits stay while the curves fill more than this part of them, so that the picture does not jump at each change."""

MOST_NAMED = 8
"""Most points or coordinates with a legend."""


class ExploredPicture:
    """Two panels of a system, for successive runs and any time in them."""

    def __init__(self, statement: Statement, style: Style) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.patches import Rectangle

        self.statement, self.style = statement, style
        self._figure = on_paper(new_figure(figsize=_SIZE, dpi=_DPI), style)
        untyped: Any = FigureCanvasAgg
        self._canvas = untyped(self._figure)
        self._place: Axes = self._figure.add_axes(_LEFT)
        self._energy: Axes = self._figure.add_axes(_RIGHT)
        dress(self._place, style)
        dress(self._energy, style, "energy")
        time = with_unit("t", unit_of(statement, "t"))
        self._energy.set_xlabel(time)
        for ticks in (self._place.xaxis, self._place.yaxis, self._energy.xaxis, self._energy.yaxis):
            ticks.set_major_formatter(_tick)
        self._energy.locator_params(axis="y", nbins=5)
        (self._curve,) = self._energy.plot([], [], color=style.ink, linewidth=1.2, animated=True)
        panels = [self._energy] if statement.positions else [self._energy, self._place]
        self._cursors = {axis: axis.axvline(0.0, color=style.quiet, linewidth=1.0, animated=True) for axis in panels}
        named, fixed = list(statement.positions), fixed_points(statement)
        self._names = tuple(name for name in named if not fixed[name]) if named else statement.names
        self._fixed = tuple(name for name in (*named, ORIGIN) if fixed[name])
        own = colours(len(self._names), style.colours)
        self._paths = [self._place.plot([], [], color=c, linewidth=1.0, alpha=0.6, animated=True)[0] for c in own]
        self._dots = [
            self._place.plot([], [], "o", color=c, markersize=8, animated=True, label=plain_text(name), zorder=5)[0]
            for c, name in zip(own, self._names, strict=True)
        ]
        self._links: list[Line2D] = [
            self._place.plot([], [], color=style.quiet, linewidth=1.8, animated=True, zorder=3)[0]
            for _ in statement.links
        ]
        self._marks = [
            self._place.plot([], [], "s", color=style.ink, markersize=4, animated=True, zorder=4)[0]
            for _ in self._fixed
        ]
        if not named:
            self._place.set_xlabel(time)
        if not named and len(self._names) == 1:
            (name,) = self._names
            self._place.set_ylabel(with_unit(f"${letters([name])[name]}$", unit_of(statement, name)))
        if 1 < len(self._names) <= MOST_NAMED:
            self._legend()
        self._times: FloatArray = np.zeros(1)
        self._points: dict[str, FloatArray] = {}
        self._rows: FloatArray = np.zeros((len(statement.names), 1))
        self._view: View | None = None
        self._placed = self._shown = False
        sheet: Any = {"transform": self._figure.transFigure, "facecolor": style.paper, "edgecolor": "none"}
        self._sheets = {
            self._place: Rectangle((0.0, 0.0), 0.5, 1.0, **sheet),
            self._energy: Rectangle((0.5, 0.0), 0.5, 1.0, **sheet),
        }
        self._stale: dict[Axes, bool] = dict.fromkeys(self._sheets, True)
        self._canvas.draw()
        self._kept = self._canvas.copy_from_bbox(self._figure.bbox)

    def _legend(self) -> None:
        labels = [
            f"${letters([name])[name]}$" if not self.statement.positions else plain_text(name) for name in self._names
        ]
        self._place.legend(
            self._dots,
            labels,
            fontsize=8,
            frameon=False,
            ncols=4,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            borderaxespad=0.2,
            labelcolor=self.style.ink,
        )

    def show(self, solution: Solution) -> None:
        """Take a run, whose picture can then be drawn at any time. A run without output keeps the last picture."""
        if not len(solution.t):
            return
        self._shown = True
        start, end = solution.trajectory.span
        self._times = np.linspace(start, end, SAMPLES)
        states = solution.at(self._times)
        self._rows = states[: len(self.statement.names)]
        self._points = points_at(solution.model, self._times, states, solution.parameters_at(self._times))
        if self._points:
            self._show_points()
        else:
            for line, row in zip(self._paths, self._rows, strict=True):
                line.set_data(self._times, row)
            self._limit(self._place, self._times, self._rows)
        self._show_energy(solution, states)

    def _show_points(self) -> None:
        view = view_of(self._points)
        if self._view is None or view.labels != self._view.labels:
            unit = length_unit(self.statement)
            right, up = ("", "") if view.spatial else (with_unit(name, unit) for name in view.labels)
            self._place.set_xlabel(right)
            self._place.set_ylabel(up)
            if view.spatial:
                _draw_directions(self._place, view, self.style)
            self._stale[self._place] = True
        self._view = view
        self._points = {name: view.of(point) for name, point in self._points.items()}
        for line, name in zip(self._paths, self._names, strict=True):
            line.set_data(*self._points[name])
        together = np.concatenate(list(self._points.values()), axis=1)
        self._limit_to_scale(together[:, np.isfinite(together).all(axis=0)])

    def _show_energy(self, solution: Solution, states: FloatArray) -> None:
        if not solution.has_energy:
            self._curve.set_data([], [])
            self._titled("energy: it has no value at some state")
            return
        model, drift = solution.model, solution.drift
        energy = np.asarray(model.energy(*model.layout.split(states), self._times, solution.parameters_at(self._times)))
        if drift.conserved:
            energy = (energy - drift.first) / (drift.scale if drift.scale > 0 else 1.0)
            self._titled(f"energy drift, relative to {drift.against}")
        else:
            self._titled(f"energy ({drift.unkept})")
        self._curve.set_data(self._times, energy)
        self._limit(self._energy, self._times, energy[None], about_zero=bool(drift.conserved))

    def _titled(self, title: str) -> None:
        if title != self._energy.get_title("left"):
            self._energy.set_title(title, loc="left", fontsize=10, color=self.style.ink)
            self._stale[self._energy] = True

    def png(self, share: float) -> bytes:
        """Return the picture at a part of the run, between 0 and 1, as PNG."""
        self._canvas.restore_region(self._kept)
        if self._stale:
            self._draw_axes()
        for line in self._paths:
            self._place.draw_artist(line)
        self._energy.draw_artist(self._curve)
        self._move(min(int(share * len(self._times)), len(self._times) - 1))
        return self._encoded()

    def _draw_axes(self) -> None:
        """Draw the panels whose limits or titles have changed, and store the result as the background."""
        renderer = self._canvas.get_renderer()
        for axis in self._stale:
            self._sheets[axis].draw(renderer)
            axis.draw(renderer)
        self._stale = {}
        self._kept = self._canvas.copy_from_bbox(self._figure.bbox)

    def _move(self, place: int) -> None:
        """Draw the moving artists at time index `place`."""
        if not self._shown:
            return
        time = self._times[place]
        for axis, cursor in self._cursors.items():
            cursor.set_xdata([time, time])
            axis.draw_artist(cursor)
        if self._points:
            self._move_points(place)
        else:
            for dot, row in zip(self._dots, self._rows, strict=True):
                dot.set_data([time], [row[place]])
                self._place.draw_artist(dot)

    def _move_points(self, place: int) -> None:
        here = {name: point[:, place] for name, point in self._points.items()}
        size = float(np.ptp(self._place.get_xlim()))
        for line, (start, end, kind) in zip(self._links, self.statement.links, strict=True):
            ends = here[start], here[end]
            line.set_data(*(spring(*ends, 0.03 * size) if kind == SPRING else np.array(ends).T))
            self._place.draw_artist(line)
        for dot, name in zip([*self._marks, *self._dots], [*self._fixed, *self._names], strict=True):
            if name in here:
                dot.set_data(*here[name][:, None])
                self._place.draw_artist(dot)

    def _encoded(self) -> bytes:
        from PIL import Image

        file = BytesIO()
        pixels = np.asarray(self._canvas.buffer_rgba())[..., :3]
        Image.fromarray(pixels).save(file, format="png", compress_level=1)
        return file.getvalue()

    def _limit(self, axis: Axes, t: FloatArray, rows: FloatArray, *, about_zero: bool = False) -> None:
        """Set limits around curves over time, or keep limits that fit."""
        good = rows[np.isfinite(rows)]
        low, high = (float(good.min()), float(good.max())) if good.size else (0.0, 1.0)
        across = (float(t[0]), float(t[-1])) if t[0] != t[-1] else (t[0] - 0.5, t[0] + 0.5)
        up = _about_zero(axis.get_ylim(), low, high) if about_zero else _kept(axis.get_ylim(), low, high)
        self._set(axis, across, up)

    def _set(self, axis: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
        """Set limits; if they change the background must be drawn again."""
        if (axis.get_xlim(), axis.get_ylim()) != (across, up):
            axis.set_xlim(*across)
            axis.set_ylim(*up)
            self._stale[axis] = True

    def _limit_to_scale(self, points: FloatArray) -> None:
        """Set limits of a plane with equal lengths in both directions."""
        if not points.shape[1]:
            return
        low, high = points.min(axis=1), points.max(axis=1)
        middle, extent = (low + high) / 2, high - low
        wide, high_in = _LEFT[2] * _SIZE[0], _LEFT[3] * _SIZE[1]
        per_inch = float(max(extent[0] / wide, extent[1] / high_in)) * (1 + 2 * _ROOM) or 1.0 / wide
        (x0, x1), (y0, y1) = self._place.get_xlim(), self._place.get_ylim()
        now = (x1 - x0) / wide
        inside = x0 <= low[0] and high[0] <= x1 and y0 <= low[1] and high[1] <= y1
        if self._view is not None and self._placed and inside and per_inch > _TOO_SMALL * now:
            return
        self._placed = True
        half = per_inch * np.array([wide, high_in]) / 2
        (x0, y0), (x1, y1) = (middle - half).tolist(), (middle + half).tolist()
        self._set(self._place, (x0, x1), (y0, y1))


def _draw_directions(axis: Axes, view: View, style: Style) -> None:
    """Draw the directions of x, y and z in a corner, in place of numbers, which do not apply to this view."""
    axis.set(xticks=[], yticks=[])
    for name, (right, up) in zip("xyz", view.matrix.T, strict=True):
        tip, end = (0.12 + 0.1 * right, 0.12 + 0.12 * up), (0.12 + 0.13 * right, 0.12 + 0.16 * up)
        arrow = {"arrowstyle": "->", "color": style.quiet}
        axis.annotate("", tip, (0.1, 0.1), "axes fraction", "axes fraction", arrowprops=arrow)
        axis.annotate(name, end, xycoords="axes fraction", ha="center", va="center", color=style.ink)


def _tick(value: float, _: float) -> str:
    """Return the number at a tick as plain text, which is drawn ten times as fast as a formula."""
    return f"{value:.4g}".replace("e-0", "e-").replace("-", "\N{MINUS SIGN}")


def _about_zero(limits: tuple[float, float], low: float, high: float) -> tuple[float, float]:
    """Return limits of a drift, symmetric about zero: a power of ten, or half of it, that contains all values."""
    largest = max(abs(low), abs(high)) or 1e-16
    if -limits[0] == limits[1] and largest < limits[1] < 30 * largest:
        return limits
    power = 10.0 ** np.ceil(np.log10(largest))
    end = float(power / 2 if largest < power / 2 else power if largest < power else 5 * power)
    return -end, end


def _kept(limits: tuple[float, float], low: float, high: float) -> tuple[float, float]:
    """Return limits around values: the present ones while the values fill them, else new ones with some room."""
    if limits[0] <= low and high <= limits[1] and high - low > _TOO_SMALL * (limits[1] - limits[0]):
        return limits
    return around(np.array([low, high]), _ROOM)


Run = Callable[[Mapping[str, float], Mapping[str, float]], Solution]
"""Function from initial values by name and parameters by name to the run."""


class Exploration:
    """A system at the values of its sliders: `picture` is a PNG, `message` says how the run ended.

    A failed run changes the message, and the picture as far as the run got.
    """

    def __init__(self, statement: Statement, sliders: Sequence[Slider], run: Run, style: Style) -> None:
        self.statement, self.sliders = statement, tuple(sliders)
        self.values = {slider.name: slider.value for slider in sliders}
        self.share = 0.0
        self.message = ""
        self.complete = False
        self._run = run
        self._note = "" if statement.positions else "No positions are stated: the coordinates are drawn."
        self._drawn = ExploredPicture(statement, style)
        self.picture = b""
        self.change({})

    def change(self, values: Mapping[str, float]) -> None:
        """Set sliders to values, run again and draw."""
        self.values |= values
        parameters = {slider.name: self.values[slider.name] for slider in self.sliders if slider.kind == PARAMETER}
        initial = {slider.name: self.values[slider.name] for slider in self.sliders if slider.kind != PARAMETER}
        try:
            solution = self._run(initial, parameters)
        except LagrangeError as refusal:
            self.message, self.complete = str(refusal), False
        else:
            self._drawn.show(solution)
            self.complete = solution.status.complete
            self.message = " ".join(filter(None, (solution.message, _drift(solution), self._note)))
        self.move(self.share)

    def move(self, share: float) -> None:
        """Draw the picture at another part of the run, between 0 and 1."""
        self.share = min(max(share, 0.0), 1.0)
        self.picture = self._drawn.png(self.share)


def _drift(solution: Solution) -> str:
    """Return a sentence on the change of the energy, if the system conserves it."""
    if not solution.has_energy or not solution.drift.conserved:
        return ""
    return f"Energy drift {solution.drift.sentence()}."


PLACES = 400
"""Number of positions of the time slider; the whole run plays in 20 s at 20 per second."""
INTERVAL = 50
"""Milliseconds between two frames while a run plays."""


LONGEST = 1.0
"""Longest time of a run for the sliders, in seconds, before it ends with a message: longer runs would block them."""


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
    """Return the widgets of a system; `runs(t_end, initial, parameters=..., ...)` runs it. See `System.explore`."""
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
    """Return the widget of a slider. It has no steps, because the browser would round the value to a step."""
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
    """Return the message of the run as HTML."""
    words = text(exploration.message)
    return words if exploration.complete else f"<b>The run did not get to its end.</b> {words}"
