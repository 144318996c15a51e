"""States with a rate and no inertia: their rate is the force, and Rayleigh's function has half of its square."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.statement.scene.scene_reader import scene_from_text
from tests.models import TARGETS, k, m, x, y, z

e = lg.coordinate("e")


def relaxation(**given: Any) -> lg.System:
    return lg.System(kinetic=0, coordinates=[e], forces={e: 1 - e}, dissipation=e.dot**2 / 2, **given)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_a_filter_relaxes(method: str, target: str) -> None:
    solution = relaxation().run(2.0, method=method, target=target, rtol=1e-10)
    # The tolerance of a step times the few steps of the run.
    assert solution[e][-1] == pytest.approx(1 - np.exp(-2.0), abs=1e-8)


def test_the_check_holds() -> None:
    report = relaxation().check(points=2)
    assert report, str(report)


def test_a_force_and_a_constraint_state_the_same_lorenz_system() -> None:
    rates = {x: 10 * (y - x), y: x * (28 - z) - y, z: x * y - 8 * z / 3}
    drag = (x.dot**2 + y.dot**2 + z.dot**2) / 2
    start = {x: 1.0, y: 1.0, z: 1.0}
    by_force = lg.System(kinetic=0, coordinates=[x, y, z], forces=rates, dissipation=drag, initial=start)
    held = [q.dot - rate for q, rate in rates.items()]
    by_constraint = lg.System(kinetic=0, coordinates=[x, y, z], constraints=held, initial=start)

    def by_hand(_: float, s: Any) -> list[float]:
        return [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 * s[2] / 3]

    expected = solve_ivp(by_hand, (0, 2), [1.0, 1.0, 1.0], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    # Errors of 1e-13 grow by less than 1e4 in this time.
    assert by_force.run(2.0, rtol=1e-12).y[:3, -1] == pytest.approx(expected, abs=1e-8)
    start_on = by_constraint.consistent().initial
    assert by_constraint.run(2.0, start_on, rtol=1e-12).y[:3, -1] == pytest.approx(expected, abs=1e-8)


def test_a_scene_may_have_them() -> None:
    text = 'coordinates = ["e"]\nkinetic = "0"\ndissipation = "e_dot**2/2"\n[forces]\ne = "1 - e"\n'
    system = lg.System.from_statement(scene_from_text(text))
    assert system.run(2.0)[e][-1] == pytest.approx(1 - np.exp(-2.0), abs=1e-7)


@pytest.mark.parametrize("given", [{"forces": {y: 1 - y}}, {"kinetic": m, "dissipation": k * y.dot**2 / 2}])
def test_the_refusal_says_how_to_state_them(given: dict[Any, Any]) -> None:
    with pytest.raises(StatementError, match=r"force on it and y\.dot\*\*2/2 as dissipation") as raised:
        lg.System(**{"kinetic": 0, "coordinates": [y], **given})
    assert len(str(raised.value)) <= 400
