"""Systems, random graphs, and programs that call exported modules and print what these return."""

import math
import random
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import mpmath
import pytest
from sympy import cos

import lagrange as lg
from lagrange.algorithm.kernel.body import PreparedLayout
from lagrange.algorithm.kernel.kernels import kernel, prepare
from lagrange.export.languages import c, fortran, javascript, octave, rust
from lagrange.export.module import ExportedQuantity, SourceModule, ValueNames
from lagrange.export.straight_line import with_outputs
from lagrange.export.target import find
from lagrange.machine import python_source
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock
from tests.models import SCENE_NAMES
from tests.operations import operations


class Call(NamedTuple):
    """A call of a quantity with `size` results, or of an integrator, which changes the state."""

    name: str
    t: float
    y: Sequence[float]
    size: int = 0
    step: float = 0.0
    end: float | None = None


class Found(NamedTuple):
    """The return value of a call, and the results or the new state."""

    status: int
    values: list[float]


@dataclass(frozen=True)
class Language:
    """A language: the text by which a program calls a module, and the `commands` that compile and run it by `tool`."""

    tool: str
    suffix: str
    head: str
    quantity: str
    tail: str
    commands: Sequence[str]
    strict: Sequence[str]
    """Commands that compile the module itself with warnings as errors."""
    step: str = ""
    run: str = ""
    """The text of a step and of a run, empty for a language that has quantities only."""
    first: int = 0
    """The number of the first state and the first result in what a test prints."""


LANGUAGES: Mapping[str, Language] = {
    "javascript": Language(
        tool="node",
        suffix="mjs",
        head="""\
import * as m from "./{module}.mjs";
const p = new Float64Array(m.PREPARED);
const shown = (value) => (Object.is(value, -0) ? "-0" : value);
const told = (status, values) => console.log([Number(status), ...Array.from(values, shown)].join(" "));
const quantity = (f, t, y, count) => {{
    const out = new Float64Array(count);
    told(f(t, Float64Array.from(y), p, out), out);
}};
const change = (f, values) => {{
    const y = Float64Array.from(values);
    told(f(y), y);
}};
told(m.prepare([{parameters}], p), []);
""",
        quantity="quantity(m.{name}, {t}, [{y}], {count});",
        step="change((y) => m.{name}({t}, {step}, y, p), [{y}]);",
        run="change((y) => m.{name}([{t}], {end}, y, p, 1e-10, 1e-10, 10000), [{y}]);",
        tail="",
        commands=("node caller.mjs",),
        strict=("node --check {module}.mjs",),
    ),
    "rust": Language(
        tool="rustc",
        suffix="rs",
        head="""\
mod {module};
use {module} as m;
fn told(status: i64, values: &[f64]) {{
    let row: Vec<String> = values.iter().map(|value| format!("{{value:?}}")).collect();
    println!("{{status}} {{}}", row.join(" "));
}}
#[allow(dead_code)]
fn quantity(f: fn(f64, &[f64], &[f64], &mut [f64]) -> bool, t: f64, y: &[f64], p: &[f64], count: usize) {{
    let mut out = vec![0.0; count];
    let status = f(t, y, p, &mut out);
    told(i64::from(status), &out);
}}
fn main() {{
    let mut p = [0.0; m::PREPARED];
    let status = m::prepare(&[{parameters}], &mut p);
    told(i64::from(status), &[]);
""",
        quantity="    quantity(m::{name}, {t}, &[{y}], &p, {count});",
        tail="}\n",
        commands=("rustc --edition 2021 -D warnings -o caller caller.rs", "./caller"),
        strict=("rustc --edition 2021 -D warnings --crate-type lib --emit metadata {module}.rs",),
    ),
    "python": Language(
        tool=sys.executable,
        suffix="py",
        head="""\
import numpy as np
import {module} as m
nan, inf = np.nan, np.inf
p = np.zeros(m.PREPARED)
def told(status, values):
    print(int(status), *values.tolist())
def quantity(f, t, y, count):
    out = np.zeros(count)
    told(f(t, y, p, out), out)
def change(f, values):
    y = np.array(values)
    told(f(y), y)
told(m.prepare([{parameters}], p), p[:0])
""",
        quantity="quantity(m.{name}, {t}, [{y}], {count})",
        step="change(lambda y: m.{name}({t}, {step}, y, p), [{y}])",
        run="change(lambda y: m.{name}(np.array([{t}]), {end}, y, p, 1e-10, 1e-10, 10000), [{y}])",
        tail="",
        commands=(f"{sys.executable} -W error caller.py",),
        strict=(f"{sys.executable} -W error -m py_compile {{module}}.py",),
    ),
    "fortran": Language(
        tool="gfortran",
        suffix="f90",
        head="""\
program caller
  use, intrinsic :: iso_fortran_env, only: dp => real64, int64
  use {module}
  implicit none
  real(dp), parameter :: infinity = transfer(9218868437227405312_int64, 1.0_dp)
  real(dp), parameter :: not_a_number = transfer(9221120237041090560_int64, 1.0_dp)
  real(dp) :: p(prepared_size), y(state_size), out(4096)
  logical :: singular
  call prepare([real(dp) :: {parameters}], p, singular)
  call told(merge(1_int64, 0_int64, singular), out(:0))
""",
        quantity="""\
  y = [real(dp) :: {y}]
  call {name}({t}, y, p, out, singular)
  call told(merge(1_int64, 0_int64, singular), out(:{count}))""",
        tail="""\
contains
  subroutine told(code, values)
    integer(int64), intent(in) :: code
    real(dp), intent(in) :: values(:)
    write (*, '(i0, *(1x, es25.17e3))') code, values
  end subroutine told
end program caller
""",
        commands=(
            "gfortran -std=f2008 -fcheck=all -O1 -ffree-line-length-none -o caller {module}.f90 caller.f90",
            "./caller",
        ),
        strict=tuple(
            f"gfortran -std=f2008 -pedantic -Wall -Wextra -Werror -O{level} -c {{module}}.f90" for level in (0, 2)
        ),
        first=1,
    ),
    "octave": Language(
        tool="octave-cli",
        suffix="m",
        head="""\
1;
function told(status, values)
    disp(strjoin([{{num2str(status)}}, arrayfun(@(x) sprintf('%.17g', x), values(:).', 'UniformOutput', false)], ' '));
end
[p, status] = {module}_prepare([{parameters}]);
told(status, []);
""",
        quantity="[out, status] = {module}_{name}({t}, [{y}], p); told(status, out);",
        tail="",
        commands=("octave-cli --quiet --no-history caller.m",),
        strict=(),
        first=1,
    ),
    "c": Language(
        tool="cc",
        suffix="c",
        head="""\
#include <math.h>
#include <stdio.h>
#include "{module}.h"
#define TOLD told(status, y, sizeof y / sizeof *y);
static double p[4096], out[4096];
static void told(int64_t status, const double *values, size_t count) {{
    printf("%lld", (long long)status);
    for (size_t k = 0; k < count; k++) printf(" %.17g", values[k]);
    printf("\\n");
}}
int main(void) {{
    const double given[] = {{0.0, {parameters}}};
    told({module}_prepare(given + 1, p), p, 0);
""",
        quantity="    {{ const double y[] = {{{y}}}; told({module}_{name}({t}, y, p, out), out, {count}); }}",
        step="    {{ double y[] = {{{y}}}; int64_t status = {module}_{name}({t}, {step}, y, p); TOLD }}",
        run="    {{ double t[] = {{{t}}}, y[] = {{{y}}}; int64_t status = "
        "{module}_{name}(t, {end}, y, p, 1e-10, 1e-10, 10000); TOLD }}",
        tail="    return 0;\n}\n",
        commands=("cc -std=c99 -O1 -o caller {module}.c caller.c -lm", "./caller"),
        strict=("cc -std=c99 -O1 -Wall -Wextra -Wconversion -Werror -c {module}.c",),
    ),
}

