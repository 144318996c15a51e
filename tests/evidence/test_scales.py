"""Characteristic sizes, and samples and quick checks of systems in any units."""

from __future__ import annotations

import itertools
import math
import random
import sys
from typing import Any, cast

import pytest
import sympy

import lagrange as lg
from lagrange.errors import RunError
from lagrange.evidence.quick import quick_check
from lagrange.evidence.reference import Reference
from lagrange.evidence.sample import SAMPLE_KINDS, SamplePoint, Sampler, Scales
from lagrange.machine.model import Model
from lagrange.statement.declare import declare
from tests.evidence.stand_in import StandIn
from tests.evidence.test_check import FAULTS

x, y, theta = lg.coordinates("x y theta")
m, k, l, g = lg.parameters("m k l g")

UNITS = (1e-12, 1e-6, 1e6, 1e12)


def saturated(size: float) -> Any:
    """Return an inertia that saturates where x exceeds a size."""
    u = x / size
    return x.dot**2 / 2 * (1 + u**2 / (1 + u**2))


@pytest.mark.parametrize("unit", UNITS)
def test_sizes_follow_constants_parameters_and_the_start(unit: float) -> None:
    assert Scales(declare(kinetic=saturated(unit))).sizes({}) == pytest.approx((unit, 1.0))
    spring = declare(kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * (sympy.sqrt(x**2 + y**2) - l) ** 2 / 2)
    assert Scales(spring).sizes({m: 1.0, k: 1.0, l: unit}) == pytest.approx((unit,) * 4)
    chain = declare(kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * (x - y) ** 2 / 2)
    assert Scales(chain).sizes({m: 1.0, k: 1.0}, (unit, 0, 0, 0)) == pytest.approx((unit,) * 4)
    pendulum = declare(kinetic=m * l**2 * theta.dot**2 / 2, potential=-m * g * l * sympy.cos(theta))
    assert Scales(pendulum).sizes({m: unit, l: unit, g: 1.0})[0] == 1.0
    switched = declare(kinetic=x.dot**2 / 2, potential=sympy.Piecewise((x**2, x > unit), (0, True)))
    assert Scales(switched).sizes({})[0] == pytest.approx(unit)


@pytest.mark.parametrize("unit", UNITS)
def test_samples_are_of_that_size(unit: float) -> None:
    sampler = Sampler(declare(kinetic=saturated(unit)), seed=0)
    for kind in SAMPLE_KINDS:
        for _ in range(20):
            assert 0.05 < abs(sampler.point(kind).q[0]) / unit < 2


def test_a_size_spreads_along_a_chain() -> None:
    """The size of the first link reaches the last, in the order of the statement and against it."""
    links = lg.coordinates(" ".join(f"s{i}" for i in range(60)))
    energy = sympy.Add(*((a - b) ** 2 for a, b in itertools.pairwise(links)))
    kinetic = sympy.Add(*(q.dot**2 for q in links))
    for order, first in ((links, 0), (links[::-1], 59)):
        start = [1e-9 * (i == first) for i in range(120)]
        sizes = Scales(declare(kinetic=kinetic, potential=energy, coordinates=order)).sizes({}, start)
        assert all(math.isclose(size, 1e-9, rel_tol=1e-9) for size in sizes)


def test_the_work_of_sizes_is_linear_in_a_chain() -> None:
    """Each row looked its symbols up among all coordinates: the sizes of 50 bodies took 3 s."""
    counts = {}
    for n in (20, 40):
        links = lg.coordinates(" ".join(f"s{i}" for i in range(n)))
        springs = sympy.Add(*((a - b) ** 2 for a, b in itertools.pairwise(links)))
        scales = Scales(declare(kinetic=sympy.Add(*(q.dot**2 for q in links)), potential=k * springs / 2))
        calls = 0

        def count(_frame: Any, _event: str, _argument: Any) -> None:
            nonlocal calls
            calls += 1

        sys.setprofile(count)
        try:
            scales.sizes({k: 2.0}, [0.1] * n)
        finally:
            sys.setprofile(None)
        counts[n] = calls
    assert counts[40] < 2.5 * counts[20]


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3))
def test_right_equations_in_small_and_large_units_pass(seed: int) -> None:
    """The quick check called those in which x/1e-3 stands a fault of lagrange."""
    draw = random.Random(seed)
    length, mass, time = (10.0 ** draw.uniform(-12, 12) for _ in range(3))
    u, w = x / length, y / length
    shape = [u**2 / (1 + u**2), sympy.sqrt(1 + u**2), 1 / (1 + (u - w) ** 2), sympy.tanh(u) * w, sympy.exp(-(u**2))]
    kinetic = mass * (x.dot**2 * (1 + draw.choice(shape)) + y.dot**2) / 2
    potential = mass * (length / time) ** 2 * (draw.choice(shape) + u**2 + w**2)
    system = lg.System(kinetic, potential, initial={x: length * draw.choice((0.0, 0.3))})
    system.compile("numpy")
    assert system.check(points=1)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_in_any_units(unit: float, fault: str) -> None:
    """At samples of order one rounding was all that was left of the acceleration in small units."""
    model = StandIn(declare(kinetic=saturated(unit), potential=sympy.cos(x / unit)), {"bias": FAULTS[fault]})
    with pytest.raises(RunError, match="fault of lagrange, please report"):
        quick_check(cast("Model", model))


HELD: dict[str, Any] = {
    "a rod": [x**2 + y**2 - l**2],
    "a wheel on a ramp": [x.dot - l * theta.dot, y - x / 3],
    "a knife edge": [x.dot * sympy.sin(theta) - y.dot * sympy.cos(theta)],
    "a rolling rod": [x**2 + y**2 - l**2, x.dot - l * theta.dot],
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("held", HELD)
def test_the_reference_of_held_systems_does_not_depend_on_units(held: str, seed: int) -> None:
    """In one of six random units the pivots of constraints were taken for zero: "the mass matrix is singular"."""
    energy = m * (x.dot**2 + y.dot**2) / 2 + m * l**2 * theta.dot**2 / 3
    statement = declare(kinetic=energy, potential=m * g * y, coordinates=[x, y, theta], constraints=HELD[held])
    reference, draw = Reference(statement), random.Random(seed)
    length, mass, time = (10.0 ** draw.uniform(-12, 12) for _ in range(3))

    def accelerations(length: float, mass: float, time: float) -> list[float]:
        parameters = {m: 1.3 * mass, l: 1.1 * length, g: 0.7 * length / time**2}
        q, v = (0.4 * length, 1.0 * length, 0.9), (0.5 * length / time, -0.2 * length / time, 0.6 / time)
        parameters = {symbol: parameters[symbol] for symbol in statement.parameters}
        entries = reference.at(SamplePoint(q, v, 0.1, parameters, "stated"), [0])
        return [float(a) for a in entries["accelerations"].value]

    scaled = accelerations(length, mass, time)
    units = (length / time**2, length / time**2, 1 / time**2)
    assert [a / unit for a, unit in zip(scaled, units, strict=True)] == pytest.approx(accelerations(1.0, 1.0, 1.0))
