"""Default absolute tolerances: small entries, entries that are round-off, and entries without a size yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from random import Random
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import cos, exp, sin

import lagrange as lg
from lagrange.trajectory.sizes import entry_sizes, slopes_of
from tests.trajectory.runs import ADAPTIVE

x, y = lg.coordinates("x y")
t = lg.t


def plain(*coordinates: Any) -> Any:
    return sum(q.dot**2 for q in coordinates) / 2


@pytest.mark.few
@pytest.mark.parametrize("method", ADAPTIVE)
def test_a_metre_and_a_nanometre_have_the_same_digits(method: str) -> None:
    small = 2.0**-30
    potential = -sp.cos(x) - small**2 * sp.cos(y / sp.Rational(1, 2**30))
    pair = lg.System(kinetic=plain(x, y), potential=potential, coordinates=[x, y], initial={x: 2.0, y: 2 * small})
    result = lg.integrate(pair.compile(), (0.0, 20.0), {}, method=method, rtol=1e-6)
    assert result[y] / small == pytest.approx(result[x], abs=1e-12)


PUSHES = {
    "by a place": sp.Piecewise((1, y < 0), (0, True)),
    "by a speed": sp.Piecewise((1, y.dot < -sp.Rational(1, 2)), (0, True)),
    "by a place, smoothly": 1 + sp.tanh(-100 * (y + sp.Rational(1, 2))),
    "in time, smoothly": 1 + sp.tanh(100 * (t - 5)),
}


@pytest.mark.few(1)
@pytest.mark.parametrize("method", [*ADAPTIVE, "scipy-dop853", "scipy-lsoda"])
@pytest.mark.parametrize("push", PUSHES.values(), ids=PUSHES)
def test_a_push_that_something_else_sets_off_is_met(method: str, push: Any) -> None:
    pair = lg.System(
        kinetic=plain(x, y), potential=(x**2 + y**2) / 2, coordinates=[x, y], initial={y: 1.0}, forces={x: push}
    )
    model, span = pair.compile(), (0.0, 12.0)
    result = lg.integrate(model, span, {}, method=method, rtol=1e-7, max_steps=50_000)
    right = lg.integrate(model, span, {}, method=method, rtol=1e-9, atol=1e-11, max_steps=50_000)
    assert result.status is lg.Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(right.y[:, -1], abs=1e-4)


def sizes(system: lg.System, left: float) -> tuple[Any, Any, float]:
    model = system.compile()
    state = np.array(model.statement.initial, dtype=float)
    slopes = slopes_of(model, model.parameter_array(None))
    return entry_sizes(slopes, model.equations.layout, 0.0, state, left, [(0.0, state)])


ORBIT, WELL = lambda k: -k / sp.sqrt(x**2 + y**2), lambda k: k * ((1 - x**2) ** 2 + x**2 * y**2) / 4


@pytest.mark.parametrize(("potential", "start"), [
    (ORBIT, (0.1, 0.0, 0.0, 4.0)),
    (WELL, (1.0, 0.0, 0.0, 0.0)),  # at rest in the well: no velocity has a size
    (WELL, (1.0, 0.0, 0.0, 0.3)),
])  # fmt: skip
def test_sizes_are_the_same_in_slow_and_fast_units_of_time(potential: Any, start: tuple[float, ...]) -> None:
    k = lg.parameters("k")
    model = lg.System(kinetic=plain(x, y), potential=potential(k), coordinates=[x, y]).compile()

    def in_units_of(second: float) -> Any:
        one = np.array([1.0, 1.0, 1 / second, 1 / second])
        law = slopes_of(model, model.parameter_array({k: second**-2}))
        state = np.array(start) * one
        result, owed, period = entry_sizes(law, model.layout, 0.0, state, 7 * second, [(0.0, state)])
        return [*(result / one), *(owed / one), period / second]

    plainly = in_units_of(1.0)
    assert plainly[-1] < 1.0
    for power in (-60, -20, 10, 20, 60):
        assert in_units_of(2.0**power) == pytest.approx(plainly, rel=1e-6), power


# --- noisy entries --------------------------------------------------------------------------------------------
# Systems at rest but for one entry: the rounding noise of the others does not make the steps short.

Case = tuple[lg.System, Mapping[Any, float], float]


def random_chain(random: Random) -> Case:
    """Three to seven hanging links in relative or absolute angles, with one angle or rate that is not zero."""
    angles, joint = lg.coordinates(" ".join(f"a{i}" for i in range(random.randint(3, 7)))), random.random() < 0.5
    kinetic, potential, vx, vy, height, angle, rate = [0] * 7
    for a in angles:
        angle, rate, m, r = (angle + a, rate + a.dot, *random_pair(random)) if joint else (a, a.dot, 1, 1)
        vx, vy, height = vx + r * rate * cos(angle), vy + r * rate * sin(angle), height - r * cos(angle)
        kinetic, potential = kinetic + m * (vx**2 + vy**2) / 2, potential + 9.81 * m * height
    return lg.System(kinetic, potential), displaced(random, angles), 1.0


def random_pair(random: Random) -> tuple[float, float]:
    """Return a mass and a length."""
    return random.uniform(0.5, 2), random.uniform(0.5, 1.5)


def displaced(random: Random, coordinates: Sequence[Any]) -> dict[Any, float]:
    """Return a start with one entry that is not zero."""
    q = random.choice(coordinates)
    return {random.choice([q, q.dot]): random.uniform(0.2, 1)}


def random_lattice(random: Random) -> Case:
    """Up to thirty masses in a line with springs of one of three laws."""
    places = lg.coordinates(" ".join(f"q{i}" for i in range(random.randint(8, 30))))
    laws: list[Callable[[Any], Any]] = [lambda d: exp(d) - d, lambda d: d**2 / 2 + d**4 / 4, lambda d: 1 - cos(d)]
    law = random.choice(laws)
    return (
        lg.System(sum(q.dot**2 for q in places) / 2, sum(law(a - b) for a, b in pairwise(places))),
        displaced(random, places),
        2.0,
    )


def random_rods(random: Random) -> Case:
    """Two to five masses on rods that hang straight, in Cartesian coordinates, the last one pushed."""
    count = random.randint(2, 5)
    xs, ys = (lg.coordinates(" ".join(f"{name}{i}" for i in range(count))) for name in "xy")
    lengths, start, below = [random.uniform(0.5, 1.5) for _ in xs], {}, 0.0
    for y, length in zip(ys, lengths, strict=True):
        below -= length
        start[y] = below
    ends = pairwise([(0, 0), *zip(xs, ys, strict=True)])
    rods = [sum((a - b) ** 2 for a, b in zip(*pair, strict=True)) - r**2 for pair, r in zip(ends, lengths, strict=True)]
    kinetic = sum(q.dot**2 for q in (*xs, *ys)) / 2
    return lg.System(kinetic, 9.81 * sum(ys), constraints=rods, initial=start), {**start, xs[-1].dot: 0.5}, 1.0


def steps_by_default(case: Case, method: str) -> tuple[int, int]:
    """Return the numbers of trial steps of a default run, and of a run with an absolute tolerance for the displacement.

    Their end states may differ by the sum of all tolerances: 1e-9 of the largest entry for each trial step. Measured
    differences are at most 1 % of this limit (LSODA); dop853 has 0.3 %.
    """
    system, start, end = case
    model, size = system.compile(), max(map(abs, start.values()))
    free = lg.integrate(model, (0.0, end), start, method=method, max_steps=20_000)
    good = lg.integrate(model, (0.0, end), start, method=method, atol=1e-12 * size)
    tries, fewest = (run.steps + run.trajectory.rejected for run in (free, good))
    assert free.status is lg.Status.SUCCESS
    assert np.abs(free.y[:, -1] - good.y[:, -1]).max() < (tries + fewest) * 1e-9 * np.abs(good.y).max()
    return tries, fewest


KINDS = (random_chain, random_lattice)

MOST = {"taylor": 1.5, "dop853": 2.5, "verner9": 2.5, "scipy-dop853": 2.5}
"""Most tries as a multiple of those with a good `atol`; other methods have 3.5, and `FEW` 1.5 except on lattices.

