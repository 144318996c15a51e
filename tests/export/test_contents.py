"""Contents of exported files: requested languages, awkward names, open inputs, useful tests, comments for readers."""

import ctypes
import importlib.util
import keyword
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from itertools import cycle, islice
from pathlib import Path
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pytest
import sympy
from sympy import erf, sin, sqrt

import lagrange as lg
from lagrange.export.contents import contents_of, module_of, names_of
from lagrange.export.languages import c, fortran, javascript, julia, octave, python, rust
from lagrange.export.programs import evaluate
from lagrange.export.straight_line import with_outputs
from lagrange.export.target import REGISTERED, Target, find, register, target_names
from tests.export.callers import named, run
from tests.models import shared_scene
from tests.refusals import refusal
from tests.statement.examples import VALUES, X, at, driven, theta, u

LOADED = """
import sys
import lagrange.system
print(*sorted(name for name in sys.modules if name.startswith("lagrange.export")))
"""


def load(path: Path) -> Any:
    """Import a file."""
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.mark.slow
def test_a_system_loads_no_language_that_it_does_not_write() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert not [name for name in loaded if name.endswith((".write", ".registry", ".c", ".rust", ".fmu", "_printer"))]


def test_divisors_that_are_constants_are_not_tested(tmp_path: Path) -> None:
    x, z = lg.coordinates("x z")
    m = lg.parameters("m")
    for name, kinetic, tested in (
        ("constant", x.dot**2 / 2 + z.dot**2, False),
        ("given", m * x.dot**2 / 2 + z.dot**2, True),
    ):
        lg.System(kinetic, x**2 + z**2, parameters={m: 2}, name=name).export("c", tmp_path)
        assert ("divisors" in (tmp_path / f"{name}.c").read_text()) == tested
        assert ("divisors[1]" in (tmp_path / f"{name}.c").read_text()) == tested


def test_given_functions_stand_by_their_names_in_the_comment(tmp_path: Path) -> None:
    x = lg.coordinate("x")
    k = lg.parameters("k")
    u = lg.given("u", ([0, 1, 2, 3, 4], [0, 1, 0, 1, 0]))
    v = lg.given("v", k * sin(lg.t))
    carried = lg.System((x.dot + v.dot) ** 2 / 2, k * (x - u) ** 2 / 2, parameters={k: 2}, name="carried")
    (_, source, _) = carried.export("c", tmp_path).files
    comment = source.read_text().partition("*/")[0]
    assert "   V = k*(x - u)**2/2\n" in comment
    assert "   u is given by a table of 5 times from 0 to 4.\n" in comment and "   v = k*sin(t)\n" in comment
    assert "Piecewise" not in comment and "parameters: k = 2.0\n" in comment


