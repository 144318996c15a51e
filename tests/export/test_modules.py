"""Models exported to the languages that run here: no warnings, right numbers, a status; features of one language."""

import math
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.algorithm.constants import Outcome
from lagrange.errors import StatementError
from lagrange.export.contents import MAIN_RTOL
from lagrange.export.elimination import ROWS, factored, solved
from lagrange.export.target import QUANTITIES, find
from lagrange.program.program import Instruction, Program, ProgramBlock
from tests.covering import Share
from tests.export.callers import (
    LANGUAGES,
    SPECIAL,
    Call,
    as_module,
    called,
    edges,
    every_scene,
    graph,
    held,
    main_command,
    missing,
    named,
    points,
    rarer,
    rarer_results,
    run,
    section,
    tried,
    write,
    wrong,
)
from tests.models import shared_scene

TARGETS = [
    pytest.param(name, marks=pytest.mark.skipif(bool(missing(name)), reason=missing(name) or "it is there"))
    for name in LANGUAGES
]
every_target = pytest.mark.parametrize("target", TARGETS)


def stepping(target: str) -> bool:
    """Return True if a target has steps, runs and `main`."""
    return "steps" in find(target).contents


with_steps = pytest.mark.parametrize("target", [one for one in TARGETS if stepping(str(one.values[0]))])


def every_second(first: int) -> pytest.MarkDecorator:
    """Return all languages as test parameters; a default run takes every second one, because compilers are slow."""
    return pytest.mark.parametrize("target", [
        pytest.param(*item.values, marks=[*item.marks, *[pytest.mark.slow] * ((k + first) % 2)])
        for k, item in enumerate(TARGETS)
    ])  # fmt: skip


@pytest.mark.few(1)
@every_target
@pytest.mark.parametrize("scene", every_scene("double-pendulum", "cartesian-double-pendulum"))
def test_a_scene_conforms(target: str, scene: str, tmp_path: Path) -> None:
    """Compile all contents of a scene, run the self-test, and compare the table of main with our trajectory."""
    system = shared_scene(scene)
    contents = [item for item in CONTENTS if item in QUANTITIES or stepping(target)]
    made = system.export(target, tmp_path, [*contents, *held(system)])
    for text in (file.read_text() for file in made.files):
        assert text.isascii() and text.endswith("\n") and not text.endswith("\n\n")
    for command in LANGUAGES[target].strict:
        run(command.format(module=scene.replace("-", "_")), tmp_path)
    assert [run(command, tmp_path) for command in made.commands][-1].endswith("results are right\n")
    if not stepping(target):
        return
    end = min(1.0, system.statement.run.t_end)
    *build, start = made.run_commands
    for command in build:
        run(command, tmp_path)
    head, *rows = run(main_command(start, end, 4), tmp_path).splitlines()
    names = system.statement.names
    assert head.split(",") == ["t", *names, *(f"{name}_dot" for name in names)]
    result = np.array([row.split(",") for row in rows], dtype=float)
    # Both take the tolerance of main. Ours is interpolated where main stops, so the steps are not the same.
    rtol = min(MAIN_RTOL, float(system.statement.run.rtol or MAIN_RTOL))
    ours = system.run(end, method="dop853", rtol=rtol, atol=rtol, t_eval=result[:, 0]).y.T
    assert result[:, 0] == pytest.approx(np.linspace(0.0, end, 5), rel=1e-15)
    assert result[:, 1:] == pytest.approx(ours, rel=1000 * rtol, abs=1000 * rtol * np.abs(ours).max())


WRONG: dict[str, tuple[str, str]] = {
    "fortran": ("out(2) = ", "out(2) = 1.00000000001_dp * "),
    "octave": ("    out(2) = ", "    out(2) = 1.00000000001 * "),
    "javascript": ("out[out_at + 1] = ", "out[out_at + 1] = 1.00000000001 * "),
    "rust": ("    out[1] = ", "    out[1] = 1.00000000001 * "),
    "python": ("out[1] = ", "out[1] = 1.00000000001 * "),
    "c": ("out[1] = ", "out[1] = 1.00000000001 * "),
}


