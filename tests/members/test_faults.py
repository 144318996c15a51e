"""Members with a fault beside healthy ones: each ends as its single run does, with the same message."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import Piecewise, log, sqrt

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.faults.motions import LOST, NO_NUMBER, ROD, on_a_line, particle, sphere, x
from tests.faults.motions import x as place
from tests.faults.motions import y as height

t = lg.t
c, onset = lg.parameters("c onset", positive=False)

HEALTHY = 7


@dataclass(frozen=True)
class Faulty:
    """A model, the varied key, its value for the faulty member, and its range for the healthy ones.

    `held` are the entries that all starts share. `follows` returns the entries that depend on the key.
    """

    name: str
    model: Callable[[], Model]
    key: str
    fault: float
    healthy: tuple[float, float]
    statuses: tuple[Status, ...]
    end: float = 1.0
    step: float = 0.01
    held: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    follows: Callable[[Any], Mapping[str, Any]] | None = None

    def starts(self, *places: int, count: int = HEALTHY) -> dict[str, Any]:
        """Return the starts or parameters of healthy members, with a faulty member inserted at some indices."""
        values = np.insert(np.linspace(*self.healthy, count), places, self.fault)
        return self.given(values)

    def given(self, values: Any) -> dict[str, Any]:
        """Return values in the form that an ensemble or a run accepts."""
        own = {self.key: values}
        initial = {**self.held, **(self.follows(values) if self.follows else {})}
        if self.key in {p.name for p in self.model().statement.parameters}:
            return {"initial": initial, "parameters": own}
        return {"initial": {**initial, **own}}


@cache
def forced(force: Any, **initial: float) -> Model:
    """Return the model of a unit mass on a line under a force with parameters c and onset."""
    return lg.System(
        kinetic=x.dot**2 / 2,
        forces={x: force},
        coordinates=[x],
        initial={x: initial.get("place", 0.0), x.dot: initial.get("speed", 0.0)},
        parameters={c: 0.0, onset: 10.0},
        name="particle",
    ).compile()


@cache
def weighed() -> Model:
    """Return the model of a body whose mass is a parameter."""
    return lg.System(
        kinetic=c * x.dot**2 / 2, potential=x**2 / 2, parameters={c: 1.0}, initial={x: 1.0}, name="weighed body"
    ).compile()


def shrinking() -> Model:
    """Return the model of a body that moves towards x = 0, where it has no inertia."""
    return on_a_line(x**2 * x.dot**2 / 2, 0, 1.0, -1.0)


STUCK, WRONG = (*NO_NUMBER, Status.SINGULAR), (*NO_NUMBER, Status.UNRELIABLE)
LONG = (*NO_NUMBER, Status.MAX_STEPS, Status.UNRELIABLE)
"""How a run may end that loses its inertia, that a method with fixed steps does not follow, or that takes too long."""

FAULTY = (
    Faulty("nan force", lambda: forced(Piecewise((-x + c, t < onset)), place=1.0), "onset", 0.5, (5.0, 9.0), NO_NUMBER),
    Faulty("blow-up", lambda: particle(x.dot**2, 0.0, 1.0), "x_dot", 1.0, (-1.0, 0.3), NO_NUMBER, end=2.0),
    Faulty("collision", lambda: on_a_line(x.dot**2 / 2, -1 / x, 1.0), "x", 1.0, (4.0, 6.0), WRONG, end=3.0, step=1e-3),
    Faulty("singular on the way", shrinking, "x_dot", -1.0, (0.1, 1.0), STUCK, step=1e-3),
    Faulty("no inertia", lambda: sphere(0.0, 1.0, 1.0), "theta", 0.0, (1.0, 1.5), (Status.SINGULAR,)),
    Faulty("massless", weighed, "c", 0.0, (0.5, 2.0), (Status.SINGULAR,)),
    Faulty("huge", lambda: particle(-(x**3), 1.0), "x", 1e300, (0.5, 1.0), NO_NUMBER),
    Faulty("stiff", lambda: forced(-c * x.dot - x, place=1.0), "c", 1e9, (0.5, 2.0), LONG, options={"max_steps": 3000}),
)
"""Faults of the motion: one for each status with which `tests.faults` has a member end that others avoid."""


@cache
def held(*constraints: Any, **initial: float) -> Model:
    """Return the model of a unit mass in a plane under unit gravity, with constraints that contain a parameter c."""
    return lg.System(
        kinetic=(place.dot**2 + height.dot**2) / 2,
        potential=height + 0 * c,
        coordinates=[place, height],
        constraints=dict(zip("ab", constraints, strict=False)),
        initial={entry: initial[name] for name, entry in (("x", place), ("y", height)) if name in initial},
        parameters={c: initial.get("c", 1.0)},
        name="held mass",
    ).compile()


def rod() -> Model:
    """Return the model of a bob on a rod of unit length."""
    return held(ROD, x=0.6, y=-0.8)


FAULTY_CONSTRAINTS = (
    Faulty(
        "off a constraint", rod, "x", 1.3, (0.1, 0.9), (Status.NON_FINITE,),
        follows=lambda v: {"y": -np.sqrt(np.maximum(1 - v * v, 0.0))},
    ),
    Faulty(
        "dependent", lambda: held(place - height - 1, place - c * height - 1, x=1.0, c=2.0),
        "c", 1.0, (2.0, 3.0), (Status.NON_FINITE,),
    ),
    Faulty(
        "drive out of its domain", lambda: held(place - sqrt(c - lg.t), c=9.0, x=3.0),
        "c", 1.0, (4.0, 9.0), (Status.SINGULAR, Status.DIVERGED, *LOST), end=2.0,
        follows=lambda v: {"x": np.sqrt(v), "x_dot": -1 / (2 * np.sqrt(v))},
    ),
)  # fmt: skip
"""Constraints that are not met at the start of a member, are dependent there, or are lost on its way."""


@cache
def falling(force: Any = -2) -> Model:
    """Return the model of a unit mass on a line under a force, with a parameter c that only events contain."""
    return lg.System(
        kinetic=x.dot**2 / 2, forces={x: force + 0 * c}, initial={x: 1.0}, parameters={c: 0.5}, name="falling body"
    ).compile()


kick = Piecewise((1.0, c > 0.9), (c * height.dot, True))
"""What a positive c makes of a velocity across the rod's end: one along the rod."""