LITERALS = {
    "fortran": fortran.LITERALS.real,
    "octave": octave.LITERALS.real,
    "javascript": javascript.LITERALS.real,
    "rust": rust.LITERALS.real,
    "python": python_source.LITERALS.real,
    "c": c.LITERALS.real,
}


PAGES = Path(__file__).resolve().parents[2] / "docs" / "export"


def section(title: str) -> str:
    """Return a section of the pages on exports, such as "Rust"."""
    pages = [(PAGES / name).read_text("utf-8") for name in ("README.md", "languages.md")]
    (result,) = (part for page in pages for part in page.split("\n## ")[1:] if part.startswith(f"{title}\n"))
    return result


def missing(target: str) -> str:
    """Return the reason why a target cannot be tested here, or an empty text."""
    tool = LANGUAGES[target].tool
    return "" if shutil.which(tool) else f"{tool} is not installed"


def tried(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a shell command, whatever its exit code."""
    words = shlex.split(command)
    words[0] = sys.executable if words[0] == "python" else words[0]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


def run(command: str, folder: Path) -> str:
    """Run a shell command, which must succeed and print no warning."""
    done = tried(command, folder)
    assert done.returncode == 0 and not done.stderr, f"{command}\n{done.stdout[-2000:]}{done.stderr[:4000]}"
    return done.stdout


def write(target: str, module: SourceModule, folder: Path) -> Path:
    """Write a module, and return the path of its file, without a suffix."""
    for name, text in find(target).files(module).items():
        assert isinstance(text, str)
        (folder / name).write_text(text, "ascii")
    return folder / module.name


def called(target: str, file: Path, calls: Sequence[Call], parameters: Sequence[float] = ()) -> list[Found]:
    """Return the result of `prepare` of a module, then the result of each call.

    `file` is the path of the module, without a suffix.
    """
    language, literal = LANGUAGES[target], LITERALS[target]
    lines = [language.head.format(module=file.stem, parameters=", ".join(map(literal, parameters)))]
    for call in calls:
        text = language.quantity if call.size else language.run if call.end is not None else language.step
        given = {"t": literal(call.t), "step": literal(call.step), "end": literal(call.end or 0.0)}
        lines.append(
            text.format(module=file.stem, name=call.name, y=", ".join(map(literal, call.y)), count=call.size, **given)
        )
    (file.parent / f"caller.{language.suffix}").write_text("\n".join([*lines, language.tail]))
    for command in language.commands:
        printed = run(command.format(module=file.stem), file.parent)
    rows = [line.split() for line in printed.splitlines()]
    return [Found(int(status), [float(item) for item in values]) for status, *values in rows]


def main_command(start: str, end: float, intervals: int) -> str:
    """Return the shell command that runs `main`, with its arguments after it or in parentheses."""
    return start.replace("()", f"({end}, {intervals})") if "()" in start else f"{start} {end} {intervals}"


# --- systems that tests of several targets share ---------------------------------------------------------------


def every_scene(*few: str) -> list[Any]:
    """Return the names of all scenes as test parameters; a run without --conformance takes a few of them."""
    return [pytest.param(name, marks=[pytest.mark.conformance] * (name not in few)) for name in SCENE_NAMES]


def held(system: lg.System) -> list[str]:
    """Return the optional contents that this system has."""
    statement = system.statement
    result = {
        "multipliers": bool(statement.constraints),
        "positions": bool(statement.positions),
        "energies": not statement.lagrangian_alone,
    }
    return [name for name, there in result.items() if there]


def named(coordinates: Sequence[str], parameters: Sequence[str], name: str = "named") -> lg.System:
    """Return coupled pendulums whose coordinates and parameters have given names."""
    q = [lg.coordinates(item) for item in coordinates]
    p = [lg.parameters(item) for item in parameters]
    kinetic = sum((1 + k) * item.dot**2 / 2 for k, item in enumerate(q))
    coupled = sum(a.dot * b.dot * cos(a - b) / 4 for a, b in pairwise(q))
    return lg.System(
        kinetic=kinetic + coupled,
        potential=sum(item * (1 - cos(q[k % len(q)] * (1 + k / 8))) for k, item in enumerate(p)),
        coordinates=q,
        parameters={item: 1 + k / 16 for k, item in enumerate(p)},
        initial={item: 0.5 - k / 32 for k, item in enumerate(q)},
        name=name,
    )


# --- random expression graphs as exported modules; each operation is compared with mpmath and with this package ---


STATES = 4
LENGTH = 14
"""Operations of a graph."""

CONDITIONS = {"less": 0, "less_equal": 0, "equal": 0, "and": 2, "or": 2, "not": 1}
"""Operations that give conditions, and how many of their operands are conditions."""
LEAVES = ("time", "state", "parameter", "constant", "factor", "solve", "component")
SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 5e-324, -1e-310, 1e300, -1e308, 3e5, 1.0000001)


def graph(seed: int, without: Sequence[str] = ()) -> Program:
    """Return a program of random operations on inputs and earlier results; every number is an output."""
    rng = random.Random(seed)
    code = [Instruction("state", place=k) for k in range(STATES)]
    code.append(Instruction("constant", value=rng.uniform(-3, 3)))
    code.append(Instruction("less", (0, 1)))
    names = [op for op in ARITY if op not in (*LEAVES, *without)]
    for _ in range(LENGTH):
        op = rng.choice(names)
        holds = 1 if op == "select" else CONDITIONS.get(op, 0)
        flags = [k for k, item in enumerate(code) if item.op in CONDITIONS]
        reals = [k for k, item in enumerate(code) if item.op not in CONDITIONS]
        args = [rng.choice(flags if place < holds else reals[-6:]) for place in range(ARITY[op] or 0)]
        code.append(Instruction(op, tuple(args)))
    return _with_results(f"graph_{seed}", code)


def _with_results(name: str, code: Sequence[Instruction]) -> Program:
    outputs = tuple(range(STATES, len(code)))
    values = (ProgramBlock("values", len(outputs)),)
    return Program(name, (ProgramBlock("y", STATES),), 0, tuple(code), 0, outputs, values, (len(outputs),))


def edges(without: Sequence[str] = ()) -> Program:
    """Return a program with each operation on one or two numbers, applied to the first inputs."""
    code = [Instruction("state", place=k) for k in range(STATES)]
    for op, arity in ARITY.items():
        if op not in (*LEAVES, *without, "and", "or", "not") and arity in (1, 2):
            code.append(Instruction(op, tuple(range(arity))))
    return _with_results("edges", code)


def points(seed: int, count: int) -> list[list[float]]:
    """Return inputs: ordinary numbers, zeros, infinities and NaN."""
    rng = random.Random(seed)
    return [
        [rng.choice(SPECIAL) if rng.random() < 0.25 else rng.uniform(-2, 2) for _ in range(STATES)]
        for _ in range(count)
    ]


def as_module(programs: Sequence[Program], more: Sequence[Procedure] = (), name: str = "graphs") -> SourceModule:
    """Return a module that consists of programs without parameters and other procedures."""
    prepared, first = PreparedLayout.of(programs), with_outputs(programs[0], programs[0].instructions, (0,))
    made = [(item, kernel(item, prepared, item.name, "Random operations.")) for item in programs]
    made += [(programs[0], item) for item in more]
    quantities = [
        ExportedQuantity(
            item.name, item.about, program, item, tuple(f"r{k}" for k in range(_results(item))), (_results(item),)
        )
        for program, item in made
    ]
    return SourceModule(
        name=name,
        statement=("random operations",),
        state=tuple(f"y{k}" for k in range(STATES)),
        parameters=(),
        values=(),
        units={},
        names=ValueNames(tuple(f"y{k}" for k in range(STATES)), (), ("first",), first),
        prepare=prepare(prepared, "Nothing depends on parameters."),
        prepared=prepared.size,
        quantities=tuple(quantities),
    )


def _results(procedure: Procedure) -> int:
    (out,) = (item.type for item in procedure.parameters if item.name == "out")
    size = getattr(out, "size", None)
    assert isinstance(size, int)
    return size


def wrong(program: Program, y: Sequence[float], result: Sequence[float]) -> Iterator[str]:
    """Yield the operations with an error above 4 ulp, or whose result is NaN or infinite unlike ours."""
    values: list[Any] = [*y, *result]
    for ref in range(STATES, len(program.instructions)):
        one, value = program.instructions[ref], values[ref]
        args = [values[arg] for arg in one.args]
        holds = 1 if one.op == "select" else CONDITIONS.get(one.op, 0)
        args = [bool(arg) if place < holds else arg for place, arg in enumerate(args)]
        expected = one.value if one.op == "constant" else OPERATIONS[one.op](*args)
        if one.op == "fma" and not abs(args[0] * args[1]) < 1e300:
            continue  # the product overflows where it is rounded by itself
        if not _near(one.op, args, value, float(expected)):
            yield f"{program.name}, {one.op}{tuple(args)} = {value!r} instead of {float(expected)!r}"


def _near(op: str, args: Sequence[Any], value: float, ours: float) -> bool:
    if not math.isfinite(ours):
        return value == ours or (math.isnan(value) and math.isnan(ours))
    if value == ours:
        return True
    if any(isinstance(arg, float) and not math.isfinite(arg) for arg in args) or (op == "atan2" and not args[0]):
        return abs(value - ours) <= 4 * math.ulp(ours)  # mpmath has no signed zeros, and few limits
    with mpmath.workdps(60):
        exact = operations(mpmath)[op](*(arg if isinstance(arg, bool) else mpmath.mpf(arg) for arg in args))
        size = abs(args[0] * args[1]) + abs(args[2]) if op == "fma" else abs(float(exact))
        return bool(abs(value - exact) <= 4 * math.ulp(float(size)))


def rarer() -> Procedure:
    """Return a procedure with operations that occur in no program, applied to y[0] and y[1]."""
    p = Builder("rarer", "Operations of integrators.")
    p.given("t", REAL)
    y, _, out = p.array("y", size=STATES, read=True), p.array("p", size=1, read=True), p.array("out", size=8)
    a, b = y[0], y[1]
    out[0], out[1] = p.operation("round", a), p.operation("copysign", a, b)
    out[2] = p.real(p.operation("exponent", a))
    out[3], out[4] = p.operation("mantissa", a), p.operation("magnitude", a, b)
    whole = p.operation("whole", b)
    out[5] = p.real(whole)
    out[6] = p.real(p.operation("quotient", whole, 3))
    out[7] = p.operation("two_to", whole)
    p.leave(p.false)
    return p.finish(FLAG)


def rarer_results(a: float, b: float) -> list[float]:
    """Return the reference results of `rarer`."""
    ops, whole = OPERATIONS, int(b)
    return [
        ops["round"](a),
        ops["copysign"](a, b),
        float(ops["exponent"](a)),
        ops["mantissa"](a),
        ops["magnitude"](a, b),
        float(whole),
        float(ops["quotient"](whole, 3)),
        ops["two_to"](whole),
    ]