@pytest.mark.few(1)
@every_target
def test_a_wrong_number_fails_the_self_test(target: str, tmp_path: Path) -> None:
    made = shared_scene("pendulum").export(target, tmp_path)
    file = next(item for item in made.files if WRONG[target][0] in item.read_text())
    assert WRONG[target][0] in file.read_text()
    file.write_text(file.read_text().replace(*WRONG[target], 1))
    *build, start = made.commands
    for command in build:
        run(command, tmp_path)
    first = LANGUAGES[target].first
    wrong_ones = [f"rhs, state {first + k}, result {first + 1}: " for k in (0, 5)]
    with pytest.raises(AssertionError, match=rf"{wrong_ones[0]}[^\n]+ instead of (.|\n)*{wrong_ones[1]}"):
        run(start, tmp_path)


@pytest.mark.few(1)
@every_second(0)
def test_random_graphs(target: str, tmp_path: Path, share: Share) -> None:
    without = sorted(find(target).inexpressible)
    programs = [*(graph(seed, without) for seed in range(share(60))), edges(without)]
    others = [rarer()] if stepping(target) else []
    file = write(target, as_module(programs, others), tmp_path)
    states = {program.name: points(k, 6) for k, program in enumerate(programs)}
    states["edges"] = [[a, b, 0.0, 0.0] for a in SPECIAL for b in (*SPECIAL, 0.5, -2.5)]
    calls = [Call(item.name, 0.0, y, len(item.outputs)) for item in programs for y in states[item.name]]
    pairs = [(2.5, -7.0), (-0.4, -0.0), (3.5, 9.0), (-1e300, 4.0), (5e-324, -3.0), (math.inf, 1.0), (math.nan, -2.0)]
    rare = [Call("rarer", 0.0, [*pair, 0.0, 0.0], 8) for pair in pairs if others]
    _, *result = called(target, file, [*calls, *rare])
    by_name = {program.name: program for program in programs}
    complaints = [
        line
        for call, item in zip(calls, result, strict=False)
        for line in wrong(by_name[call.name], call.y, item.values)
    ]
    assert not complaints, "\n".join(complaints[:20])
    for (a, b), item in zip(pairs, result[len(calls) :], strict=bool(others)):
        rest = slice(0, 8) if math.isfinite(a) and abs(a) >= 2.3e-308 else [0, 1, 2, 4, 5, 6, 7]  # else no mantissa
        np.testing.assert_array_equal(np.array(item.values)[rest], np.array(rarer_results(a, b))[rest])


def on_a_sphere() -> lg.System:
    """Return a system whose mass matrix is diagonal, and singular at x = 0."""
    x, z = lg.coordinates("x z")
    m, g = lg.parameters("m g")
    return lg.System(
        kinetic=m * (x.dot**2 + sin(x) ** 2 * z.dot**2) / 2,
        potential=m * g * x**2 / 2,
        parameters={m: 1, g: 2},
        initial={x: 1.0, z.dot: 0.5},
        name="sphere",
    )


def coupled() -> lg.System:
    """Return a system with a coupled mass matrix that is singular at x = 0."""
    x, z = lg.coordinates("x z")
    m, g = lg.parameters("m g")
    return lg.System(
        kinetic=m * (x.dot**2 / 2 + cos(x) * x.dot * z.dot + z.dot**2 / 2),
        potential=m * g * x**2 / 2,
        parameters={m: 1, g: 2},
        initial={x: 1.0, z.dot: 0.5},
        name="coupled",
    )


@pytest.mark.few(1)
@every_second(0)
@pytest.mark.parametrize("stated", [coupled, on_a_sphere])
def test_a_singular_matrix_is_a_status(target: str, stated: Callable[[], lg.System], tmp_path: Path) -> None:
    system = stated()
    system.export(target, tmp_path, ["rhs", "jacobian", "energy", *(["rk4", "dop853"] if stepping(target) else [])])
    file = tmp_path / system.statement.name
    zero, good = [0.0, 0.0, 0.5, 0.1], [1.0, 0.0, 0.0, 0.5]
    calls = [Call("rhs", 0.0, zero, 4), Call("jacobian", 0.0, zero, 16), Call("energy", 0.0, zero, 1)]
    calls.append(Call("rhs", 0.0, good, 4))
    if stepping(target):
        calls += [Call("rk4", 0.0, zero, step=0.1), Call("dop853", 0.0, zero, end=1.0)]
        calls += [Call("rk4", 0.0, good, step=0.1), Call("dop853", 0.0, good, end=0.1)]
    prepared, *result = called(target, file, calls, [1.0, 2.0])
    assert prepared.status == 0
    assert [item.status for item in result[:4]] == [1, 1, 0, 0]
    assert result[3].values[2:] == pytest.approx(system.compile().accelerations(good[:2], good[2:]), rel=1e-14)
    if stepping(target):
        steps, singular, done = result[4:], int(Outcome.SINGULAR), int(Outcome.DONE)
        assert [item.status for item in steps] == [singular, steps[1].status, done, done]
        # The controller takes a singular matrix for a step that is too long. What was given is kept.
        assert steps[1].status in (singular, Outcome.STEP_TOO_SMALL)
        assert steps[0].values == steps[1].values == zero