def test_arrays_that_are_too_short_are_told_by_name(tmp_path: Path) -> None:
    system = shared_scene("double-pendulum")
    system.export("python", tmp_path, ["rhs", "dop853"])
    made = load(tmp_path / "double_pendulum.py")
    p, t, four, three = np.zeros(made.PREPARED), np.zeros(1), np.zeros(4), np.zeros(3)
    made.prepare(made.DEFAULT_PARAMETERS, p)
    with pytest.raises(ValueError, match=r"^y has shape \(3,\): give 4 numbers$"):
        made.rhs(0.0, three, p, four)
    with pytest.raises(ValueError, match=r"^out has shape \(3,\): give 4 numbers$"):
        made.rhs(0.0, four, p, three)
    with pytest.raises(ValueError, match=r"^y has shape \(2, 2\): give 4 numbers$"):
        made.rhs(0.0, four.reshape(2, 2), p, four)
    with pytest.raises(ValueError, match=r"^p has shape \(3,\): give \d+ numbers$"):
        made.dop853(t, 1.0, four, three, 1e-9, 1e-9, 100)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_arrays_that_are_too_short_are_told_by_name_in_javascript(tmp_path: Path) -> None:
    shared_scene("double-pendulum").export("javascript", tmp_path, ["rhs", "dop853"])
    script = (
        'import * as made from "./double_pendulum.mjs"; const given = (n) => new Float64Array(n);'
        "for (const call of [() => made.prepare(given(2), given(99)), "
        "() => made.dop853(given(1), 1, given(3), given(99), 1e-9, 1e-9, 9)])"
        " { try { call(); } catch (error) { console.log(error.name, error.message); } }"
    )
    done = subprocess.run(
        ["node", "--input-type=module", "-e", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "RangeError parameters has 2 numbers: give 5\nRangeError y has 3 numbers: give 4\n"


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["c", "javascript", "rust", "octave", "fortran", "julia", "modelica"])
def test_lines_are_short_and_ascii(target: str, tmp_path: Path) -> None:
    steps = ["dop853", "main"] if target in ("c", "javascript") else []
    contents = ["rhs", "jacobian", *steps, *(["taylor"] if target == "c" else [])]
    made = shared_scene("four-bar").export(target, tmp_path, contents)
    for text in (file.read_text() for file in made.files):
        assert text.isascii() and text.endswith("\n") and not text.endswith("\n\n")
        assert max(map(len, text.splitlines())) <= (132 if target in ("fortran", "julia", "modelica") else 120)


def test_the_tested_run_takes_few_steps() -> None:
    """The test run of 50 particles with close encounters took 3,000 steps in Python."""
    x = lg.coordinate("x")
    fast = lg.System(kinetic=x.dot**2 / 2, potential=1e10 * x**2, initial={x: 1.0}, name="fast")
    model = fast.compile("numpy")
    check = module_of(model, contents_of(find("python"), model, ["dop853"], (), None), ()).step_checks[0]
    assert 1e-5 < check.length < 1e-2
    assert check.result[0] == pytest.approx(np.cos(2e10**0.5 * check.length), abs=1e-9)


# --- Names of values in exported files say what a value is, and differ in the letters that a language distinguishes ---


def test_names_that_differ_beyond_63_letters_stay_different(tmp_path: Path) -> None:
    long = "a" * 63
    system = named([long, f"{long}b", f"{'c' * 62}1", f"{'c' * 62}12"], ["x8", "x9", f"{long}d"])
    system.export("c", tmp_path, ["rhs", "energy"])
    text = (tmp_path / "named.c").read_text()
    body = text.partition("int named_rhs(")[2].partition("\n}\n")[0]
    defined = re.findall(r"const double (\w+) =", body)
    assert len({name[:63] for name in defined}) == len(defined) >= 8
    assert max(map(len, defined)) == 63


@pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")
def test_constants_of_headers_are_renamed(tmp_path: Path) -> None:
    """Compilers define more names than the C standard, unless they get an option."""
    system = named(["M_PI", "SIZE_MAX"], ["M_E", "SEEK_SET", "RAND_MAX", "INT8_MAX", "MAXFLOAT"])
    system.export("c", tmp_path, ["rhs", "energy"])
    command = ["cc", "-std=gnu99", "-Wall", "-Werror", "-fsyntax-only", "named.c", "named_test.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


ENTRIES = {
    "double-pendulum": {"mass_theta1_theta1", "mass_theta1_theta2", "mass_theta2_theta2"},
    "four-bar": {
        *("mass_theta1_theta1", "mass_theta1_theta2", "mass_theta2_theta2", "mass_theta3_theta3"),
        *(f"gradient_{one}_theta{k}" for one in "xy" for k in (1, 2, 3)),
    },
}
"""The entries of the matrix that gives the accelerations, which are not zero, by scene."""


@pytest.mark.parametrize("target", [name for name in target_names() if name not in ("fmu", "octave")])
@pytest.mark.parametrize("scene", ENTRIES)
def test_entries_of_the_matrix_are_named(scene: str, target: str, tmp_path: Path) -> None:
    files = shared_scene(scene).export(target, tmp_path, None if find(target).always else ["rhs"]).files
    text = files[1 if target == "c" else 0].read_text()
    assert set(re.findall(r"\b((?:mass|gradient)_\w+)(?:: f64)? :?= ", text)) == ENTRIES[scene]


@pytest.mark.parametrize("scene", ENTRIES)
def test_named_entries_are_those_of_the_equations(scene: str) -> None:
    """The named entries are compared with SymPy: second derivatives of T, and gradients of constraints."""
    system = shared_scene(scene)
    statement, model = system.statement, system.compile("numpy")
    program = model.law("rhs").program
    named = {ref: name for ref, name in names_of(model).of(program).items() if name in ENTRIES[scene]}
    state, values = statement.initial, model.parameter_array(None).tolist()
    result = evaluate(with_outputs(program, program.instructions, tuple(named)), 0.0, state, values)
    at = {**dict(zip(statement.parameters, values, strict=True)), sympy.Symbol("t"): 0.0}
    at |= dict(zip((*statement.velocities, *statement.coordinates), (*state[len(state) // 2 :], *state), strict=False))
    every = dict(zip(statement.names, zip(statement.coordinates, statement.velocities, strict=True), strict=True))
    for name, value in zip(named.values(), result, strict=True):
        kind, a, b = name.split("_")
        if kind == "mass":
            exact = sympy.diff(statement.kinetic, every[a][1], every[b][1])
        else:
            (constraint,) = (item.expression for item in statement.constraints if item.name == a)
            exact = sympy.diff(constraint, every[b][0])
        assert float(value) == pytest.approx(float(exact.subs(at)), rel=1e-12), name


# --- refusals -------------------------------------------------------------------------------------------------
# Exports that are not possible are refused with a message, and leave no files.


def pendulum(**stated: Any) -> lg.System:
    theta = lg.coordinate("theta")
    m, k = lg.parameters("m k")
    known: dict[str, Any] = {
        "kinetic": m * theta.dot**2 / 2,
        "potential": k * theta**2 / 2,
        "parameters": {m: 1, k: 2},
        "name": "spring",
    }
    return lg.System(**(known | stated))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"target": "basic"}, "there is no target 'basic'; the targets are c"),
        ({"target": "cc"}, "Did you mean 'c'?"),
        ({"contents": ["multipliers"]}, "spring has no constraints, and so no multipliers"),
        ({"contents": ["positions"]}, "spring states no positions to export: state them"),
        ({"contents": ["events"]}, "spring has no events to export: give them"),
        ({"contents": ["jacobain"]}, "Did you mean 'jacobian'?"),
        ({"contents": ["radau5"]}, "the method 'radau5' cannot be exported"),
        ({"contents": "rhs"}, "contents is 'rhs': give a list of names"),
        ({"contents": []}, "contents is []: give a list of names"),
        ({"contents": [3]}, "contents is [3]: give a list of names"),
        ({"parameters": {"z": 1}}, "z"),
        ({"parameters": {"m": 0}}, "the mass matrix of spring is singular in every state with m = 0"),
        ({"target": "fmu", "contents": ["rk4"]}, "runs with error control, which rk4 does not have"),
        ({"target": "fmu", "contents": ["dop853", "tsit5"]}, "one method, and contents has dop853 and tsit5"),
        (
            {"scene": "two-point-vortices", "contents": ["energies"]},
            "two-point-vortices states its Lagrangian alone, not T and V",
        ),
        (
            {"scene": "double-pendulum", "parameters": {"l2": 0.0}},
            "near the initial one with l2 = 0, which the self-test needs",
        ),
        ({"scene": "double-pendulum", "contents": ["verlet"]}, "its mass matrix changes along the motion"),
    ],
)
def test_a_wrong_argument(given: dict[str, Any], said: str, tmp_path: Path) -> None:
    system = shared_scene(given["scene"]) if "scene" in given else pendulum()
    arguments = {"target": "c", "path": tmp_path / "out", **given}
    arguments.pop("scene", None)
    assert said in refusal(system.export, **arguments)
    assert not (tmp_path / "out").exists()


def test_a_parameter_without_a_value(tmp_path: Path) -> None:
    theta = lg.coordinate("theta")
    m, k = lg.parameters("m k")
    system = lg.System(kinetic=m * theta.dot**2 / 2, potential=k * theta**2 / 2, parameters={m: 1})
    assert "k" in refusal(system.export, "c", tmp_path)
    assert system.export("c", tmp_path, parameters={k: 3.0}).files


class Plain(Target):
    """A user's target that has no error function (erf)."""

    name = "plain"
    about = "one line"
    contents = frozenset[str]()
    inexpressible = frozenset(("erf",))

    def files(self, module: Any) -> dict[str, str | bytes]:
        return {f"{module.name}.txt": "\n".join(quantity.name for quantity in module.quantities) + "\n"}

    def commands(self, module: Any) -> list[str]:
        return [f"test -f {module.name}.txt"]


@pytest.fixture
def plain() -> Any:
    register(Plain)
    yield find("plain")
    del REGISTERED["plain"]


@pytest.mark.usefixtures("plain")
def test_a_target_of_a_users_own(tmp_path: Path) -> None:
    assert lg.targets()["plain"] == "one line"
    made = pendulum().export("plain", tmp_path, ["rhs", "momenta"])
    assert (tmp_path / "spring.txt").read_text() == "rhs\nmomenta\n"
    assert made.commands == ("test -f spring.txt",)
    with pytest.raises(lg.StatementError, match="target 'plain' has no rk4: leave it out of contents, or take c"):
        pendulum().export("plain", tmp_path, ["rk4"])


@pytest.mark.usefixtures("plain")
def test_a_function_that_a_target_does_not_have(tmp_path: Path) -> None:
    theta = lg.coordinate("theta")
    with pytest.raises(lg.StatementError, match="contains erf, which target 'plain' has no function for: c"):
        lg.System(kinetic=theta.dot**2 / 2, potential=erf(theta), name="spring").export("plain", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_target() -> None:
    assert "is not a target" in refusal(register, cast("Any", dict))
    with pytest.raises(lg.StatementError, match="there is a target 'fortran' already: give another name"):
        register(type("Mine", (Plain,), {"name": "fortran"}))


def test_a_step_is_tested_elsewhere_where_there_is_no_motion_from_the_initial_state(tmp_path: Path) -> None:
    x, y = lg.coordinates("x y")
    kepler = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sqrt(x**2 + y**2), name="kepler")
    assert kepler.export("c", tmp_path, ["rk4", "dop853"]).files


# --- awkward names are allowed with every registered target ----------------------------------------------------


STRICT = {
    "cc -std=c99": "cc -std=c99 -Wall -Wextra -Wconversion -Werror",
    "gfortran": "gfortran -Wall -Wextra -Werror",
    "rustc": "rustc -D warnings",
    "python": "python -W error",
}
"""What makes warnings errors, by how a command begins."""

PACKAGES = {"jax": "jax", "casadi": "casadi"}
"""What a target needs of Python, beside NumPy."""


def missing(target: str, commands: Sequence[str] = ()) -> str:
    """Return the reason why a target cannot be tested here, or an empty text."""
    package = PACKAGES.get(target)
    if package and importlib.util.find_spec(package) is None:
        return f"{package} is not installed"
    words = [command.split()[0] for command in commands]
    return next((f"{word} is not installed" for word in words if not word.startswith("./") and not found(word)), "")


def found(word: str) -> bool:
    return word == "python" or shutil.which(word) is not None


def strict(command: str) -> str:
    """Return a command whose warnings are errors."""
    plain = next((item for item in STRICT if command.startswith(f"{item} ")), "")
    return command.replace(plain, STRICT[plain], 1) if plain else command


def passes(target: str, system: lg.System, folder: Path) -> None:
    """Export a system, and run its test without warnings."""
    steps = ["rk4"] if "steps" in find(target).contents else []
    made = system.export(target, folder, ["rhs", "energy", *steps])
    why = missing(target, made.commands)
    if why:
        pytest.skip(why)
    said = [run(strict(command), folder) for command in made.commands][-1]
    assert re.search(r"(\d+) of \1 results are right\n$", said), said


WORDS = (
    *("x0", "x1", "x2", "lam1", "_t", "t_", "t1", "dt", "θ", "θ1", "theta", "ω2", "Ω", "ψ", "φ", "ε", "λ1", "Δ", "π1"),
    *("a" * 63, "a" * 64, "b" * 62, "m", "M", "y", "Y", "p", "P", "out", "out_at", "q", "v", "h", "rhs", "energy"),
    *("prepare", "main", "test", "results", "singular", "inf", "nan", "jnp", "ca", "jax", "np", "pi", "e", "j", "I"),
    *("a1", "A1", "a_1", "a__1", "M_PI", "NULL", "errno", "stdin", "model", "equation", "der", "time", "parameter"),
    *(f"{stem}{k}" for stem in ("x", "lam", "y", "p", "t", "s", "f", "r") for k in range(20)),
    *keyword.kwlist,
    *c.RESERVED,
    *fortran.RESERVED,
    *javascript.RESERVED,
    *julia.RESERVED,
    *octave.RESERVED,
    *python.RESERVED,
    *rust.RESERVED,
)
TITLES = ("while", "θ", "a" * 64, "end", "math", "numpy", "class", "program", "stdio", "Main", "x0", "lambda", "julia")
AT_ONCE, COORDINATES = 250, 8


def awkward() -> Iterator[str]:
    """Return words, in several cases, as names of coordinates and parameters."""
    cases = dict.fromkeys(item for word in WORDS for item in (word, word.capitalize(), word.upper()))
    return (word for word in cases if accepted(word))


def accepted(word: str) -> bool:
    """Return True if a statement accepts a word as a name."""
    try:
        lg.coordinate(word)
        lg.parameters(word)
    except lg.StatementError:
        return False
    return True


def systems(at_once: int) -> Iterator[lg.System]:
    """Yield systems with awkward names, all of which are used."""
    words, titles = awkward(), cycle(TITLES)
    while some := [*islice(words, at_once)]:
        yield named(some[:COORDINATES], some[COORDINATES:], next(titles))


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "target", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("fmu", "jax"))) for name in lg.targets()]
)
def test_awkward_names(target: str, tmp_path: Path) -> None:
    passes(target, next(systems(60)), tmp_path)


