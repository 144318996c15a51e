"""Ensembles: each member equals its single run, whatever the other members do and however they are divided."""

from __future__ import annotations

import re
from functools import cache
from typing import Any, cast

import numpy as np
import pytest

import lagrange as lg
from tests.refusals import refusal
from tests.systems import rod_pendulum

METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-9},
    "dop853": {"rtol": 1e-9},
    "tsit5": {"rtol": 1e-7, "atol": 1e-9},
    "rk4": {"step": 0.01},
    "verlet": {"step": 0.01},
    "radau5": {"rtol": 1e-7},
}
"""Methods that run in lanes, and one that does not."""

SPREAD = 21
"""Members: two vectors of eight and five more, so that lanes run out of members at different times."""


@cache
def system(name: str) -> lg.System:
    return lg.scene(name)


def starts(name: str) -> dict[str, Any]:
    first, value = next(iter(zip(system(name).compile().layout.names(), system(name).statement.initial, strict=False)))
    return {first: value + np.linspace(-0.2, 0.25, SPREAD)}


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["pendulum", "henon-heiles", "double-pendulum"])
def test_a_member_ends_where_a_run_of_its_own_ends(name: str, method: str) -> None:
    """Lanes and single runs differ by rounding, which grows by less than a factor of 100 until t = 3."""
    if (name, method) == ("double-pendulum", "verlet"):
        pytest.skip("its mass matrix changes along the motion")
    initial, settings = starts(name), METHODS[method]
    runs = lg.ensemble(system(name), 3.0, initial, method=method, keep=("end", "counts"), **settings)
    assert set(runs.status) == {lg.Status.SUCCESS} and not runs.messages and (runs.t == 3.0).all()
    key = next(iter(initial))
    for i in (0, 7, 8, SPREAD - 1):
        alone = system(name).run(3.0, {key: initial[key][i]}, method=method, **settings)
        assert np.allclose(runs.y[:, i], alone.y[:, -1], rtol=1e-11, atol=1e-12), (i, runs.y[:, i] - alone.y[:, -1])
        assert runs.steps[i] == alone.steps


def test_parameters_vary_and_outputs_are_those_of_a_run() -> None:
    times = np.array([0.0, 0.1, 0.1, 1.3, 2.0])
    drawn = lg.sample({"l": (0.5, 1.5), "g": (9.0, 10.0)}, 13, seed=3)
    runs = lg.ensemble(system("pendulum"), 2.0, parameters=drawn, t_eval=times)
    assert runs.y.shape == (2, 5, 13)
    for i in (0, 6, 12):
        alone = system("pendulum").run(2.0, parameters={"l": runs["l"][i], "g": runs["g"][i]}, t_eval=times)
        assert np.allclose(runs.y[:, :, i], alone.y, rtol=1e-12, atol=1e-13)


def test_a_member_that_fails_says_why_and_stops_where_a_run_stops() -> None:
    runs = lg.ensemble(system("henon-heiles"), 15.0, {"x": [0.1, 1.0, 0.2]}, t_eval=[1.0, 14.0, 15.0])
    assert [item.value for item in runs.status] == ["success", "step_too_small", "success"]
    alone = system("henon-heiles").run(15.0, {"x": 1.0}, t_eval=[1.0, 14.0, 15.0])
    assert list(runs.messages) == [1] and "singularity there" in runs.messages[1]
    assert repr(runs.messages).startswith("<messages of 1 member, of member 1: taylor stopped at")
    assert runs.messages[1].split(" on the way")[0] == alone.message.split(" on the way")[0]
    assert np.isnan(runs.y[:, 1:, 1]).all() and np.isfinite(runs.y[:, 0, 1]).all()
    assert np.isfinite(runs.y[:, :, [0, 2]]).all()


def test_an_energy_that_moves_is_told_as_in_a_run() -> None:
    settings: dict[str, Any] = {"method": "euler", "step": 0.1}
    runs = lg.ensemble(system("pendulum"), 60.0, {"theta": [0.01, 2.5]}, **settings)
    for i, theta in enumerate((0.01, 2.5)):
        alone = system("pendulum").run(60.0, {"theta": theta}, **settings)
        assert runs.status[i] is alone.status
        assert runs.status[i] is lg.Status.SUCCESS or runs.messages[i] == alone.message


def test_a_grid_is_every_combination_and_a_sample_is_repeated_by_its_seed() -> None:
    runs = lg.ensemble(system("pendulum"), 0.1, lg.grid({"theta": (0.0, 1.0, 3), "l": [1.0, 2.0]}))
    assert runs["l"].tolist() == [1.0, 2.0] * 3 and runs.given("theta").tolist() == [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]
    result = runs.to_xarray()
    assert dict(result.sizes) == {"theta": 3, "l": 2} and result["theta_dot"].dims == ("theta", "l")
    path = lg.ensemble(system("pendulum"), 0.1, lg.grid({"theta": (0.0, 1.0, 3)}), t_eval=[0.0, 0.1]).to_xarray()
    assert path["theta"].dims == ("theta_start", "t")
    assert np.array_equal(path["theta"][:, 0], path["theta_start"]) and path["theta_start"][2] == 1.0
    for method in ("sobol", "latin", "random"):
        first, second, third = (lg.sample({"m": (0.9, 1.1)}, 37, seed=seed, method=method) for seed in (5, 5, 6))
        every = np.arange(37)
        assert np.array_equal(first.values("m", every), second.values("m", every))
        assert not np.array_equal(first.values("m", every), third.values("m", every))
        assert first.values("m", every).min() >= 0.9 and first.values("m", every).max() <= 1.1


