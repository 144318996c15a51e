"""Steady rotations of a body: turns about an axis of space, and precessions, against closed forms."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import diag

import lagrange as lg

R = lg.rotation("R")
m, g, a, J1, J3 = lg.parameters("m g a J1 J3")
VALUES = {m: 1, g: 9.81, a: 0.1, J1: 0.02, J3: 0.01}


def body(moments: Any, potential: Any = 0, **more: Any) -> lg.System:
    return lg.System(R.body.dot(diag(*moments) * R.body) / 2, potential, **more)


def rates(result: Any) -> list[float]:
    return [float(result.velocities.get(rate, 0)) for rate in R.body]


def test_a_free_body_turns_about_its_principal_axes() -> None:
    """Both ways about each, with the energy J w^2/2; the middle axis alone is unstable."""
    result = body((1, 2, 3)).equilibria({R.space[2]: 1.5})
    assert sorted(map(rates, result)) == sorted(
        [s * 1.5 * (k == i) for i in range(3)] for k in range(3) for s in (1, -1)
    )
    for each in result:
        axis = int(np.argmax(np.abs(rates(each))))
        assert float(each.energy) == (1 + axis) * 1.5**2 / 2
        assert each.stable is (axis != 1)


@pytest.mark.slow
def test_a_heavy_top_hangs_stands_or_leans() -> None:
    """It leans at cos(tilt) = -m g a/((J1 - J3) w^2), and stands if J3^2 w^2 > 4 m g a J1 (Landau, section 35)."""
    top = body((J1, J1, J3), m * g * a * R[2, 2], parameters=VALUES)
    hanging, upright, leaning = top.equilibria({R.space[2]: 100})
    assert [each.stable for each in (hanging, upright, leaning)] == [True] * 3
    limit = J3**2 * 100**2 / (4 * J1) - m * g * a
    assert sympy.simplify(upright.criterion[0] - limit) == 0
    w, x, *_ = leaning.coordinates.values()
    assert sympy.simplify(w**2 - x**2 + m * g * a / ((J1 - J3) * 100**2)) == 0
    assert leaning.condition != sympy.true


@pytest.mark.parametrize("axis", [2, pytest.param(0, marks=pytest.mark.slow)])
def test_both_rates_of_precession_at_a_tilt(axis: int) -> None:
    """They are the roots of J1 cos(tilt) W^2 - J3 w W + m g a, for an axis of symmetry z or x of the body."""
    attitude, spin = lg.turn((0.3, 0.2, 0.5), 2.5), 10.0
    top = body([0.5 if k == axis else 1 for k in range(3)], R[2, axis])
    result = top.equilibria({R: attitude, R.body[axis]: spin})
    matrix = top.run(0.01, {R: attitude})[R][0]
    tilt = np.arccos(matrix[2, axis])
    roots = np.sort(np.abs(np.roots([np.cos(tilt), -0.5 * spin, 1])))
    across = sorted(np.linalg.norm(np.delete(rates(each), axis)) / np.sin(tilt) for each in result)
    assert across == pytest.approx(roots, rel=1e-12)
    for each in result:
        assert each.stable
        path = top.run(1.0, each.at, rtol=1e-13)[R][:, 2, axis]
        assert np.abs(path - np.cos(tilt)).max() < 1e-12


def test_a_free_symmetric_body_precesses_or_spins_about_a_fixed_axis() -> None:
    """It precesses at the rate J3 w/(J1 cos(tilt)). Without a precession its axis stays where it is."""
    found = body((1, 1, 2)).equilibria({R: lg.turn(lg.x, 0.5), R.body[2]: 3})
    assert [each.stable for each in found] == [True, True]
    np.testing.assert_allclose([rates(each) for each in found], [(0, 0, 3), (0, 6 * np.tan(0.5), 3)], rtol=1e-14)


@pytest.mark.slow
def test_a_body_on_a_spring_turns_with_its_spring_stretched() -> None:
    """The spring and the pull of the body, x (R z)_z, balance at x = -(R z)_z / 2."""
    x = lg.coordinate("x")
    kinetic = R.body.dot(diag(1, 1, 0.25) * R.body) / 2 + x.dot**2 / 2
    result = lg.System(kinetic, x**2 + x * R[2, 2]).equilibria({R.space[2]: 1})
    w, i, j, k = (np.array([float(each.coordinates[q]) for each in result]) for q in R.quaternion)
    assert [float(each.coordinates[x]) for each in result] == pytest.approx(-(w**2 - i**2 - j**2 + k**2) / 2)


@pytest.mark.parametrize(("missing", "count"), [(0.0, 1), (1e-10, 2), (1e-14, 2)])
def test_a_horizontal_top_precesses_at_m_g_a_over_its_momentum(missing: float, count: int) -> None:
    """The other root has the factor of the cosine of the tilt in its denominator, and goes to infinity."""
    top = body((1, 1, 0.5), R[2, 2] / 2)
    result = top.equilibria({R: lg.turn(lg.x, np.pi / 2 - missing), R.body[2]: 100})
    assert len(result) == count
    # m g a = 1/2, J3 w = 50; the slow root differs from their ratio by the relative amount of `missing`.
    assert min(abs(np.linalg.norm(rates(each)[:2])) for each in result) == pytest.approx(0.01, rel=1e-9)


S, y = lg.rotation("S"), lg.coordinate("y")
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "two rates": (lambda: body((1, 2, 3)).equilibria({R.space: (0, 1, 2)}), "no steady motion of R: give {R.space"),
    "a spin under a drag": (
        lambda: body((1, 1, 2), dissipation=R.body.dot(R.body), forces={R.body: (0, 0, 1)}).equilibria(),
        "the forces on R are not solved",
    ),
    "a spin alone": (lambda: body((1, 2, 3)).equilibria({R.body[2]: 2}), r"or {R: attitude, R.body\[2\]: w}"),
    "no vertical": (lambda: body((1, 2, 3), R[2, 2]).equilibria({R.space[0]: 1}), "steadily about the axis x of space"),
    "a drag": (
        lambda: body((1, 2, 3), dissipation=R.body.dot(R.body)).equilibria({R.space[2]: 1}),
        "forces or drags act about this axis",
    ),
    "no symmetry": (
        lambda: body((1, 2, 3)).equilibria({R: lg.turn(lg.x, 1), R.body[2]: 2}),
        "no steady precession: forces or drags act about its axis z and",
    ),
    "upright": (
        lambda: body((1, 1, 0.5), R[2, 2]).equilibria({R: lg.turn(lg.z, 1), R.body[2]: 2}),
        "axis z of R lies along axis z of space at this attitude",
    ),
    "too slow": (
        lambda: body((1, 1, 0.5), R[2, 2]).equilibria({R: lg.turn(lg.x, 0.5), R.body[2]: 2}),
        "no steady precession at this attitude: R spins too slowly",
    ),
    "another unknown": (
        lambda: lg.System(R.body.dot(diag(1, 1, 2) * R.body) / 2 + y.dot**2, y**2 + R[2, 2]).equilibria(
            {R: lg.turn(lg.x, 0.5), R.body[2]: 9}
        ),
        "depend on",
    ),
    "two rotations": (
        lambda: lg.System(R.body.dot(R.body) + S.body.dot(S.body)).equilibria({R.space[2]: 1}),
        "steady rotations are found for one rotation alone",
    ),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_steady_motion_is_refused(case: str) -> None:
    attempt, sentence = REFUSED[case]
    with pytest.raises(lg.StatementError, match=sentence) as refusal:
        attempt()
    assert len(str(refusal.value)) <= 400
