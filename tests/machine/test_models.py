"""Models on both machines: equal results for one state and in columns, all outputs, and error messages."""

import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
import sympy as sp
from llvmlite.binding.executionengine import ExecutionEngine
from sympy import sin

import lagrange as lg
from lagrange.compiler import machine, model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.errors import RunError, StatementError
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import KernelCode
from lagrange.machine.llvm import engine
from lagrange.machine.model import Model
from lagrange.program.catalogue import QUANTITIES, program_of
from tests.models import SYSTEMS, TARGETS, M, build, k, m, model, shared_scene, x, y, z
from tests.refusals import refusal

WIDTHS = (1, 2, 7, 8, 9, 64)
KEPT: list[Any] = []
"""Code that kernels of other tests call; it must not go away."""


def states(name: str, width: int, seed: int = 1) -> tuple[Any, Any, Any]:
    rng = np.random.default_rng(seed)
    n = model(name).dimension
    return rng.uniform(0.3, 1.2, (n, width)), rng.uniform(-1, 1, (n, width)), rng.uniform(0, 3, width)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", SYSTEMS)
def test_both_machines_give_the_same_for_every_quantity_and_element(name: str) -> None:
    q, v, t = states(name, 3)
    for quantity in QUANTITIES:
        for i in range(3):
            compiled = model(name, "llvm").evaluate(quantity, q[:, i], v[:, i], t[i])
            reference = model(name, "numpy").evaluate(quantity, q[:, i], v[:, i], t[i])
            assert np.shape(compiled) == np.shape(reference)
            assert compiled == pytest.approx(reference, rel=1e-11, abs=1e-11), quantity


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_columns_are_the_states_one_by_one(name: str, target: str) -> None:
    compiled = model(name, target)
    for width in WIDTHS:
        q, v, t = states(name, width)
        for quantity in ("rhs", "accelerations") if width > 2 else QUANTITIES:
            together = compiled.evaluate(quantity, q, v, t)
            alone = [compiled.evaluate(quantity, q[:, i], v[:, i], t[i]) for i in range(width)]
            assert together.shape == (*np.shape(alone[0]), width)
            assert together == pytest.approx(np.stack(alone, axis=-1), rel=1e-12, abs=1e-12), (quantity, width)


@pytest.mark.parametrize("name", ["8 carried masses", "friction"])
def test_every_output_is_written(name: str) -> None:
    """The machine code gets an output array full of NaN with additional entries, which it must not change."""
    import ctypes

    compiled = model(name, "llvm")
    q, v, t = states(name, 1)
    y = np.concatenate([q[:, 0], v[:, 0]])
    for quantity in ("rhs", "jacobian", "mass_matrix"):
        kernel: Any = compiled.kernel(quantity)
        prepared = kernel.prepare(compiled.parameter_array())
        call = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, *[ctypes.c_void_p] * 3)(kernel.address)
        size = len(kernel.program.outputs)
        out = np.full(size + 8, np.nan)
        assert call(float(t[0]), y.ctypes.data, prepared.ctypes.data, out.ctypes.data) == 0
        assert np.isfinite(out[:size]).all() and np.isnan(out[size:]).all()
        assert out[:size] == pytest.approx(np.ravel(kernel(float(t[0]), y, compiled.parameter_array())), rel=0, abs=0)


@pytest.mark.parametrize("target", TARGETS)
def test_time_is_one_number_or_one_per_column(target: str) -> None:
    compiled = model("bead on a hoop", target)
    q, v = np.full((1, 5), 0.4), np.full((1, 5), 0.2)
    times = np.linspace(0, 1, 5)
    several = compiled.evaluate("lagrangian", q, v, times)
    assert several[3] == pytest.approx(compiled.evaluate("lagrangian", q[:, 0], v[:, 0], times[3]), rel=1e-13)
    one = compiled.evaluate("lagrangian", q, v, np.float64(0.75))
    assert one == pytest.approx(np.full(5, several[3]), rel=1e-13)
    assert compiled.evaluate("lagrangian", q, v, sp.Rational(3, 4)) == pytest.approx(one, rel=0, abs=0)
    assert compiled.energy(q[:, :0], v[:, :0]).shape == (0,)


