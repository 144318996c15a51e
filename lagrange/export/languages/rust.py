"""Rust, edition 2021: one file, a module or a crate, with or without the standard library.

An array that is written is a slice of cells, so that parts of one array may be read and written in one call without
unsafe code. An array that is only read is of either kind, numbers or cells: the trait `Reals` has both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from lagrange.errors import LagrangeError
from lagrange.export.braced import BracedPrinter
from lagrange.export.comments import commented
from lagrange.export.descriptions import TEST, about_of, places, sizes, statement_comment, statuses
from lagrange.export.identifiers import distinct
from lagrange.export.lines import continued
from lagrange.export.module import Check, SourceModule
from lagrange.export.programs import tables
from lagrange.export.target import QUANTITIES, Target, register
from lagrange.procedure.form import FLAG, REAL, SUMS, WHOLE, Array, Block, Call, Fold, Kind, Let, Part, Procedure
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM, Literals, Operator
from lagrange.procedure.spelling import OPERATORS as COMMON

KINDS: Mapping[Kind, str] = {REAL: "f64", WHOLE: "i64", FLAG: "bool"}

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "select": Operator(1, "if {0} {{ {1} }} else {{ {2} }}"),
    "quotient": COMMON["div"],
}

LITERALS = Literals("f64::INFINITY", "f64::NAN")

LIBRARY: Mapping[str, str] = {
    **{name: name for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "sinh", "cosh", "tanh")},
    "log": "ln",
    "log1p": "ln_1p",
    "atan2": "atan2",
    "power": "powf",
}
"""Functions of the standard library, each a method of its first argument."""

FOREIGN: Mapping[str, str] = {"power": "pow"}
"""Names of functions in the C library, where they differ."""

BINARY = ("atan2", "power")

HELPERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "abs": ("abs", ("fn abs(x: f64) -> f64 {", "    f64::from_bits(x.to_bits() & (u64::MAX >> 1))", "}")),
    "min": ("smaller", ("fn smaller(a: f64, b: f64) -> f64 {", "    if a < b || a.is_nan() { a } else { b }", "}")),
    "max": ("larger", ("fn larger(a: f64, b: f64) -> f64 {", "    if a > b || a.is_nan() { a } else { b }", "}")),
    "magnitude": (
        "magnitude",
        (
            "fn magnitude(a: f64, b: f64) -> f64 {",
            "    let (x, y) = (abs(a), abs(b));",
            "    if x > y || x.is_nan() { x } else { y }",
            "}",
        ),
    ),
    "sign": (
        "sign",
        (
            "fn sign(x: f64) -> f64 {",
            "    if x > 0.0 { 1.0 } else if x < 0.0 { -1.0 } else { x }",
            "}",
        ),
    ),
    "copysign": (
        "copysign",
        (
            "fn copysign(x: f64, y: f64) -> f64 {",
            "    let sign = 1 << 63;",
            "    f64::from_bits((x.to_bits() & !sign) | (y.to_bits() & sign))",
            "}",
        ),
    ),
    "round": (
        "round_even",
        (
            "// The sum has no digits behind the point, and is rounded to the nearest, ties to even.",
            "fn round_even(x: f64) -> f64 {",
            "    let size = abs(x);",
            "    let most = 4503599627370496.0;",
            "    if size < most { copysign((size + most) - most, x) } else { x }",
            "}",
        ),
    ),
    "asinh": (
        "asinh",
        (
            "// The methods of the standard library lose digits: here log1p takes what is small.",
            "fn asinh(x: f64) -> f64 {",
            "    let size = abs(x);",
            "    if size > 1.0e8 {",
            "        return copysign(math::log(size) + core::f64::consts::LN_2, x);",
            "    }",
            "    let square = size * size;",
            "    copysign(math::log1p(size + square / (1.0 + math::sqrt(1.0 + square))), x)",
            "}",
        ),
    ),
    "acosh": (
        "acosh",
        (
            "fn acosh(x: f64) -> f64 {",
            "    if x < 1.0 {",
            "        return f64::NAN;",
            "    }",
            "    if x > 1.0e8 {",
            "        return math::log(x) + core::f64::consts::LN_2;",
            "    }",
            "    let above = x - 1.0;",
            "    math::log1p(above + math::sqrt(above * (above + 2.0)))",
            "}",
        ),
    ),
    "atanh": (
        "atanh",
        (
            "fn atanh(x: f64) -> f64 {",
            "    let size = abs(x);",
            "    copysign(0.5 * math::log1p(2.0 * size / (1.0 - size)), x)",
            "}",
        ),
    ),
    "two_to": ("two_to", ("fn two_to(k: i64) -> f64 {", "    f64::from_bits(((k + 1023) as u64) << 52)", "}")),
    "exponent": (
        "exponent",
        ("fn exponent(x: f64) -> i64 {", "    ((x.to_bits() >> 52) & 2047) as i64 - 1023", "}"),
    ),
    "mantissa": (
        "mantissa",
        (
            "fn mantissa(x: f64) -> f64 {",
            "    f64::from_bits((x.to_bits() & ((1 << 52) - 1)) | (1023 << 52))",
            "}",
        ),
    ),
    "real": ("real", ("fn real(k: i64) -> f64 {", "    k as f64", "}")),
    "whole": ("whole", ("fn whole(x: f64) -> i64 {", "    x as i64", "}")),
}
"""Operations that are defined in the file: a name, and its definition. NaN stays NaN in all."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    "magnitude": ("abs",),
    "round": ("abs", "copysign"),
    "asinh": ("abs", "copysign", "log", "log1p", "sqrt"),
    "acosh": ("log", "log1p", "sqrt"),
    "atanh": ("abs", "copysign", "log1p"),
}
"""The operations that the definitions of others use."""

