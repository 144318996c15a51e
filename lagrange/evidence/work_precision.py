"""Compare methods by work and precision: error and time of each at every tolerance or step size (`race`).

The methods that `race` compares by default are listed here. All errors are relative to one reference solution.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.errors import LagrangeError, RunError, StatementError, listing, shown
from lagrange.evidence.trust_horizon import (
    GREATEST_DIGITS,
    LEAST_DIGITS,
    ReferenceSolution,
    Sensitivity,
    reference_solution,
    sensitivity,
)
from lagrange.machine.model import Model
from lagrange.statement.expression import entries, flag, positive_number, real_number, whole_number
from lagrange.trajectory.integrator import Integrator, Problem, RunOptions, run_by
from lagrange.trajectory.methods.registry import find, names
from lagrange.trajectory.run import Flow, trajectory_of
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

TOLERANCES = tuple(10.0**-k for k in range(3, 14))

STEP_SIZES = 9
"""Number of default step sizes, each half of the previous one."""

PRELIMINARY_METHOD = "dop853"
"""Method of the preliminary runs. Steps of taylor may span half an oscillation, and miss its amplitude."""

STEPS_PER_PRELIMINARY = 4
"""Ratio of dop853's mean step at COARSE_RTOL to the longest default step. RK4 then resolves the motion."""

COARSE_RTOL, FINE_RTOL = 1e-6, 1e-11
"""Tolerances of the preliminary runs.

The coarse run gives the step sizes, and the fine run the growth of errors and the magnitudes of the states.
"""

RACED = (
    "taylor",
    "dop853",
    "verner9",
    "tsit5",
    "rk4",
    "velocity-verlet",
    "yoshida6",
    "composition8",
    "gauss3",
    "radau5",
    "scipy-dop853",
    "scipy-lsoda",
)
"""Default methods of a comparison, one or two of each kind.

The kinds are Taylor series, explicit methods with and without step control, symplectic and implicit ones, and SciPy's
best. All methods would take minutes, and each of the others performs like one of these.
"""

FEWEST_STEPS = 16
"""Smallest number of steps of a run with the longest default step."""

NOTABLE_GROWTH = 1e4
"""Growth factor of errors above which the result has a note on the growth."""

FINE_RUN_SECONDS = 60.0
"""Smallest time limit of the fine preliminary run, in seconds."""

MOST_OUTPUTS, MOST_REPEATS = 100_000, 10_000
"""Largest numbers of times at which errors are measured, and of timed runs.

The reference solution is evaluated with many digits at each time.
"""

SHORTEST_TIMING = 1e-3
"""Shortest timing, in seconds; a shorter run is repeated within one timing."""

LARGEST_UNCERTAINTY = 1e-3
"""Largest uncertainty of the reference, and largest effect of rounding, relative to the size of the states.

Above this limit the comparison has no meaning.
"""

REFUSED, SKIPPED = "refused", "skipped"
"""Status of an entry that the method refuses, and of an entry skipped because a coarser setting took too long."""


@dataclass(frozen=True)
class Entry:
    """Measurement of one method at one setting.

    `setting` is the tolerance (rtol) of an adaptive method, else the step. `error` is NaN if the run did not reach its
    end. If `resolved` is false, `error` is the uncertainty of the reference, and the true error is at most as large.
    `time` is the shortest of `timed` warm runs, in seconds, or NaN if none reached its end. `status` and `message` say
    how the run ended.
    """

    method: str
    adaptive: bool
    setting: float
    error: float = math.nan
    resolved: bool = True
    time: float = math.nan
    timed: int = 0
    steps: int = 0
    evaluations: int = 0
    status: str = REFUSED
    message: str = ""

    def __repr__(self) -> str:
        how = f"error {self.error:.1e} in {self.time:.3g} s" if self.complete else self.status
        return f"<{self.method} at {'tol' if self.adaptive else 'h'} = {self.setting:.3g}: {how}, {self.steps} steps>"

    @property
    def complete(self) -> bool:
        """True if the run reached its end."""
        return math.isfinite(self.time)


