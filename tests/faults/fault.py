"""Faults: wrong or difficult requests, their allowed outcomes, and the judgement of the run of one method."""

import faulthandler
import math
import re
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError
from lagrange.machine.model import Model
from lagrange.trajectory.integrator import Claims, RunOptions
from lagrange.trajectory.methods.registry import BUILT_IN, find
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

ENDLESS = 300.0
"""Seconds after which a run is called endless."""

LIMITS = {"max_steps": 30_000, "max_wall": 1000.0}
SLOW_LIMITS = {"max_steps": 1_500, "max_wall": 1000.0}
"""Limits of a run. `SLOW_LIMITS` are for methods of other packages, which call Python at each step. Such a method may
reach its limit. The number of steps decides, not the time, so that results do not depend on the load of the machine.
"""

GAVE_UP = (Status.MAX_STEPS, Status.MAX_WALL)

SOUND = ("right", "refused", "ended", "unreliable")
"""Allowed verdicts: the right answer; a refusal with an error message; an early end with a status; or a run to the end
with the status UNRELIABLE.
"""

FAILED = ("silent", "warned", "endless", "wrong")
"""Verdicts that fail the test: a wrong answer with the status SUCCESS and no warning; such an answer with a warning in
the message only; a run that does not end; or another status, message or result than the fault allows.
"""

CRASHES = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, TypeError, ValueError, RunError)
"""Exceptions that count as crashes, not as refusals."""

TIME = re.compile(r"\bt = ([-+]?(?:\d[\d.]*(?:e[-+]?\d+)?|inf|nan))")
UNTRUSTED = re.compile(r"does not follow the motion|leaves it few digits, or none")

Truth = Callable[[FloatArray], FloatArray]
"""Function that returns the exact states (2n, K) at times (K,)."""


@dataclass(frozen=True, eq=False)
class Fault:
    """A wrong or difficult request that any method can run, and its allowed outcomes.

    `about` describes the fault. `truth` returns the exact states, or is None if there is no right answer. The stored
    states must agree with them to a part of the largest magnitude of each row: `close` for adaptive methods, `fine`
    for fixed steps of order 2 or more, `rough` for order 1. `events` are the exact times of the events.

    A run may end early with one of `statuses`, at a time within `window`; its states until the time `compared` must
    be right. If the motion itself ends, `until` is the time of its end. `words` is a pattern in the message of such a
    run. `refusal` is a pattern in the message of a refusal, or a pair of patterns: for adaptive methods, and for equal
    steps. An empty pattern means that the request must not be refused. `raises` is an exception of the user's code
    that the run must raise.
    """

    name: str
    about: str
    model: Callable[[], Model]
    end: float = 1.0
    start: float = 0.0
    step: float | None = 0.01
    options: Mapping[str, Any] = field(default_factory=dict)
    adaptive: Mapping[str, Any] = field(default_factory=dict)
    equal: Mapping[str, Any] = field(default_factory=dict)
    truth: Truth | None = None
    until: float | None = None
    compared: float = math.inf
    close: float = 1e-5
    fine: float = 1e-2
    rough: float = 0.2
    statuses: tuple[Status, ...] = ()
    window: tuple[float, float] = (-math.inf, math.inf)
    words: str = ""
    refusal: str | tuple[str, str] = ""
    raises: type[RuntimeError] | None = None
    events: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Cell:
    """Result of one method on one fault: a verdict of `SOUND` or `FAILED`, the status, and the reason or message."""

    fault: str
    method: str
    verdict: str
    status: str
    detail: str
    wall: float

    @property
    def sound(self) -> bool:
        """True if the verdict is allowed."""
        return self.verdict in SOUND


class _Endless(BaseException):
    """Exception of the timer in `guarded`. It is no Exception, so that no method catches it."""


@contextmanager
def guarded(seconds: float) -> Iterator[None]:
    """Context that raises _Endless in its block after a time, and later ends the process if that has no effect.

    The timer must expire twice, so that a machine that was suspended does not fail the test.
    """
    rings: list[int] = []

    def ring(number: int, frame: FrameType | None) -> None:
        rings.append(number)
        if len(rings) > 1:
            raise _Endless

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds / 2, seconds / 2)
    faulthandler.dump_traceback_later(2 * seconds + 60, exit=True)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        faulthandler.cancel_dump_traceback_later()


def take(fault: Fault, given: Any) -> Cell:
    """Run a method on a fault and judge the result. `given` is the name of the method or an instance."""
    method, claims = find(given).name, find(given).claims
    began = time.perf_counter()
    status = ""
    try:
        with guarded(ENDLESS):
            result = run(fault, given, claims)
        status = result.status.value
        verdict, detail = judged(fault, method, claims, result)
    except StatementError as error:
        verdict, detail = refused(fault, given, claims, str(error))
    except _Endless:
        verdict, detail = "endless", f"no end within {ENDLESS:g} s"
    except CRASHES as error:
        due = fault.raises is not None and type(error) is fault.raises
        verdict, detail = "refused" if due else "wrong", f"{type(error).__name__}: {error}"
    return Cell(fault.name, method, verdict, status, detail, time.perf_counter() - began)


def run(fault: Fault, method: Any, claims: Claims) -> Trajectory:
    """Return the trajectory of a method on a fault."""
    options: dict[str, Any] = {**(SLOW_LIMITS if _slow(find(method).name) else LIMITS), **fault.options}
    if claims.adaptive:
        options.update(fault.adaptive)
    else:
        options.update({"step": fault.step, **fault.equal})
    initial, progress = options.pop("initial", None), options.pop("progress", None)
    span = (fault.start, fault.end)
    return trajectory_of(fault.model(), span, initial, RunOptions(method, **options), progress=progress)[0]


