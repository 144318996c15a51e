"""Result of event processing, and the messages of ends at events: rest, accumulation, sliding, undefined values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.trajectory.trajectory import FloatArray, Status


@dataclass(frozen=True)
class EventResult:
    """Result of event processing: the end of the run and its cause, or a jump of the state, or neither.

    `status` is the status of a run that ends, else None, and `detail` a sentence on its cause. `jumped` is True if the
    state has jumped. `smooth` is True if only the Taylor series ends at this point, and the motion may continue.
    """

    status: Status | None = None
    detail: str = ""
    jumped: bool = False
    smooth: bool = False


_AS_CONTACT = "State the reset as a contact, as in contacts={'floor': lagrange.contact(gap=...)}"


def at_rest(name: str) -> EventResult:
    """Return the result that ends a run at a contact whose reset leaves no velocity, so that the body comes to rest.

    `name` is the text of the contact's event function.
    """
    return EventResult(
        Status.STEP_TOO_SMALL,
        f"After the reset {name} is zero, its rate is zero, and the motion would cross zero: the body comes to rest "
        "there, as a ball does after infinitely many impacts, and the reset does not say how it stays. "
        f"{_AS_CONTACT}, or end the run with a terminal event.",
    )


def accumulating(name: str) -> EventResult:
    """Return the result that ends a run because the event `name` occurs again and again at nearly the same time."""
    return EventResult(
        Status.STEP_TOO_SMALL,
        f"Events accumulate: {name} is zero again and again within the spacing of floating-point times, as for a ball "
        f"that comes to rest after infinitely many impacts. {_AS_CONTACT}, or end the run with a terminal event.",
    )


def unresolved(name: str) -> EventResult:
    """Return the result that ends a run because resets by the event `name` follow each other too quickly.

    The time between these resets is too short for the steps of the method, or for their errors.
    """
    return EventResult(
        Status.STEP_TOO_SMALL,
        f"The resets where {name} is zero follow each other too quickly for the steps of the method, as when a ball "
        f"comes to rest after infinitely many impacts. {_AS_CONTACT}, end the run before, or take smaller tolerances, "
        "a shorter step, or a one-step method such as dop853.",
    )


def sliding(name: str, t: float) -> EventResult:
    """Return the result that ends a run at time t, since the forces drive it to a switching surface from both sides.

    `name` is the text of the surface's expression.
    """
    return EventResult(
        Status.STEP_TOO_SMALL,
        f"The equations of motion jump where {name} is zero, and from t = {t:.6g} on they drive {name} back to zero "
        "from both sides, so the motion sticks there. State dry friction as a contact, as in "
        "contacts={'floor': lagrange.contact(gap=..., slip=..., friction=...)}, or smooth the jump: tanh(v/0.001) in "
        "place of sign(v).",
    )


def not_finite_after_reset(name: str) -> EventResult:
    """Return the result that ends a run whose reset gives a state that is nan or infinite.

    `name` is the text of the function of the event that resets the state.
    """
    return EventResult(
        Status.NON_FINITE,
        f"The reset where {name} is zero gives a state that is nan or infinite. Look for a division by zero, for a "
        "root or logarithm outside its domain, or for two events at this time that reset one entry to different "
        "values: reset this entry in one event only.",
    )


def off_constraints(names: str, violated: str) -> EventResult:
    """Return the result that ends a run whose resets violate constraints.

    `names` lists the functions of the events that reset the state. `violated` is a sentence on the violation.
    """
    return EventResult(
        Status.DIVERGED,
        f"The reset where {names} is zero violates the constraints: {violated} Reset velocities only, and all "
        "velocities in these constraints, to values that satisfy the constraints.",
    )


def undefined(names: Sequence[str], watched: FloatArray) -> EventResult:
    """Return the result that ends a run at a state at which an event function, or a derivative of it, is not finite.

    `names` are the names of the watched functions (E,), and `watched` (order + 1, E) their Taylor coefficients.
    """
    bad = int(np.argmax(~np.isfinite(watched).all(axis=0)))
    return EventResult(
        Status.NON_FINITE,
        f"The event function {names[bad]} is {watched[0, bad]:.6g} there, and its value or its derivatives are not "
        "finite. Start elsewhere, or give an event with an expression that is defined and smooth along the run.",
        smooth=bool(np.isfinite(watched[0]).all()),
    )


def zero_root(name: str) -> EventResult:
    """Return the result that ends a run where the root or power `name` in the equations of motion becomes zero."""
    return EventResult(
        Status.NON_FINITE,
        f"{name} becomes zero there, and has no Taylor series: after this time a sqrt, log or power leaves its domain, "
        "or a force jumps. Write the root of a square as abs, or take dop853.",
        smooth=True,
    )


def without_value(
    name: str, value: float, lack: str = "after this time it has none", *, smooth: bool = False
) -> EventResult:
    """Return the result that ends a run at a point after which a watched function has no value, or no Taylor series.

    `name` is the text of the function, and `value` its value there. `lack` is the clause of the message that says what
    is missing. `smooth` is True for a switching surface: the motion may continue although the surface's series ends.
    """
    return EventResult(
        Status.NON_FINITE,
        f"The event function {name} has a pole there or leaves its domain: its value is {value:.4g}, and {lack}. End "
        "the run before, or give an event without the division, root or logarithm.",
        smooth=smooth,
    )
