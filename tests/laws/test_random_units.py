"""Rods with random masses move alike in random units of mass, length and time."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lagrange as lg
from lagrange.export.elimination import ROWS, factored, solved
from tests.trajectory.runs import ADAPTIVE

m, g, ell = lg.parameters("m g ell")

LIGHTEST = 1e-3
"""Mass of some bodies, in the unit of the others: solutions without pivoting then miss their constraints."""

SEEDS = range(30)
FAR = 12
"""Powers of ten of the units, from -FAR to FAR. The square of a length is in a constraint."""


UNSCALED = "radau5-index2"
"""Method whose unknowns are multipliers too, which Newton's method takes in the units of the system."""


def rods(draw: random.Random, unit: tuple[float, float, float]) -> tuple[lg.System, float]:
    """Return one to three bodies on rods in Cartesian coordinates, and the duration of a run.

    Half of the systems hang at rest except for one body. `unit` has the units of mass, length and time. The same
    random numbers give the same system in other units.
    """
    mass, length, time = unit
    count = draw.randint(1, 3)
    q = lg.coordinates(" ".join(f"x{i} y{i}" for i in range(count)))
    masses = [draw.choice([1.0, 1.0, 5.0, LIGHTEST]) for _ in range(count)]
    angles = [draw.uniform(-2.0, 2.0) for _ in range(count)]
    if draw.random() < 0.5:
        angles = [0.0] * (count - 1) + [draw.choice([0.5, 1e-3])]
    ends = np.cumsum([(np.sin(a), -np.cos(a)) for a in angles], axis=0) * length
    joints = [(0, 0), *zip(q[::2], q[1::2], strict=True)]
    system = lg.System(
        m * sum(w * (x.dot**2 + y.dot**2) for w, x, y in zip(masses, q[::2], q[1::2], strict=True)) / 2,
        m * g * sum(w * y for w, y in zip(masses, q[1::2], strict=True)),
        coordinates=list(q),
        constraints=[(x - a) ** 2 + (y - b) ** 2 - ell**2 for (a, b), (x, y) in pairwise(joints)],
        parameters={m: mass, g: 9.81 * length / time**2, ell: length},
        initial=dict(zip(q, map(float, ends.ravel()), strict=True)),
    )
    return system, draw.uniform(0.5, 1.5) * time


def ended(seed: int, unit: tuple[float, float, float], method: str, rtol: float) -> NDArray[Any]:
    """Return the last state of a run, converted to SI units."""
    system, end = rods(random.Random(seed), unit)
    run = lg.integrate(system.compile(check=False), (0.0, end), method=method, rtol=rtol)
    assert run.status is lg.Status.SUCCESS, run.message
    last = run.y[:, -1] / unit[1]
    last[len(last) // 2 :] *= unit[2]
    return np.asarray(last)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_motion_of_rods_is_the_same_in_all_units(seed: int) -> None:
    draw = random.Random(1000 + seed)
    unit = (10.0 ** draw.uniform(-FAR, FAR), 10.0 ** draw.uniform(-FAR, FAR), 10.0 ** draw.uniform(-FAR, FAR))
    method = draw.choice([name for name in ADAPTIVE if name != UNSCALED])
    expected = ended(seed, (1.0, 1.0, 1.0), "taylor", 1e-14)
    result = ended(seed, unit, method, 1e-7)
    # Runs of a tenth of a second to a second multiply the errors of steps by less than 1,000.
    assert result == pytest.approx(expected, abs=1e-4)


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="the rows and columns of multipliers in Newton's matrix are not scaled")
def test_multipliers_may_be_unknowns_in_all_units() -> None:
    ended(27, (3e-12, 6e9, 10.0), UNSCALED, 1e-7)


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("seed", SEEDS)
def test_accelerations_of_rods_are_the_same_in_all_units(seed: int, target: str) -> None:
    draw = random.Random(2000 + seed)
    mass, length, time = (10.0 ** draw.uniform(-FAR, FAR) for _ in range(3))
    plain, _ = rods(random.Random(seed), (1.0, 1.0, 1.0))
    second, _ = rods(random.Random(seed), (mass, length, time))
    expected, result = (
        first.compile(target, check=False).rhs(0.0, list(first.statement.initial)) for first in (plain, second)
    )
    # A light body is accelerated by forces that are a thousand times as large: 1e3 of 1e-16.
    assert result * time**2 / length == pytest.approx(expected, abs=1e-11 * max(1.0, np.abs(expected).max()))


def in_units(seed: int) -> tuple[lg.System, float]:
    """Return rods in random units, and the unit of acceleration."""
    draw = random.Random(2000 + seed)
    mass, length, time = (10.0 ** draw.uniform(-FAR, FAR) for _ in range(3))
    return rods(random.Random(seed), (mass, length, time))[0], length / time**2


UNSCALED_SEEDS = (3, 23, 36, 41, 52, 153)
"""Systems that were singular in exports that compared an inertia with a constraint, and others."""


@pytest.mark.parametrize("seed", UNSCALED_SEEDS)
def test_printed_eliminations_solve_rods_in_all_units(seed: int) -> None:
    system, unit = in_units(seed)
    model = system.compile("numpy", check=False)
    equations, start = model.equations, np.array(system.statement.initial)
    n, count = len(equations.matrix), len(equations.q)
    a, x = np.zeros((n + ROWS, n)), np.zeros(n)
    entries = tuple(entry for i, row in enumerate(equations.matrix) for entry in row[: i + 1])
    a[np.tril_indices(n)] = model.function("matrix", entries)(0.0, start, model.parameter_array())
    # At rest the accelerations are those of gravity and rods: M a + G^T z = -dV/dq and G a = 0.
    forces = model.evaluate("forces", *model.layout.split(start))
    assert not factored(n, a)
    solved(n, a, np.append(forces, np.zeros(n - count)), x)
    expected = model.rhs(0.0, start)[model.layout.v]
    assert x[:count] / unit == pytest.approx(expected / unit, abs=1e-11 * max(1.0, np.abs(expected / unit).max()))


@pytest.mark.few(1)
@pytest.mark.parametrize("library", [pytest.param("jax", marks=pytest.mark.slow), "casadi"])
@pytest.mark.parametrize("seed", UNSCALED_SEEDS[::2])
def test_traced_accelerations_of_rods_are_the_same_in_all_units(seed: int, library: str) -> None:
    pytest.importorskip(library)
    system, unit = in_units(seed)
    model = system.compile(check=False)
    start, values = np.array(system.statement.initial), model.parameter_array()
    if library == "jax":
        import jax

        jax.config.update("jax_enable_x64", val=True)
        result, singular = model.as_jax().checked(0.0, start, values)
    else:
        result, singular = model.as_casadi(status=True)(0.0, start, values)
    expected = model.rhs(0.0, start) / unit
    assert not bool(singular)
    allowed = 1e-11 * max(1.0, np.abs(expected).max())
    assert np.array(result).ravel() / unit == pytest.approx(expected, abs=allowed)
