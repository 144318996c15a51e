"""Kernels of systems with constraints against dense linear algebra, and the quick way of calls with plain arrays."""

import gc
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, Rational, exp, log, sqrt

import lagrange as lg
from lagrange.algorithm.series.packing import pack
from lagrange.compiler import machine, model_of
from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.errors import RunError
from lagrange.graph import node as rebuilding
from lagrange.graph.node import Binding, Graph, Node
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import KernelCode, LlvmKernel
from lagrange.machine.llvm import procedures
from lagrange.machine.llvm.emitter import MOST_ACCESSES
from lagrange.machine.llvm.procedures import INLINE_ANGLES
from lagrange.machine.llvm.processor import lanes
from lagrange.machine.llvm_series import CompiledJet
from lagrange.machine.model import Model
from lagrange.machine.numpy_machine import NumpySeries
from lagrange.program.catalogue import program_of
from lagrange.program.lower import lower
from lagrange.program.program import Program, SolveGroup, scheduled
from lagrange.program.taylor import series_program
from lagrange.statement.statement import Statement
from tests.covering import Share
from tests.machine.matrices import REGULAR, SINGULAR, Matrix, positive
from tests.models import m, shared_scene, stated
from tests.refusals import refusal
from tests.series_systems import HELD, ladder, rods

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


@pytest.mark.parametrize("t", [float("nan"), float("inf")])
def test_a_time_that_is_no_number_is_told(model: Model, t: float) -> None:
    assert "time t" in refusal(model.rhs, t, STATE)


