"""What a fault is, what a run of it deserves, and what came of one method on it."""

from __future__ import annotations

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
"""Limits of a run. The second are for methods from other packages, which call Python at every step; these may use them
up. Steps decide, not seconds: what comes of a cell must not depend on how busy the machine is."""

GAVE_UP = (Status.MAX_STEPS, Status.MAX_WALL)

SOUND = ("right", "refused", "ended", "unreliable")
"""What may come of a cell: the right answer, a refusal in words, an early end with its status, or a run to the end
whose status says that its answer is not to be trusted."""

FAILED = ("silent", "warned", "endless", "wrong")
"""What may not: a wrong answer without a word, one of which the message alone warns while the status is success, no
end, or a status, a message or results that are not those due."""

CRASHES = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, TypeError, ValueError, RunError)
"""What falls over with one of these has not refused anything."""

TIME = re.compile(r"\bt = ([-+]?(?:\d[\d.]*(?:e[-+]?\d+)?|inf|nan))")
UNTRUSTED = re.compile(r"does not follow the motion|leaves it few digits, or none")

Truth = Callable[[FloatArray], FloatArray]
"""The right states (2n, K) at times (K,)."""


@dataclass(frozen=True, eq=False)
class Fault:
    """One way to go wrong, as a run of any method, and what is due.

    A run to the end is right if `truth` is there and every kept state agrees with it to `close` (adaptive methods),
    `fine` (equal steps, order 2 and more) or `rough` (order 1), in parts of each row's largest magnitude. Runs that
    end early may do so with one of `statuses`, at a time within `window`; what they kept until `compared` must be right
    all the same. `until` is where the motion itself ends, if it does: nothing is right beyond. `words` is in their
    message, and `refusal` in the message of a run that is refused: one pattern, or one each for adaptive methods and
    for equal steps. An empty one means that a refusal is not due. `raises` is an exception of the user's own that is
    to arrive, and `events` are the right times of the events.
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
    """What came of a method on a fault: one of SOUND or FAILED, the status, and the reason or the message."""

    fault: str
    method: str
    verdict: str
    status: str
    detail: str
    wall: float

    @property
    def sound(self) -> bool:
        """Whether it is what was due."""
        return self.verdict in SOUND


class _Endless(BaseException):
    """The guard's alarm; no exception that a method could take for one of its own."""


