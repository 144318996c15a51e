"""Methods by name, by instance and by users, and the table of their claims."""

import inspect
import math
import re
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.show import methods
from lagrange.statement.coordinate import t
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.integrator import Claims, Integrator
from lagrange.trajectory.methods import registry
from lagrange.trajectory.methods.registry import BUILT_IN, GROUP, find, names, register, table
from lagrange.trajectory.methods.runge_kutta import RK4, tableau
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.methods.user_defined import step_method
from tests.models import TARGETS, model
from tests.refusals import refusal
from tests.trajectory.runs import NAMES, exact, run


def test_names_and_instances_are_found() -> None:
    for name in NAMES:
        assert find(name).name == name
    assert find(DEFAULT_METHOD).claims.adaptive
    instance = RK4(step=0.1)
    assert find(instance) is instance
    assert set(NAMES) <= set(names()) and names() == list(methods.names())


class Standing:
    """A minimal integrator that returns the initial state."""

    name = "standing"
    claims = Claims(order=0)

    def integrate(self, problem: Any) -> Any:
        return RK4(step=abs(problem.t1 - problem.t0)).integrate(problem)


def test_anything_with_the_protocol_runs() -> None:
    integrator: Integrator = Standing()
    assert run(model("oscillator"), 1e-3, integrator).steps == 1


def test_events_are_refused_and_not_ignored_by_a_method_that_does_not_claim_them() -> None:
    with pytest.raises(StatementError, match="standing does not locate events: use taylor or another method"):
        run(model("oscillator"), 1e-3, Standing(), events=[t - 5e-4])


def test_the_table_of_methods() -> None:
    rows = {row.name: row for row in table()}
    assert set(NAMES) <= set(rows)
    assert rows["verlet"].claims == Claims(order=2, symplectic=True, symmetric=True, dense=3, events=True)
    text = str(table())
    assert text.splitlines()[0].split() == [
        "method", "order", "step", "symplectic", "symmetric", "energy", "A-stable", "dense", "about",
    ]  # fmt: skip
    assert "rk4" in text and "fixed" in text and "adaptive" in text
    markdown = table().to_markdown()
    assert "| `verlet` | 2 | fixed | yes | yes |  |  | 3 |" in markdown
    assert all(row.about for row in table())


def test_a_method_without_its_package_is_listed_and_refused_when_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("cvode", "lagrange.trajectory.foreign.sundials:CVODE", GROUP)
    monkeypatch.setattr(registry, "_offered", lambda: {"cvode": entry})
    monkeypatch.setitem(sys.modules, "sksundae", None)
    assert "cvode" in names() and find("cvode").claims == Claims(order=5, adaptive=True, explicit=False, events=True)
    assert {row.name: row for row in table()}["cvode"].about.startswith("CVODE of SUNDIALS")
    with pytest.raises(StatementError, match=r"needs scikit-sundae, .*: pip install scikit-sundae, or take"):
        run(model("oscillator"), 1.0, "cvode")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "bdf"}, "method = 'bdf' is not a family of CVODE's formulas: give 'BDF' or 'Adams'"),
        ({"max_step": 0.0}, "max_step = 0.0, the length of a step of cvode: give a positive time"),
        ({"first_step": float("nan")}, "first_step = nan, the length of a step of cvode"),
        ({"max_order": 6}, "max_order = 6 is not an order of BDF formulas: give a whole number from 1 to 5"),
        ({"max_order": 2.5}, "max_order = 2.5 is not an order of BDF formulas"),
    ],
)
def test_options_of_cvode_that_cannot_be_meant(options: dict[str, Any], words: str) -> None:
    assert re.search(words, refusal(methods.CVODE, **options))


def test_every_built_in_method_stands_in_the_public_module() -> None:
    for make in BUILT_IN.values():
        name = getattr(make, "__name__", "")
        assert name in methods.__all__ and getattr(methods, name) is make


@pytest.mark.parametrize(
    ("given", "meant"),
    [("RK45", "dopri5"), ("ode45", "dopri5"), ("RK4", "rk4"), ("BDF", "scipy-bdf"), ("gauss4", "gauss2")],
)
def test_names_from_elsewhere_are_understood(given: str, meant: str) -> None:
    assert re.search(f"Did you mean '{meant}'", refusal(find, given))


