"""Mechanisms with constraints against numbers that others have published."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.trajectory.run import flow
from tests.mechanisms.ladder import four_bar_ladder, parallelogram_acceleration
from tests.models import loaded


def compiled(name: str) -> Model:
    return model_of(loaded(name), machine("llvm"))


def end(name: str) -> Any:
    """Return the state at the end of a scene's run."""
    run: Any = flow(compiled(name), rtol=1e-13, atol=1e-15)
    return run(np.array(loaded(name).initial), 0.0, loaded(name).run.t_end)


# F. Mazzia, C. Magherini, Test Set for Initial Value Problem Solvers (2008), problem Andrews' squeezing mechanism:
# states at t = 0.03 by PSIDE on a Cray C90 at tolerances of 1e-14. There M a = f - G^T lambda, so lambda is ours with
# the other sign.
ANDREWS_END = (
    *(0.1581077119629904e2, -0.1575637105984298e2, 0.4082224013073101e-1, -0.5347301163226948),
    *(0.5244099658805304, 0.5347301163226948, 0.1048080741042263e1),
    *(0.1139920302151208e4, -0.1424379294994111e4, 0.1103291221937134e2, 0.1929337464421385e2),
    *(0.5735699284790808, -0.1929337464421385e2, 0.3231791658026955),
)
ANDREWS_FIRST_ACCELERATIONS = (14222.4439199541138705911625887, -10666.8329399655854029433719415, 0, 0, 0, 0, 0)
ANDREWS_FIRST_MULTIPLIERS = (98.5668703962410896057654982170, -6.12268834425566265503114393122, 0, 0, 0, 0)
ANDREWS_LAST_ACCELERATIONS = (
    *(-0.2463176316945196e5, 0.5185037701610329e5, 0.3241025686413781e6, 0.5667493645176213e6),
    *(0.1674362929479361e5, -0.5667493645176222e6, 0.9826520791458422e4),
)
ANDREWS_LAST_MULTIPLIERS = (
    *(0.1991753333731910e3, -0.2975531228015052e2, 0.2306654119098399e2),
    *(0.3145271365475927e2, 0.2264249232082739e2, 0.1161740700019673e2),
)


def test_the_seven_body_mechanism_begins_as_published() -> None:
    model, start = compiled("seven-body-mechanism"), np.array(loaded("seven-body-mechanism").initial)
    found = model.accelerations(start[:7], start[7:])
    assert found == pytest.approx(ANDREWS_FIRST_ACCELERATIONS, rel=1e-13, abs=1e-9)
    pulls = model.multipliers(start[:7], start[7:])
    assert -pulls == pytest.approx(ANDREWS_FIRST_MULTIPLIERS, rel=1e-13, abs=1e-11)


def test_the_seven_body_mechanism_ends_as_published() -> None:
    """The published velocities are off their own constraints by 1e-9, which bounds the digits of the velocities.

    Our end states by taylor, dop853 and verner9 differ among themselves by less than 1e-12.
    """
    model, found = compiled("seven-body-mechanism"), end("seven-body-mechanism")
    last = np.array(ANDREWS_END)
    assert np.abs(model.evaluate("constraints", last[:7], last[7:])[6:]).max() > 5e-10
    assert found[:7] == pytest.approx(last[:7], rel=0, abs=2e-9)
    assert found[7:] == pytest.approx(last[7:], rel=1e-7, abs=0)
    accelerations = model.accelerations(last[:7], last[7:])
    assert accelerations == pytest.approx(ANDREWS_LAST_ACCELERATIONS, rel=0, abs=3e-7 * 5.7e5)
    assert -model.multipliers(last[:7], last[7:]) == pytest.approx(ANDREWS_LAST_MULTIPLIERS, rel=0, abs=3e-7 * 200)


def test_the_slider_crank_ends_as_published() -> None:
    """Five digits of idasSlCrank_dns in SUNDIALS, run there at a tolerance of 1e-6."""
    q, x, p = end("slider-crank")[:3]
    assert (q, x, p) == pytest.approx((1.2757, 1.0236, -0.49881), abs=5.1e-5)


def test_the_ladder_of_four_bars_starts_as_its_reduction_says() -> None:
    """One degree of freedom: all rods that turn are parallel."""
    model, start = compiled("four-bar-ladder"), np.array(loaded("four-bar-ladder").initial)
    for angle in (1.2, 0.7, 0.3):
        sine, cosine = np.sin(angle), np.cos(angle)
        q = np.array([[i + cosine, sine] for i in range(3)]).ravel()
        v = -1.5 * np.array([[-sine, cosine]] * 3).ravel()
        turn = parallelogram_acceleration(2, angle)
        expected = np.array([[-sine * turn - cosine * 2.25, cosine * turn - sine * 2.25]] * 3).ravel()
        assert model.accelerations(q, v) == pytest.approx(expected, rel=1e-11, abs=1e-11), angle
    assert start[1] == 1.0


def test_the_ladder_of_two_loops_is_the_scene() -> None:
    """The generator for any number of loops, at two, gives the scene of the library."""
    made, scene = model_of(four_bar_ladder(2), machine("llvm")), compiled("four-bar-ladder")
    start = np.array(loaded("four-bar-ladder").initial)
    assert np.array(made.statement.initial) == pytest.approx(start)
    assert made.accelerations(start[:6], start[6:]) == pytest.approx(
        scene.accelerations(start[:6], start[6:]), abs=1e-12
    )
    assert made.multipliers(start[:6], start[6:]) == pytest.approx(scene.multipliers(start[:6], start[6:]), abs=1e-12)


@pytest.mark.parametrize(("method", "rtol"), [("taylor", 1e-8), ("dop853", 1e-9)])
def test_the_ladder_passes_where_its_rods_lie_in_one_line_as_published(method: str, rtol: float) -> None:
    """B0 at t = 10, after several passages: EXUDYN with steps of 1.25e-4, and its one degree of freedom by DOP853."""
    run: Any = flow(compiled("four-bar-ladder"), method=method, rtol=rtol)
    found = run(np.array(loaded("four-bar-ladder").initial), 0.0, 10.0)
    x, y, x_rate, y_rate = found[[0, 1, 6, 7]]
    assert (x, y, x_rate, y_rate) == pytest.approx((0.3284573768, 0.9445187937, 1.423050003, -0.4948670827), abs=5e-6)
    reduced = (0.32845811153906, 0.94451853817921, 1.42305147020307, -0.49486884548273)
    assert (x, y, x_rate, y_rate) == pytest.approx(reduced, abs=1e-6)
