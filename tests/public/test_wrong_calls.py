"""Wrong calls of all public functions: each raises an error of this package, or TypeError for a wrong signature."""

import inspect
import itertools
import random
import resource
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.errors import LONGEST_SENTENCE
from lagrange.trajectory.methods import registry
from tests.public.surface import INSTANCES, Public, arguments, classes, surface
from tests.refusals import nested, refusal

X = lg.coordinate("x")
U = sympy.Symbol("u")


class Hostile:
    """An object whose repr raises an error."""

    def __repr__(self) -> str:
        raise ValueError("no repr")


def itself() -> list[Any]:
    """Return a list that contains itself."""
    made: list[Any] = [1.0]
    made.append(made)
    return made


NUMBERS: list[Any] = [
    *(5e-324, sympy.Float("1e-400"), 0, 1, -1, 2, 7, 3.5, 0.25, -0.0, 1e-300, 1e300, -1e-9, 10**400, -(10**5000)),
    *(2**63, float("nan"), float("inf"), -float("inf"), 1j, complex("nan"), True, False, Fraction(1, 3)),
    *(Fraction(10**400, 7), Decimal("0.1"), Decimal("nan"), np.float16(1.5), np.float32("nan")),
    *(np.longdouble("1e4000"), np.int8(3), np.uint64(2**64 - 1), np.bool_(1), np.complex64(1)),
    *(np.timedelta64(1, "s"), np.datetime64("2020-01-01"), np.array(2.0), np.array(1, bool), sympy.Integer(2)),
    *(sympy.Rational(1, 3), sympy.Float("1e400"), sympy.nan, sympy.oo, sympy.zoo, sympy.I, sympy.pi, sympy.true),
    np.ma.masked,
]

TEXTS: list[Any] = [
    *("", "x", "x y", "1.0", "nan", "taylor", "rk4", "a" * 100_000, "\0", "../x", b"x", bytearray(b"1")),
    np.str_("x"),
]

EXPRESSIONS: list[Any] = [
    *(nested(X, 250), X ** (10**30), X ** sympy.Rational(10**50, 3), X, X.dot, X.ddot, U, X**2 + U, lg.t),
    *(sympy.Eq(X, 1), X > 0, sympy.Eq(X, sympy.true), sympy.Function("f")(X, U), sympy.Derivative(sympy.sin(X), X)),
    *(sympy.Integral(U, U), sympy.Symbol("q", commutative=False), sympy.MatrixSymbol("A", 2, 2), sympy.Symbol("a b")),
    *(sympy.Piecewise((X, X > 0), (0, True)), sympy.Interval(0, 1), sympy.Poly(U**2, U), sympy.gamma(X)),
    *(sympy.Tuple(X, U), sympy.Lambda(U, U), sympy.sin, sympy.Symbol),
]

MATRICES: list[Any] = [
    *(sympy.Matrix([[1, 2], [3, 4]]), sympy.Matrix([X, U]), sympy.Matrix(0, 0, []), sympy.ImmutableMatrix([[X]])),
    *(sympy.Array([[1, 2], [3, 4]]), sympy.Array([1, 2, 3, 4]), sympy.SparseMatrix(3, 3, {(0, 0): X}), sympy.eye(2)),
]

ARRAYS: list[Any] = [
    *(np.zeros(0), np.zeros((0, 3)), np.zeros(4), np.ones((4, 3)), np.zeros((2, 2, 2)), np.arange(4)),
    *(np.full(4, np.nan), np.array([True, False, True, False]), np.array(["a", "b"]), np.array([b"a"])),
    *(np.array([1j, 2]), np.array([None, 1.0], object), np.array([X, U], object)),
    *(np.ma.array([1.0, 2.0, 3.0, 4.0], mask=[False, True, False, False]), np.array([1, 2], "M8[s]")),
    *(np.array([1, 2], "m8[s]"), np.zeros(2, dtype=[("a", float)]), np.array([np.inf, 1.0]), np.zeros(4, np.float16)),
    *(np.array([1.0, 2.0], ">f8"), np.matrix([[1.0, 2.0]]), np.array(X, object), np.broadcast_to(0.05, 10**9)),
    *(np.broadcast_to(0.5, (4, 10**9)), range(10**9), np.ones(4, np.longdouble)),
]

CONTAINERS: list[Any] = [
    *([], (), {}, set(), frozenset(), [None], [[]], [[1.0, 2.0], [3.0]], [1.0, True], [1.0, 2.0, 3.0, 4.0]),
    *([0.0, 0.1], (0.0, 0.1), (0.1,), [X, U], [[X, U], [U, X]], ["x", "y"], ("a", 1.0), [b"x"], {"x": 1.0}, {X: 1.0}),
    *({"m": "1"}, {"m": None}, {X: X > 0}, {1: 2}, {None: None}, {(): []}, {"x": [1.0]}, {10**5000: 1.0}),
    *({float("nan"): 1.0}, {"k": -1.0}, {"bob": (X, X)}, {"bob": "ab"}, {1, 2}, deque([1.0]), [10**400]),
    *([np.nan, 1.0], [object()], [Hostile()], [1.0, np.ma.masked], [("origin", "bob")], [Fraction(1, 2), 1]),
    [range(10**9)],
]