@pytest.mark.few(1)
@every_second(1)
def test_a_matrix_of_parameters_that_is_singular_is_a_status(target: str, tmp_path: Path) -> None:
    x, z = lg.coordinates("x z")
    m, k = lg.parameters("m k")
    system = lg.System(
        kinetic=m * (x.dot**2 + z.dot**2) / 2 + k * x.dot * z.dot,
        potential=x**2 + z**2,
        parameters={m: 2, k: 1},
        initial={x: 1.0},
        name="masses",
    )
    system.export(target, tmp_path, ["rhs"])
    file = tmp_path / "masses"
    call = Call("rhs", 0.0, [1.0, 0.5, 0.0, 0.0], 4)
    assert [max(item.status for item in called(target, file, [call], [2.0, k])) for k in (1.0, 2.0)] == [0, 1]


FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FENCES = {"javascript": "js", "python": "py"}
"""Words for a language at its blocks of code, where they are not its name."""


@pytest.mark.few(1)
@every_target
def test_the_program_on_the_page_runs(target: str, tmp_path: Path) -> None:
    """It prints the end of a run and its energy, or rates and energy at the start, which may be followed by the end."""
    blocks = FENCE.findall(section({"javascript": "JavaScript"}.get(target, target.capitalize())))
    (program,) = (body for kind, body in blocks if kind == FENCES.get(target, target))
    lines = [line for kind, body in blocks if kind == "sh" for line in body.splitlines()]
    file = f"program.{LANGUAGES[target].suffix}"
    (tmp_path / file).write_text(program)
    system = shared_scene("double-pendulum")
    made = system.export(target, tmp_path, ["rhs", "energy", *(["dop853", "main"] if stepping(target) else [])])
    assert " && ".join(made.commands) in lines  # how the self-test is run
    printed = run(next((line for line in lines if file in line), f"python {file}"), tmp_path)
    printed += run("./program", tmp_path) if (tmp_path / "program").exists() else ""
    result = [float(word) for word in printed.split()]
    model, q, v, changed = system.compile(), [1.0, 0.5], [0.0, 0.0], {"l2": 0.5}
    end = system.run(2.0, initial={"theta1": 1.0, "theta2": 0.5}, parameters=changed, rtol=1e-12).y[:2, -1]
    energy = model.energy(q, v, parameters=changed)
    if stepping(target):
        assert result[:2] == pytest.approx(end, abs=1e-8)  # dop853 at 1e-10 over two units of time
        assert result[2] == pytest.approx(energy, rel=1e-9)
    else:
        # Twelve decimals are printed; ode45 has a relative tolerance of 1e-8, and five digits of its end are printed.
        assert result[:3] == pytest.approx([*model.accelerations(q, v, parameters=changed), energy], rel=0, abs=1e-11)
        assert result[3:] == pytest.approx(end[: len(result) - 3], abs=1e-5)


@pytest.mark.few(1)
@every_second(0)
def test_operations_on_constants_have_the_values_of_doubles(target: str, tmp_path: Path) -> None:
    code = [Instruction("constant", value=value) for value in (1.0, 0.0, 1e300, -1.0)]
    code += [
        Instruction("div", (0, 1)),
        Instruction("mul", (2, 2)),
        Instruction("sqrt", (3,)),
        Instruction("log", (1,)),
    ]
    code += [Instruction("sub", (4, 5)), Instruction("mul", (4, 3)), Instruction("div", (0, 2))]
    outputs = tuple(range(4, len(code)))
    state = ProgramBlock("y", 4)
    program = Program("constants", (state,), 0, tuple(code), 0, outputs, (ProgramBlock("v", 7),), (7,))
    file = write(target, as_module([program]), tmp_path)
    for command in LANGUAGES[target].strict:
        run(command.format(module=file.stem), tmp_path)
    _, result = called(target, file, [Call("constants", 0.0, [0.0] * 4, 7)])
    inf, nan = math.inf, math.nan
    np.testing.assert_array_equal(result.values, [inf, inf, nan, -inf, nan, -inf, 1e-300])


