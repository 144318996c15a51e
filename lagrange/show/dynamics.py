"""Public functions for phase portraits, Poincare sections and bifurcations, with their defaults and their results."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lagrange.dynamics.equilibrium_branches import BranchesData, equilibrium_branches
from lagrange.dynamics.portrait import CELLS as CELLS_OF_PLANE
from lagrange.dynamics.portrait import PortraitData, portrait
from lagrange.dynamics.runs import Runs, depends_on_time
from lagrange.dynamics.section import SectionData, point_counts, surface
from lagrange.dynamics.section import section as section_of
from lagrange.dynamics.sweep import SweepData, parameter_of, sweep, values_of, with_value
from lagrange.errors import StatementError, counted, listing
from lagrange.machine.model import Model, Stated
from lagrange.mechanics.modes import Modes, ModeShapes, mode_shapes
from lagrange.show.figures.dynamics_figures import plot_branches, plot_modes, plot_portrait, plot_section, plot_sweep
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.files.picture import picture
from lagrange.show.notebook.html_card import pairs, pictured
from lagrange.show.notebook.page_writer import ExpressionTuple
from lagrange.statement.display import LINES, counter, text_table
from lagrange.statement.expression import flag, flag_or_word, positive_number, real_number, whole_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.tolerances import check_options
from lagrange.trajectory.run import compiled
from lagrange.trajectory.trajectory import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIGHT, USUAL = 1e-12, 1e-9
"""Default relative tolerances of adaptive methods: 1e-12 for portraits and sections, in which closed orbits have to
close visibly, and 1e-9 for bifurcations."""

ORBIT_STEPS = 20_000
"""Default limit of steps for an orbit of a portrait with an adaptive method: thousands of oscillations."""

_MOST_PLACES = 8  # Largest number of equilibria or branches that a card lists


class Drawn(ABC):
    """Base class of results with a card, the printed summary, and a picture.

    `status` says whether the result is complete; `message` names the missing parts.
    """

    statement: Statement
    status: Status
    message: str

    @abstractmethod
    def plot(self, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure of the result, drawn on Matplotlib's axes `ax` if they are given.

        `style` is "light" or "dark".
        """

    @abstractmethod
    def _lines(self) -> list[tuple[str, str]]:
        """Return the lines of the result's card, a table of its data, as pairs (label, text)."""

    def to_png(self, path: str | os.PathLike[str], *, dpi: int = FILE_DPI, style: str = "light") -> Path:
        """Write the figure of the result to `path` as PNG, with `dpi` dots per inch, and return the path.

        `style` is "light" or "dark". Raises StatementError for a path that cannot be written.
        """
        return write_atomically(path, picture(lambda: self.plot(style=style), dpi))

    def __repr__(self) -> str:
        return f"{self._heading()}\n{text_table(('', ''), self._card())}"

    def _repr_html_(self) -> str:
        return pictured(pairs(self._heading(), self._card()), self.plot, self._heading())

    def _heading(self) -> str:
        return f"{self.statement.name}: {self.status.value}"

    def _card(self) -> list[tuple[str, str]]:
        return [*self._lines(), *([("message", self.message)] if self.message else [])]


