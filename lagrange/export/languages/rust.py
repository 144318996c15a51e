"""Export to Rust, edition 2021: one file, which is a module or a crate, and a test."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from lagrange.export.module import (
    SourceModule,
    about_of,
    commented,
    continued,
    indices,
    places,
    sizes,
    statement_comment,
    statuses,
)
from lagrange.export.programs import Script, helpers, marked, test_text, words
from lagrange.export.straight_line import Language, PrintedFunction, PrintedFunctions
from lagrange.export.target import QUANTITIES, Target, register
from lagrange.procedure.spelling import OPERATORS, Literals, Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

MISSING = ("erf",)  # Elementary functions that Rust does not have

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **{op: call(f"f64::{op}({{0}})") for op in (*ELEMENTARY, "sqrt", "abs") if op not in MISSING},
    "log": call("f64::ln({0})"),
    "atan2": call("f64::atan2({0}, {1})"),
    "power": call("f64::powf({0}, {1})"),
    **{op: call(f"{op}({{0}})") for op in ("sign", "asinh", "acosh", "atanh")},
    "min": call("smaller({0}, {1})"),
    "max": call("larger({0}, {1})"),
    "select": Operator(1, "if {0} {{ {1} }} else {{ {2} }}"),
}

LITERALS = Literals("f64::INFINITY", "f64::NAN")

HELPERS = helpers("rust")
"""Helper functions that the file defines. All return NaN for NaN."""

RESERVED = (
    *words("rust", "reserved"),
    *QUANTITIES,
    *(name.upper() for name in (*QUANTITIES, "state", "parameters", "prepared")),
    *("STATE_NAMES", "PARAMETER_NAMES", "DEFAULT_PARAMETERS"),
)
"""Words that cannot be names of values: keywords, names that the file uses, and parameters of functions."""

LANGUAGE = Language(
    name="Rust",
    operations=OPERATIONS,
    literals=LITERALS,
    helpers=HELPERS,
    define="let {name}: {type} = {value};",
    store="{name} = {value};",
    types=("f64", "bool"),
    condition=Operator(5, "{0} != 0.0", (6,)),
    number=Operator(1, "if {0} {{ 1.0 }} else {{ 0.0 }}"),
    matrix="let mut {name} = [[0.0; {order}]; {rows}];",
    factor="let {other} = factored(&mut {name});",
    solve="let mut {name} = [0.0; {order}];\nsolved(&{other}, &[{entries}], &mut {name});",
    reserved=RESERVED,
    local="let {mut}{name} = {value};",
    entry="{0}[{1}][{2}]",
    loop="for {0} in {1}..{2} {{",
    back="for {0} in ({1}..{2}).rev() {{",
    when="if {0} {{",
    end_loop="}",
    end_when="}",
    to_real="{0} as f64",
    to_index="{0} as usize",
    leave="{0}",
    factored=("fn factored<const N: usize>(a: &mut [[f64; N]]) -> bool {\n    let n = N;", "}"),
    solved=("fn solved<const N: usize>(a: &[[f64; N]], right: &[f64; N], x: &mut [f64; N]) {\n    let n = N;", "}"),
)


def source(module: SourceModule) -> str:
    """Return the text of the Rust file."""
    functions = PrintedFunctions(module, LANGUAGE)
    lines = [
        *statement_comment(module, "//"),
        "",
        "// Names are those of the statement. A program may leave functions unused.",
        "#![allow(dead_code, non_snake_case, unexpected_cfgs, unused_parens, unknown_lints, invalid_nan_comparisons)]",
        "",
        *constants(module, functions.hoisted.size),
        "",
        *_function(
            "pub fn prepare(parameters: &[f64], p: &mut [f64]) -> bool {",
            module.prepare.about,
            functions.prepare(),
            f"let (parameters, p) = (&parameters[..{len(module.parameters)}], &mut p[..{functions.hoisted.size}]);",
        ),
    ]
    for quantity in module.quantities:
        slices = f"(&y[..STATE], &p[..{functions.hoisted.size}], &mut out[..{len(quantity.results)}])"
        head = f"pub fn {quantity.name}(t: f64, y: &[f64], p: &[f64], out: &mut [f64]) -> bool {{"
        about = about_of(module, quantity.procedure)
        lines += _function(head, about, functions.quantity(quantity), f"let (y, p, out) = {slices};")
    lines += LANGUAGE.systems(functions.needed)
    lines += (f"{text}\n" for text in LANGUAGE.definitions(functions.needed))
    return "\n".join(lines).rstrip("\n") + "\n"


def _function(head: str, about: str, function: PrintedFunction, slices: str) -> Iterator[str]:
    """Yield the lines of a Rust function with the first line `head`; `about` is its comment.

    `slices` is the first line of its body, which checks the lengths of the arrays.
    """
    yield from commented(about, "///")
    yield head
    ignored = [name for name in function.unused if name in head.replace("(", " ").replace(":", " ").split()]
    for line in (slices, *(f"let _ = {name};" for name in ignored), *function.lines, function.status):
        yield from continued(f"    {line}")
    yield "}"
    yield ""


def constants(module: SourceModule, prepared: int) -> Iterator[str]:
    """Yield the lines at the top of the file: array sizes, names, defaults, and comments on functions.

    `prepared` is the length of p, the array of values that depend on parameters alone.
    """
    for name, count, about in sizes(module, prepared):
        yield f"pub const {name.upper()}: usize = {count}; // {about}"
    yield ""
    yield from commented(places("y", module.state), "//")
    yield from commented(places("parameters", module.parameters), "//")
    for name, names in (("STATE_NAMES", module.state), ("PARAMETER_NAMES", module.parameters)):
        yield from continued(f"pub const {name}: [&str; {len(names)}] = [{', '.join(map(quoted, names))}];")
    yield from (f"pub const {name}: usize = {k};" for name, k in indices(module))
    values = ", ".join(map(LITERALS.real, module.values))
    yield from continued(f"pub const DEFAULT_PARAMETERS: [f64; {len(module.values)}] = [{values}];")
    yield ""
    yield from commented(statuses("false", "true"), "//")


def quoted(text: str) -> str:
    """Return a text as a Rust string literal in ASCII."""
    escaped = re.sub(r'[^ -~]|["\\]', lambda match: f"\\u{{{ord(match[0]):x}}}", text)
    return f'"{escaped}"'


TEST = Script("rust", comment=marked("//"), literals=LITERALS)


@register
class Rust(Target):
    """Target `rust`: one source file, and its test."""

    name = "rust"
    about = "Rust (edition 2021): one file, no crates, no unsafe code, quantities only"
    contents = frozenset()
    inexpressible = frozenset(MISSING)
    shell = ("rustc --edition 2021 -O -o {name}_{program} {name}_{program}.rs", "./{name}_{program}")
    reserved_files = (*RESERVED, "alloc", "lib", "proc_macro")
    """Keywords, and names of Rust's own crates."""

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the source file and of the self-test by file name."""
        name = self.file_name(module)
        return {f"{name}.rs": source(module), f"{name}_test.rs": test_text(module, TEST, file=name)}
