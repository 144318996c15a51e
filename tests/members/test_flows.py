"""Members one after the other of which only the last state is kept: they end as runs do, and fail as runs do."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import lagrange as lg


@cache
def rod() -> lg.System:
    """Return a pendulum in Cartesian coordinates."""
    x, y = lg.coordinates("x y")
    m, g = lg.parameters("m g")
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints=[x**2 + y**2 - 1],
        parameters={m: 1.0, g: 9.81},
        initial={x: 1.0, y: 0.0},
    )


@cache
def pole() -> lg.System:
    """Return motions towards a wall, which the faster ones reach."""
    x = lg.coordinate("x")
    return lg.System(kinetic=x.dot**2 / 2, potential=-1 / (2 - x), initial={x: 0.0, x.dot: 0.1})


@pytest.mark.parametrize(("method", "settings"), [("taylor", {"rtol": 1e-9}), ("radau5-index2", {"rtol": 1e-6})])
def test_members_with_constraints_end_where_runs_end(method: str, settings: dict[str, Any]) -> None:
    angles = np.linspace(0.0, 1.5, 5)
    runs = lg.ensemble(rod(), 1.0, {"x": np.cos(angles), "y": -np.sin(angles)}, method=method, **settings)
    assert runs.form == "runs one after the other"
    for i, angle in enumerate(angles):
        alone = rod().run(1.0, {"x": np.cos(angle), "y": -np.sin(angle)}, method=method, **settings)
        assert runs.y[:, i].tobytes() == alone.y[:, -1].tobytes(), i


def test_members_that_do_not_get_there_say_why() -> None:
    speeds = [0.05, 3.0, 0.1, 4.0]
    runs = lg.ensemble(pole(), 2.0, {"x_dot": speeds}, method="radau5", rtol=1e-8)
    for i, speed in enumerate(speeds):
        alone = pole().run(2.0, {"x_dot": speed}, method="radau5", rtol=1e-8)
        assert runs.status[i] is alone.status and runs.t[i] == alone.t[-1], i
        assert runs.messages.get(i, "") == ("" if alone.status is lg.Status.SUCCESS else alone.message)
    assert len(set(runs.status)) == 2


def test_parameters_of_each_member_are_its_own() -> None:
    runs = lg.ensemble(rod(), 1.0, parameters={"g": [1.0, 9.81, 20.0]})
    for i, g in enumerate(runs["g"]):
        assert runs.y[:, i].tobytes() == rod().run(1.0, parameters={"g": g}).y[:, -1].tobytes()