@pytest.mark.parametrize("target", TARGETS)
def test_a_singular_mass_matrix_is_reported_with_its_configuration_or_parameters(target: str) -> None:
    """Two masses on one rail that a guide couples: at y = 0 nothing resists x. A regular matrix is not reported."""
    kinetic = m * (x.dot * sin(y) + y.dot) ** 2 / 2 + M * y.dot**2 / 2
    compiled = build(target, kinetic=kinetic, potential=k * x, coordinates=[x, y])
    assert np.isfinite(compiled.accelerations([0.3, 0.5], [0.1, 0.2])).all()
    with pytest.raises(RunError, match=r"singular at t = 1\.5, x = 0\.3, y = 0: the accelerations are not determined"):
        compiled.accelerations([0.3, 0.0], [0.1, 0.2], 1.5)
    q = np.array([np.full(12, 0.3), np.linspace(0.1, 1.2, 12)])
    q[1, 9] = 0.0
    with pytest.raises(RunError, match=r"singular at t = 0\.9, x = 0\.3, y = 0:"):
        compiled.accelerations(q, np.ones((2, 12)), np.arange(12) / 10)
    with pytest.raises(RunError, match="singular"):
        compiled.jacobian(0.0, [0.3, 0.0, 0.1, 0.2])
    assert np.isfinite(compiled.energy(q, np.ones((2, 12)))).all()  # no inverse is needed for it
    with pytest.raises(RunError, match=r"a motion with x\.dot = 1, y\.dot = -1 has no inertia with m = 0, so"):
        model("coupled masses", target).accelerations(np.ones((2, 3)), np.ones((2, 3)), parameters={"m": 0.0})