FAULTY_EVENTS = (
    Faulty(
        "nan event on the way", lambda: falling(0), "x", 0.0, (-9.0, -4.0), NO_NUMBER,
        end=2.0, held={"x_dot": 1.0}, options={"events": [log(1 - x) + 1]},
    ),
    Faulty(
        "terminal event", lambda: falling(0), "x", -0.3, (-9.0, -4.0), (Status.EVENT,),
        held={"x_dot": 1.0}, options={"events": [lg.event(x, terminal=True)]},
    ),
    Faulty(
        "bounces without end", falling, "c", 0.5, (0.9, 1.0), (Status.STEP_TOO_SMALL,),
        end=6.0, options={"events": [lg.event(x, direction=-1, reset={x.dot: -c * x.dot})]},
    ),
    Faulty(
        "reset off a constraint", lambda: held(ROD, x=0.6, y=-0.8, c=-1.0), "c", 1.0, (-1.0, -0.5), (Status.DIVERGED,),
        end=2.0, options={"events": [lg.event(place, reset={place.dot: c * place.dot, height.dot: kick})]},
    ),
)  # fmt: skip
"""Events without a value or an end, a terminal one, and a reset that leaves a constraint."""


# --- A member with a fault beside healthy ones: it ends as its single run does, with the same message ----------
# A lane that is stuck or full of NaN executes the same instructions as its neighbours, and then takes other members.


METHODS = ("taylor", "dop853", "rk4", "verlet")
QUEUE = 3 * HEALTHY + 4
"""So many healthy members that lanes take members before and behind those with a fault."""
PLACES = [(HEALTHY, (0,)), (HEALTHY, (3,)), (HEALTHY, (HEALTHY,)), (QUEUE, (0, 9, 9, 10, QUEUE))]
NUMBERS = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?|x(_dot)? is [^ ]+")


