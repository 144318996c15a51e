"""Calls with plain arrays are quick, and whatever else is given takes the way that checks and tells."""

from __future__ import annotations

import gc
import sys
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.machine.model import Model
from tests.models import shared_scene

x, y = lg.coordinates("x y")

TARGETS = ("llvm", "numpy")


def elastic(target: str) -> Model:
    swinging = shared_scene("elastic-pendulum").compile(target=target)
    assert isinstance(swinging, Model)
    return swinging


@pytest.fixture(params=TARGETS)
def model(request: pytest.FixtureRequest) -> Model:
    return elastic(request.param)


STATE = np.array([1.1, 0.4, -0.3, 0.7])


def slow(model: Model, name: str, state: Any = STATE, t: float = 0.0) -> Any:
    return model.kernel(name)(t, np.array(state), model.parameter_array())


def test_what_is_computed_is_the_same(model: Model) -> None:
    q, v = STATE[:2].copy(), STATE[2:].copy()
    assert model._quick["rhs"].whole(0.0, STATE) is not None and model._quick["energy"].parts(0.0, q, v) is not None
    assert np.array_equal(model.rhs(0.0, STATE), slow(model, "rhs"))
    assert np.array_equal(model.jacobian(0.0, STATE), slow(model, "jacobian"))
    assert np.array_equal(model.accelerations(q, v), slow(model, "rhs")[2:])
    assert np.array_equal(model.momenta(q, v), slow(model, "momenta"))
    assert model.energy(q, v) == float(slow(model, "energy")) and type(model.energy(q, v)) is float


@pytest.mark.parametrize(
    "given",
    [
        STATE[::-1][::-1],
        np.repeat(STATE, 2)[::2],
        np.array([*STATE, 9.0])[:4],
        np.column_stack([STATE, STATE])[:, 0],
        np.frombuffer(b"." + STATE.tobytes(), offset=1),
        STATE.astype(">f8"),
        STATE.view(np.matrix).A1,
        STATE.tolist(),
        np.asfortranarray(STATE),
    ],
    ids=["twice reversed", "strided", "a part", "a column", "odd address", "other bytes", "matrix", "list", "fortran"],
)
def test_arrays_of_every_kind(model: Model, given: Any) -> None:
    assert np.array_equal(model.rhs(0.0, given), slow(model, "rhs"))


def test_what_is_given_is_not_changed_and_results_are_new(model: Model) -> None:
    given = STATE.copy()
    given.flags.writeable = False
    first, second = model.rhs(0.0, given), model.rhs(0.0, given)
    assert first is not second and np.array_equal(given, STATE) and first.flags.owndata


def test_batches_and_times_are_as_before(model: Model) -> None:
    many = np.column_stack([STATE, STATE + 0.1])
    assert np.array_equal(model.rhs(0.0, many[:, :1]), model.rhs(0.0, many)[:, :1])
    assert model.rhs(0.0, many)[:, 0] == pytest.approx(slow(model, "rhs"), rel=1e-14)
    assert np.array_equal(model.rhs(0, STATE), model.rhs(np.float64(0.0), STATE))


@pytest.mark.parametrize("wrong", [np.zeros(3), np.zeros(5), np.zeros(0), np.zeros(()), np.zeros((1, 4))])
def test_wrong_shapes_are_told(model: Model, wrong: Any) -> None:
    with pytest.raises(StatementError, match="y has shape"):
        model.rhs(0.0, wrong)
    with pytest.raises(StatementError, match="q has shape"):
        model.energy(wrong, wrong)


@pytest.mark.parametrize("t", [float("nan"), float("inf")])
def test_a_time_that_is_no_number_is_told(model: Model, t: float) -> None:
    with pytest.raises(StatementError, match="time t"):
        model.rhs(t, STATE)


def test_results_without_a_value_come_as_they_are(model: Model) -> None:
    state = np.array([np.nan, 0.4, -0.3, 0.7])
    assert np.isnan(model.rhs(0.0, state)[2:]).any()


def test_other_parameters_do_not_disturb(model: Model) -> None:
    expected = model.rhs(0.0, STATE)
    other = model.rhs(0.0, STATE, {"k": 99.0})
    assert not np.array_equal(other, expected) and np.array_equal(model.rhs(0.0, STATE), expected)


@pytest.mark.parametrize("t", [np.float64(0.25), np.array([0.25])[0]])
def test_times_as_solvers_give_them_are_quick(model: Model, t: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """SciPy adds NumPy's numbers to times, and they are NumPy's from its first step on."""
    expected = slow(model, "rhs", t=0.25), slow(model, "energy", t=0.25)
    monkeypatch.setattr(model, "_run", None)
    assert np.array_equal(model.rhs(t, STATE), expected[0])
    assert model.energy(STATE[:2].copy(), STATE[2:].copy(), t) == expected[1]


def test_quick_calls_are_made_once_for_the_same_parameters(model: Model) -> None:
    kernel, values = model.kernel("rhs"), model.parameter_array()
    assert kernel.quick(values) is kernel.quick(values.copy())
    other = values + 1.0
    for given in (other, values):
        calls = kernel.quick(given)
        assert calls is not None
        found = calls.whole(0.0, STATE)
        assert found is not None and np.array_equal(found, kernel(0.0, STATE, given))


@pytest.mark.parametrize("t", [0, np.int64(0), np.float32(0.0), sympy.Integer(0), np.array(0.0)])
def test_other_numbers_are_times_too(model: Model, t: Any) -> None:
    assert np.array_equal(model.rhs(t, STATE), slow(model, "rhs"))
    assert model.energy(STATE[:2], STATE[2:], t) == slow(model, "energy")


@pytest.mark.parametrize("given", [STATE.astype(np.float32), np.array([1, 0, 0, 1]), np.zeros(4, dtype=complex), None])
def test_quick_calls_take_doubles_alone(model: Model, given: Any) -> None:
    quick = model._quick["rhs"]
    assert quick.whole(0.0, given) is None and quick.parts(0.0, given, given) is None
    assert quick.whole(0.0, STATE) is not None


def test_quick_calls_outlive_their_kernel_and_count_what_they_hold(model: Model) -> None:
    """They are made of addresses: all that these point to is kept, and no result and no refusal is counted wrongly."""
    expected, bad = slow(model, "rhs"), STATE.astype(np.float32)
    made: Any = type(model.kernel("rhs"))
    kernel = made(model.kernel("rhs").program)
    quick = kernel.quick(model.parameter_array() + 0.0)
    del kernel
    gc.collect()
    assert quick is not None
    held, nothing = sys.getrefcount(STATE), sys.getrefcount(None)
    for _ in range(10_000):
        quick.whole(0.0, bad)
        found = quick.whole(0.0, STATE)
    assert found is not None and np.array_equal(found, expected) and sys.getrefcount(found) == 2
    assert sys.getrefcount(STATE) == held and abs(sys.getrefcount(None) - nothing) < 1000