@pytest.mark.conformance
@pytest.mark.parametrize("target", list(lg.targets()))
def test_more_than_a_thousand_awkward_names(target: str, tmp_path: Path) -> None:
    count = 0
    for k, system in enumerate(systems(AT_ONCE)):
        (tmp_path / str(k)).mkdir()
        passes(target, system, tmp_path / str(k))
        count += len(system.coordinates) + len(system.parameters)
    assert count >= 1500


# --- open inputs: entries of the parameters that may change along a motion, and inputs of FMUs -----------------


STATE, TIME = [0.7, -1.3], 0.4


@pytest.fixture(scope="module")
def expected() -> list[float]:
    """Return the right-hand side at a state for values of the inputs."""
    result: list[float] = driven().substitute(VALUES).compile("numpy").rhs(TIME, STATE).tolist()
    return result


@pytest.mark.parametrize("target", [target for target in lg.targets() if target != "fmu"])
def test_every_target_takes_inputs(target: str, tmp_path: Path) -> None:
    made = driven().export(target, tmp_path, ["rhs"], parameters=at(TIME))
    texts = [path.read_text() for path in made.files]
    assert any("inputs: X, X_dot, X_ddot, u:" in text for text in texts)
    if target == "modelica":
        assert any("  input Real u(start = " in text for text in texts)