def options(fault: Faulty, method: str) -> dict[str, Any]:
    fixed = not find(method).claims.adaptive
    return {"method": method, **fault.options, **({"step": fault.step} if fixed else {})}


def run(fault: Faulty, method: str, *places: int, count: int) -> lg.Ensemble:
    given = {**fault.starts(*places, count=count), **options(fault, method)}
    kept = ("end", "counts", "drift", *([("events", 2)] if "events" in given else []))
    return lg.ensemble(fault.model(), fault.end, keep=kept, workers=1, **given)


def alone(fault: Faulty, method: str, value: float) -> Trajectory | str:
    """Return the single run of a member, or the message of its refusal."""
    given, asked = fault.given(np.float64(value)), options(fault, method)
    chosen = RunOptions(asked.pop("method"), parameters=given.get("parameters"), **asked)
    try:
        return trajectory_of(fault.model(), (0.0, fault.end), given["initial"], chosen)[0]
    except lg.StatementError as refusal:
        return str(refusal)


def check_member(runs: lg.Ensemble, i: int, own: Trajectory | str) -> None:
    """Assert that a member ended as its single run, with the same message, and has no numbers if it was refused."""
    if isinstance(own, str):
        assert (runs.status[i], runs.messages[i], runs.t[i]) == (Status.NON_FINITE, own, 0.0)
        assert np.isnan(runs.y[:, i]).all()
        return
    assert runs.status[i] is own.status
    assert np.isfinite(runs.y[:, i]).all()
    if own.status is Status.MAX_STEPS:  # so many steps lead, by other rounding, to another time
        assert NUMBERS.sub("", runs.messages[i]) == NUMBERS.sub("", own.message)
        return
    assert runs.messages.get(i, own.message) == own.message
    assert runs.t[i] == pytest.approx(own.span[1], rel=1e-5)
    for times, result in zip(runs.t_events, own.t_events, strict=True):
        assert times[i][: len(result)] == pytest.approx(result[:2], rel=1e-9)
        assert np.isnan(times[i][len(result) :]).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fault", [*FAULTY, *FAULTY_CONSTRAINTS, *FAULTY_EVENTS], ids=lambda fault: fault.name)
def test_a_fault_beside_healthy_members(fault: Faulty, method: str) -> None:
    own, sound = (alone(fault, method, value) for value in (fault.fault, fault.healthy[0]))
    if isinstance(sound, str):  # the method is not made for the system
        with pytest.raises(lg.StatementError, match=re.escape(sound)):
            run(fault, method, 0, count=HEALTHY)
        return
    status = Status.NON_FINITE if isinstance(own, str) else own.status
    assert status in fault.statuses
    healthy = {count: run(fault, method, count=count) for count in (HEALTHY, QUEUE)}
    assert all(set(runs.status) == {Status.SUCCESS} for runs in healthy.values())
    for count, places in PLACES:
        runs = run(fault, method, *places, count=count)
        faulty = np.array(places) + np.arange(len(places))
        for column in (column.name for column in runs.columns):
            others = np.delete(runs.results.column(column), faulty, axis=0)
            if column != "evaluations" or "side by side" in runs.form:  # a run with a new driver makes one more
                assert others.tobytes() == healthy[count].results.column(column).tobytes(), column
        assert list(runs.messages) == ([] if status is Status.SUCCESS else faulty.tolist())
        for i in faulty.tolist():
            check_member(runs, i, own)


@pytest.mark.slow
def test_a_store_has_the_sentences_of_memory(tmp_path: Any) -> None:
    pytest.importorskip("zarr")
    galaxy, starts = lg.scene("henon-heiles").compile(), {"x": [0.1, 1.0, 0.2, 1.1]}
    for method in ("taylor", "radau5"):
        memory = lg.ensemble(galaxy, 15.0, starts, method=method)
        stored = lg.ensemble(galaxy, 15.0, starts, method=method, store=tmp_path / method)
        assert dict(stored.messages) == dict(memory.messages) and set(memory.messages) == {1, 3}