_RESERVED = (
    "as async await break const continue crate dyn else enum extern false fn for if impl in let loop match "
    "move mut pub ref return self Self static struct super trait true type unsafe use where while abstract "
    "become box do final gen macro override priv try typeof unsized virtual yield union f64 i64 u64 u8 usize "
    "bool str core std math Cell Reals Some None Ok Err main test get set cells number at part from_fn "
    "mod "
    "y p out t h parameters "
)
RESERVED = (
    *_RESERVED.split(),
    *(name.upper() for name in (*QUANTITIES, "state", "parameters", "prepared")),
    *("STATE_NAMES", "PARAMETER_NAMES", "DEFAULT_PARAMETERS"),
)
"""Words that are not names of values: keywords, what the file uses, and what parameters of functions are called."""


def needed(ops: Mapping[str, None]) -> dict[str, None]:
    """Return operations and those that their definitions use."""
    found: dict[str, None] = {}
    for op in ops:
        found |= dict.fromkeys((*NEEDS.get(op, ()), op))
    return found


def library_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the functions of a library that a file calls, from the standard library or from C's."""
    used = sorted(op for op in ops if op in LIBRARY)
    if not used:
        return []
    standard, foreign, declared = [], [], []
    for op in used:
        given, args = ("x: f64, y: f64", "x, y") if op in BINARY else ("x: f64", "x")
        rest, name = "y" if op in BINARY else "", FOREIGN.get(op, op)
        head = [f"    pub fn {op}({given}) -> f64 {{"]
        standard += ["    #[inline]", *head, f"        x.{LIBRARY[op]}({rest})", "    }"]
        foreign += [*head, f"        unsafe {{ c::{name}({args}) }}", "    }"]
        declared.append(f"            pub fn {name}({given}) -> f64;")
    return [
        "#[cfg(not(no_std))]",
        "mod math {",
        *standard,
        "}",
        "",
        "// Without the standard library these functions are those of the C library that the program is linked with.",
        "#[cfg(no_std)]",
        "mod math {",
        "    mod c {",
        '        extern "C" {',
        *declared,
        "        }",
        "    }",
        *foreign,
        "}",
        "",
    ]