@contextmanager
def guarded(seconds: float) -> Iterator[None]:
    """End what is inside by an alarm, and the process if it does not listen.

    The alarm rings twice: a machine that stood still hears the first, and goes on.
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
    """Run a method, a name or an instance, on a fault and judge it."""
    method, claims = find(given).name, find(given).claims
    began = time.perf_counter()
    status = ""
    try:
        with guarded(ENDLESS):
            found = run(fault, given, claims)
        status = found.status.value
        verdict, detail = judged(fault, method, claims, found)
    except StatementError as error:
        verdict, detail = refused(fault, given, claims, str(error))
    except _Endless:
        verdict, detail = "endless", f"no end within {ENDLESS:g} s"
    except CRASHES as error:
        due = fault.raises is not None and type(error) is fault.raises
        verdict, detail = "refused" if due else "wrong", f"{type(error).__name__}: {error}"
    return Cell(fault.name, method, verdict, status, detail, time.perf_counter() - began)


def run(fault: Fault, method: Any, claims: Claims) -> Trajectory:
    """Run a method on a fault."""
    options: dict[str, Any] = {**(SLOW_LIMITS if _slow(find(method).name) else LIMITS), **fault.options}
    if claims.adaptive:
        options.update(fault.adaptive)
    else:
        options.update({"step": fault.step, **fault.equal})
    initial, progress = options.pop("initial", None), options.pop("progress", None)
    span = (fault.start, fault.end)
    return trajectory_of(fault.model(), span, initial, RunOptions(method, **options), progress=progress)[0]


def _slow(method: str) -> bool:
    """Whether the method is one that another package offers."""
    return method not in BUILT_IN


def refused(fault: Fault, method: Any, claims: Claims, words: str) -> tuple[str, str]:
    """Judge a refusal: one that the fault calls for, or of a system that the method is not made for."""
    due = fault.refusal if isinstance(fault.refusal, str) else fault.refusal[not claims.adaptive]
    if due and re.search(due, words):
        return "refused", words
    if not due and words.startswith(find(method).name) and _refuses_system(fault, method, words):
        return "refused", words
    return "wrong", f"refused, which is not due: {words}"


def _refuses_system(fault: Fault, method: Any, words: str) -> bool:
    """Whether the method refuses this system in the same words when nothing is asked but to stay where it is."""
    try:
        trajectory_of(fault.model(), (fault.start, fault.start), options=RunOptions(method))
    except StatementError as error:
        return str(error) == words
    return False


def judged(fault: Fault, method: str, claims: Claims, found: Trajectory) -> tuple[str, str]:
    """Judge a run that came back."""
    broken = [*_unsound(fault, method, found), *_untrue(fault, claims, found)]
    answerless = fault.truth is None or fault.until is not None
    if found.status is Status.UNRELIABLE:
        return _unreliable(found, due=answerless or bool(broken))
    if found.status is Status.SUCCESS and (answerless or broken):
        if UNTRUSTED.search(found.message):
            return "warned", found.message
        return "silent", "; ".join(broken) or f"an answer where there is none: {found.message}"
    if found.status.complete and not broken:
        if found.status is Status.EVENT and Status.EVENT not in fault.statuses:
            return "wrong", f"ended at an event without being told to: {found.message}"
        return "right", found.message
    if found.status.complete:
        return "silent", "; ".join(broken)
    broken += _undue(fault, found)
    return ("wrong", f"{'; '.join(broken)}: {found.message}") if broken else ("ended", found.message)


def _unreliable(found: Trajectory, due: bool) -> tuple[str, str]:
    """Judge a run that says that it does not follow the motion: it must not, and must say what helps."""
    if not due:
        return "wrong", f"called unreliable, and right: {found.message}"
    if not re.search(r"does not follow the motion. (Shorten|Lower)", found.message):
        return "wrong", f"unreliable without a cause and a remedy: {found.message}"
    return "unreliable", found.message


def _unsound(fault: Fault, method: str, found: Trajectory) -> Iterator[str]:
    """Yield what no result may be, however it ended."""
    rows = 2 * fault.model().dimension
    if not (np.isfinite(found.t).all() and np.isfinite(found.y).all()):
        yield "kept states are not finite"
    if found.y.shape != (rows, len(found.t)) or not len(found.t):
        yield f"y has the shape {found.y.shape} for {len(found.t)} times"
    if not found.message.startswith(method):
        yield "the message does not begin with the method"
    direction = 1 if fault.end >= fault.start else -1
    if (np.diff(found.t) * direction < 0).any():
        yield "times go back"
    if (found.span[1] - fault.end) * direction > 0 or (found.t[-1] - found.span[1]) * direction > 0:
        yield "states beyond the last accepted one"
    if found.status is Status.SUCCESS and found.span[1] != fault.end:
        yield f"success at t = {found.span[1]}"


def _untrue(fault: Fault, claims: Claims, found: Trajectory) -> Iterator[str]:
    """Yield how what was kept differs from the truth, where there is one."""
    allowed = fault.close if claims.adaptive else fault.fine if claims.order > 1 else fault.rough
    direction = 1 if fault.end >= fault.start else -1
    if fault.truth is not None:
        until = found.t[-1] if found.status.complete else fault.compared
        until = until if fault.until is None else fault.until
        kept = (found.t - until) * direction <= 0
        right = fault.truth(found.t[kept])
        if right.size:
            size = np.maximum(np.abs(right).max(axis=1), 1e-308)
            error = float((np.abs(found.y[:, kept] - right).max(axis=1) / size).max())
            if not error <= allowed:
                yield f"the states are off by {error:.1e} of their size, where {allowed:.1e} is due"
    if fault.events and found.status.complete:
        for place, (times, right_times) in enumerate(zip(found.t_events, fault.events, strict=True)):
            if len(times) != len(right_times):
                yield f"event {place} was found {len(times)} times in place of {len(right_times)}"
            elif len(times) and not np.abs(np.subtract(times, right_times)).max() <= allowed:
                yield f"event {place} was found at {times} in place of {right_times}"


def _undue(fault: Fault, found: Trajectory) -> Iterator[str]:
    """Yield what an early end lacks: a status that is due, a time, a coordinate and the words that say why."""
    place = TIME.search(found.message)
    low, high = fault.window
    if place is None:
        yield "the message names no time"
    names = [name for base in fault.model().statement.names for name in (base, f"{base}_dot")]
    if found.status is not Status.INTERRUPTED and not any(re.search(rf"\b{n}\b", found.message) for n in names):
        yield "the message names no coordinate"
    if _slow(found.method) and found.status in GAVE_UP:
        return
    if found.status not in fault.statuses:
        yield f"{found.status.value} is not due"
    if place and not low <= float(place[1]) <= high:
        yield f"it ended at t = {place[1]}, outside {fault.window}"
    if fault.words and not re.search(fault.words, found.message):
        yield f"the message does not say {fault.words!r}"