@dataclass(frozen=True, eq=False, repr=False)
class PhasePortrait(Drawn, PortraitData):
    """Orbits, equilibria and separatrices on a plane of the state; the result of `lagrange.phase_portrait`."""

    def plot(self, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure of the phase portrait: field, nullclines, orbits, separatrices and equilibria.

        It is drawn on Matplotlib's axes `ax` if they are given. `style` is "light" or "dark".
        """
        return plot_portrait(self, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        fixed = listing(f"{name} = {value:g}" for name, value in self.held.items())
        equilibria = [
            (equilibrium.kind, listing(map("{} = {:.6g}".format, self.statement.names, equilibrium.state)))
            for equilibrium in self.equilibria[:_MOST_PLACES]
        ]
        return [
            ("plane", listing(f"{axis.name} {axis.low:.4g} to {axis.high:.4g}" for axis in self.plane)),
            *([("held", fixed)] if self.held else []),
            *equilibria,
            ("separatrices", str(len(self.separatrices))),
            ("orbits", f"{len(self.orbits)}, {sum(axis.closed for axis in self.orbits)} closed"),
        ]


@dataclass(frozen=True, eq=False, repr=False)
class PoincareSection(Drawn, SectionData):
    """Times and states at the crossings of each orbit; the result of `lagrange.poincare`."""

    def plot(self, x: Any = None, y: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure of the Poincare section: a point for each crossing, and a colour for each orbit.

        `x` and `y` are the entries of the state on the axes, None for the default. The figure is drawn on Matplotlib's
        axes `ax` if they are given. `style` is "light" or "dark".
        """
        return plot_section(self, x, y, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        where = f"every {self.period:.6g}" if self.event is None else surface(self.event, self.statement)
        lines = [("section", where), ("orbits", str(len(self.states))), ("points", str(len(self.points)))]
        return [*lines, *([("energy drift", f"{self.drift:.1e}")] if self.drift is not None else [])]


@dataclass(frozen=True, eq=False, repr=False)
class Bifurcation(Drawn, SweepData):
    """States of a driven system along a parameter, sampled after the transient; a result of `lagrange.bifurcation`."""

    def plot(self, entry: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure of the bifurcation diagram: the sampled states against the parameter.

        `entry` is the entry of the state to draw, None for the default. The figure is drawn on Matplotlib's axes `ax`
        if they are given. `style` is "light" or "dark".
        """
        return plot_sweep(self, entry, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        count = Counter(self.cycles.ravel().tolist())
        known = listing(f"{p} at {number}" for p, number in sorted(count.items()) if p)
        return [
            ("parameter", f"{self.parameter}, {_range(self.values)}"),
            ("points", f"{self.states.shape[2]} of {counted(self.states.shape[1], 'orbit')} at each value"),
            ("cycles", f"of length {known}" if known != "none" else known),
            *([("no cycle", f"at {count[0]}")] if count[0] else []),
        ]


@dataclass(frozen=True, eq=False, repr=False)
class EquilibriumBranches(Drawn, BranchesData):
    """Branches of equilibria along a parameter; the result of `lagrange.bifurcation` without driving or section."""

    def plot(self, entry: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure of equilibria along the parameter: a line for each branch, dashed where unstable.

        `entry` is the coordinate to draw, None for the default. The figure is drawn on Matplotlib's axes `ax` if they
        are given. `style` is "light" or "dark".
        """
        return plot_branches(self, entry, ax, style)

    def _lines(self) -> list[tuple[str, str]]:
        lines = [("parameter", f"{self.parameter}, {_range(self.values)}")]
        for branch in self.branches[:_MOST_PLACES]:
            stated = zip(self.statement.names, branch.formula.values(), strict=True)
            where = listing(f"{name} = {x}" for name, x in stated) if branch.formula else "by number"
            # `stable` is 1 for values at which no eigenvalue has a positive real part.
            within, alone = branch.values[branch.stable == 1], "" if (branch.stable != 0).all() else " alone"
            stability = f"no growing motion from {within.min():.4g} to {within.max():.4g}{alone}" if len(within) else ""
            lines.append(("branch", f"{where}; {stability or 'unstable'}"))
        return lines


@dataclass(frozen=True, eq=False, repr=False)
class ShownModes(Modes):
    """Frequencies and shapes of small oscillations; the result of `System.modes`."""

    def __post_init__(self) -> None:
        if self.symbolic:
            readable = ExpressionTuple(self.frequencies, self.linearization.statement)
            object.__setattr__(self, "frequencies", readable)

    def __repr__(self) -> str:
        frequencies = self.frequencies
        written = frequencies.written() if isinstance(frequencies, ExpressionTuple) else map(str, frequencies)
        return self._summary(written)

    def shapes_in_numbers(self) -> ModeShapes:
        """Return the shapes of the modes as numbers, for all coordinates and for the stated positions.

        Raises StatementError where a parameter has no value.
        """
        return mode_shapes(self, self.linearization.statement)

    def plot(self, *, ax: Any = None, style: str = "light") -> Figure:
        """Return the figure of the modes: for each mode bars for its components, and the displaced positions.

        On a user's axes `ax` the components of all modes are bars side by side. `style` is "light" or "dark". Raises
        StatementError where a parameter has no value.
        """
        return plot_modes(self.shapes_in_numbers(), ax, style)


_Record = TypeVar("_Record")


def shown_as(kind: type[_Record], data: Any) -> _Record:
    """Return `data` as an instance of `kind`, a subclass of its class that adds a card and a picture."""
    return kind(**{field.name: getattr(data, field.name) for field in fields(data)})


def _range(values: np.ndarray) -> str:
    return f"{counted(len(values), 'value')} from {values[0]:g} to {values[-1]:g}"


def phase_portrait(
    system: Stated | Model,
    window: Mapping[Any, Any] | None = None,
    *,
    at: Mapping[Any, Any] | None = None,
    starts: Any = None,
    parameters: Mapping[Any, Any] | None = None,
    t: float = 0.0,
    t_end: float | None = None,
    method: Any = None,
    rtol: float | None = None,
    step: float | None = None,
    max_steps: int | None = None,
    progress: bool | str = False,
) -> PhasePortrait:
    """Return the phase portrait on a plane of the state: field, nullclines, equilibria, separatrices and orbits.

    `window` gives two entries of the state with their ranges, {theta: (-3, 3), theta.dot: (-5, 5)}. The first is on the
    horizontal axis; (low, high, count) sets the number of arrows. By default, for a system with one coordinate, the
    window contains the equilibria and the motions between them. For more coordinates the portrait is a slice: `at`
    fixes all other entries, {phi: 0, phi.dot: 0}, and orbits leave the plane. `starts` are initial states, dicts or
    rows (m, 2n); by default orbits fill the plane evenly. Each orbit is followed forwards and backwards. It ends where
    it leaves the window or closes, or after the time `t_end` or `max_steps` steps, which the message reports. The
    default of `t_end` is 20 periods of small motions. The default of `max_steps` is 20,000, unless `step` is given. A
    coordinate with a period of 2 pi is an angle, and is wrapped.

    Separatrices begin on the eigenvectors of a saddle, with an error below 1e-10 of the window. For a system that
    depends on time, the field is evaluated at the time `t`, at which orbits begin. `parameters`, `method`, `rtol` and
    `step` are as for a run; the default of rtol is 1e-12. `progress` shows the finished part. Ctrl-C keeps the finished
    parts, with `Status.INTERRUPTED`. Raises StatementError for an invalid plane.
    """
    limit = ORBIT_STEPS if max_steps is None and step is None else max_steps
    _, runs = _runs(system, (method, rtol, step), TIGHT, parameters, progress, limit)
    reach = None if t_end is None else positive_number(t_end, "t_end", "give a positive time to follow orbits")
    total, noun = (CELLS_OF_PLANE**2, "cell") if starts is None else (_length(starts), "orbit")
    with counter(total, noun, enabled=progress) as report:
        data = portrait(runs, window, at, starts, time=real_number(t, "t"), reach=reach, progress=report)
    return shown_as(PhasePortrait, data)


def poincare(
    system: Stated | Model,
    event: Any,
    starts: Any = None,
    *,
    crossings: int = 500,
    skip: int = 0,
    energy: float | None = None,
    solve_for: Any = None,
    longest: float | None = None,
    parameters: Mapping[Any, Any] | None = None,
    method: Any = None,
    rtol: float | None = None,
    step: float | None = None,
    progress: bool | str = False,
) -> PoincareSection:
    """Return the Poincare section of orbits from many starts: their states each time an event happens.

    `event` is an expression that is zero on the section, or `lg.event(x, direction=1)` for one direction of crossing. A
    number, or an expression in parameters such as 2*pi/w, is a sampling period instead, as for a driven system.
    `starts` are initial states, a list of dicts or rows (m, 2n); a dict overlays the initial state of the system. With
    `energy` all starts have that energy. The velocity `solve_for` follows from the energy, with the sign of the event's
    direction. Each orbit is followed for `skip` crossings, and then for `crossings` that are kept. An orbit ends early
    if no crossing occurs within the time `longest`, 200 periods of small motions by default. `parameters`, `method`,
    `rtol` and `step` are as for a run; the default of rtol is 1e-12. `progress` shows the number of finished orbits.

    The result has `times` and `states`, (k,) and (k, 2n) for each start, `points` of all, and `plot(x, y)`. Ctrl-C
    keeps the finished orbits. Raises StatementError for an invalid section, and for starts whose energy is too high.
    """
    _, runs = _runs(system, (method, rtol, step), TIGHT, parameters, progress)
    with counter(_length(starts), "orbit", enabled=progress) as report:
        data = section_of(
            runs,
            event,
            starts,
            crossings=crossings,
            skip=skip,
            energy=energy,
            solve_for=solve_for,
            longest=longest,
            progress=report,
        )
    return shown_as(PoincareSection, data)


def bifurcation(
    system: Stated | Model,
    parameter: Any,
    values: ArrayLike,
    *,
    section: Any = None,
    starts: Any = None,
    points: int = 64,
    skip: int = 200,
    follow: bool = True,
    parameters: Mapping[Any, Any] | None = None,
    method: Any = None,
    rtol: float | None = None,
    step: float | None = None,
    progress: bool | str = False,
) -> Bifurcation | EquilibriumBranches:
    """Return the bifurcation diagram of a system along a parameter.

    `values` are a list, or (low, high, count), in any order. A system that is driven in time is sampled after each
    period of its driving. The period follows from the sines and cosines of time, or is given as `section`. With an
    event as `section`, as in `poincare`, any system is sampled at its crossings. At each value the orbits from `starts`
    are followed for `skip` samples, and then for `points` samples that are kept. With `follow` the orbits begin where
    those of the previous value ended, so that rising and falling values show hysteresis. The result has `states` (k, m,
    points, 2n), and `cycles` (k, m), the number of points after which each orbit repeats.

    For a system without driving and without a section the result shows its equilibria: `branches`, with formulas where
    they are found, and stability.

    `parameters` overlay the values of the other parameters. `method`, `rtol` and `step` are as for a run; the default
    of rtol is 1e-9. `progress` shows the number of finished values, which Ctrl-C keeps. Raises StatementError for an
    unknown parameter, and for an empty range.
    """
    model, runs = _runs(system, (method, rtol, step), USUAL, parameters, progress)
    name = parameter_of(model.statement, parameter)
    chosen = values_of(values, name)
    count, dropped = point_counts(points, skip, "points", 2)
    followed = flag(follow, "follow")
    index = [p.name for p in model.statement.parameters].index(name)
    for value in chosen.tolist():
        with_value(runs, index, value)  # refuse an invalid value of the parameter before the first run
    if section is None and not depends_on_time(model.statement):
        if starts is not None:
            raise StatementError(
                f"{model.statement.name} is not driven in time, so the diagram shows its equilibria, which need no "
                "starts: leave starts out, or give section=..., an event at which its motion is sampled."
            )
        with counter(3, "value", enabled=progress) as report:
            known = model.with_defaults(parameters or {})
            return shown_as(EquilibriumBranches, equilibrium_branches(known, name, chosen, report))
    with counter(len(chosen), "value", enabled=progress) as report:
        data = sweep(
            runs, name, chosen, section, starts, count=count, dropped=dropped, followed=followed, progress=report
        )
    return shown_as(Bifurcation, data)


def _runs(
    system: Stated | Model,
    step_options: tuple[Any, Any, Any],
    default_rtol: float,
    parameters: Mapping[Any, Any] | None,
    progress: bool | str,
    max_steps: int | None = None,
) -> tuple[Model, Runs]:
    """Return the compiled model of a system, and the object that runs it with the given options.

    `step_options` is (method, rtol, step), each None for its default. `default_rtol` is the default of rtol for
    adaptive methods, and `max_steps` the limit of steps of a run, None for the default. `parameters` overlay the stated
    values. With `progress` the compilation is reported.
    """
    method, rtol, step = step_options
    if rtol is None and (method is None or (isinstance(method, str) and find(method).claims.adaptive)):
        rtol = default_rtol
    model = compiled(system, "pendulum", progress=flag_or_word(progress, "progress", LINES))
    model.statement.check_without_contacts("a portrait, section or sweep")
    options = RunOptions(method, rtol, None, step, max_steps=max_steps)
    check_options(step, rtol)
    if method is not None:
        find(method)
    if max_steps is not None:
        whole_number(max_steps, "max_steps", 1)
    return model, Runs(model, model.parameter_array(parameters), options)


def _length(starts: Any) -> int:
    many = isinstance(starts, (list, tuple)) or (isinstance(starts, np.ndarray) and starts.ndim > 0)
    return max(len(starts), 1) if many else 1
