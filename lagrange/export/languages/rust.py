"""Rust, edition 2021: one file, a module or a crate, with or without the standard library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.export.comments import commented
from lagrange.export.descriptions import TEST, about_of, places, sizes, statement_comment, statuses
from lagrange.export.identifiers import distinct
from lagrange.export.languages.rust_printer import File, function, result_type
from lagrange.export.languages.rust_spelling import (
    KINDS,
    LITERALS,
    RESERVED,
    helper_lines,
    library_lines,
    needed,
)
from lagrange.export.lines import continued
from lagrange.export.module import Check, SourceModule
from lagrange.export.programs import tables
from lagrange.export.target import Target, register
from lagrange.procedure.form import Array, Kind, Procedure


@register
class Rust(Target):
    """Rust; see `Target`."""

    name = "rust"
    about = "Rust (edition 2021): one file, no crates, no unsafe code, no_std by a cfg, quantities only"
    contents = frozenset()
    inexpressible = frozenset(("erf",))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the file; the test is switched on by a cfg."""
        return {f"{file_name(module)}.rs": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the test."""
        name = file_name(module)
        return [f"rustc --edition 2021 -O --cfg self_test -o {name}_test {name}.rs", f"./{name}_test"]


def file_name(module: SourceModule) -> str:
    """Return the name of the module, which no keyword or crate has."""
    return distinct([module.name], (*RESERVED, "alloc", "lib", "proc_macro"))[0]


def source(module: SourceModule) -> str:
    """Return the file."""
    file = File(module.public)
    functions = [function(procedure, file) for procedure in module.procedures]
    ops = needed(file.needed)
    lines = [
        *statement_comment(module, "//"),
        "",
        "#![cfg_attr(no_std, no_std)]",
        "// Names are those of the statement. A program may leave functions unused.",
        "#![allow(dead_code, non_snake_case, unexpected_cfgs)]",
        "",
        "use core::cell::Cell;",
        "",
        *constants(module),
        "",
        *(line for procedure in module.public for line in wrapper(module, procedure)),
        ACCESS,
        *library_lines(ops),
        *helper_lines(ops),
        *functions,
        *test(module),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


ACCESS = """\
/// Numbers that are read: a slice of them, or of cells that hold them.
trait Reals {
    fn at(&self, k: i64) -> f64;
    fn part(&self, k: i64) -> &Self;
}

impl Reals for [f64] {
    #[inline]
    fn at(&self, k: i64) -> f64 {
        self[k as usize]
    }
    #[inline]
    fn part(&self, k: i64) -> &Self {
        &self[k as usize..]
    }
}

impl Reals for [Cell<f64>] {
    #[inline]
    fn at(&self, k: i64) -> f64 {
        self[k as usize].get()
    }
    #[inline]
    fn part(&self, k: i64) -> &Self {
        &self[k as usize..]
    }
}

#[inline]
fn cell(numbers: &[Cell<f64>], k: i64) -> &Cell<f64> {
    &numbers[k as usize]
}

#[inline]
fn cells(numbers: &[Cell<f64>], k: i64) -> &[Cell<f64>] {
    &numbers[k as usize..]
}
"""


def constants(module: SourceModule) -> Iterator[str]:
    """Yield sizes, names, and comments on arrays and functions."""
    for name, count, about in sizes(module):
        yield f"pub const {name.upper()}: usize = {count}; // {about}"
    yield ""
    yield from commented(places("y", module.state), "//")
    yield from commented(places("parameters", module.parameters), "//")
    for name, names in (("STATE_NAMES", module.state), ("PARAMETER_NAMES", module.parameters)):
        yield from continued(f"pub const {name}: [&str; {len(names)}] = [{', '.join(map(quoted, names))}];")
    values = ", ".join(map(LITERALS.real, module.values))
    yield from continued(f"pub const DEFAULT_PARAMETERS: [f64; {len(module.values)}] = [{values}];")
    yield ""
    yield from commented(statuses("false", "true"), "//")


def quoted(text: str) -> str:
    """Return a string literal in ASCII."""
    return '"' + "".join(_escaped(letter) for letter in text) + '"'


def _escaped(letter: str) -> str:
    plain_letter = letter.isascii() and letter.isprintable() and letter not in '"\\'
    return letter if plain_letter else f"\\u{{{ord(letter):x}}}"


def wrapper(module: SourceModule, procedure: Procedure) -> Iterator[str]:
    """Yield a public function, which takes slices of numbers."""
    given, passed = [], []
    for one in procedure.parameters:
        name, kind = one.name, one.type
        if isinstance(kind, Array):
            change = "" if kind.read else "mut "
            given.append(f"{name}: &{change}[f64]")
            part = name if kind.size is None else f"&{change}{name}[..{kind.size}]"
            passed.append(part if kind.read else f"Cell::from_mut({part}).as_slice_of_cells()")
        else:
            assert isinstance(kind, Kind)
            given.append(f"{name}: {KINDS[kind]}")
            passed.append(name)
    yield from commented(about_of(module, procedure), "///")
    yield from continued(f"pub fn {procedure.name}({', '.join(given)}){result_type(procedure)} {{")
    yield from continued(f"    {File(module.public).name(procedure)}({', '.join(passed)})")
    yield "}"
    yield ""


# --- the test

COMPARE = """\
#[cfg(self_test)]
#[derive(Default)]
struct Tests {
    p: Vec<f64>,
    checked: usize,
    failures: usize,
}

#[cfg(self_test)]
impl Tests {
    fn compare(&mut self, name: &str, state: usize, found: &[f64], wanted: &[f64], allowed: &[f64]) {
        for (i, value) in found.iter().enumerate() {
            let near = (value - wanted[i]).abs() <= allowed[i];
            if !near {
                println!("{name}, state {state}, result {i}: {value:?} instead of {:?}", wanted[i]);
                self.failures += 1;
            }
        }
    }

    fn quantity(
        &mut self,
        name: &str,
        evaluate: fn(f64, &[f64], &[f64], &mut [f64]) -> bool,
        times: &[f64],
        states: &[f64],
        wanted: &[f64],
        allowed: &[f64],
    ) {
        let count = wanted.len() / times.len();
        for (k, t) in times.iter().enumerate() {
            let mut out = vec![0.0; count];
            let row = count * k..count * (k + 1);
            self.checked += count;
            if evaluate(*t, &states[STATE * k..], &self.p, &mut out) {
                println!("{name}, state {k}: a matrix is singular");
                self.failures += count;
            } else {
                self.compare(name, k, &out, &wanted[row.clone()], &allowed[row]);
            }
        }
    }
}

#[cfg(self_test)]
fn main() {
    let mut tests = Tests { p: vec![0.0; PREPARED], ..Tests::default() };
    if prepare(&DEFAULT_PARAMETERS, &mut tests.p) {
        println!("prepare: a matrix is singular");
        tests.failures += 1;
    }
"""


def test(module: SourceModule) -> Iterator[str]:
    """Yield the test: a program that compares results with those of multiple precision."""
    yield from commented(f"{TEST} Failures are printed. Exit status 0 if all are right, else 1.", "//")
    yield COMPARE.rstrip("\n")
    for check in module.checks:
        yield from _quantity_test(check)
    yield "    let right = tests.checked - tests.failures.min(tests.checked);"
    yield f'    println!("{module.name}: {{right}} of {{}} results are right", tests.checked);'
    yield "    std::process::exit(if tests.failures == 0 { 0 } else { 1 });"
    yield "}"


def _quantity_test(check: Check) -> Iterator[str]:
    yield f'    tests.quantity("{check.name}", {check.name},'
    yield from tables(check.flat, LITERALS, "&[")
    yield "    );"