def _slow(method: str) -> bool:
    """Return True for a method of another package."""
    return method not in BUILT_IN


def refused(fault: Fault, method: Any, claims: Claims, words: str) -> tuple[str, str]:
    """Judge a refusal. It is allowed if the fault demands it, or if the method does not support the system."""
    due = fault.refusal if isinstance(fault.refusal, str) else fault.refusal[not claims.adaptive]
    if due and re.search(due, words):
        return "refused", words
    if not due and words.startswith(find(method).name) and _refuses_system(fault, method, words):
        return "refused", words
    return "wrong", f"refused, which is not due: {words}"


def _refuses_system(fault: Fault, method: Any, words: str) -> bool:
    """Return True if the method refuses a run of length zero of this system with the same message."""
    try:
        trajectory_of(fault.model(), (fault.start, fault.start), options=RunOptions(method))
    except StatementError as error:
        return str(error) == words
    return False


def judged(fault: Fault, method: str, claims: Claims, result: Trajectory) -> tuple[str, str]:
    """Judge a run that returned a trajectory."""
    broken = [*_unsound(fault, method, result), *_untrue(fault, claims, result)]
    answerless = fault.truth is None or fault.until is not None
    if result.status is Status.UNRELIABLE:
        return _unreliable(result, due=answerless or bool(broken))
    if result.status is Status.SUCCESS and (answerless or broken):
        if UNTRUSTED.search(result.message):
            return "warned", result.message
        return "silent", "; ".join(broken) or f"an answer where there is none: {result.message}"
    if result.status.complete and not broken:
        if result.status is Status.EVENT and Status.EVENT not in fault.statuses:
            return "wrong", f"ended at an event without being told to: {result.message}"
        return "right", result.message
    if result.status.complete:
        return "silent", "; ".join(broken)
    broken += _undue(fault, result)
    return ("wrong", f"{'; '.join(broken)}: {result.message}") if broken else ("ended", result.message)


def _unreliable(result: Trajectory, due: bool) -> tuple[str, str]:
    """Judge a run with the status UNRELIABLE. It must be wrong, and its message must name a remedy."""
    if not due:
        return "wrong", f"called unreliable, and right: {result.message}"
    if not re.search(r"does not follow the motion. (Shorten|Lower)", result.message):
        return "wrong", f"unreliable without a cause and a remedy: {result.message}"
    return "unreliable", result.message


def _unsound(fault: Fault, method: str, result: Trajectory) -> Iterator[str]:
    """Yield faults that no trajectory may have, whatever its status."""
    rows = 2 * fault.model().dimension
    if not (np.isfinite(result.t).all() and np.isfinite(result.y).all()):
        yield "kept states are not finite"
    if result.y.shape != (rows, len(result.t)) or not len(result.t):
        yield f"y has the shape {result.y.shape} for {len(result.t)} times"
    if not result.message.startswith(method):
        yield "the message does not begin with the method"
    direction = 1 if fault.end >= fault.start else -1
    if (np.diff(result.t) * direction < 0).any():
        yield "times go back"
    if (result.span[1] - fault.end) * direction > 0 or (result.t[-1] - result.span[1]) * direction > 0:
        yield "states beyond the last accepted one"
    if result.status is Status.SUCCESS and result.span[1] != fault.end:
        yield f"success at t = {result.span[1]}"


def _untrue(fault: Fault, claims: Claims, result: Trajectory) -> Iterator[str]:
    """Yield differences of the stored states and events from the exact ones."""
    allowed = fault.close if claims.adaptive else fault.fine if claims.order > 1 else fault.rough
    direction = 1 if fault.end >= fault.start else -1
    if fault.truth is not None:
        until = result.t[-1] if result.status.complete else fault.compared
        until = until if fault.until is None else fault.until
        kept = (result.t - until) * direction <= 0
        right = fault.truth(result.t[kept])
        if right.size:
            size = np.maximum(np.abs(right).max(axis=1), 1e-308)
            error = float((np.abs(result.y[:, kept] - right).max(axis=1) / size).max())
            if not error <= allowed:
                yield f"the states are off by {error:.1e} of their size, where {allowed:.1e} is due"
    if fault.events and result.status.complete:
        for place, (times, right_times) in enumerate(zip(result.t_events, fault.events, strict=True)):
            if len(times) != len(right_times):
                yield f"event {place} was found {len(times)} times in place of {len(right_times)}"
            elif len(times) and not np.abs(np.subtract(times, right_times)).max() <= allowed:
                yield f"event {place} was found at {times} in place of {right_times}"


def _undue(fault: Fault, result: Trajectory) -> Iterator[str]:
    """Yield the faults of an early end: its status, its time, and what its message does not name."""
    place = TIME.search(result.message)
    low, high = fault.window
    if place is None:
        yield "the message names no time"
    names = [name for base in fault.model().statement.names for name in (base, f"{base}_dot")]
    if result.status is not Status.INTERRUPTED and not any(re.search(rf"\b{n}\b", result.message) for n in names):
        yield "the message names no coordinate"
    if _slow(result.method) and result.status in GAVE_UP:
        return
    if result.status not in fault.statuses:
        yield f"{result.status.value} is not due"
    if place and not low <= float(place[1]) <= high:
        yield f"it ended at t = {place[1]}, outside {fault.window}"
    if fault.words and not re.search(fault.words, result.message):
        yield f"the message does not say {fault.words!r}"