def test_an_entry_point_is_loaded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading an entry point takes as long as a short run, so it is done once. Its class is called for each run."""
    first = find("scipy-rk45")
    monkeypatch.setattr(EntryPoint, "load", None)
    assert find("scipy-rk45") == first


# --- own ------------------------------------------------------------------------------------------------------
# Methods of a user's own: registered, run everywhere, and refused in words where they are not what they claim.


@pytest.fixture(autouse=True)
def _forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the methods that a test registers."""
    monkeypatch.setattr(registry, "_registered", {})


def heun(f: Any, t: Any, y: Any, h: Any) -> Any:
    """Heun's method as a user's step function."""
    first = f(t, y)
    return y + h / 2 * (first + f(t + h, y + h * first))


def kicked(a: Any, t: Any, q: Any, v: Any, h: Any) -> Any:
    v = v + np.float64(0.5) * h * a(t, q)
    q = q + h * v
    return q, v + h / 2 * a(t + h, q)


@pytest.mark.parametrize("target", TARGETS)
def test_a_step_function_does_what_the_built_in_method_does(target: str) -> None:
    register("my-heun", heun, order=2)
    register("my-verlet", kicked, order=2)
    pairs = (("double pendulum", "my-heun", "heun"), ("Henon-Heiles", "my-verlet", "velocity-verlet"))
    for system, own, known in pairs:
        result, expected = (run(model(system, target), 0.5, name, step=0.01) for name in (own, known))
        assert result.y == pytest.approx(expected.y, rel=1e-13, abs=1e-14)
        assert result.method == own and result.evaluations == expected.evaluations


def test_a_registered_name_works_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    from lagrange.cli.program import main

    register("my-heun", heun, order=2)
    system = lg.scene("pendulum")
    assert system.run(1.0, method="my-heun", step=0.01).method == "my-heun"
    assert lg.flow(system.compile(), method="my-heun") is not None
    raced = lg.race(system, 1.0, methods=["my-heun", "rk4"])
    assert "my-heun" in raced.methods
    assert main(["run", "pendulum", "--t-end", "1", "--method", "my-heun", "--step", "0.01"]) == 0
    assert "my-heun" in capsys.readouterr().out
    assert names()[-1] == "my-heun" and table()[-1].about == "Heun's method as a user's step function"


def test_a_tableau_is_registered_with_its_step_control() -> None:
    register("ralston", tableau([[0, 0], ["2/3", 0]], ["1/4", "3/4"], order=2, embedded=sympy.Matrix([1, 0])))
    compiled = model("double pendulum")
    error = np.abs(run(compiled, 1.0, "ralston", rtol=1e-6).y[:, -1] - exact(compiled, 1.0).y[:, -1]).max()
    assert find("ralston").name == "ralston" and find("ralston").claims.adaptive and error < 1e-4


def test_instances_classes_and_factories_are_registered() -> None:
    register("tenth", RK4(step=0.1))
    register("fifth", lambda: RK4(step=0.2))
    register("series", Taylor)
    compiled = model("oscillator")
    assert [run(compiled, 1.0, name).steps for name in ("tenth", "fifth")] == [10, 5]
    assert run(compiled, 1.0, "series").status.complete
    with pytest.raises(StatementError, match=r"there is a method 'tenth' already: .* Pass replaces=True to replace it"):
        register("tenth", heun, order=2)
    register("tenth", RK4(step=0.05), replaces=True)
    assert run(compiled, 1.0, "tenth").steps == 20
    assert run(compiled, 1.0, step_method(heun, order=2, step=0.25)).steps == 4