@pytest.mark.parametrize("t", [np.float64(0.25), np.array([0.25])[0]])
def test_times_as_solvers_give_them_are_quick(model: Model, t: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """SciPy passes times as NumPy numbers from its first step on."""
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
        result = calls.whole(0.0, STATE)
        assert result is not None and np.array_equal(result, kernel(0.0, STATE, given))


@pytest.mark.parametrize("given", [STATE.astype(np.float32), np.array([1, 0, 0, 1]), np.zeros(4, dtype=complex), None])
def test_quick_calls_take_doubles_alone(model: Model, given: Any) -> None:
    quick = model._quick["rhs"]
    assert quick.whole(0.0, given) is None and quick.parts(0.0, given, given) is None
    assert quick.whole(0.0, STATE) is not None


@pytest.mark.few(2)
def test_quick_calls_outlive_their_kernel_and_count_what_they_hold(model: Model) -> None:
    """Quick calls contain addresses. The memory behind them must stay alive, with right reference counts."""
    expected, bad = slow(model, "rhs"), STATE.astype(np.float32)
    made: Any = type(model.kernel("rhs"))
    kernel = made(model.kernel("rhs").program)
    quick = kernel.quick(model.parameter_array() + 0.0)
    del kernel
    gc.collect()
    assert quick is not None
    held, nothing = sys.getrefcount(STATE), sys.getrefcount(None)
    for _ in range(2_000):
        quick.whole(0.0, bad)
        result = quick.whole(0.0, STATE)
    assert result is not None and np.array_equal(result, expected) and sys.getrefcount(result) == 2
    assert sys.getrefcount(STATE) == held and abs(sys.getrefcount(None) - nothing) < 200


# --- overflow -------------------------------------------------------------------------------------------------
# Numbers that overflow come back as inf and NaN, or as a sentence: NumPy's warnings stay inside.
#
# pytest turns warnings into errors here; the same calls are made where a user has told NumPy to raise.

x, y = lg.coordinates("x y")
T = x.dot**2 / 2

SYSTEMS: dict[str, dict[str, Any]] = {
    "exponential": {"kinetic": T, "potential": exp(x)},
    "high power": {"kinetic": T + y.dot**2 / 2, "potential": x**301 / 301 + x * y},
    "root": {"kinetic": T, "potential": sqrt(x)},
    "logarithm": {"kinetic": T, "potential": log(x) * x**2},
    "mass that overflows": {"kinetic": exp(x) * T + y.dot**2 / 2, "potential": y**2},
    "masses that differ": {"kinetic": 1e300 * x.dot**2 + 1e-300 * y.dot**2, "potential": x**2 + y**2},
    "coupled masses that differ": {"kinetic": 1e300 * x.dot**2 + 1e-300 * y.dot**2 + x.dot * y.dot, "potential": x},
    "drag": {"kinetic": T, "potential": x**2, "forces": {x: -x.dot * Abs(x.dot) ** 41}},
    "kink": {"kinetic": T, "potential": Abs(x) ** Rational(3, 2)},
    "velocity": {"kinetic": x.dot**4 / 4, "potential": x**2},
}
NUMBERS = [0.0, 1.0, -1.0, 1e3, 1e155, -1e308, 5e-324, np.inf, np.nan]


@pytest.fixture(params=["warn", "raise"])
def errors(request: pytest.FixtureRequest) -> Iterator[None]:
    with np.errstate(all=request.param):
        yield


def calls(model: lg.Model, q: Any, v: Any) -> list[Callable[[], Any]]:
    y0 = np.concatenate([q, v])
    named = [lambda name=name: model.evaluate(name, q, v) for name in ("forces", "bias", "lagrangian")]
    return [
        lambda: model.accelerations(q, v),
        lambda: model.rhs(0.0, y0),
        lambda: model.jacobian(0.0, y0),
        lambda: model.energy(q, v),
        lambda: model.momenta(q, v),
        lambda: model.mass_matrix(q, v=v),
        lambda: model.evaluate_expression(exp(x) / x + x.ddot, np.zeros(y0.shape[1]), y0) if y0.ndim > 1 else None,
        *named,
    ]


@pytest.mark.usefixtures("errors")
@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_no_evaluation_lets_a_warning_out(name: str, target: str) -> None:
    model = lg.System(**SYSTEMS[name]).compile(target)
    n, refused, answered = model.dimension, 0, 0
    for a in NUMBERS:
        for b in (0.0, 1e160):
            for shape in ((n,), (n, 3)):
                for call in calls(model, np.full(shape, a), np.full(shape, b)):
                    try:
                        call()
                        answered += 1
                    except lg.RunError:
                        refused += 1
    assert answered > refused


def test_what_is_finite_is_told_from_what_is_not() -> None:
    """Accelerations whose squares overflow are finite. An infinite one, without inertia, is refused."""
    for target in ("llvm", "numpy"):
        free = lg.System(kinetic=T + y.dot**2 / 2, potential=1e200 * x * y).compile(target)
        assert free.accelerations([1e100, 1e100], [0.0, 0.0]).tolist() == [-1e300, -1e300]
        assert free.accelerations(np.full((2, 99), 1e100), np.zeros((2, 99))).tolist() == [[-1e300] * 99] * 2
        model = lg.System(kinetic=x**2 * T + y.dot**2 / 2, potential=x, coordinates=[x, y]).compile(target)
        for batch in (1, 99):
            q = np.ones((2, batch))
            q[0, -1] = 0.0
            with pytest.raises(lg.RunError, match="the mass matrix is singular at t = 0, x = 0, y = 1"):
                model.accelerations(q, np.zeros((2, batch)))


# --- large models ---------------------------------------------------------------------------------------------
# Large models compile in time in proportion to their size.


def nested(depth: int) -> lg.System:
    """Return a potential of nested sines."""
    x = lg.coordinate("x")
    inner: Any = x
    for _ in range(depth):
        inner = sp.Add(sp.sin(inner, evaluate=False), sp.Integer(1), evaluate=False)
    return lg.System(kinetic=x.dot**2 / 2, potential=inner, initial={x: 0.3}, name="nested sines")


def chain(count: int) -> lg.System:
    """Return masses in a row between stiffening springs."""
    q = [lg.coordinate(f"x{i}") for i in range(count)]
    stretch = [a - b for a, b in pairwise(q)]
    return lg.System(
        kinetic=sp.Add(*[x.dot**2 / 2 for x in q]),
        potential=sp.Add(*[d**2 / 2 + d**4 / 4 for d in stretch]),
        initial={q[0]: 0.3},
        name="chain",
    )


def many_angles(count: int) -> lg.System:
    """Return a potential of many harmonics."""
    x = lg.coordinate("x")
    return lg.System(
        kinetic=x.dot**2 / 2,
        potential=sp.Add(*[sp.cos(k * x) / k for k in range(1, count + 1)]),
        initial={x: 0.3},
        name="harmonics",
    )


def accesses(text: str) -> int:
    """Return the most loads and stores in one basic block of some IR."""
    most = now = 0
    for line in text.splitlines():
        now = 0 if line.endswith((":", "{")) else now + ((" load " in line) or line.startswith("  store "))
        most = max(most, now)
    return most


@pytest.fixture(scope="module")
def equations() -> Equations:
    return euler_lagrange(nested(100).statement)


@pytest.mark.slow
def test_no_block_of_a_series_holds_more_than_llvm_compares_quickly(equations: Equations) -> None:
    """Blocks are cut, since in one block 100 sines took 4 s to compile and 200 took 13 s."""
    jet = CompiledJet(pack(series_program(equations)[0], lanes()), 0)
    assert accesses(jet.ir) <= MOST_ACCESSES + 8 * lanes()


def test_a_series_in_many_blocks_is_that_of_the_interpreter(equations: Equations) -> None:
    program = series_program(equations)[0]
    y, none = np.array([0.3, 0.1]), np.empty(0)
    expected = NumpySeries(program).rows(12, 0.0, y, 0.5, none)
    result = CompiledJet(pack(program, lanes()), 0).rows(12, 0.0, y, 0.5, none)
    # Derivatives of 100 sines in one another lose a digit or so: the two sum in another order.
    np.testing.assert_allclose(result, expected, rtol=1e-11, atol=1e-13)


@pytest.mark.few(1)
@pytest.mark.parametrize("system", [nested, chain])
def test_the_start_of_a_series_is_built_once(system: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values at order 0 are built once. Before, 1,500 sines took two minutes."""
    calls: list[Node] = []
    real = rebuilding.rebuild

    def counted(node: Node, args: Sequence[Node]) -> Node:
        calls.append(node)
        return real(node, args)

    monkeypatch.setattr(rebuilding, "rebuild", counted)
    counts = []
    for size in (20, 80):
        calls.clear()
        series_program(euler_lagrange(system(size).statement))
        counts.append(len(calls))
    assert counts[1] < 5 * counts[0]


def test_the_inertia_of_a_lone_coordinate_is_looked_up_without_the_whole_matrix() -> None:
    """The start of a run must not write the million entries of the mass matrix of 1,000 masses."""
    model = chain(40).compile(check=False)
    assert isinstance(model, Model)
    zeros = np.zeros(40)
    assert model.column_without_inertia(0.0, zeros, zeros, np.empty(0)) is None
    assert len(model._masses.program.outputs) == 40
    assert "v has shape (3,)" in refusal(model.column_without_inertia, 0.0, zeros, np.zeros(3), np.empty(0))


@pytest.mark.slow
def test_many_angles_share_a_function() -> None:
    """Unrolled, 20,000 cosines were 76 million characters of code, which took two minutes to compile."""
    most = 8 * INLINE_ANGLES + 44
    few, many = (series_program(euler_lagrange(many_angles(count).statement))[0] for count in (40, most))
    jets = [CompiledJet(pack(program, lanes()), 0) for program in (few, many)]
    assert "@sine_and_cosine_8" not in jets[0].ir
    assert jets[1].ir.count("call {<8 x double>, <8 x double>} @sine_and_cosine_8") == most // 8
    y, none = np.array([0.3, 0.1]), np.empty(0)
    expected = NumpySeries(many).rows(6, 0.0, y, 0.01, none)
    # Sums of 108 terms of either sign, in another order: a few hundred rounding errors of the largest.
    np.testing.assert_allclose(jets[1].rows(6, 0.0, y, 0.01, none), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.few(1)
@pytest.mark.parametrize("quantity", ["jacobian", "mass_matrix"])
def test_zeros_of_matrices_take_no_code_in_batches(quantity: str) -> None:
    """Twice the masses have twice the nonzero entries, so the kernel over columns is twice as long."""
    sizes = [
        len(KernelCode(program_of(quantity, chain(count).compile("numpy").equations)).column_module(4).splitlines())
        for count in (20, 40)
    ]
    assert sizes[1] < 2.2 * sizes[0]
    model, rng = chain(20).compile(), np.random.default_rng(0)
    q, v = rng.uniform(-1, 1, (2, 20, 9))
    together = model.evaluate(quantity, q, v)
    for k in range(9):
        np.testing.assert_allclose(together[..., k], model.evaluate(quantity, q[:, k], v[:, k]), rtol=1e-13, atol=1e-13)


# --- kernels of systems with constraints, compared with dense linear algebra on all machines -------------------


CASES: dict[str, Callable[[], Statement]] = {**HELD, "12 rods": lambda: rods(12)}
"""24 coordinates and 12 multipliers are written out by LLVM, and interpreted on the numpy target."""


@cache
def constrained_model(name: str, target: str) -> Model:
    return model_of(CASES[name](), machine(target))


def motion(constrained_model: Model, q: Any, v: Any) -> tuple[Any, Any]:
    """Return the accelerations and multipliers by dense linear algebra, from M, h and the nodes of G and gamma."""
    held = constrained_model.equations.constraints
    m, n = len(held), constrained_model.dimension
    y = np.concatenate([q, v])
    nodes = (*(entry for row in held.gradient for entry in row), *held.bias)
    result = constrained_model.function("rows", nodes)(0.25, y, constrained_model.parameter_array())
    gradient, gamma = result[: m * n].reshape(m, n), result[m * n :]
    mass, bias = constrained_model.mass_matrix(q, 0.25, v=v), constrained_model.evaluate("bias", q, v, 0.25)
    whole = np.block([[mass, -gradient.T], [gradient, np.zeros((m, m))]])
    solution = np.linalg.solve(whole, np.concatenate([bias, -gamma]))
    return solution[:n], solution[n:]


def states(constrained_model: Model, count: int) -> tuple[Any, Any]:
    """Return coordinates and velocities near the initial ones, (n, count) each; they need not obey the constraints."""
    rng = np.random.default_rng(5)
    y = np.array(constrained_model.statement.initial)[:, None] + rng.uniform(
        -0.1, 0.1, (constrained_model.layout.size, count)
    )
    return y[constrained_model.layout.q], y[constrained_model.layout.v]


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", CASES)
def test_accelerations_and_multipliers_are_those_of_the_whole_system(name: str, target: str) -> None:
    held = constrained_model(name, target)
    q, v = states(held, 6)
    many = held.accelerations(q, v, 0.25), held.multipliers(q, v, 0.25)
    for k in range(6):
        a, multipliers = motion(held, q[:, k], v[:, k])
        # Both solve to some hundred rounding errors: the systems are well conditioned.
        for result, expected in ((held.accelerations(q[:, k], v[:, k], 0.25), a), (many[0][:, k], a)):
            assert result == pytest.approx(expected, rel=1e-11, abs=1e-12 * np.abs(a).max())
        for result in (held.multipliers(q[:, k], v[:, k], 0.25), many[1][:, k]):
            assert result == pytest.approx(multipliers, rel=1e-11, abs=1e-12 * np.abs(multipliers).max())


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_near_a_configuration_where_constraints_depend_on_one_another_pivots_are_taken_by_size(target: str) -> None:
    """The bars of a ladder are within 1e-4 of one line. Elimination without pivoting would lose eight digits."""
    held = model_of(ladder(3), machine(target))
    angle = np.pi / 2 - 1e-4
    q = np.ravel([(i + np.sin(angle), np.cos(angle)) for i in range(4)])
    v = np.ravel([(np.cos(angle), -np.sin(angle)) for _ in range(4)])
    result, (expected, _) = held.accelerations(q, v, 0.25), motion(held, q, v)
    assert result == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
    straight = np.ravel([(i + 1.0, 0.0) for i in range(4)])
    with pytest.raises(RunError):
        held.accelerations(straight, np.zeros(8), 0.25)


@pytest.mark.parametrize(("loops", "largest"), [(5, 8), pytest.param(60, 50_000, marks=pytest.mark.slow)])
def test_a_large_system_that_is_singular_takes_its_memory_from_the_heap(
    loops: int, largest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The matrix of 60 loops has 243 unknowns and half a megabyte; with its factors it exceeds a thread's stack."""
    monkeypatch.setattr(procedures, "LARGEST_ON_STACK", largest)
    held = model_of(ladder(loops), machine("llvm"))
    straight = np.ravel([(i + 1.0, 0.0) for i in range(loops + 1)])
    with pytest.raises(RunError):
        held.accelerations(straight, np.zeros(2 * loops + 2), 0.25)
    bent = np.ravel([(i + 0.28, 0.96) for i in range(loops + 1)])
    assert np.isfinite(held.accelerations(bent, np.zeros(2 * loops + 2), 0.25)).all()


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("light", [1e-6, 1e-9, 1e-12, 1e-15, 1e-17])
def test_a_light_body_tied_to_a_heavy_one_has_its_acceleration(light: float, target: str) -> None:
    """Both accelerations are F / (m + M).

    Without pivoting that of the light body would be a difference of equal forces.
    """
    a, b = lg.coordinates("a b")
    tied = stated(
        kinetic=m * a.dot**2 / 2 + b.dot**2 / 2, potential=-a, constraints={"tie": a - b}, parameters={m: light}
    )
    held, zero = model_of(tied, machine(target)), np.zeros(2)
    exact = 1 / (1 + light)
    assert held.accelerations(zero, zero) == pytest.approx([exact, exact], rel=1e-11)
    many = held.accelerations(np.zeros((2, 9)), np.zeros((2, 9)))
    assert many == pytest.approx(np.full((2, 9), exact), rel=1e-11)


# --- solve groups ---------------------------------------------------------------------------------------------
# Systems with one factored matrix, solved together: the same to the last bit as one by one, and less work.

ORDERS = (2, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (6, 7, 12)))
"""Of these 6, 7 and 12 are written in loops, and take the longest to compile."""
WIDTH = 9


def one_by_one(program: Program, refs: Iterable[int], most: Callable[[int], int]) -> list[int | SolveGroup]:
    return list(refs)


def random_program(rng: np.random.Generator, n: int, *, hoisted: bool = False, multipliers: int = 0) -> Program:
    """Return a program with systems of one or two matrices. Some right-hand sides depend on earlier solutions.

    The matrices are the first inputs or the parameters, n (n + 1) / 2 entries of each.
    """
    graph = Graph()
    matrices = [f"{name}{i}" for name in "ac" for i in range(n * (n + 1) // 2)]
    given = [graph.symbol(name, Binding.PARAMETER if hoisted else Binding.CONFIGURATION) for name in matrices]
    state = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(n)]
    entries = [2 * entry for entry in given]  # not the parameters themselves, which are at hand anyway
    rows = [
        [[entries[start + i * (i + 1) // 2 + j] for j in range(i + 1)] for i in range(n)]
        for start in (0, len(given) // 2)
    ]
    known: list[Node] = list(state)
    outputs: list[Node] = []
    for count in rng.integers(1, 45, size=3):
        result: list[Node] = []
        for _ in range(count):
            right = [
                known[a] * float(rng.normal()) + known[b] for a, b in rng.integers(0, len(known), size=(n, 2)).tolist()
            ]
            chosen = rows[int(rng.integers(0, 4) == 0)]
            result += graph.solve(chosen, right, tuple(range(n - multipliers, n)))
        known += result
        outputs += [first + second for first, second in zip(result, result[::-1], strict=True)] + result
    time = graph.symbol("t", Binding.TIME)
    return lower("systems", {"x": outputs}, {"y": state if hoisted else [*given, *state]}, time, given * hoisted)


def both(program: Program, monkeypatch: pytest.MonkeyPatch, use: Callable[[LlvmKernel], Any]) -> tuple[Any, Any]:
    """Return the results of two kernels: one solves for all right-hand sides together, the other one by one."""
    together = use(LlvmKernel(program))
    with monkeypatch.context() as patch:
        patch.setattr("lagrange.algorithm.kernel.body.scheduled", one_by_one)
        return together, use(LlvmKernel(program))


def at(y: FloatArray, kernel: LlvmKernel) -> FloatArray:
    return kernel(0.0, y, np.empty(0))


def triangle(matrix: Any) -> FloatArray:
    result: FloatArray = np.asarray(matrix[np.tril_indices(len(matrix))], dtype=float)
    return result


def steps_of(program: Program, most: int = 32) -> list[int | SolveGroup]:
    return scheduled(program, range(program.hoisted, len(program.instructions)), lambda _: most)


@pytest.mark.slow
@pytest.mark.parametrize("n", ORDERS)
@pytest.mark.parametrize("kind", REGULAR, ids=lambda kind: kind.__name__)
def test_together_is_one_by_one_to_the_last_bit(
    n: int, kind: Matrix, monkeypatch: pytest.MonkeyPatch, everything: bool
) -> None:
    """Matrices with and without trusted pivots, from the state and from parameters, for one state and in columns."""
    rng = np.random.default_rng([n, REGULAR.index(kind)])
    for hoisted in (False, True) if everything else (n % 2 == 0,):
        program = random_program(rng, n, hoisted=hoisted)
        matrices = np.concatenate([triangle(kind(rng, n)), triangle(positive(rng, n))])
        right = rng.normal(size=(n, WIDTH))
        many = right if hoisted else np.concatenate([np.repeat(matrices[:, None], WIDTH, axis=1), right])
        parameters = matrices if hoisted else np.empty(0)

        def use(kernel: LlvmKernel, many: Any = many, parameters: Any = parameters) -> Any:
            alone = kernel(0.0, many[:, 4].copy(), parameters)
            return np.column_stack([alone, kernel(0.0, many, parameters)])

        together, alone = both(program, monkeypatch, use)
        assert np.isfinite(alone).all()
        assert (together == alone).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", SINGULAR, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("n", ORDERS)
def test_a_singular_matrix_of_a_group_is_told(n: int, kind: Matrix) -> None:
    rng = np.random.default_rng(n)
    program = random_program(rng, n)
    assert any(isinstance(step, SolveGroup) for step in steps_of(program))
    good, right = triangle(positive(rng, n)), rng.normal(size=n)
    kernel, y = LlvmKernel(program), np.concatenate([triangle(kind(rng, n)), good, right])
    with pytest.raises(SingularMassMatrix):
        kernel(0.0, y, np.empty(0))
    many = np.repeat(np.concatenate([good, good, right])[:, None], WIDTH, axis=1)
    assert np.isfinite(kernel(0.0, many, np.empty(0))).all()
    many[:, 5] = y
    with pytest.raises(SingularMassMatrix) as raised:
        kernel(0.0, many, np.empty(0))
    assert raised.value.column == 5


def test_an_order_of_groups_is_an_order_of_the_program(share: Share) -> None:
    """Each instruction occurs once, after all that it reads.

    A group has all its right-hand sides and one factorization.
    """
    for seed in range(share(30)):
        rng = np.random.default_rng(seed)
        program, most = random_program(rng, 2), int(rng.integers(1, 33))
        code, steps = program.instructions, steps_of(program, most)
        groups = [step for step in steps if isinstance(step, SolveGroup)]
        grouped = [i for group in groups for i in group.solves]
        assert sorted(step for step in steps if isinstance(step, int)) == list(range(program.hoisted, len(code)))
        assert len(set(grouped)) == len(grouped)
        assert all(2 <= len(group.solves) <= most for group in groups)
        assert bool(groups) == (most > 1)
        done: set[int] = set(range(program.hoisted))
        ready: set[int] = set()
        for step in steps:
            if isinstance(step, SolveGroup):
                assert ready.issuperset(step.solves)
                assert {code[i].args[0] for i in step.solves} == {step.factor}
                done.update(step.solves)
            else:
                assert done.issuperset(code[step].args)
                (ready if step in grouped else done).add(step)
