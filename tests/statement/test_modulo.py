"""Mod in a statement: the remainder, its derivative between jumps, and runs that pass its jumps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg

x = lg.coordinate("x")
m, k = lg.parameters("m k")
SAW: Any = x % 2 - 1


def rolling() -> lg.System:
    """Return a mass in a potential of period 2: a parabola about each even integer."""
    return lg.System(
        m * x.dot**2 / 2, k * SAW**2 / 2, parameters={m: 1, k: 3}, initial={x: 0.3, x.dot: 2.5}, name="rolling"
    )


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("place", [-7.7, -0.2, 0.4, 1.9, 11.5])
def test_a_force_is_that_of_the_remainder(place: float, target: str) -> None:
    model = rolling().compile(target)
    # Some roundings of the angle, 2 pi x/2, and of its sine.
    expected = -3 * (math.fmod(math.fmod(place, 2) + 2, 2) - 1)
    assert model.accelerations([place], [0.0])[0] == pytest.approx(expected, rel=1e-12, abs=1e-13)
    assert model.jacobian(0.0, [place, 0.0])[1, 0] == pytest.approx(-3, rel=1e-12)


@pytest.mark.parametrize(("dividend", "divisor"), [(7.25, 3), (-7.25, 3), (7.25, -3), (-7.25, -3), (0.5, 1.5)])
def test_the_sign_is_that_of_the_divisor(dividend: float, divisor: float) -> None:
    system = lg.System(m * x.dot**2 / 2, 0, forces={x: sympy.Mod(x, sympy.Float(divisor))}, parameters={m: 1})
    result = system.compile("numpy").accelerations([dividend], [0.0])[0]
    assert result == pytest.approx(dividend % divisor, rel=1e-13)


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_a_run_passes_the_jumps_of_its_force(method: str) -> None:
    run = rolling().run(6.0, method=method, rtol=1e-10)
    assert run.status is lg.Status.SUCCESS
    assert run[x][-1] > 10
    energies = run[x.dot] ** 2 / 2 + 3 * (np.mod(run[x], 2) - 1) ** 2 / 2
    # A step across a jump of the force is repeated until its error is within the tolerance.
    np.testing.assert_allclose(energies, energies[0], rtol=1e-7)


def test_remainders_of_remainders_and_their_derivatives_are_written_out() -> None:
    inner: Any = sympy.Mod(sympy.Mod(x, 5) + x, 2)
    system = lg.System(m * x.dot**2 / 2, 0, forces={x: inner + sympy.Mod(x, 3).diff(x)}, parameters={m: 1})
    assert system.check()
    result = system.compile("numpy").accelerations([7.3], [0.0])[0]
    assert result == pytest.approx((7.3 % 5 + 7.3) % 2 + 1, rel=1e-12)


def test_a_scene_file_says_mod(tmp_path: Path) -> None:
    path = tmp_path / "rolling.toml"
    rolling().to_scene(path)
    again = lg.System.from_scene(path)
    text = 'name = "rolling"\ncoordinates = ["x"]\nkinetic = "x_dot**2/2"\npotential = "3*(mod(x, 2) - 1)**2/2"\n'
    path.write_text(text)
    for system in (again, lg.System.from_scene(path)):
        assert system.compile("numpy").accelerations([0.4], [0.0])[0] == pytest.approx(1.8, rel=1e-12)


THROW = 1.4
"""Speed at x = 1/2 of a body under the force Mod(x, 1) - 1: it passes two jumps, and turns."""


n = lg.parameters("n", positive=False)


def thrown(force: Any) -> lg.System:
    start = {x: 0.5, x.dot: THROW}
    return lg.System(m * x.dot**2 / 2, 0, forces={x: force}, parameters={m: 1, n: 0}, initial=start)


def check_there_and_back(run: lg.Solution, close: float) -> None:
    """Assert a row at each jump, the right energy steps, and the return to the start in a run backwards."""
    assert run.status is lg.Status.SUCCESS
    v = run[x.dot]
    upwards = v > 0
    for jump in (1, 2):
        for part in (run[x][upwards], run[x][~upwards]):
            assert np.abs(part - jump).min() < 1e-13
    whole = np.floor(run[x])
    energy = v**2 / 2 - (whole / 2 + (run[x] - whole) ** 2 / 2) + run[x]
    np.testing.assert_allclose(energy, energy[0], atol=close)
    (top,) = run.t_events[0]
    assert run.at(2 * top) == pytest.approx([0.5, -THROW], abs=close)


def test_taylor_ends_a_step_on_each_jump() -> None:
    run = thrown(sympy.Mod(x, 1) - 1).run(5.5, rtol=1e-13, events=[x.dot])
    check_there_and_back(run, 1e-11)
