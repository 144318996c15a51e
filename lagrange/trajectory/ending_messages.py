"""Write the message at the end of a run: the time, the coordinate that failed, the cause and the remedy."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lagrange.errors import listing
from lagrange.graph.node import Kind, reachable
from lagrange.statement.rotation import symbols_of_entries
from lagrange.trajectory.integrator import LEAST_ATOL, Problem, Tolerances, memory_limit
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

_SENTENCES: dict[Status, str] = {
    Status.SUCCESS: "reached t = {t}.",
    Status.EVENT: "stopped at an event at t = {t}.",
    Status.UNRELIABLE: "reached t = {t}, and does not follow the motion.",
    Status.MAX_STEPS: "used up max_steps = {max_steps} {where}, where {largest}.",
    Status.MAX_WALL: "used up {max_wall} {where}, where {largest}.",
    Status.MAX_MEMORY: "used up {max_memory} {where}, where {largest}: it keeps every step, for solution.at(t).",
    Status.NON_FINITE: "stopped {where}: {non_finite}.",
    Status.SINGULAR: "stopped {where}: {singular}",
    Status.STEP_TOO_SMALL: "stopped {where}: the step that the tolerances require is below the spacing of floating-"
    "point times. The largest entry of the state: {largest}.",
    Status.DIVERGED: "stopped {where}: the step did not converge. The largest entry of the state: {largest}.",
    Status.INTERRUPTED: "was interrupted {where}; what was computed until then is kept.",
}

_STIFF = "; a stiff system needs an implicit method such as radau5"

_STICKS = (
    "; where a force jumps, as with sign(v), a body may stick, which needs tiny steps: smooth the jump by tanh(v/0.001)"
)

_DOMAIN = (
    "Look for a division by zero, an overflow, or a sqrt, log or power outside its domain in the energies and forces "
    "near that state, and check the initial state and the parameters."
)

_SINGULARITY = "The solution probably has a singularity there: end the run before it, or check the signs of the forces."

_JUMPS = "where forces jump, as with sign(v), a step may have no solution: smooth the jump, such as by tanh(v/0.001)."

LOOSE_RTOL = 1e-5
"""Smallest rtol at which errors may lead a run into a singularity that the exact motion does not reach."""

BLOW_UP_GROWTH = 1e6
"""Growth of the largest entry of the state, relative to the start, that counts as a blow-up. With smaller steps the
motion may turn out to be bounded."""

SLOW_RESIDUAL = 1e-6
"""Largest last correction of Newton's method, relative to the unknowns, that counts as slow convergence. After a larger
correction the solution is far away."""

COARSE_ATOL = 1e3
"""The message of a run names an entry of the state if `atol` exceeds this multiple of `rtol` times the entry. The entry
then loses three digits."""

CANCELLATION_NOISE = 2.0**-40
"""An entry of the state may be rounding noise if it is below this fraction of the largest coordinate, or velocity."""

UNITS = "choose units in which its numbers are larger"
"""Remedy in a message if a tolerance would be below the smallest normal double."""

UNPROJECTED = (
    "The state after the step is so far from the constraints that Newton's method does not bring it back onto them."
)
"""Cause in a message if the state after a step cannot be projected onto the constraints."""

_SINGULAR = (
    "the mass matrix is singular there, so the accelerations are not determined. Start elsewhere, or choose "
    "coordinates that are regular at this configuration."
)


def message(
    status: Status,
    problem: Problem,
    t: float,
    y: FloatArray,
    method: str,
    *,
    slope: FloatArray | None = None,
    detail: str = "",
    cause: str = "",
    rtol: float | None = None,
) -> str:
    """Return the message for a run by the method named `method`, which ended with `status` at time t.

    `y` (2n,) is the state that is not finite, else the last accepted state. `slope` (2n,) is its derivative dy/dt,
    given if it is not finite. `detail` is one more sentence on the cause; for a singular mass matrix it replaces the
    sentence on the status. `cause` replaces the sentences on cause and remedy. `rtol` is the relative tolerance, None
    for fixed steps.
    """
    if status.complete and not (detail or cause):
        backwards = " Time ran backwards." if status is Status.SUCCESS and problem.t1 < problem.t0 else ""
        return f"{method} {_SENTENCES[status].format(t=number(t))}{backwards}"
    whole = problem.whole or problem
    where = f"at t = {number(t)} on the way from {number(whole.t0)} to {number(whole.t1)}"
    if cause:
        return f"{method} stopped {where}. {cause}"
    fields: dict[str, Callable[[], Any]] = {
        "t": lambda: number(t),
        "where": lambda: where,
        "max_steps": lambda: whole.max_steps,
        "max_wall": lambda: "its time" if whole.max_wall is None else f"max_wall = {number(whole.max_wall)} s",
        "max_memory": lambda: f"max_memory = {number(memory_limit(problem))} bytes",
        "largest": lambda: largest(problem, y),
        "singular": lambda: detail or _SINGULAR,
        "non_finite": lambda: (
            non_finite(problem, y, slope)
            or f"the derivative of the state is nan or infinite, soon after {largest(problem, y)}"
        ),
    }
    sentence = _SENTENCES[status]
    spoken = sentence.format(**{name: value() for name, value in fields.items() if f"{{{name}}}" in sentence})
    detail = "" if status is Status.SINGULAR else detail
    parts = (method, spoken, detail, _remedy(status, problem, y, method, rtol))
    return " ".join(part for part in parts if part)


def _remedy(status: Status, problem: Problem, y: FloatArray, method: str, rtol: float | None) -> str:
    """Return the sentence that says what to do after a run ended with `status`, or "".

    `y` (2n,) is the last state, and `method` the method's name. `rtol` is the relative tolerance, None for fixed steps.
    """
    if status.at_end or status is Status.INTERRUPTED:
        return ""
    finer = "shorten the step" if rtol is None else f"lower rtol (now {rtol:g}) and atol"
    sizes = np.abs(y[np.isfinite(y)])
    grown = bool(sizes.max(initial=0.0) > BLOW_UP_GROWTH * (float(np.abs(problem.y0).max()) or 1.0))
    stray = rtol is None or rtol >= LOOSE_RTOL or grown
    if status in (Status.MAX_STEPS, Status.MAX_WALL):
        coarser = "lengthen the step" if rtol is None else "loosen rtol"
        nodes = reachable(problem.model.equations.accelerations) if rtol is not None else ()
        jumps = any(node.kind is Kind.CALL and node.data == "sign" for node in nodes)
        other = f"or, if the motion does not grow like that, {finer}" if grown else f"or {coarser}"
        events = ", or end the run at an event with terminal=True" if problem.events else ""
        stiff = "" if method == "radau5" else _STIFF
        return f"Raise {status.value}, {other}{events}{_STICKS if jumps else ''}{stiff}."
    if status is Status.MAX_MEMORY:
        other = finer if grown else "lengthen the step" if rtol is None else "loosen rtol"
        alone = "" if problem.t_eval is not None else "give t_eval, which is kept without the steps, "
        return f"Raise max_memory, end the run earlier and go on from there, {alone}or {other}; lg.flow keeps no steps."
    if status is Status.NON_FINITE:
        return f"{_DOMAIN} If the motion is finite there, {finer}." if stray else _DOMAIN
    if status is Status.STEP_TOO_SMALL:
        return f"{_SINGULARITY} If it has none, {finer if stray else 'loosen rtol and atol'}."
    if status is Status.DIVERGED:
        other = "radau5" if method != "radau5" else "taylor"
        what = "Take a shorter step, or a method with step control" if rtol is None else "Take another method,"
        return f"{what} such as {other}; {_JUMPS}"
    return ""


def unsolved(residual: float) -> str:
    """Return a sentence for an implicit step that did not converge.

    `residual` is the size of the last correction of Newton's method, relative to the unknowns.
    """
    if residual < SLOW_RESIDUAL:
        return (
            f"The corrections of Newton's method shrink too slowly: the last was {residual:.2g} of the unknowns of the "
            "step, more than round-off. The equations of the step may have a double root there, or none."
        )
    return (
        f"The last correction of Newton's method was still {residual:.2g} of the unknowns of the step; it should be at "
        "round-off."
    )


def outputs_alone(problem: Problem) -> str:
    """Return the note that a run stored only the states at its output times, to save memory."""
    return (
        f"The steps of the run took more than max_memory = {number(memory_limit(problem))} bytes, so it kept only the "
        "states at its output times: ask for others in t_eval, or raise max_memory."
    )


def interrupted(run: Trajectory, span: Sequence[float]) -> Trajectory:
    """Return `run` with the status INTERRUPTED, since Ctrl-C stopped the search for the cause of its end.

    `span` (t0, t1) is the span of the whole run, for the message.
    """
    end = f"at t = {number(run.span[1])} on the way from {number(span[0])} to {number(span[1])}"
    sentence = f"{run.method} {_SENTENCES[Status.INTERRUPTED].format(where=end)}"
    return replace(run, status=Status.INTERRUPTED, message=sentence)


def events_fill(problem: Problem) -> str:
    """Return the cause and the remedy for a run without stored steps whose events have used up the memory."""
    return (
        f"The times and states of its events have used up max_memory = {number(memory_limit(problem))} bytes. Raise "
        "max_memory, end the run earlier and go on from there, or locate fewer events, for example by direction=1."
    )


def event_after_outputs(t: FloatArray) -> str:
    """Return the note on a run that an event ended after the last output. `t` (N,) are the output times."""
    last = f"The last output before the event is at t = {number(t[-1])}" if len(t) else "No output is before the event"
    return f"{last}; y_events has the state at the event."


def without_tolerance(problem: Problem, status: Status, tolerances: Tolerances, y: FloatArray) -> str:
    """Return the cause and the remedy if a step failed because an entry of the state has zero tolerance, else "".

    An entry of `y` (2n,) that is 0 has zero tolerance if the absolute tolerance is 0. `status` is the run's status.
    """
    failed = status in (Status.STEP_TOO_SMALL, Status.DIVERGED)
    if not failed or not tolerances.rtol or tolerances.atol > LEAST_ATOL or tolerances.share or y.all():
        return ""
    entry = problem.model.layout.names()[int(np.argmin(np.abs(y)))]
    return (
        f"{entry} is 0, and with atol = 0 its tolerance is zero: leave atol out, so that it follows the size of each "
        "entry."
    )


def limited(problem: Problem, status: Status, y: FloatArray, which: tuple[int, int], atol: float) -> str:
    """Return the cause and the remedy for a run that used up a limit because a small entry keeps its steps short.

    `status` says which limit was used up, `max_steps` or `max_wall`. `y` (2n,) is the state. `which` is a pair of
    indices: the small entry, and the entry of the same kind (coordinate or velocity) with the largest tolerance. `atol`
    is the present absolute tolerance of the second.
    """
    limit, names, (row, largest) = status.value, problem.model.layout.names(), which
    return (
        f"It used up {limit}, because {names[row]} limits the step: it is {y[row]:.2g} while {names[largest]} is "
        f"{y[largest]:.2g}, and without atol each entry is accurate to rtol of its own size. Give atol = {atol:.0e}, "
        f"which needs fewer digits of {names[row]}, or raise {limit}."
    )


def coarse(problem: Problem, status: Status, states: FloatArray, tolerances: Tolerances) -> Iterator[str]:
    """Yield a note if the absolute tolerance of a complete run gives an entry fewer correct digits than rtol specifies.

    `states` (S+1, 2n) are the accepted states. An entry is ignored if it is only the rounding error of other entries of
    its kind (coordinates or velocities).
    """
    if not status.complete or not tolerances.rtol:
        return
    least = tolerances.atol / (COARSE_ATOL * tolerances.rtol)
    ends = list(map(max, map(abs, states[0].tolist()), map(abs, states[-1].tolist())))
    if min(ends) >= least:
        return
    sizes = ends if len(states) <= 2 else np.abs(states).max(axis=0).tolist()
    kinds = [max(part) for part in problem.model.layout.split(sizes) for _ in part]
    noise = [CANCELLATION_NOISE * kind for kind in kinds]
    short = [row for row, size in enumerate(sizes) if noise[row] < size < least]
    if not short:
        return
    row = min(short, key=sizes.__getitem__)
    entry = f"{problem.model.layout.names()[row]} does not exceed {sizes[row]:.3g}"
    request = f"rtol = {tolerances.rtol:g} requires"
    lower = tolerances.rtol * sizes[row]
    if tolerances.share or lower < sys.float_info.min:
        yield f"{entry}, near the smallest of all doubles, and has fewer digits than {request}: {UNITS}."
    else:
        # Without atol the steps would also follow entries that are rounding noise.
        rounded = any(0 < size <= least for size, least in zip(sizes, noise, strict=True))
        leave = "" if rounded else "leave atol out, so that it follows the size of each entry, or "
        yield (
            f"{entry}, so atol = {tolerances.atol:g} leaves it fewer digits than {request}: {leave}lower it to some "
            f"{lower:.0e}."
        )


def non_finite(problem: Problem, y: FloatArray, slope: FloatArray | None = None) -> str:
    """Return a phrase with the entries of a state that are not finite, such as ``theta_dot is nan``.

    If the state `y` (2n,) is finite, the phrase has the entries of its derivative `slope` (2n,) that are not finite.
    The four entries of a quaternion are reported as one, the rotation.
    """
    layout, symbols = problem.model.layout, symbols_of_entries(problem.model.statement.rotations)

    def bad(names: Iterable[str], values: FloatArray) -> list[str]:
        pairs = zip(names, values, strict=True)
        return list(dict.fromkeys(f"{name} is {value}" for name, value in pairs if not np.isfinite(value)))

    entries = bad((symbols.get(name, name) for name in layout.names()), y)
    if entries or slope is None:
        return _few(entries)
    rates = [f"the velocity of {symbols.get(name, name)}" for name in layout.coordinates]
    rates += [f"the acceleration of {symbols.get(name, name)}" for name in layout.rates]
    return _few(bad(rates, slope))


def largest(problem: Problem, y: FloatArray) -> str:
    """Return a phrase with the largest entry of a state y (2n,), such as ``x_dot is -1.2e+15``."""
    row = int(np.argmax(np.abs(y)))
    return f"{problem.model.layout.names()[row]} is {y[row]:.4g}"


def number(value: float) -> str:
    """Return a number as text for a sentence, with at most six digits."""
    return f"{value:.6g}"


def _few(parts: list[str]) -> str:
    return listing(parts if len(parts) <= 3 else [*parts[:2], f"{len(parts) - 2} more"]) if parts else ""