@dataclass(frozen=True)
class Result:
    """Result of a comparison of methods.

    `entries` are the measurements. `unit` (2n,) is the unit of errors for each entry of the state: 1, or the entry's
    `size` for relative errors. `size` (2n,) is the largest magnitude of each entry along the run. `notes` are sentences
    on the growth of errors and on methods that were left out.
    """

    entries: tuple[Entry, ...]
    reference: ReferenceSolution
    sensitivity: Sensitivity
    size: tuple[float, ...]
    unit: tuple[float, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class RaceSettings:
    """Settings of a comparison of methods, which measures errors at `times`.

    `tolerances` are the settings of adaptive methods. `steps` are the step sizes of other methods, or None for the
    default ones. Each method is timed `repeats` times. `max_wall` is the longest time of a run in seconds. If
    `relative` is true, errors are relative to the size of each entry. `digits` is the precision of the reference
    solution, or None for the default.
    """

    times: tuple[float, ...]
    tolerances: tuple[float, ...]
    steps: tuple[float, ...] | None
    repeats: int
    max_wall: float
    relative: bool
    digits: int | None = None


def race(
    model: Model,
    span: Sequence[float],
    initial: Mapping[Any, Any] | None,
    parameters: Mapping[Any, Any] | None,
    methods: Iterable[Any] | None,
    chosen: RaceSettings,
    reference: Any = None,
) -> Result:
    """Return the error and the time of every method at every setting.

    If `methods` is None, the default methods are compared. `chosen` has the settings. `reference` is a solution to
    compare with, or None to compute one. Raises StatementError for invalid arguments, and RunError if the run or the
    reference is too inaccurate for a comparison.
    """
    labelled = _labelled_methods(methods)
    seconds = max(chosen.max_wall, FINE_RUN_SECONDS)
    options = RunOptions(PRELIMINARY_METHOD, FINE_RTOL, max_wall=seconds, parameters=parameters)
    run, values = trajectory_of(model, span, initial, options)
    if not _checked(run).status.complete:
        raise RunError(f"the race has no end state, because the first run stopped early: {run.message}")
    t0, t1 = map(float, span)
    problem = Problem(model, values, t0, t1, run.y[:, 0].copy(), max_wall=chosen.max_wall)
    size = np.abs(run.y).max(axis=1)
    size = np.where(size > 0, size, 1.0)
    unit = size if chosen.relative else np.ones_like(size)
    growth = sensitivity(model, run, problem.parameters, size, unit)
    right = reference_solution(problem, chosen.times, reference, chosen.digits, unit, growth.growth)
    if not right.uncertainty < LARGEST_UNCERTAINTY * float((size / unit).max()):
        raise RunError(
            f"the reference has an error of {right.uncertainty:.1e}, too large to measure errors against it: a "
            f"relative error grows {growth.growth:.0e} times. End the race earlier, or give another reference."
        )
    measured = _Measurements(problem, chosen, right, unit)
    entries: list[Entry] = []
    refused: dict[str, list[str]] = {}
    for label, method in labelled:
        settings = chosen.tolerances if method.claims.adaptive else chosen.steps
        if settings is None:
            preliminary = find(PRELIMINARY_METHOD).integrate(replace(problem, rtol=COARSE_RTOL))
            count = max(FEWEST_STEPS, STEPS_PER_PRELIMINARY * preliminary.steps)
            settings = tuple(abs(t1 - t0) / (count << k) for k in range(STEP_SIZES))
        measurements = list(measured.run(label, method, settings))
        if methods is None and all(entry.status == REFUSED for entry in measurements):
            refused.setdefault(measurements[0].message.removeprefix(label), []).append(label)
        else:
            entries += measurements
    absent = (f"Left out: {listing(labels)}. {labels[0]}{why}" for why, labels in refused.items())
    notes = (*_growth_notes(growth, size, unit), *absent)
    return Result(tuple(entries), right, growth, tuple(size.tolist()), tuple(unit.tolist()), notes)


class _Measurements:
    """The problem, settings, reference and unit of errors that all measurements of a comparison share."""

    def __init__(self, problem: Problem, settings: RaceSettings, right: ReferenceSolution, unit: FloatArray) -> None:
        self.problem, self.settings, self.reference, self.unit = problem, settings, right, unit
        self.outputs = np.array(settings.times) if len(settings.times) > 1 else None

    def run(self, label: str, method: Integrator, settings: Sequence[float]) -> Iterator[Entry]:
        """Yield the measurements of the method `method`, called `label`, from the coarsest of `settings` to the finest.

        Settings are tolerances of an adaptive method, and step sizes of any other.
        """
        late: float | None = None
        for setting in sorted(settings, reverse=True):
            entry = self._entry(label, method, setting, late)
            late = setting if entry.status == Status.MAX_WALL.value else late
            yield entry

    def _entry(self, label: str, method: Integrator, setting: float, late: float | None) -> Entry:
        adaptive = method.claims.adaptive
        blank = Entry(label, adaptive, setting)
        if late is not None:
            message = f"not run: at {late:.3g} it took longer than {self.settings.max_wall:g} s."
            return replace(blank, status=SKIPPED, message=message)
        chosen: dict[str, Any] = {"rtol": setting} if adaptive else {"step": setting}
        problem = replace(self.problem, t_eval=self.outputs, began=time.perf_counter(), **chosen)
        try:
            trajectory = _checked(run_by(method, problem))
            blank = replace(blank, steps=trajectory.steps, evaluations=trajectory.evaluations)
            blank = replace(blank, status=trajectory.status.value, message=trajectory.message)
            if not trajectory.status.complete:
                return blank
            run = self._warm(method, problem)
            y = run()
            seconds, timed = self._timed(run, trajectory.wall)
        except LagrangeError as refusal:
            return replace(blank, message=str(refusal))
        error = self.reference.error(y, self.unit)
        bound = self.reference.uncertainty
        return replace(blank, error=max(error, bound), resolved=error > bound, time=seconds, timed=timed)

    def _timed(self, run: Callable[[], FloatArray], single: float) -> tuple[float, int]:
        """Return the shortest time of `run` in seconds, and the number of timings; `single` is the time of one run."""
        least, timed = math.inf, 0
        count = max(1, math.ceil(SHORTEST_TIMING / max(single, 1e-9)))
        began = time.perf_counter()
        while timed < self.settings.repeats and (not timed or time.perf_counter() - began < self.settings.max_wall):
            start = time.perf_counter()
            for _ in range(count):
                run()
            least = min(least, (time.perf_counter() - start) / count)
            timed += 1
        return least, timed

    def _warm(self, method: Integrator, problem: Problem) -> Callable[[], FloatArray]:
        """Return a function that runs the prepared method and returns states (2n, K); only this run is timed."""
        if self.outputs is not None:
            return lambda: method.integrate(problem).y
        flow = Flow(
            problem.model, RunOptions(method, problem.rtol, problem.atol, problem.step, max_steps=problem.max_steps)
        )
        return lambda: flow(problem.y0, problem.t0, problem.t1, problem.parameters)[:, None]


def race_settings(
    span: Sequence[float],
    *,
    tolerances: Any = TOLERANCES,
    steps: Any = None,
    repeats: Any = 5,
    max_wall: Any = 10.0,
    outputs: Any = None,
    relative: bool = False,
    digits: Any = None,
) -> RaceSettings:
    """Return checked settings of a comparison of methods. Raises StatementError for invalid values.

    `outputs` is the number of equally spaced times at which errors are measured, or None for the end only.
    """
    t0, t1 = float(span[0]), float(span[1])
    if t0 == t1:
        raise StatementError(f"a race from t = {t0:g} to t = {t1:g} has no length: give t_end=.")
    count = 1 if outputs is None else whole_number(outputs, "outputs", 1, MOST_OUTPUTS)
    times = [t0 + (t1 - t0) * k / count for k in range(1, count)]
    return RaceSettings(
        times=(*times, t1),
        tolerances=_sizes("tolerances", tolerances),
        steps=None if steps is None else _sizes("steps", steps),
        repeats=whole_number(repeats, "repeats", 1, MOST_REPEATS),
        max_wall=positive_number(max_wall, "max_wall", "give a positive number of seconds"),
        relative=flag(relative, "relative"),
        digits=None if digits is None else whole_number(digits, "digits", LEAST_DIGITS, GREATEST_DIGITS),
    )


def _sizes(label: str, sizes: Any) -> tuple[float, ...]:
    """Return `sizes` as a tuple of distinct positive numbers. Raises StatementError for anything else."""
    listed = None if isinstance(sizes, (str, bytes)) else entries(sizes, label)
    if listed is None:
        raise StatementError(f"{label} is {shown(sizes)}: give a list of positive numbers, such as [1e-6, 1e-9].")
    numbers = [real_number(x, f"an entry of {label}") for x in listed]
    wrong = [x for x in numbers if x <= 0]
    if wrong:
        raise StatementError(f"{label} contains {wrong[0]:g}: give positive numbers, such as 1e-6.")
    if not numbers:
        raise StatementError(f"{label} is empty: give at least one positive number, such as 1e-6.")
    return tuple(dict.fromkeys(numbers))


def _labelled_methods(methods: Any) -> list[tuple[str, Integrator]]:
    """Return pairs (label, method) for names or instances of methods, or for the default methods if None.

    Labels of repeated methods get a number.
    """
    if methods is None:
        chosen: list[Any] = list(RACED)
    else:
        listed = None if isinstance(methods, (str, bytes)) else entries(methods, "methods")
        chosen = [methods] if listed is None else listed
    if not chosen:
        raise StatementError(f"methods is empty: name at least one; there are {listing(names())}.")
    labelled: dict[str, Integrator] = {}
    for method in map(find, chosen):
        label, number = method.name, 1
        while label in labelled:
            number += 1
            label = f"{method.name} ({number})"
        labelled[label] = method
    return list(labelled.items())


def _checked(run: Trajectory) -> Trajectory:
    """Return the run unchanged. Raises KeyboardInterrupt if the user interrupted the run."""
    if run.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return run


def _growth_notes(effect: Sensitivity, size: FloatArray, unit: FloatArray) -> Iterator[str]:
    """Yield a note on the growth of errors along the run if it is large, since it affects all methods.

    `size` (2n,) is the magnitude of each entry of the state, and `unit` (2n,) the unit of its error.
    """
    if effect.floor > LARGEST_UNCERTAINTY * float((size / unit).max()):
        yield (
            f"No method can win: an error grows up to {effect.growth:.0e} times, and rounding a single state to double "
            "precision decides where the run ends. Compare methods over a shorter time."
        )
    elif effect.growth > NOTABLE_GROWTH:
        yield (
            f"Errors grow up to {effect.growth:.0e} times until the end. Rounding a single state to double precision "
            f"moves the end by {effect.floor:.0e}: smaller errors are chance."
        )
