"""Programs in several languages that call an exported module and print what it returns, for tests to read."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from lagrange.export.languages import c, fortran, javascript, octave, rust
from lagrange.export.module import SourceModule
from lagrange.export.target import find
from lagrange.machine import python_source


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
        commands=(
            "cc -std=c99 -O1 -o caller {module}.c caller.c -lm",
            "./caller",
        ),
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