@pytest.mark.few(1)
@with_steps
def test_main_writes_the_times_of_the_grid_and_says_why_it_ends_early(target: str, tmp_path: Path) -> None:
    x = lg.coordinate("x")
    falls = lg.System(kinetic=x.dot**2 / 2, potential=-1 / x**2, initial={x: 1}, name="falls")
    *build, start = falls.export(target, tmp_path, ["main"]).run_commands
    for command in build:
        run(command, tmp_path)
    done = tried(main_command(start, 7.0, 100), tmp_path)
    assert done.returncode == 1
    assert "the run stopped at t = 0.70710678" in done.stderr  # it reaches x = 0 at 1/sqrt(2)
    assert done.stderr.splitlines()[0].endswith(": the step became too small")
    times = [row.split(",")[0] for row in done.stdout.splitlines()[1:]]
    assert list(map(float, times)) == [7.0 * k / 100 for k in range(11)]
    assert max(map(len, times)) <= len("0.07")


# --- features of exported C alone; `test_modules.py` has what it shares with other languages -------------------


WARNINGS = "cc -std=c99 -O1 -Wall -Wextra -Wconversion -Werror"
CONTENTS = ("rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations", "rk4", "dop853", "main")

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize("scene", ["kepler", "pleiades", "cartesian-pendulum"])
def test_the_taylor_integrator_passes_its_test(scene: str, tmp_path: Path) -> None:
    """The exported integrator passes its test: unrolled, in a loop over orders, and with projection."""
    name = scene.replace("-", "_")
    made = shared_scene(scene).export("c", tmp_path, ["taylor", "main"])
    assert [path.name for path in made.files] == [f"{name}{end}" for end in (".h", ".c", "_test.c", "_main.c")]
    for program in ("test", "main"):
        run(f"{WARNINGS} -o warned {name}.c {name}_{program}.c -lm", tmp_path)
    for command in made.commands:
        said = run(command, tmp_path)
    assert said.endswith("results are right\n")


@pytest.mark.slow
@needs_cc
def test_main_runs_by_taylor_series(tmp_path: Path) -> None:
    system = shared_scene("kepler")
    system.export("c", tmp_path, ["main", "taylor"])
    run("cc -O2 -o main kepler.c kepler_main.c -lm", tmp_path)
    _, *rows = run("./main 20 2", tmp_path).splitlines()
    ours = system.run(20.0, t_eval=[0.0, 10.0, 20.0], method="taylor", rtol=1e-10, atol=1e-10)
    for row, state in zip(rows, ours.y.T, strict=True):
        assert [float(cell) for cell in row.split(",")[1:]] == pytest.approx(state, abs=1e-9)


def test_switching_surfaces_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(StatementError, match=r"crosses no switching surfaces .*leave 'taylor' out of contents"):
        shared_scene("falling-ball").export("c", tmp_path / "made", ["taylor"])
    assert not (tmp_path / "made").exists()


@needs_cc
def test_events_are_functions(tmp_path: Path) -> None:
    system = shared_scene("pendulum")
    (theta,) = system.coordinates
    made = system.export("c", tmp_path, events=[theta.dot, lg.event(theta - 1, direction=1)])
    header = (tmp_path / "pendulum.h").read_text()
    assert "out: event0, event1" in header
    assert "event1 = theta - 1 (rising)" in header
    for command in made.commands:
        said = run(command, tmp_path)
    assert said == "pendulum: 30 of 30 results are right\n"