REFUSED: dict[str, tuple[Callable[..., Any], str]] = {
    "sine": (lambda f, t, y, h: y + h * np.sin(y), "it takes numpy's sin of a vector"),
    "product": (lambda f, t, y, h: y * f(t, y), "it multiplies two vectors"),
    "branch": (lambda f, t, y, h: y if y > 0 else y + h * f(t, y), "it compares a vector: a step cannot branch"),
    "entry": (lambda f, t, y, h: y[0] + h * f(t, y), "it takes entry 0 of a vector: a step treats all"),
    "array": (lambda f, t, y, h: np.concatenate([y, f(t, y)]), "it makes an array of a vector"),
    "one more": (lambda f, t, y, h: y + h * f(t, y) + 1, "it adds the number 1 to a vector"),
    "swapped": (lambda f, t, y, h: y + h * f(y, t), r"it calls f\(t, y\) at a time that is"),
    "none": (lambda f, t, y, h: None, "it returns a NoneType in place of the new state"),
    "idle": (lambda f, t, y, h: y, r"it never calls f\(t, y\)"),
    "half": (lambda f, t, y, h: y / 2 + h * f(t, y), r"the new state holds 0\.5 times the old state"),
    "slope": (lambda f, t, y, h: y + h * f(t, 2 * y), "a slope is taken at 2 times the old state"),
    "broken": (lambda f, t, y, h: y + h * f(t, y) / 0, "it divides a vector by zero"),
    "root": (lambda f, t, y, h: y + math.sqrt(h) ** 2 * f(t, y), "of t and h it takes more than sums"),
    "three": (lambda f, t, y: y, r"takes 3 arguments \(f, t, y\): write step\(f, t, y, h\)"),
    "force": (lambda a, t, q, v, h: (q + h * v, v + h / 2 * a(t, q)), r"the new v holds.* 0\.5 times h a instead of 1"),
    "square": (lambda f, t, y, h: y + h**2 * f(t, y), "where h is small, at t = 0, its slopes add up to 0.000244"),
    "clock": (lambda f, t, y, h: y + h * (1 + t) * f(t, y), "where h is small, at t = 2, its slopes add up to 3 times"),
    "late": (lambda f, t, y, h: y + h * f(2 * t, y), "where h is small, at t = 2, a slope is taken at the time 4"),
    "first": (lambda f, t, y, h: y + h * f(t + h, y) if t == 0 else y + h * f(t, y), "not do the same at every call"),
    "jerk": (lambda a, t, q, v, h: (q + h * h * v, v + h * a(t, q)), "the new q holds 2 times h v instead of 1"),
}


def test_a_step_whose_numbers_are_not_in_proportion_to_h_is_held_to_be_a_step() -> None:
    """Its weights sum to h as h tends to 0, so it is consistent, as order 1 requires."""
    method = step_method(lambda f, t, y, h: y + h / (1 + h) * f(t, y) + h**2 / (1 + h) * f(t + h, y), order=1)
    assert run(model("oscillator"), 1.0, method, step=0.01).status.complete


def test_a_step_function_that_carries_something_on_is_refused() -> None:
    """The function is called only to record its operations, so state kept between calls would be lost."""
    calls = []

    def stateful(f: Any, t: Any, y: Any, h: Any) -> Any:
        calls.append(t)
        return y + h * f(t, y) if len(calls) < 3 else y + 2 * h * f(t, y)

    call = {"__call__": lambda self, f, t, y, h: y + h * f(t, y)}
    unhashable: Any = type("Unhashable", (), {"__hash__": None, **call})
    assert "does not do the same at every call" in refusal(step_method, stateful, order=1)
    assert "is a Unhashable without a hash: give a function" in refusal(step_method, unhashable(), order=1)


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_step_is_refused_in_one_sentence_of_words(case: str) -> None:
    function, words = REFUSED[case]
    message = refusal(register, "mine", function, order=1)
    assert re.search(words, message) and message.count("cannot be used") <= 1
    assert "mine" in message and "mine" not in names()


@pytest.mark.parametrize(
    ("name", "thing", "options", "words"),
    [
        ("rk4", heun, {"order": 2}, "there is a method 'rk4' already: give another name"),
        ("Mine", heun, {"order": 2}, "name = 'Mine': give lower-case letters and digits"),
        (3, heun, {"order": 2}, "name = 3: give lower-case letters"),
        ("mine", heun, {}, r"needs the arguments \(f, t, y, h\). If it is a step function, give order="),
        (
            "mine",
            3,
            {},
            "the method for the name 'mine' is 3: give a ButcherTableau, an integrator, its class, or a step function",
        ),
        (
            "mine",
            RK4(),
            {"order": 4},
            "order= is for step functions only, and mine states its order itself: leave out order",
        ),
        ("mine", heun, {"order": 2.5}, r"order = 2\.5: give the order of the method, a whole number"),
        ("mine", heun, {"order": 3}, r"'mine' is not what it claims: the condition of order 3, sum b_i c_i\^2 = 1/3"),
    ],
)
def test_what_cannot_be_registered_is_refused(name: Any, thing: Any, options: dict[str, Any], words: str) -> None:
    assert re.search(words, refusal(register, name, thing, **options))
    assert "mine" not in names()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"A": [[0, 0], ["a", 0]], "b": [1, 0], "order": 1}, "has an entry that is not a number"),
        ({"A": 3, "b": [1], "order": 1}, "has A = 3: give its rows"),
        ({"A": [[0, 0], [1, 0]], "b": [1, 0], "order": 2}, "condition of order 2, sum b_i c_i = 1/2, fails by -0.5"),
        ({"A": [[0, 1], [1, 0]], "b": [1, 0], "order": 1}, "is not explicit: A must be zero on and above"),
        ({"A": [[0, 0], [1, 0]], "b": [0.5, 0.5], "order": 2, "embedded": [1]}, "2 weights in b and 1 in embedded"),
        ({"A": [[0, 0], ["1e400", 0]], "b": [1, 0], "order": 1}, "has an entry that is not a number .*too large"),
        ({"A": [[0, 0], [1, 0]], "b": [1, 0], "order": 1, "embedded": [1, 0]}, "has embedded equal to b: their differ"),
        ({"A": [[]], "b": [1], "order": 12}, "orders up to 10 can be checked, not 12"),
    ],
)
def test_a_tableau_that_is_not_one_is_refused(given: dict[str, Any], words: str) -> None:
    assert re.search(words, refusal(tableau, **given))


