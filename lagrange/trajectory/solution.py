"""The result of a run for users: rows by name, states at any time, energy, files and pictures."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from sympy import MatrixBase

from lagrange.errors import LagrangeError, RunError, StatementError, listing, suggestion
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import Parameters
from lagrange.statement.coordinate import multiplier, row_label
from lagrange.statement.expression import ByName
from lagrange.statement.rotation import Rotation, in_symbols, rotation_of, shorthands
from lagrange.trajectory.contact.history import ContactResult, ContactRun
from lagrange.trajectory.measures.conservation import EnergyDrift, energy_drift, momentum_drifts, since_start
from lagrange.trajectory.measures.constraints import ConstraintDrift, ConstraintForces, constraint_drift
from lagrange.trajectory.measures.stiffness import Stiffness, stiffness
from lagrange.trajectory.measures.times_and_points import reached_times, states_at
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from lagrange.page.player import Animation


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """States of a model along a run, with N output times.

    `solution[theta]`, `solution[theta.dot]`, `solution["theta"]` and `solution["theta_dot"]` are rows (N,). Units are
    the units of the statement. Times fall in a run backwards. A run that ended early keeps the states computed until
    then; `status` and `message` say why it ended.
    """

    trajectory: Trajectory
    model: Model
    parameters: Mapping[Any, float]

    @property
    def t(self) -> FloatArray:
        """The output times, (N,)."""
        return self.trajectory.t

    @property
    def y(self) -> FloatArray:
        """The states [q, v] at the output times, (2n, N)."""
        return self.trajectory.y

    @property
    def status(self) -> Status:
        """The way in which the run ended, such as `Status.SUCCESS`."""
        return self.trajectory.status

    @property
    def message(self) -> str:
        """The end of the run in words: coordinate, time, cause and remedy."""
        return self.trajectory.message

    @property
    def method(self) -> str:
        """The name of the method."""
        return self.trajectory.method

    @property
    def steps(self) -> int:
        """The number of accepted steps."""
        return self.trajectory.steps

    @property
    def evaluations(self) -> int:
        """The number of evaluations of the right-hand side."""
        return self.trajectory.evaluations

    @property
    def wall(self) -> float:
        """The duration of the run in seconds, without compilation."""
        return self.trajectory.wall

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,), in the order in which the events were given."""
        return self.trajectory.t_events

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states [q, v] at each event, (k, 2n), before any reset."""
        return self.trajectory.y_events

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the 2n rows: the coordinates, then their velocities with the suffix `_dot`."""
        return self.model.layout.names()

    def __getitem__(self, key: Any) -> FloatArray:
        """Return the row (N,) of a coordinate or a velocity. `key` is a SymPy expression or a name.

        For a rotation R the result is its matrices (N, 3, 3), for a vector such as R.body or R*v its entries (3, N).
        """
        if isinstance(key, Rotation):
            matrices: FloatArray = np.moveaxis(self[key.matrix].reshape(3, 3, -1), 2, 0)
            return matrices
        if isinstance(key, MatrixBase):
            return np.array([self.evaluate(entry) for entry in key])
        label = row_label(key)
        if label not in self.names:
            rotations = self.model.statement.rotations
            name, _, axes = label.partition(".")
            if name in rotations and axes in ("", "body", "space"):
                return self[getattr(rotation_of(name), axes) if axes else rotation_of(name)]
            if label in (vectors := shorthands(rotations)):
                return self.evaluate(vectors[label])
            names = in_symbols(self.names, rotations)
            raise StatementError(
                f"{label[:80]!r} is neither a coordinate nor a velocity of this system; they are {listing(names)}."
                + (suggestion(label, self.names) or " For an expression use solution.evaluate(...).")
            )
        row: FloatArray = self.y[self.names.index(label)]
        return row

    def at(self, t: ArrayLike) -> FloatArray:
        """Return the states at one time, (2n,), or at K times in any order, (2n, K), by the dense output.

        Raises StatementError for a time that the run did not reach: nothing is extrapolated.
        """
        return states_at(self.trajectory, t, len(self.names))

    def sampled(self, t: ArrayLike) -> Solution:
        """Return the same run with other output times (K,), and the states of the dense output at these times.

        Raises StatementError for a time that the run did not reach.
        """
        times = np.atleast_1d(reached_times(self.trajectory, t))
        return replace(self, trajectory=replace(self.trajectory, t=times, y=self.at(times)))

    def parameters_at(self, t: ArrayLike) -> Parameters:
        """Return the parameters at times (K,), as the methods of a model take them.

        Without events that set parameters the result is `parameters` itself. Otherwise it is an array (k, K), with a
        row for each parameter in the statement's order. Raises StatementError for a time that the run did not reach.
        """
        return self.trajectory.parameters_at(np.atleast_1d(reached_times(self.trajectory, t)), self.parameters)

    @property
    def parameter_changes(self) -> list[tuple[float, dict[str, float]]]:
        """The times of events that set parameters, each with the values by name that hold from then on."""
        names, history = [symbol.name for symbol in self.model.statement.parameters], self.trajectory.history
        return [] if history is None else history.changes(names)

    @cached_property
    def _along(self) -> Parameters:
        """The parameters at the output times: `parameters` itself, or an array (k, N) if events set parameters."""
        return self.trajectory.parameters_at(self.t, self.parameters)

    @cached_property
    def energy(self) -> FloatArray:
        """The energy v.p - L at the output times, (N,)."""
        return np.asarray(self.model.energy(*self.model.layout.split(self.y), self.t, self._along))

    @cached_property
    def drift(self) -> EnergyDrift:
        """The change of the energy since the start of the run, or since the first output if no start is known."""
        self._check_output()
        t, y, from_start = since_start(self.trajectory)
        lost = np.zeros(len(t)) if self._contact_run is None else self._contact_run.lost_at(t)
        return energy_drift(self.model, t, y, from_start, self.parameters, self.trajectory, lost)

    @cached_property
    def invariants(self) -> Mapping[str, FloatArray]:
        """The conserved quantities by name, (N,) each. `System.conserved` finds them at the first access."""
        from lagrange.mechanics.conserved import invariants

        return invariants(self.model, self.t, self.y, self._along)

    @cached_property
    def momentum_drift(self) -> Mapping[str, FloatArray]:
        """The change of each ignorable coordinate's momentum since the start, (N,), relative to the momentum's terms.

        Empty for a system with contacts, whose forces may change the momenta.
        """
        if self.contacts:
            return {}
        t, y, _ = since_start(self.trajectory)
        drifts = momentum_drifts(self.model, t, y, self.parameters_at(t))
        return {name: drift[-len(self.t) :] for name, drift in drifts.items()}

    @property
    def constraint_error(self) -> FloatArray:
        """The largest violation of the constraints, (N,), relative to their terms. Zero without constraints."""
        return np.zeros(len(self.t)) if self.constraint_drift is None else self.constraint_drift.error

    @cached_property
    def constraint_drift(self) -> ConstraintDrift | None:
        """The violation of the constraints along the run. None without constraints and without output."""
        return constraint_drift(self.model, self.t, self.y, self._along)

    @cached_property
    def has_energy(self) -> bool:
        """True if the Lagrangian is not zero and the energy is finite at every output."""
        try:
            stated = self.model.statement.lagrangian != 0
            return stated and len(self.t) > 0 and math.isfinite(self.drift.absolute)
        except LagrangeError:
            return False

    @cached_property
    def stiff(self) -> Stiffness | None:
        """The stiffness of a run whose steps were limited by stability and not by accuracy, or None for other runs."""
        return stiffness(self.model, self.trajectory, self.parameters)

    def evaluate(self, expression: Any) -> FloatArray:
        """Return a SymPy expression along the run, (N,).

        It may contain coordinates, velocities, accelerations, multipliers (`lagrange.multiplier(name)`), parameters and
        t. Anything else is a StatementError.
        """
        if self._contact_run is not None:
            return self._contact_run.evaluate(expression)
        return self.model.evaluate_expression(expression, self.t, self.y, self._along)

    @cached_property
    def _contact_run(self) -> ContactRun | None:
        history = self.trajectory.contacts
        if history is None:
            return None
        return ContactRun(self.model, self.trajectory, history, self.model.parameter_array(self.parameters))

    @property
    def contacts(self) -> Mapping[str, ContactResult]:
        """Each contact by name, with `.mode`, `.gap`, `.force`, `.friction` and `.impacts`. Empty without contacts."""
        return ByName("contact") if self._contact_run is None else self._contact_run.by_name

    @property
    def energy_lost(self) -> FloatArray:
        """The energy that impacts and friction of contacts have dissipated, (N,) at the output times."""
        return np.zeros(len(self.t)) if self._contact_run is None else self._contact_run.energy_lost

    @cached_property
    def _exerted(self) -> ConstraintForces:
        return ConstraintForces(self.model, self.t, self.y, self._along)

    @property
    def multipliers(self) -> Mapping[str, FloatArray]:
        """The multiplier of each constraint by name, (N,) at the output times. Empty without constraints.

        A multiplier is NaN where the constraints are dependent. A run may end at such a state.
        """
        if self._contact_run is not None:
            names = self.model.statement.multiplier_names
            return ByName("constraint", ((name, self.evaluate(multiplier(name))) for name in names))
        return self._exerted.multipliers

    def constraint_force(self, name: str, at: str | None = None) -> FloatArray:
        """Return the forces of a constraint along the run: generalized forces G^T lambda, (n, N), in coordinate order.

        With `at`, return the force on that named point, (2, N) or (3, N): lambda dphi/dr where the constraint relates
        only named points. G^T lambda is then the sum of (dr/dq)^T F over these points; the force on all others is zero.
        Raises StatementError for an unknown name, and where forces on points are not determined.
        """
        return self._exerted.generalized(name) if at is None else self._exerted.on_point(name, at)

    @property
    def final(self) -> dict[str, float]:
        """The state at the last output by name. Continue by `other.run(t_end, solution.final, t_start=solution.t[-1])`.

        With `t_eval` an event may end the run after the last output; `y_events` has the state there. The result has no
        parameters. If events set some, give `parameters=` too, with the values in `parameter_changes`.
        """
        self._check_output()
        return dict(zip(self.names, self.y[:, -1].tolist(), strict=True))

    def require(self) -> Solution:
        """Return the solution itself if the run is complete; else raise RunError with the run's message."""
        if not self.status.complete:
            raise RunError(self.message)
        return self

    def card(self) -> dict[str, Any]:
        """Return the status card, a summary of the run, as JSON-ready data; numbers that are not finite are None."""
        from lagrange.show.card import card_of

        return card_of(self)

    def to_csv(self, path: str | os.PathLike[str], *, rate: float | None = None, t: ArrayLike | None = None) -> Path:
        """Write t, the coordinates, their velocities and the multipliers, one line per output time; numbers round-trip.

        `rate` is the number of lines per unit of time, from the first output on. `t` (K,) are the times of the lines.
        Both read the dense output. A file is written whole or not at all. Raises StatementError for a path that cannot
        be written and for a time that the run did not reach, RunError if the disk is full.
        """
        from lagrange.show.files.run_files import write_csv

        return write_csv(self, path, rate, t)

    def to_npz(self, path: str | os.PathLike[str]) -> Path:
        """Write NumPy arrays t (N,), y (2n, N), energy (N,), names (2n,), card (JSON) and statement (a scene).

        For runs of few steps, t_between (K,) and y_between (2n, K) are states between the outputs, for animations. With
        m constraints there are also constraint_error (N,), multipliers (m, N), and constraints (m,), their names; with
        events t_event_0 (k,), y_event_0 (k, 2n), and so on; with contacts contact_begins (s,), contact_modes (JSON),
        and contact_impacts_0 (k, 3 + slips): t, impulse, energy lost, friction. `lagrange.load` reads the file. Raises
        StatementError for a path that cannot be written, RunError if the disk is full.
        """
        from lagrange.show.files.atomic_file import write_atomically
        from lagrange.show.files.run_files import arrays_of_run

        return write_atomically(path, lambda file: np.savez(file, allow_pickle=False, **arrays_of_run(self)))

    def to_png(self, path: str | os.PathLike[str], *, dpi: int | None = None) -> Path:
        """Write the picture of `plot()` with `dpi` dots per inch, 150 by default.

        Raises StatementError for a path that cannot be written, RunError if the disk is full.
        """
        from lagrange.show.files.atomic_file import write_atomically
        from lagrange.show.files.picture import picture

        return write_atomically(path, picture(lambda: self.plot(dpi=dpi), dpi))

    def to_folder(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write trajectory.csv, trajectory.png and, last, card.json, which marks a complete folder; return their paths.

        The folder must exist; its other files stay. A run without output has no picture, and the picture of an earlier
        run is removed. Raises StatementError for a folder that cannot be written to, RunError if the disk is full.
        """
        from lagrange.show.files.run_files import write_folder

        return write_folder(self, folder)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a DataFrame: index t, a column for each row of the state and each multiplier, the card in `.attrs`."""
        from lagrange.show.files.run_files import columns_of, data_frame

        return data_frame(self.t, columns_of(self), self.card())

    def to_xarray(self) -> xarray.Dataset:
        """Return a Dataset over the dimension t, with the status card in `.attrs`.

        It has a variable for each row of the state, and for each multiplier, called lambda[name].
        """
        from lagrange.show.files.run_files import columns_of, data_set

        return data_set(self.t, columns_of(self), self.card())

    def plot(
        self,
        what: Any = None,
        *,
        of: Any = None,
        ax: Any = None,
        size: Any = None,
        style: str = "light",
        dpi: int | None = None,
    ) -> Figure:
        """Return a Matplotlib figure of the run; curves come from the dense output and are exact within a pixel.

        `what` is one of "coordinates", "velocities", "phase", "energies" (T, V and E), "drift" (of the energy),
        "invariants", "path", "multipliers" and "violation", a coordinate or any SymPy expression, or a list of them.
        The default is the coordinates, the drifts and the paths of named points. `of` chooses coordinates. `ax` is
        Matplotlib axes or a list of them: one panel is drawn in each and their figure returned. `size` is (width,
        height) in inches, `style` is "light" or "dark", and `dpi` is the dots per inch for which curves are drawn, 200
        by default. Raises StatementError for a run without output, and for quantities that the system does not have.
        """
        from lagrange.show.figures.run_figure import plot

        return plot(self, what, of=of, ax=ax, size=size, style=style, dpi=dpi)

    def animate(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        fps: float | None = None,
        speed: float | None = None,
        size: tuple[int, int] | None = None,
        style: str = "auto",
        trail: float | None = None,
        progress: bool = False,
    ) -> Animation:
        """Return the animation of the run, which a notebook shows; with a path it is written as well.

        The suffix of the path sets the format: .html is a page with a player, .gif a picture, .mp4 a film, which needs
        ffmpeg. The stated positions are drawn with rods and springs, or the coordinates if there are none; and the
        energies. `fps` is the number of frames per second, 30 by default. `speed` is time of the run per time on the
        screen, by default 1 for runs of 1 to 100 s, else a round number. `size` is (width, height) in pixels, `trail`
        the duration of trails, 0 for none. `style` is light, dark, or auto, with which a page follows the setting of
        the browser. At most 3000 frames are shown; `.notes` lists deviations from the request. Raises StatementError
        for a run that cannot be drawn and a path that cannot be written, RunError if the disk is full.
        """
        from lagrange.page.player import animate

        return animate(self, path, fps=fps, speed=speed, size=size, style=style, trail=trail, progress=progress)

    def __repr__(self) -> str:
        from lagrange.show.card import card_text

        return card_text(self)

    def _repr_html_(self) -> str:
        from lagrange.show.card import card_html

        return card_html(self)

    def _check_output(self) -> None:
        if not len(self.t):
            raise StatementError(
                "the run has no output: it ended before the first of its output times. Its message says why."
            )