@pytest.mark.slow
def test_what_is_kept_has_its_name_and_the_pair_that_it_was_asked_by() -> None:
    x = system("henon-heiles").coordinates[0]
    starts, times = {"x": [0.1, 0.2]}, [0.5, 1.0]
    runs = lg.ensemble(system("henon-heiles"), 1.0, starts, keep=("end", ("max", x.dot), ("mean", "y")))
    assert np.array_equal(runs["max", x.dot], runs["max(x_dot)"])
    assert np.array_equal(runs["mean", "y"], runs["mean(y)"])
    alone = lg.ensemble(system("henon-heiles"), 1.0, starts, keep=("max", "x_dot"))
    assert np.array_equal(alone["max(x_dot)"], runs["max(x_dot)"])
    with pytest.raises(lg.StatementError, match="state was not kept"):
        _ = alone["x_end"]
    outputs = lg.ensemble(system("henon-heiles"), 1.0, starts, t_eval=times)
    for row, name in enumerate(runs.names):
        assert np.array_equal(runs[f"{name}_end"], runs.y[row])
        assert np.array_equal(outputs[f"{name}_end"], outputs.y[row, -1])
    for name, entry in (("drift", '"drift"'), ("rejected", '"counts"'), ("min(x)", '("min", x)')):
        with pytest.raises(lg.StatementError, match=f"{re.escape(name)} was not kept: add {re.escape(entry)} to keep"):
            _ = runs[name]
    with pytest.raises(lg.StatementError, match="'z_end' is not a coordinate"):
        _ = runs["z_end"]


REFUSALS: list[tuple[dict[str, Any], str]] = [
    (
        {"initial": {"theta1": [1.0] * 3, "theta2": [1.0] * 4}},
        "theta1 has 3 values and theta2 has 4 values: give arrays",
    ),
    (
        {"initial": {"theta3": [1.0]}},
        "'theta3' varies, and is not a coordinate, velocity or parameter of double-pendulum",
    ),
    ({"initial": {"theta1": 1.0}}, "no value varies between members"),
    ({"initial": 3}, "initial is 3: give a dict from name to number or array"),
    ({"initial": {"theta1": [1.0]}, "parameters": {"m3": 1.0}}, "'m3' is not a parameter of this system"),
    ({"initial": {"theta1": [1.0]}, "keep": ("ends",)}, "keep has 'ends', which is none of end, counts"),
    (
        {"initial": {"theta1": [1.0]}, "keep": ()},
        'keep is (): give at least one result, such as ("end", ("max", theta)).',
    ),
    ({"initial": {"theta1": [1.0]}, "keep": ("events",)}, "keep has events, and the ensemble has none"),
    ({"initial": {"theta1": [1.0]}, "keep": (("max", lg.coordinate("w")),)}, "contains w(t), which this"),
    (
        {"initial": {"theta1": [1.0]}, "keep": (("median", lg.coordinate("theta1")),)},
        "keep has ('median', theta1), which is none of",
    ),
    (
        {"initial": {"theta1": [1.0]}, "keep": ("max", "theta3")},
        "'theta3' in keep is neither a coordinate nor a velocity; these are theta1, theta2, theta1_dot and theta2_dot.",
    ),
    ({"initial": {"theta1": [1.0]}, "executor": 3, "workers": 2}, "workers and executor are both given"),
    ({"initial": lg.grid({"theta1": (0, 1, 10**6), "theta2": (0, 1, 10**5)})}, 'give store="runs.zarr"'),
    ({"initial": {"theta1": [1.0]}, "step": 0.1}, "taylor chooses its steps by itself"),
    ({"initial": {"theta1": [1.0, 2.0]}, "parameters": {"m1": [1.0]}}, "theta1 has 2 values and m1 has 1 value"),
    (
        {"initial": lg.grid({"theta1": (0, 1, 3)}), "parameters": {"m1": [1.0, 2.0]}},
        "or, for all combinations, one lg.grid(...) of all that varies.",
    ),
]


@pytest.mark.parametrize(("request_", "text"), REFUSALS, ids=[text[:30] for _, text in REFUSALS])
def test_what_cannot_be_meant_is_refused(request_: dict[str, Any], text: str) -> None:
    assert text in refusal(lg.ensemble, system("double-pendulum"), 1.0, **request_)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: lg.grid({}), "axes is empty: give a dict"),
        (lambda: lg.grid({"x": []}), "the axis x is []: give (low, high, count)"),
        (lambda: lg.sample({"x": "wide"}, 3), "the range of x is 'wide': give (low, high), or a distribution"),
        (lambda: lg.sample({"x": (0.0, 1.0)}, 3, method="sobal"), "Did you mean 'sobol'?"),
        (lambda: lg.ensemble(cast(Any, "double-pendulum"), 1.0), "is not a system"),
    ],
)
def test_grids_and_samples_refuse_in_words(make: Any, text: str) -> None:
    assert text in refusal(make)


# --- flows ----------------------------------------------------------------------------------------------------
# Members one after the other of which only the last state is kept: they end as runs do, and fail as runs do.


@pytest.mark.parametrize(("method", "settings"), [("taylor", {"rtol": 1e-9}), ("radau5-index2", {"rtol": 1e-6})])
def test_members_with_constraints_end_where_runs_end(method: str, settings: dict[str, Any]) -> None:
    rod, angles = rod_pendulum(), np.linspace(0.0, 1.5, 5)
    runs = lg.ensemble(rod, 1.0, {"x": np.cos(angles), "y": -np.sin(angles)}, method=method, **settings)
    assert runs.form == "runs one after the other"
    for i, angle in enumerate(angles):
        alone = rod.run(1.0, {"x": np.cos(angle), "y": -np.sin(angle)}, method=method, **settings)
        assert runs.y[:, i].tobytes() == alone.y[:, -1].tobytes(), i