OBJECTS: list[Any] = [
    *(None, ..., NotImplemented, object(), object, int, Hostile(), Hostile, len, print, lambda: 1, lambda *a: a[0]),
    *(lambda f, t, y, h: y, SimpleNamespace(integrate=lambda p: None), SimpleNamespace(integrate=1, claims=2)),
    *(SimpleNamespace(name="own", claims=lg.Claims(order=1), integrate=lambda problem: 3), Path("x"), Path("/")),
    *(slice(1, 2), Exception("x"), SimpleNamespace(compile=lambda: 3), lg.Status.SUCCESS, lg.System, lg.methods.RK4),
    *(lg.methods.RK4(), lg.methods.Taylor(), memoryview(b"ab"), type("Empty", (), {})),
]

MADE: list[Callable[[], Any]] = [
    *(itself, lambda: iter([1.0, 2.0]), lambda: (x for x in (X, U)), lambda: (x for x in "ab"), itertools.count),
    *(lambda: itertools.repeat(X), lambda: map(str, range(3)), lambda: zip([1], [2], strict=True)),
    lambda: [*range(20_000)],
]

KINDS: list[list[Any]] = [NUMBERS, TEXTS, EXPRESSIONS, MATRICES, ARRAYS, CONTAINERS, OBJECTS]


SEED = 20_240_229
LONGEST = 120.0
"""Seconds of one call, a hang guard: the slowest takes one on a quiet machine."""

MEMORY = 12 * 2**30
"""Bytes of addresses that the process may have meanwhile."""

CHANGED = (0.6, 0.85)
"""Up to the first, one argument is wrong; up to the second, two are; else all are."""


@pytest.fixture(autouse=True)
def bounded() -> Iterator[None]:
    """Limit the memory of the process, so that a call that requests too much raises MemoryError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the methods that a test registers."""
    monkeypatch.setattr(registry, "_registered", {})


def wrong(chance: random.Random) -> Any:
    """Return a random value."""
    kind = chance.randrange(len(KINDS) + 1)
    return chance.choice(MADE)() if kind == len(KINDS) else chance.choice(KINDS[kind])


def call(public: Public, chance: random.Random, folder: Path) -> tuple[list[Any], dict[str, Any]]:
    """Return the arguments of a call, some of them wrong."""
    given = arguments(public, folder)
    names = [p.name for p in public.parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    how = chance.random()
    count = 1 if how < CHANGED[0] else 2 if how < CHANGED[1] else len(names)
    for name in chance.sample(names, min(count, len(names))):
        given[name] = wrong(chance)
    many = [wrong(chance)] if any(p.kind is p.VAR_POSITIONAL for p in public.parameters) else []
    alone = [p.name for p in public.parameters if p.kind is p.POSITIONAL_ONLY]
    return [*(given.pop(name) for name in alone if name in given), *many], given


@contextmanager
def alarm(seconds: float) -> Iterator[None]:
    """Context that raises TimeoutError in a call that does not end."""

    def late(*_: Any) -> None:
        raise TimeoutError(f"after {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class Caught:
    """Context that stores the exception that ends its block."""

    error: BaseException | None = None

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> bool:
        self.error = error
        return isinstance(error, Exception)


def fits(function: Any, positional: list[Any], named: dict[str, Any]) -> bool:
    """Return True if a call has the number and the names of arguments that a function accepts."""
    try:
        inspect.signature(function).bind(*positional, **named)
    except TypeError:
        return False
    return True


def raw(public: Public, positional: list[Any], named: dict[str, Any]) -> str:
    """Return an unexpected exception of a call and its line in this package, or nothing."""
    function, caught = public.get(), Caught()
    with caught, alarm(LONGEST):
        result = function(*positional, **named)
        if str(type(result).__module__).startswith("lagrange."):
            repr(result)
    error = caught.error
    if isinstance(error, lg.LagrangeError):
        return "" if 0 < len(str(error).strip()) <= LONGEST_SENTENCE else f"a message of {len(str(error))} characters"
    if error is None or (isinstance(error, TypeError) and not fits(function, positional, named)):
        return ""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "/lagrange/" in frame.filename]
    place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    return f"{type(error).__name__}: {str(error)[:80]} at {place}"


def test_wrong_calls_end_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, everything: bool) -> None:
    """A default run calls a third of the public functions once."""
    monkeypatch.chdir(tmp_path)
    chance = random.Random(SEED)
    result = surface()
    failures = []
    for public in itertools.islice(itertools.cycle(result), 2000) if everything else result[1::3]:
        positional, named = call(public, chance, tmp_path)
        if failure := raw(public, positional, named):
            failures.append(f"{public.name}: {failure}")
    assert failures == []