@needs_cc
def test_main_refuses_what_is_no_number(tmp_path: Path) -> None:
    shared_scene("pendulum").export("c", tmp_path, ["main"])
    run("cc -O0 -o main pendulum.c pendulum_main.c -lm", tmp_path)
    for words in ("abc", "2 2.7", "nan", "2 0", "1 2 3"):
        done = subprocess.run(["./main", *words.split()], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (2, "") and "give a" in done.stderr, words


@needs_cc
@pytest.mark.parametrize(
    "method", ["rk4", *(pytest.param(name, marks=pytest.mark.slow) for name in ("taylor", "dop853"))]
)
def test_a_start_off_the_constraints_is_refused(method: str, tmp_path: Path) -> None:
    shared_scene("cartesian-pendulum").export("c", tmp_path, [method])
    call = "0.0, 0.01, y, p" if method == "rk4" else "t, 1.0, y, p, 1e-9, 1e-9, 100000"
    (tmp_path / "start.c").write_text(f"""\
#include <stdio.h>
#include <stdlib.h>
#include "cartesian_pendulum.h"
int main(int count, char **words) {{
    double p[CARTESIAN_PENDULUM_PREPARED], t[] = {{0.0}}, y[] = {{0.0, -1.0, 0.0, 0.0}};
    y[1] += strtod(words[count - 1], NULL);
    cartesian_pendulum_prepare(cartesian_pendulum_default_parameters, p);
    (void)t;
    printf("%d", (int)cartesian_pendulum_{method}({call}));
    return 0;
}}
""")
    run("cc -O1 -o start start.c cartesian_pendulum.c -lm", tmp_path)
    assert [run(f"./start {off}", tmp_path) for off in ("0", "1e-9", "1e-3", "0.2", "nan")] == ["0", "0", "9", "9", "9"]


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_a_program_of_cpp_includes_the_header(tmp_path: Path) -> None:
    shared_scene("pendulum").export("c++", tmp_path, ["rhs"])
    program = '#include "pendulum.h"\nint main() { double p[PENDULUM_PREPARED]; return pendulum_prepare('
    (tmp_path / "program.cpp").write_text(f"{program}pendulum_default_parameters, p); }}\n")
    run("cc -std=c99 -c pendulum.c", tmp_path)
    run("g++ -std=c++17 -Wall -Wextra -Werror -o program program.cpp pendulum.o -lm", tmp_path)
    run("./program", tmp_path)


# --- features of single languages without loops ----------------------------------------------------------------


TEXTS = {
    "fortran": (
        "  pure subroutine energy(t, y, p, out, singular)\n    ! The energy v.p - L, which is T + V where T is",
    ),
    "julia": (
        '"""\n    energy!(out, t, y, p)\n\nThe energy v.p - L, which is T + V where T is quadratic in the velocities.',
        '    length(y) < 2 && throw(DimensionMismatch("y has fewer than 2 numbers"))\n',
    ),
    "rust": (
        "pub fn energy(t: f64, y: &[f64], p: &[f64], out: &mut [f64]) -> bool {\n    let (y, p, out) = (&y[..STATE], ",
    ),
    "modelica": (
        "    Real theta(start = 2.0, fixed = true);\n    Real theta_dot(start = 0.0, fixed = true);\n",
        "    parameter Real p[6] = Functions.prepare({m, g, l});\n",
        "    rates = Functions.rhs(time, {theta, theta_dot}, p);\n    der(theta) = rates[1];\n",
        "    energy = Functions.energy(time, {theta, theta_dot}, p);\n    annotation(experiment(StopTime = 10.0,",
    ),
}
"""Text on which no result of a function depends: comments, checks of sizes, the Modelica model of a pendulum."""


@pytest.mark.parametrize("target", TEXTS)
def test_text_that_no_result_shows(target: str, tmp_path: Path) -> None:
    text = shared_scene("pendulum").export(target, tmp_path, ["energy"]).files[0].read_text()
    assert [part for part in TEXTS[target] if f"\n{part}" not in text] == []


@pytest.mark.parametrize("name", ["test", "random", "dict", "base", "sin"])
def test_no_julia_module_has_the_name_of_one_of_the_library(name: str, tmp_path: Path) -> None:
    x = lg.coordinate("x")
    lg.System(kinetic=x.dot**2 / 2, potential=x**2, name=name).export("julia", tmp_path, ["rhs"])
    own = f"{name.capitalize()}_2" if name != "sin" else "Sin"  # sin is a function, and Sin nothing
    assert f"\nmodule {own}\n" in (tmp_path / f"{name}.jl").read_text()
    assert f"{own}.rhs!,\n" in (tmp_path / f"{name}_test.jl").read_text()


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="octave-cli is not installed")
def test_results_in_octave_are_nan_where_a_matrix_is_singular(tmp_path: Path) -> None:
    coupled().export("octave", tmp_path, ["rhs"])
    p = "p = coupled_prepare(coupled_default_parameters());"
    program = f"{p} disp(isnan(coupled_rhs(0, [0; 0; 0.5; 0.1], p).')); disp(isnan(coupled_rhs(0, [1 0 0 1], p).'));"
    said = run(f'octave-cli --quiet --no-history --eval "{program}"', tmp_path)
    assert said.split() == ["1"] * 4 + ["0"] * 4