def test_machine_code_that_is_being_freed_is_not_given_to_another_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM lets other threads run while it frees code, so the code is first removed from the list of used code."""
    kept: list[bytes] = []
    dispose = ExecutionEngine._dispose

    def freed(self: ExecutionEngine) -> None:
        kept.extend(key for key, loaded in engine._ENGINES.items() if loaded._engine is self)
        dispose(self)

    monkeypatch.setattr(ExecutionEngine, "_dispose", freed)
    code = engine.Module("define double @freed_soon(double %x) {\n  ret double %x\n}")
    keys = set(engine._ENGINES)
    address = code.address("freed_soon")
    del code
    assert address and len(keys - set(engine._ENGINES)) == 1 and not kept


def test_threads_compile_their_first_models_at_once() -> None:
    """The shared linear solver is compiled once, by any thread."""
    KEPT.extend(engine._linear_solver(often) for often in (True, False))
    engine._linear_solver.cache_clear()
    engine._ENGINES.clear()
    statements = [SYSTEMS[name]() for name in ("double pendulum", "8 carried masses", "saddle", "coupled masses") * 2]
    equations = [euler_lagrange(statement) for statement in statements]
    gate = threading.Barrier(len(statements))

    def work(i: int) -> Any:
        gate.wait()
        fresh = model_of(statements[i], machine("llvm"), equations[i])
        n = fresh.dimension
        return fresh.accelerations(np.full(n, 0.4), np.full(n, 0.2))

    with ThreadPoolExecutor(len(statements)) as pool:
        result = list(pool.map(work, range(len(statements))))
    for i, values in enumerate(result):
        reference = model_of(statements[i], machine("numpy"), equations[i])
        n = reference.dimension
        assert values == pytest.approx(reference.accelerations(np.full(n, 0.4), np.full(n, 0.2)), rel=1e-10)


@pytest.mark.parametrize("target", TARGETS)
def test_the_name_of_a_program_means_nothing(target: str) -> None:
    """The record of a procedure, not its name, says which arguments and results are passed in registers."""
    program = program_of("rhs", euler_lagrange(SYSTEMS["double pendulum"]()))
    second = machine(target).load(replace(program, name="momentum"))
    kernel = machine(target).load(program)
    state, values = np.array([0.3, 0.4, -0.2, 0.5]), model("double pendulum", target).parameter_array()
    assert (second(0.0, state, values) == kernel(0.0, state, values)).all()
    many = np.stack([state, 2 * state], axis=1)
    assert (second(0.0, many, values) == kernel(0.0, many, values)).all()
    assert [*program.inputs, *program.results] == [("q", 2), ("v", 2), ("rate", 2), ("acceleration", 2)]
    assert program.returned == ("acceleration",) and program.solved
    if target == "llvm":
        alone, text = (KernelCode(first).scalar_module() for first in (second.program, program))
        assert alone.replace("@momentum", "@rhs") == text
        silent = KernelCode(replace(program, returned=())).scalar_module()
        assert "rhs_registers" in text and "rhs_registers" not in silent


@pytest.mark.parametrize("target", TARGETS)
def test_other_defaults_change_the_values_and_compile_nothing(target: str) -> None:
    first = lg.scene("pendulum").compile(target)
    before = first.accelerations([0.3], [0.2])
    other = first.with_defaults({"l": 2.0})
    assert other.kernel("accelerations") is first.kernel("accelerations")
    assert other.accelerations([0.3], [0.2]) == first.accelerations([0.3], [0.2], parameters={"l": 2.0}) != before
    assert first.accelerations([0.3], [0.2]) == before
    assert pickle.loads(pickle.dumps(other)).statement.defaults == other.statement.defaults
    assert "mass" in refusal(first.with_defaults, {"mass": 1.0})


# --- refusals -------------------------------------------------------------------------------------------------
# What a model cannot be asked is refused in the system's own names.

REFUSED: dict[str, tuple[Callable[[Model], Any], str]] = {
    "short": (
        lambda of: of.accelerations([1.0], [1.0]),
        r"q has shape \(1,\); this system has 2 coordinates \(a0, a1\): give \(2,\), or \(2, batch\)",
    ),
    "short v": (lambda of: of.accelerations([1.0, 2.0], [1.0]), r"v has shape \(1,\); this system has 2 coordinates"),
    "unlike": (
        lambda of: of.accelerations(np.ones((2, 2)), np.ones((2, 3))),
        r"q has shape \(2, 2\) and v \(2, 3\): give both the same shape",
    ),
    "cube": (lambda of: of.accelerations(np.ones((2, 2, 2)), np.ones((2, 2, 2))), r"q has shape \(2, 2, 2\)"),
    "complex": (lambda of: of.accelerations([1j, 0], [0, 0]), "q has entries of type complex128: give real numbers"),
    "ragged": (
        lambda of: of.accelerations([[1, 2], [3]], [[1, 2], [3]]),
        r"q is not an array: .* Give rows of one length",
    ),
    "state": (lambda of: of.rhs(0.0, [1, 2, 3]), r"y has shape \(3,\): give \[q, v\] of shape \(4,\), or \(4, batch\)"),
    "complex state": (lambda of: of.jacobian(0.0, np.ones(4) * 1j), "y has entries of type complex128"),
    "times": (
        lambda of: of.accelerations(np.ones((2, 2)), np.ones((2, 2)), np.zeros(3)),
        r"t has shape \(3,\), but the batch of states has shape \(2,\): give one time, or one for each",
    ),
    "complex time": (
        lambda of: of.accelerations(np.ones((2, 2)), np.ones((2, 2)), 1j),
        "the time t is 1j, a complex number",
    ),
    "time of no column": (
        lambda of: of.accelerations(np.ones(2), np.ones(2), [0.0]),
        r"t has shape \(1,\), but the batch of states has shape \(\)",
    ),
    "parameter": (
        lambda of: of.accelerations([0.1, 0.2], [0, 0], parameters={"mass": 1}),
        "'mass' is not a parameter of this system; its parameters are",
    ),
    "quantity": (
        lambda of: of.evaluate("speed", [0, 0], [0, 0]),
        "'speed' is not a quantity of a model: they are rhs, jacobian",
    ),
    "expression": (
        lambda of: of.evaluate_expression(z, 0.0, np.ones((4, 2))),
        r"the expression contains z\(t\), which this system does not have",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_meant_is_refused_in_the_names_of_the_system(what: str) -> None:
    call, message = REFUSED[what]
    for target in TARGETS:
        with pytest.raises(StatementError, match=message):
            call(model("double pendulum", target))


@pytest.mark.parametrize(("name", "count"), [("none", 0), ("two words", 1), ("", 1)])
def test_a_function_has_a_name_and_a_node(name: str, count: int) -> None:
    compiled = model("oscillator")
    with pytest.raises(StatementError, match=f"function\\('{name}', nodes\\) with {count} node"):
        compiled.function(name, compiled.equations.q[:count])


def test_a_kernel_says_what_it_is() -> None:
    compiled = model("pendulum")
    kernel: Any = compiled.kernel("rhs")
    assert kernel.program.name == "rhs" and "define i32 @rhs(double %t" in kernel.ir
    assert compiled.kernel("rhs") is kernel
    assert repr(compiled) == "<Model of pendulum (theta) on llvm>"
    many = lg.coordinates(" ".join(f"u{i}" for i in range(50)))
    chain = lg.System(sum((q.dot**2 for q in many), sp.S.Zero), name="chain")
    assert repr(chain) == "<System chain: u0, u1, u2, u3, u4, u5, u6, u7 and 42 others>"
    assert isinstance(SingularMassMatrix(3), RunError)


def test_python_has_no_address_and_says_where_one_is() -> None:
    kernel = shared_scene("pendulum").compile("numpy").kernel("rhs")
    with pytest.raises(
        StatementError, match=r"no address: take the machine code of the llvm target, system\.compile\('llvm'\)"
    ):
        attrgetter("address")(kernel)