In lattices entries grow from rounding to order one like a power of time. By default each keeps the digits that doubles
hold, which takes as many steps as an `atol` of 1e-16 of the displacement: at most 1.11 times with taylor, dop853, tsit5
and radau5. Against 1e-12 these four take up to 1.29, 2.25, 2.68 and 2.95 times in lattices, else up to 1.21, 1.29, 1.41
and 1.47, and against 1e-8, which drops digits, up to 12 times. Gauss methods take equal steps.
"""

FEW = ("dop853", "tsit5")
"""Methods measured with all seeds."""

OTHERS = [
    pytest.param(name, marks=pytest.mark.slow)
    for name in ("verner9", "scipy-dop853", "tsit5", "dopri5", "radau5", "scipy-lsoda", "scipy-rk45")
]


@pytest.mark.parametrize("method", ["taylor", "dop853", *OTHERS])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed != 2)) for seed in range(6)])
def test_random_systems_at_rest_but_for_one_entry(kind: Callable[[Random], Case], method: str, seed: int) -> None:
    tries, fewest = steps_by_default(kind(Random(seed)), method)
    most = 1.5 if method in FEW and kind is not random_lattice else MOST.get(method, 3.5)
    assert tries <= most * fewest + 2


@pytest.mark.parametrize(("method", "most"), [("taylor", 1.5), ("dop853", 2.0)])
@pytest.mark.parametrize("seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed != 2)) for seed in range(6)])
def test_constraints_have_the_noise_of_what_they_cancel(seed: int, method: str, most: float) -> None:
    """taylor took up to 27 times as many steps, because the noise of G a = -gamma was ignored."""
    tries, fewest = steps_by_default(random_rods(Random(seed)), method)
    assert tries <= most * fewest + 2


def test_the_message_names_the_entry_that_limits_the_step() -> None:
    """Before, the message advised a larger max_steps, or radau5."""
    x, y = lg.coordinates("x y")
    system = lg.System((x.dot**2 + y.dot**2) / 2, (x**2 + 1e6 * y**2) / 2, initial={x: 1, y: 1e-20})
    result = system.run(100.0, method="dop853", max_steps=200)
    assert result.status is lg.Status.MAX_STEPS and "because y limits the step: it is" in result.message
    assert "Give atol = 1e-12, which needs fewer digits of y, or raise max_steps." in result.message
    plain = system.run(100.0, {y: 1e-3}, method="dop853", max_steps=200)
    assert "limits the step" not in plain.message
