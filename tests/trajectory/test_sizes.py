"""Absolute tolerances that follow the scale: what is small by itself, what is round-off, and what has no size yet."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.sizes import entry_sizes, slopes_of
from tests.trajectory.runs import ADAPTIVE

x, y, z, a, b, c = lg.coordinates("x y z a b c")
t = lg.t


@cache
def compiled(build: Callable[..., lg.System], *given: float) -> Model:
    """Return the model of a system that a function states, one for all methods."""
    return build(*given).compile()


def plain(*coordinates: Any) -> Any:
    return sum(q.dot**2 for q in coordinates) / 2


def three_bodies(off: float) -> lg.System:
    """Three bodies in a row that turn about the middle one; the forces on that one cancel, all but its offset."""
    apart = [((a, x), (b, y)), ((c, z), (b, y)), ((a, x), (c, z))]
    potential = -sum(1 / sp.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2) for p, q in apart)
    start = {a: 1.0, b: off, c: -1.0, x.dot: 1.1, z.dot: -1.1}
    return lg.System(
        kinetic=plain(a, b, c, x, y, z), potential=potential, coordinates=[a, b, c, x, y, z], initial=start
    )


def chain(count: int) -> lg.System:
    """Equal masses on springs that stiffen, of which the first is plucked."""
    q = lg.coordinates(" ".join(f"q{i}" for i in range(count)))
    springs = [*pairwise(q)]
    potential = sum((p - r) ** 2 / 2 + (p - r) ** 4 / 8 for p, r in springs) + (q[0] ** 2 + q[-1] ** 2) / 2
    return lg.System(kinetic=plain(*q), potential=potential, coordinates=q, initial={q[0]: 1.0})


def steps(model: Any, end: float, method: str, **options: Any) -> int:
    found = lg.integrate(model, (0.0, end), {}, method=method, rtol=1e-6, max_steps=20_000, **options)
    assert found.status is lg.Status.SUCCESS, found.message
    return int(found.steps)


@pytest.mark.parametrize("method", ADAPTIVE)
def test_a_metre_and_a_nanometre_have_the_same_digits(method: str) -> None:
    small = 2.0**-30
    potential = -sp.cos(x) - small**2 * sp.cos(y / sp.Rational(1, 2**30))
    pair = lg.System(kinetic=plain(x, y), potential=potential, coordinates=[x, y], initial={x: 2.0, y: 2 * small})
    found = lg.integrate(pair.compile(), (0.0, 20.0), {}, method=method, rtol=1e-6)
    assert found[y] / small == pytest.approx(found[x], abs=1e-12)


@pytest.mark.parametrize("off", [0.0, 6e-17, 1e-13, 1e-10])
@pytest.mark.parametrize("method", ADAPTIVE)
def test_round_off_of_forces_that_cancel_does_not_shorten_steps(method: str, off: float) -> None:
    model = compiled(three_bodies, off)
    assert steps(model, 10.0, method) <= 1.5 * steps(model, 10.0, method, atol=1e-9) + 100


@pytest.mark.few
@pytest.mark.parametrize("method", ADAPTIVE)
def test_what_has_not_begun_to_move_does_not_shorten_steps(method: str) -> None:
    model = compiled(chain, 24)
    assert steps(model, 20.0, method) <= 1.1 * steps(model, 20.0, method, atol=1e-9)


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize("system", [three_bodies(0.0), three_bodies(6e-17), chain(12)])
def test_both_machines_take_the_same_steps(method: str, system: lg.System) -> None:
    # The order of a series follows its cost, which is another on every machine.
    chosen = lg.methods.Taylor(order=12) if method == "taylor" else method
    here, there = (
        lg.integrate(system.compile(target=m), (0.0, 3.0), {}, method=chosen, rtol=1e-6) for m in ("llvm", "numpy")
    )
    # Where a force is round-off the first step may follow its last digits, and a few steps the first.
    assert abs(here.steps - there.steps) <= 0.02 * there.steps + 2
    assert here.y[:, -1] == pytest.approx(there.y[:, -1], abs=1e-5)


@pytest.mark.parametrize("method", ADAPTIVE)
def test_a_push_on_what_is_at_rest_is_met(method: str) -> None:
    push = sp.Piecewise((1, t > 5), (0, True))
    spring = lg.System(kinetic=plain(x), potential=x**2 / 2, coordinates=[x], forces={x: push})
    found = lg.integrate(spring.compile(), (0.0, 20.0), {}, method=method, rtol=1e-6)
    assert found.status is lg.Status.SUCCESS and found[x][-1] == pytest.approx(1 - math.cos(15.0), abs=1e-4)


def row(count: int) -> lg.System:
    """Bodies at rest one tenth apart, each with a spring towards the next, and the first of them moves."""
    q = lg.coordinates(" ".join(f"q{i}" for i in range(count)))
    gaps = [p - r - sp.Rational(1, 10) for p, r in pairwise(q)]
    potential = 2 * sum(sp.Piecewise((gap**2, gap > 0), (0, True)) for gap in gaps)
    return lg.System(kinetic=plain(*q), potential=potential, coordinates=q, initial={q[0].dot: 1.0})


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize("count", [2, 12])
def test_what_is_hit_at_rest_is_met(method: str, count: int) -> None:
    model = compiled(row, count)
    assert steps(model, 15.0, method) <= 1.5 * steps(model, 15.0, method, atol=1e-9) + 100


PUSHES = {
    "by a place": sp.Piecewise((1, y < 0), (0, True)),
    "by a speed": sp.Piecewise((1, y.dot < -sp.Rational(1, 2)), (0, True)),
    "by a place, smoothly": 1 + sp.tanh(-100 * (y + sp.Rational(1, 2))),
    "in time, smoothly": 1 + sp.tanh(100 * (t - 5)),
}


@pytest.mark.parametrize("method", [*ADAPTIVE, "scipy-dop853", "scipy-lsoda"])
@pytest.mark.parametrize("push", PUSHES.values(), ids=PUSHES)
def test_a_push_that_something_else_sets_off_is_met(method: str, push: Any) -> None:
    pair = lg.System(
        kinetic=plain(x, y), potential=(x**2 + y**2) / 2, coordinates=[x, y], initial={y: 1.0}, forces={x: push}
    )
    model, span = pair.compile(), (0.0, 12.0)
    found = lg.integrate(model, span, {}, method=method, rtol=1e-7, max_steps=50_000)
    right = lg.integrate(model, span, {}, method=method, rtol=1e-9, atol=1e-11, max_steps=50_000)
    assert found.status is lg.Status.SUCCESS, found.message
    assert found.y[:, -1] == pytest.approx(right.y[:, -1], abs=1e-4)


def sizes(system: lg.System, left: float) -> tuple[Any, Any, float]:
    model = system.compile()
    state = np.array(model.statement.initial, dtype=float)
    slopes = slopes_of(model, model.parameter_array(None))
    return entry_sizes(slopes, model.equations.layout, 0.0, state, left, [(0.0, state)])


@pytest.mark.parametrize("left", [10.0, 1e5, -1e3])
def test_sizes_are_those_of_the_motion_whatever_the_span_is(left: float) -> None:
    kicked = lg.System(kinetic=plain(x), potential=-4 * sp.cos(x), coordinates=[x], initial={x.dot: 1e-5})
    found, _, period = sizes(kicked, left)
    assert 0.1 < period < 1.0 and found == pytest.approx([period * 1e-5, 1e-5])
    handed, _, _ = sizes(chain(20), left)
    assert handed.min() > 1e-9 and handed.max() < 10


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
        found, owed, period = entry_sizes(law, model.layout, 0.0, state, 7 * second, [(0.0, state)])
        return [*(found / one), *(owed / one), period / second]

    plainly = in_units_of(1.0)
    assert plainly[-1] < 1.0
    for power in (-60, -20, 10, 20, 60):
        assert in_units_of(2.0**power) == pytest.approx(plainly, rel=1e-6), power


def test_what_cancels_owes_its_size_to_the_rest() -> None:
    _, owed, _ = sizes(three_bodies(0.0), 10.0)
    assert 0.1 < owed[1] < 10 and 0.1 < owed[7] < 10


def test_what_never_moves_has_no_size() -> None:
    flat = lg.System(kinetic=plain(x, y), potential=x**2 + y**2 * x**2, coordinates=[x, y], initial={x: 1.0})
    found, owed, _ = sizes(flat, 10.0)
    assert found[1] == found[3] == owed[1] == owed[3] == 0
