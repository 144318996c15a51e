"""All public objects can be copied and pickled, and work alike in another process."""

from __future__ import annotations

import copy
import gc
import multiprocessing
import pickle
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import cos

import lagrange as lg
from lagrange.machine.drivers import SeriesDriver
from lagrange.trajectory.methods.registry import find, names
from tests.public import surface

theta = lg.coordinate("theta")
g = lg.parameters("g")


@cache
def pendulum() -> lg.System:
    return lg.System(
        kinetic=theta.dot**2 / 2, potential=-g * cos(theta), parameters={g: 9.81}, initial={theta: 2.0}, name="pendulum"
    )


def bounce() -> lg.Event:
    return lg.event(theta, direction=-1, reset={theta.dot: -0.9 * theta.dot})


@cache
def run(method: str, target: str = "llvm") -> lg.Solution:
    """Return a run with a reset, or a run without events if the method locates none."""
    return pendulum().run(3.0, method=method, events=[bounce(), lg.event(theta.dot)], target=target)


@cache
def a_race() -> lg.Race:
    return lg.race(pendulum(), 1.0, methods=["rk4"], steps=[0.1, 0.05])


EXAMPLES: dict[str, Callable[[], Any]] = {
    **{kind.__name__: make for kind, make in surface.INSTANCES.items()},
    "Event with a reset": bounce,
    "LagrangeError": lambda: lg.LagrangeError("what happened"),
    "RunError": lambda: lg.RunError("what happened"),
    "SceneError": lambda: lg.SceneError("what is wrong", file="a.toml", line=3, column=7),
    "StatementError": lambda: lg.StatementError("what is wrong"),
    "Status": lambda: lg.Status.MAX_WALL,
    "run with resets": lambda: run("taylor"),
    "path of dop853": lambda: run("dop853").trajectory,
    "flow of an implicit method": lambda: lg.flow(pendulum().compile(), method="radau5", rtol=1e-9),
    "status card": lambda: run("taylor").card(),
    "structure": lambda: pendulum().laws.structure,
    "derivation": lambda: pendulum().derivation(),
    "energy drift": lambda: run("taylor").drift,
    "statement": lambda: pendulum().statement,
    "kernel": lambda: pendulum().compile().kernel("energy"),
    "kernel of numpy": lambda: pendulum().compile("numpy").kernel("energy"),
    "series": lambda: pendulum().compile().series()[0],
}
"""One of everything that a user gets hold of: each public class, then what is returned by these."""


def copies(thing: Any) -> list[Any]:
    """Return a copy of each kind."""
    return [pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing), copy.copy(thing)]


@pytest.mark.parametrize("name", EXAMPLES)
def test_everything_is_copied_and_pickled(name: str) -> None:
    thing = EXAMPLES[name]()
    for other in copies(thing):
        assert isinstance(other, type(thing)) or name == "kernel"
        if " at 0x" not in str(thing):
            assert str(other) == str(thing)


@pytest.mark.parametrize("name", names())
def test_every_method_comes_back_equal(name: str) -> None:
    method = find(name)
    assert pickle.loads(pickle.dumps(method)) == copy.deepcopy(method) == copy.copy(method) == method


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5", "verlet", "gauss3", "scipy-dop853"])
def test_a_solution_gives_the_same_numbers(method: str, target: str) -> None:
    solution = run(method, target)
    times = np.linspace(0.0, float(solution.t[-1]), 40)
    for second in copies(solution):
        assert second.message == solution.message
        assert second.status is solution.status
        np.testing.assert_array_equal(second.at(times), solution.at(times))
        np.testing.assert_array_equal(second.energy, solution.energy)
        np.testing.assert_array_equal(second[theta.dot], solution[theta.dot])
        np.testing.assert_array_equal(second.evaluate(theta.ddot * g), solution.evaluate(theta.ddot * g))
        for first, two in zip(second.t_events, solution.t_events, strict=True):
            np.testing.assert_array_equal(first, two)


def test_a_flow_that_was_used_gives_the_same_numbers() -> None:
    flow = lg.flow(pendulum().compile(), method="gauss3", step=0.01)
    end = flow(np.array([2.0, 0.0]), 0.0, 1.0)
    for other in copies(flow):
        np.testing.assert_array_equal(other(np.array([2.0, 0.0]), 0.0, 1.0), end)


def test_a_kernel_that_arrives_compiles_when_it_is_called() -> None:
    kernel: Any = pendulum().compile().kernel("rhs")
    parameters = pendulum().compile().parameter_array()
    other = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(kernel))))
    assert "_kernel" not in vars(other)
    y = np.array([[2.0, 1.0], [0.0, 0.5]])
    np.testing.assert_array_equal(other(0.0, y, parameters), kernel(0.0, y, parameters))
    np.testing.assert_array_equal(other.prepare(parameters), kernel.prepare(parameters))
    assert other.address != 0
    for missing in ("_nothing", "nothing"):
        with pytest.raises(AttributeError, match=missing):
            getattr(other, missing)


def test_digits_of_a_reference_survive() -> None:
    """Numbers of multiple precision belong to a context of mpmath whose classes cannot be pickled."""
    states = a_race().result.reference.states
    assert pickle.loads(pickle.dumps(a_race())).result.reference.states == states
    assert states[0][0]._mpf_[3] > 60  # bits: a double has 53


@pytest.mark.slow
def test_copies_leave_nothing_on_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    """Incomplete copies of modules were destroyed, with tracebacks of llvmlite on stderr."""
    lost: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    kernel: Any = pendulum().compile().kernel("rhs")
    series = pendulum().compile().series()[0]
    jet = SeriesDriver(pendulum().compile().machine, series.code(8), 8, pendulum().compile().parameter_array())
    for thing in (kernel, series, kernel._module, run("taylor").trajectory):
        copy.deepcopy(thing)
    with pytest.raises(ValueError, match="pickled"):
        copy.deepcopy(jet)  # it points to memory, and nobody gets hold of it
    gc.collect()
    assert not lost


def end_of(solution: lg.Solution) -> tuple[lg.Solution, Any]:
    """Return results of a solution in another process, and of a run there."""
    again = solution.model.statement.name
    return pendulum().run(1.0, method="taylor"), (again, solution.at(0.5), solution.energy[-1])


def moved(flow: Any) -> Any:
    return flow(np.array([2.0, 0.0]), 0.0, 1.0)


@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # of a library with threads, if a test has imported one
@pytest.mark.parametrize("start", [pytest.param("spawn", marks=pytest.mark.slow), "fork"])
def test_solutions_and_flows_go_to_a_pool_and_come_back(start: str) -> None:
    solution, flow = run("taylor"), lg.flow(pendulum().compile(), method="dop853")
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(start)) as pool:
        other, (name, state, energy) = pool.submit(end_of, solution).result()
        end = pool.submit(moved, flow).result()
    assert name == "pendulum"
    np.testing.assert_array_equal(state, solution.at(0.5))
    assert energy == solution.energy[-1]
    np.testing.assert_array_equal(end, moved(flow))
    own = pendulum().run(1.0, method="taylor")
    np.testing.assert_array_equal(other.at(0.7), own.at(0.7))
    np.testing.assert_array_equal(other.evaluate(theta**2), own.evaluate(theta**2))
