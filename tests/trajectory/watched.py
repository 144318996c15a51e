"""Runs with events or switching surfaces for several tests, with checks that every such run must pass."""

from __future__ import annotations

import math
import time
from functools import cache
from typing import Any

import numpy as np
from sympy import log, sqrt, tan

from lagrange.machine.model import Model
from lagrange.statement.event import event
from lagrange.trajectory.trajectory import Trajectory
from tests.models import build, x, y
from tests.trajectory.runs import run

G = 9.81
FALL = math.sqrt(2 / G)
"""How long a fall from 1 takes."""

WITHOUT_VALUE = [
    (log(x), 0.0, "The event function log(x) is -inf there"),
    (sqrt(x - 1), 0.0, "The event function sqrt(x - 1) is nan there"),
    (tan(x + 1), math.pi / 2 - 1, "The event function tan(x + 1) "),
    (1 / (x - 1), 1.0, "The event function 1/(x - 1) "),
    (sqrt(1 - x), 1.0, "The event function sqrt(1 - x) "),
]
"""Events along x = t that have no value from a time on, and how the message begins."""


def go(
    model: Model, end: float, events: Any = None, start: float = 0.0, method: Any = "taylor", **options: Any
) -> Trajectory:
    """Return a run with events and a time limit, after checks that every result must pass."""
    began = time.process_time()
    result = run(model, end, method, start, events=events, **options)
    assert time.process_time() - began < 60.0
    forward = 1.0 if end >= start else -1.0
    assert (forward * np.diff(result.t) >= 0).all() and np.isfinite(result.y).all()
    for times, states in zip(result.t_events, result.y_events, strict=True):
        assert states.shape == (len(times), len(result.y))
        assert (forward * np.diff(times) >= 0).all()
        if len(times):
            # Nothing happens beyond the last accepted step, or before the first.
            assert forward * (times[-1] - result.span[1]) <= 4e-16 * abs(times[-1])
            assert forward * (times[0] - start) >= 0
    return result


@cache
def free(target: str = "llvm", **initial: float) -> Model:
    """Return a unit mass on a line without a force."""
    return build(target, kinetic=x.dot**2 / 2, initial=initial or {"x_dot": 1.0})


@cache
def ball(target: str = "llvm", height: float = 1.0, speed: float = 0.0) -> Model:
    return build(target, kinetic=y.dot**2 / 2, potential=G * y, initial={y: height, y.dot: speed})


def floor(restitution: Any, level: float = 0.0, **options: Any) -> Any:
    return event(y - level, direction=-1, reset={y.dot: -restitution * y.dot}, **options)


@cache
def harmonic(target: str = "llvm") -> Model:
    """Return an oscillator whose motion is x = sin t."""
    return build(target, kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x.dot: 1.0})


def bounces(restitution: float, count: int) -> Any:
    """Return the times of the impacts of a ball that falls from height 1."""
    flights = 2 * FALL * restitution ** np.arange(1, count)
    return FALL + np.concatenate([[0.0], np.cumsum(flights)])