def test_an_input_is_written_into_what_was_prepared(tmp_path: Path, expected: list[float]) -> None:
    driven().export("c", tmp_path, ["rhs"])
    command = ["cc", "-shared", "-fPIC", "-O1", "-o", "driven.so", "driven.c", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "driven.so"))
    prepared, out = (ctypes.c_double * 100)(), (ctypes.c_double * 2)()
    assert library.driven_prepare((ctypes.c_double * 7)(1.5, 9.81, 2.0), prepared) == 0
    prepared[3:7] = list(at(TIME).values())
    assert library.driven_rhs(ctypes.c_double(TIME), (ctypes.c_double * 2)(*STATE), prepared, out) == 0
    np.testing.assert_allclose(list(out), expected, rtol=1e-13)


def test_an_fmu_has_variables_of_causality_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)  # the description needs no library
    made = driven().export("fmu", tmp_path, ["rhs", "jacobian"])
    for path in made.files:
        with zipfile.ZipFile(path) as packed:
            root = ElementTree.fromstring(packed.read("modelDescription.xml"))
        scalars = [*root.iter("ScalarVariable"), *root.iter("Float64")]
        inputs = [item for item in scalars if item.get("causality") == "input"]
        assert [item.get("name") for item in inputs] == ["X", "X_dot", "X_ddot", "u"]
        assert {item.get("variability") for item in inputs} == {"continuous"}
        assert {item.get("initial") for item in inputs} == {None}
        exchange = root.find("ModelExchange")
        assert exchange is not None
        key = "providesDirectionalDerivative" + "s" * ("fmi3" in path.name)
        assert exchange.get(key) == "false"