# --- options --------------------------------------------------------------------------------------------------
# Options of methods are checked when the method is made, not when it runs.

made: Any = lg
"""The package, of which nobody has told the types here."""

WRONG: list[Any] = [
    "nan", "0.1", b"1", [0.1], (0.1,), {}, set(), float("nan"), float("inf"), -0.0, -1.0, 1j, True, np.array([0.1]),
    np.array(["a"]), np.ma.masked, object(), 10**400,
]  # fmt: skip

TAKES = [(name, option) for name, make in BUILT_IN.items() for option in inspect.signature(make).parameters]
SCIPY = [name for name in lg.methods.__all__ if name.startswith("Scipy")]


@pytest.mark.parametrize(("name", "option"), TAKES)
def test_an_option_that_no_run_could_use_is_refused(name: str, option: str) -> None:
    for value in WRONG:
        assert re.search(option, refusal(BUILT_IN[name], **{option: value}))


@pytest.mark.parametrize("name", [*SCIPY, "CVODE"])
@pytest.mark.parametrize("option", ["max_step", "first_step"])
def test_a_bound_of_steps_that_is_none_is_refused(name: str, option: str) -> None:
    for value in WRONG:
        if not (option == "max_step" and value == float("inf")):
            assert re.search(option, refusal(getattr(lg.methods, name), **{option: value}))
    assert "max_step" in refusal(getattr(lg.methods, name), max_step=None)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: made.Claims(order="a"), "order is 'a'"),
        (lambda: made.Claims(order=4, symplectic="no"), "symplectic = 'no': give True or False"),
        (lambda: made.methods.ImplicitMethod("mine", None, print), "the claims of mine are None: give an lg.Claims"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), 3), "the function of mine is 3: give a function"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), print, law="x"), "of a method is not 'x': give"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), print, control=3), "the step control of mine is 3"),
        (lambda: made.methods.ImplicitMethod("mine", lg.Claims(1), print, holonomic=2), "holonomic of mine = 2"),
        (lambda: made.methods.RungeKutta("rk4"), "'rk4' is not a tableau: make one with lg.methods.tableau"),
        (lambda: made.methods.Splitting("mine", 1, "ab"), "the stages of mine is the text 'ab'"),
        (lambda: made.methods.Splitting("mine", 1, [(1.0, 1j)]), "stage 0 of mine has entries of type complex128"),
        (lambda: made.methods.Splitting("mine", 1, [(1.0,)]), "give pairs"),
        (lambda: made.methods.tableau([[0]], ["1e999999999"], order=1), "has an entry that is not a number"),
        (lambda: made.methods.tableau([[0]], [True], order=1), "has an entry that is not a number"),
        (lambda: made.methods.ButcherTableau("mine", 1, [[]], [1]), "b, c and the rows of A must be tuples of numbers"),
        (lambda: made.methods.RK4().integrate(3), "rk4 cannot run 3: give an lg.Problem"),
        (lambda: made.methods.plot_stability("rk4", left=1, right=0), "give left < right and top > 0"),
        (lambda: made.methods.growth("rk4", ["a"]), "z has entries of type <U1: give numbers"),
        (lambda: made.System.from_statement("x"), "'x' is not a statement: give the .statement of a system"),
    ],
)  # fmt: skip
def test_records_are_checked_when_they_are_made(make: Any, words: str) -> None:
    assert words in refusal(make)