def test_names_of_functions_of_octave_have_63_letters_at_most(tmp_path: Path) -> None:
    made = named(["x"], ["k"], "a" * 64).export("octave", tmp_path, ["rhs", "jacobian"])
    assert max(len(path.stem) for path in made.files) == 63
    assert len({path.stem for path in made.files}) == len(made.files)


@pytest.mark.slow
def test_large_local_arrays_of_fortran_are_no_static_ones(tmp_path: Path) -> None:
    for count, word in ((2, "pure subroutine rhs("), (65, "pure recursive subroutine rhs(")):
        q = [lg.coordinate(f"q{k}") for k in range(count)]
        kinetic = sum(a.dot**2 for a in q) + sum(a.dot for a in q) ** 2 / 2
        lg.System(kinetic, sum(a**2 for a in q), name="many").export("fortran", tmp_path, ["rhs"])
        assert word in (tmp_path / "many.f90").read_text()


@pytest.mark.parametrize(("target", "text"), [("rust", "let _ = p;"), ("fortran", "unused1 => p(1)")])
def test_without_parameters_compilers_do_not_warn(target: str, text: str, tmp_path: Path) -> None:
    file, *_ = shared_scene("henon-heiles").export(target, tmp_path, ["rhs"]).files
    assert text in file.read_text().partition("prepare(parameters")[2].partition("rhs(")[0]
    for command in LANGUAGES[target].strict if not missing(target) else ():
        run(command.format(module=file.stem), tmp_path)


# --- linear systems


@pytest.mark.parametrize("kind", ["definite", "indefinite", "nothing on the diagonal"])
def test_every_regular_matrix_is_solved(kind: str) -> None:
    """Random systems whose units differ by 1e8 are solved with an error of some roundings for each unknown."""
    rng = np.random.default_rng(3)
    for n in (1, 2, 3, 5, 8) * 4:
        matrix = rng.normal(size=(n, n))
        matrix = matrix @ matrix.T + np.eye(n) if kind == "definite" else matrix + matrix.T
        if kind.startswith("nothing"):
            matrix -= np.diag(np.diagonal(matrix)) * (n > 1)
        units = 10.0 ** rng.integers(-4, 5, size=n)
        expected, scaled = rng.normal(size=n) / units, units[:, None] * matrix * units
        a, x = np.zeros((n + ROWS, n)), np.zeros(n)
        a[:n] = np.tril(scaled)
        assert not factored(n, a)
        solved(n, a, scaled @ expected, x)
        off = 1e-14 * np.linalg.cond(matrix) * n
        assert x * units == pytest.approx(expected * units, rel=off, abs=off)


@pytest.mark.parametrize("entries", [[0.0], [1.0, 1.0, 1.0], [0.0] * 6, [1.0, 2.0, 4.0, 3.0, 6.0, 9.0]])
def test_a_singular_matrix_is_recognized(entries: list[float]) -> None:
    n = {1: 1, 3: 2, 6: 3}[len(entries)]
    for value, expected in ((1.0, True), (np.nan, False)):
        a = np.zeros((n + ROWS, n))
        a[np.tril_indices(n)] = np.multiply(entries, value)
        with np.errstate(all="ignore"):
            assert factored(n, a) == expected


def test_the_commands_on_the_page_of_julia_are_those_of_the_target(tmp_path: Path) -> None:
    made = shared_scene("double-pendulum").export("julia", tmp_path, ["rhs"])
    assert " && ".join(made.commands) in section("Julia")