def test_a_series_of_an_open_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match="taylor needs every derivative of X and u, which has no formula"):
        driven().export("c", tmp_path, ["taylor"])


@pytest.mark.slow
def test_casadi_and_jax_take_inputs_in_the_parameters(expected: list[float]) -> None:
    model = driven().compile("numpy")
    p = model.parameter_array(at(TIME))
    casadi = pytest.importorskip("casadi", reason="CasADi is not installed")
    rhs, symbol = model.as_casadi("rhs"), casadi.SX.sym("p", 7)
    np.testing.assert_allclose(rhs(TIME, STATE, p.tolist()).full().ravel(), expected, rtol=1e-13)
    slope = casadi.Function("B", [symbol], [casadi.jacobian(rhs(TIME, STATE, symbol), symbol[6])])
    np.testing.assert_allclose(slope(p.tolist()).full().ravel(), [0, 1 / (1.5 * 4)], rtol=1e-13)
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    jax.config.update("jax_enable_x64", val=True)
    np.testing.assert_allclose(model.as_jax("rhs")(TIME, STATE, p), expected, rtol=1e-13)


@pytest.mark.slow
def test_a_run_without_values_of_inputs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match=r"its inputs X and u have no value: give a constant value") as refusal:
        driven().export("c", tmp_path, ["main"])
    assert len(str(refusal.value)) <= 400 and list(tmp_path.iterdir()) == []
    driven().export("c", tmp_path, ["main"], parameters={"X": 0, "u": 0.5})  # the rates of X are zero
    subprocess.run(["cc", "-O1", "-o", "main", "driven.c", "driven_main.c", "-lm"], cwd=tmp_path, check=True)
    rows = subprocess.run(["./main", "1.0"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout.split()
    other = driven().substitute({X: 0, u: 0.5}).run(1.0, rtol=1e-10)
    # main has a tolerance of 1e-8.
    assert float(rows[-1].split(",")[1]) == pytest.approx(other[theta][-1], rel=1e-6)


@pytest.mark.slow
def test_the_rate_of_a_constant_input_is_zero(tmp_path: Path) -> None:
    i, voltage = lg.coordinate("i"), lg.given("u")
    circuit = lg.System(kinetic=0, forces={i: voltage - i}, dissipation=i.dot**2 / 2, name="circuit")
    assert "u_dot" in [symbol.name for symbol in circuit.compile("numpy").statement.parameters]
    assert "its input u has no value: give" in refusal(circuit.export, "python", tmp_path, ["main"])
    texts = []
    for held in ({voltage: 12.0}, {voltage: 12.0, voltage.dot: 0.0}):
        made = circuit.export("python", tmp_path, ["rhs", "dop853", "main"], parameters=held)
        texts.append([path.read_text() for path in made.files])
    assert texts[0] == texts[1]