def helper_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the definitions of operations that the file defines."""
    lines = []
    for op in sorted(op for op in ops if op in HELPERS):
        *about, head = [line for line in HELPERS[op][1] if line.startswith(("//", "fn "))]
        body = HELPERS[op][1][len(about) + 1 :]
        lines += [*about, "#[inline]", head, *body, ""]
    return lines


SUFFIX = "_cells"
"""Suffix of the private function of a public one, which takes slices of cells."""


@dataclass(frozen=True)
class File:
    """State shared by the functions of one file; `needed` collects the operations whose definitions it needs."""

    public: Sequence[Procedure]
    needed: dict[str, None] = field(default_factory=dict)

    def name(self, procedure: Procedure) -> str:
        """Return the name of the function that works on cells."""
        return f"{procedure.name}{SUFFIX}" if procedure in self.public else procedure.name


def result_type(procedure: Procedure) -> str:
    """Return the results of a function, with the arrow."""
    kinds = [KINDS[kind] for kind in procedure.results]
    if not kinds:
        return ""
    return f" -> {kinds[0]}" if len(kinds) == 1 else f" -> ({', '.join(kinds)})"


def function(procedure: Procedure, file: File) -> str:
    """Return a procedure as a function; what it needs of the file is noted there."""
    return _RustPrinter(procedure, file).function()


class _RustPrinter(BracedPrinter):
    language = "Rust"
    operators = OPERATORS
    literals = LITERALS
    helpers = HELPERS

    def __init__(self, procedure: Procedure, file: File) -> None:
        self.file = file
        self.counts = True
        """True if the loop that is being opened uses its index."""
        super().__init__(procedure, file.needed, RESERVED)

    def function_name(self, procedure: Procedure) -> str:
        return self.file.name(procedure)

    def head(self) -> list[str]:
        given: list[str] = []
        types: list[str] = []
        for one in self.procedure.parameters:
            name, kind = self.text(one.ref), one.type
            if isinstance(kind, Array) and kind.read:
                types.append(f"A{len(types)}: Reals + ?Sized")
                given.append(f"{name}: &{types[-1].partition(':')[0]}")
            elif isinstance(kind, Array):
                given.append(f"{name}: &[Cell<f64>]")
            else:
                assert isinstance(kind, Kind)
                given.append(f"{name}: {KINDS[kind]}")
        generic = f"<{', '.join(types)}>" if types else ""
        head = f"fn {self.function_name(self.procedure)}{generic}("
        return [
            *commented(self.procedure.about, "//"),
            head,
            *(f"{self.indent}{one}," for one in given),
            f"){result_type(self.procedure)} {{",
            *(f"{self.indent}let _ = {self.text(one.ref)};" for one in self.unused),
        ]

    def function_of(self, op: str) -> str:
        if op not in LIBRARY:
            return super().function_of(op)
        self.needed[op] = None
        return f"math::{op}"

    def operation(self, let: Let) -> tuple[int, str]:
        kind = let.kind
        if let.op in ("real", "whole") and self.types[let.args[0]] is FLAG:
            of, (one, zero) = self.text(let.args[0]), ("1.0", "0.0") if kind is REAL else ("1", "0")
            return 1, f"if {of} {{ {one} }} else {{ {zero} }}"
        if let.op in ("min", "max") and kind is not REAL:
            return ATOM, f"i64::{let.op}({', '.join(self.text(arg) for arg in let.args)})"
        return super().operation(let)

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"let {name}: {KINDS[kind]} = {text};"

    def declare(self, name: str, kind: Kind, text: str) -> str:
        return f"let mut {name}: {KINDS[kind]} = {text};"

    def assign(self, target: str, text: str) -> str:
        return f"{target[:-6]}.set({text});" if target.endswith(".get()") else f"{target} = {text};"

    def element(self, array: int, place: int) -> str:
        if self.array(array).read:
            return f"{self.text(array)}.at({self.text(place)})"
        at = str(self.constants[place]) if place in self.constants else self.text(place)
        return f"{self.text(array)}[{at}].get()" if place in self.constants else f"cell({self.text(array)}, {at}).get()"

    def part(self, part: Part) -> None:
        held = self.array(part.array)
        text = f"{self.text(part.array)}.part({self.text(part.start)})"
        if not held.read:
            text = f"cells({self.text(part.array)}, {self.text(part.start)})"
        self.write(f"let {self.name(part.ref)} = {text};")

    def reserve(self, ref: int, array: Array) -> None:
        if array.kind is not REAL:
            raise LagrangeError("Rust has no local arrays of whole numbers here.")
        size, name = array.length, self.name(ref)
        self.put(f"let mut {name} = [0.0; {size}];")
        self.put(f"let {name} = Cell::from_mut(&mut {name}[..]).as_slice_of_cells();")

    def call(self, call: Call) -> None:
        callee = call.callee
        assert isinstance(callee, Procedure)
        made = f"{self.function_name(callee)}({', '.join(self.text(arg) for arg in call.args)})"
        kinds = results_of(self, call)
        for ref, kind in zip(call.refs, kinds, strict=True):
            self.types[ref] = kind
        self.settle()
        names = [self.name(ref) if ref in self.uses else "_" for ref in call.refs]
        if not names:
            self.put(f"{made};")
        else:
            held = ", ".join(names)
            self.put(f"let {held if len(names) == 1 else f'({held})'} = {made};")

    def leave(self, values: Sequence[int]) -> None:
        found = ", ".join(self.text(value) for value in values)
        self.write(f"return ({found});" if len(values) > 1 else f"return {found};" if values else "return;")

    def partial(self, ref: int, place: str) -> str:
        return f"cell({self.text(ref)}, {place}).get()"

    def iterations(self, index: int, places: tuple[str, str, str], body: Block, folds: Sequence[Fold]) -> None:
        self.counts = index in self.uses or any(fold.op in SUMS for fold in folds)
        super().iterations(index, places, body, folds)

    def opening(self, kind: str, *texts: str) -> str:
        match kind, texts:
            case "for", (index, start, stop, step):
                places = f"{start}..{stop}" if step == "1" else f"({start}..{stop}).step_by({step})"
                return f"for {index if self.counts else '_'} in {places} {{"
            case "forever", _:
                return "loop {"
            case "else", _:
                return "} else {"
            case _:
                return f"{kind} {texts[0]} {{"


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
        """Return the shell lines that compile and run the test."""
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