def test_every_public_class_has_an_instance_whose_methods_are_called() -> None:
    assert [kind.__name__ for kind in classes() if kind not in INSTANCES] == []


@pytest.mark.slow
def test_what_is_called_rightly_works(tmp_path: Path) -> None:
    """The other arguments of a wrong call are valid; else the wrong one would not be tested."""
    refused = {}
    for public in surface():
        given = arguments(public, tmp_path)
        if all(p.default is not p.empty or p.name in given for p in public.parameters):
            caught = Caught()
            with caught:
                public.get()(**given)
            if caught.error:
                refused[public.name] = str(caught.error)
    assert refused == {}


UNTYPED: Any = lg
"""The package, for calls that a type checker would refuse."""

TWICE: dict[str, Callable[[lg.System, Any, Any], Any]] = {
    "initial": lambda system, x, m: system.run(0.1, {x: 1.0, "x": 2.0}),
    "velocities": lambda system, x, m: system.consistent({x.dot: 1.0, "x_dot": 2.0}),
    "parameters": lambda system, x, m: system.run(0.1, parameters={m: 1.0, "m": 2.0}),
    "stated": lambda system, x, m: lg.System(m * x.dot**2, initial={x: 1.0, "x": 2.0}),
    "dimensions": lambda system, x, m: lg.System(m * x.dot**2, dimensions={m: "kg", "m": "g"}),
    "substitute": lambda system, x, m: system.substitute({m: 1.0, "m": 2.0}),
    "at": lambda system, x, m: system.linearize({x: 0.0, "x": 1.0}),
    "generator": lambda system, x, m: system.noether({x: 1, "x": 2}),
    "transform": lambda system, x, m: system.transform({x: x**3, "x": x}),
    "rotation": lambda system, x, m: turning({lg.rotation("R"): (1, 0, 0, 0), "R": (0, 1, 0, 0)}, {}),
    "rates": lambda system, x, m: turning({lg.rotation("R").body: (1, 0, 0), "R.body": (0, 1, 0)}, {}),
    "torques": lambda system, x, m: turning({}, {lg.rotation("R").body: (1, 0, 0), "R.body": (0, 1, 0)}),
}
"""Calls with a key that is given by its symbol and by its name. Each took the last value without a word."""


def turning(initial: dict[Any, Any], forces: dict[Any, Any]) -> lg.System:
    """Return a free body with a rotation R."""
    return lg.System(lg.rotational_energy([1, 1, 1], lg.rotation("R").body), initial=initial, forces=forces)


@pytest.mark.parametrize("table", TWICE)
def test_a_key_that_is_given_twice_is_refused(table: str) -> None:
    system = INSTANCES[lg.System]()
    with pytest.raises(lg.StatementError, match="twice, by its symbol and by its name: give it once"):
        TWICE[table](system, system.coordinates[0], lg.parameters("m"))


def test_torques_may_be_given_by_the_name_of_the_rates() -> None:
    body = turning({}, {"R.body": (0, 0, 3)})
    assert body.run(1.0)[lg.rotation("R").body[2]][-1] == pytest.approx(3.0)


def test_what_is_shown_has_no_bound_of_digits() -> None:
    assert "a whole number of about 5001 digits" in repr(lg.event(lg.coordinate("x"), reset={10**5000: 1.0}))
    assert "a whole number of about 5001 digits" in repr(UNTYPED.Problem(None, {}, 0.0, 10**5000, np.zeros(2)))


@pytest.mark.slow
def test_what_is_shown_has_no_bound_of_levels(tmp_path: Path) -> None:
    deep = nested(lg.coordinate("x"), 350)
    assert "an expression of many parts" in repr(lg.contact(deep, slip=lg.coordinate("x").dot, friction=0.1))
    assert "nested too deeply for SymPy" in refusal(lambda: INSTANCES[lg.Solution]().plot(deep))
    x, y = lg.coordinates("x y")
    plane = lg.System(x.dot**2 + y.dot**2, 0, coordinates=[x, y])
    for call in (
        lambda: plane.export("c", tmp_path, ["events"], events=deep),
        lambda: plane.noether({x: deep}),
        lambda: plane.transform({x: deep}),
        lambda: plane.hamiltonian().poisson(deep, y),
        lambda: lg.scene("pendulum").substitute({"m": nested(lg.parameters("q"), 350)}),
        lambda: lg.System(x.dot**2 + y.dot**2, constraints=[x - y]).eliminate({y: deep}),
    ):
        assert "nested too deeply for SymPy" in refusal(call)
    assert "Hostile" in repr(UNTYPED.Problem(None, {}, 0.0, Hostile(), np.zeros(2)))
