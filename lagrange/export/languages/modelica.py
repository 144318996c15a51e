"""Export to Modelica: one package with functions and a model of the motion, and a package that tests the functions."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.elimination import ROWS
from lagrange.export.module import SourceModule, about_of, commented, distinct, places, plain, statement_comment
from lagrange.export.programs import Script, filled, helpers, marked, test_text, words
from lagrange.export.straight_line import Language, PrintedFunction, PrintedFunctions
from lagrange.export.target import QUANTITIES, Target, register
from lagrange.procedure.spelling import OPERATORS, WORDS, Literals, Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

_BUILT_IN = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh", "abs")
EXTERNAL = tuple(op for op in ELEMENTARY if op not in _BUILT_IN)
"""Elementary functions that Modelica lacks; the exported package calls those of the C library."""

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **WORDS,
    **{op: call(f"{op}({{0}})") for op in (*_BUILT_IN, *EXTERNAL)},
    "atan2": call("atan2({0}, {1})"),
    "select": Operator(1, "if {0} then {1} else {2}"),
    "neg": Operator(6, "-{0}", (7,)),
    "power": Operator(8, "{0} ^ {1}", (9, 9)),
    "min": call("smaller({0}, {1})"),
    "max": call("larger({0}, {1})"),
    "sign": call("sign_of({0})"),
}
"""Templates and precedences of operations. A sign has the precedence of a sum."""

LITERALS = Literals("exp(1000.0)", "sqrt(-1.0)", signed=OPERATIONS["neg"].binds)
"""Literals; infinity and NaN are expressions, since Modelica has no literals for them."""


def _external(op: str) -> str:
    return f"""
function {op}
  input Real x;
  output Real y;
  external "C" y = {op}(x) annotation(Include = "#include <math.h>");
end {op};
"""


HELPERS: Mapping[str, str] = {
    **{op: _external(op) for op in EXTERNAL},
    **{op: f"\n{text}\n" for op, text in helpers("modelica").items()},
}
"""Functions that the package defines. All return NaN for NaN."""

RESERVED = tuple(words("modelica", "reserved"))
"""Words that cannot be names of variables: keywords, functions of the language, and names in the package."""

_OWN = "t y out parameters prepare factored solved smaller larger sign_of fill integer"

LANGUAGE = Language(
    name="Modelica",
    operations=OPERATIONS,
    literals=LITERALS,
    helpers=HELPERS,
    define="{name} := {value};",
    store="{name} := {value};",
    first=1,
    condition=Operator(5, "{0} <> 0.0", (6,)),
    number=Operator(1, "if {0} then 1.0 else 0.0"),
    matrix="{name} := fill(0.0, {rows}, {order});",
    factor="{name} := factored({order}, {name});",
    solve="{name} := solved({order}, {other}, {{{entries}}});",
    reserved=(*RESERVED, *_OWN.split(), *EXTERNAL, *QUANTITIES),
    entry="{0}[{1}, {2}]",
    loop="for {0} in {1}:{2} loop",
    back="for {0} in {2}:-1:{1} loop",
    when="if {0} then",
    end_loop="end for;",
    end_when="end if;",
    to_index="integer({0} + 0.5)",
    leave='assert(not ({0}), "a matrix is singular to round-off");',
    factored=(filled("modelica", "factored", rows=ROWS), "end factored;"),
    solved=(filled("modelica", "solved", rows=ROWS), "end solved;"),
)

FINITE = """\
  for k in 1:{count} loop
    assert(abs(out[k]) <= 1.7976931348623157e+308, "a matrix is singular to round-off, or a result is not finite");
  end for;
"""
"""Assertion that results are finite, for functions that divide by inertias. With a zero inertia a simulation stops."""

MODELICA_WIDTH = 100


def broken(line: str, width: int = MODELICA_WIDTH) -> list[str]:
    """Return a line as several lines of at most `width` characters; all but the first are indented."""
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.wrap(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def remark(about: str) -> list[str]:
    """Return a text as the lines of a Modelica comment."""
    return commented(about, "//", MODELICA_WIDTH + 3)


def text(module: SourceModule, package: str) -> Iterator[str]:
    """Yield the lines of the Modelica package, whose name is `package`."""
    yield from statement_comment(module, "//")
    yield ""
    yield f"package {package}"
    yield ""
    functions = PrintedFunctions(module, LANGUAGE, statuses=False)
    for line in (*function_lines(functions), "", *motion(module, functions.hoisted.size)):
        yield f"  {line}".rstrip()
    yield f"end {package};"


def function_lines(functions: PrintedFunctions) -> Iterator[str]:
    """Yield the lines of the Modelica package of functions: `prepare`, one for each quantity, and helpers."""
    module, size = functions.module, functions.hoisted.size
    state = places("y", module.state, first=1)
    lines = ["", *remark(module.prepare.about), *remark(places("parameters", module.parameters, first=1))]
    arguments = {"parameters": len(module.parameters)}
    lines += _function("prepare", arguments, f"p[{size}]", functions.prepare(), "")
    for quantity in module.quantities:
        lines += ["", *remark(about_of(module, quantity.procedure)), *remark(state)]
        arguments = {"t": 0, "y": len(module.state), "p": size}
        count = len(quantity.results)
        finite = FINITE.format(count=count) if quantity.program.solved else ""
        lines += _function(quantity.name, arguments, f"out[{count}]", functions.quantity(quantity), finite)
    lines += ["", *LANGUAGE.systems(functions.needed)][:-1]
    lines += [line for text in LANGUAGE.definitions(functions.needed) for line in text.rstrip().splitlines()]
    yield "package Functions"
    yield from (f"  {line}".rstrip() for line in lines)
    yield "end Functions;"


def _function(
    name: str, arguments: Mapping[str, int], result: str, function: PrintedFunction, finite: str
) -> Iterator[str]:
    """Yield the lines of a Modelica function.

    `arguments` has the length of each argument by name, 0 for a number. `result` is the declaration of the returned
    array, such as "out[4]". `finite` are lines which assert that all results are finite; it may be empty.
    """
    yield f"function {name}"
    yield from (
        f"  input Real {argument};" if argument == "t" else f"  input Real {argument}[{size}];"
        for argument, size in arguments.items()
    )
    yield f"  output Real {result};"
    if function.declared:
        yield "protected"
    for kind, local, sizes in function.declared:
        if not re.fullmatch(r"singular\d+", local):
            shape = f"[{', '.join(map(str, sizes))}]" if sizes else ""
            yield f"  {'Boolean' if kind == 'flag' else 'Real'} {local}{shape};"
    yield "algorithm"
    for line in function.lines:
        yield from broken(f"  {line}", 110)
    yield from finite.splitlines()
    yield f"end {name};"


def motion(module: SourceModule, prepared: int) -> Iterator[str]:
    """Yield the lines of the Modelica model that simulates the motion from the initial state.

    `prepared` is the length of p, the array of values that depend on parameters alone.
    """
    shown = [quantity for quantity in module.quantities if quantity.name not in ("rhs", "jacobian")]
    every = (*module.state, *module.parameters, *(quantity.name for quantity in shown))
    names = distinct(every, RESERVED)
    state, parameters = names[: len(module.state)], names[len(module.state) :][: len(module.parameters)]
    results = names[len(module.state) + len(module.parameters) :]
    run = module.run
    assert run is not None  # the model is always there
    yield from remark("The motion from the initial state.")
    yield "model Motion"
    for name, stated, value in zip(parameters, module.parameters, module.values, strict=True):
        if stated in module.inputs:
            yield f"  input Real {name}(start = {LITERALS.real(value)}{_unit(module, stated, ', ')});"
        else:
            yield f"  parameter Real {name}{_unit(module, stated)} = {LITERALS.real(value)};"
    for name, stated, value in zip(state, module.state, run.initial, strict=True):
        yield f"  Real {name}(start = {LITERALS.real(value)}, fixed = true{_unit(module, stated, ', ')});"
    for name, quantity in zip(results, shown, strict=True):
        yield f"  Real {name}[{len(quantity.results)}];"
    yield "protected"
    kind = "Real" if module.inputs else "parameter Real"
    yield from broken(f"  {kind} p[{prepared}] = Functions.prepare({_array(parameters)});")
    yield f"  Real rates[{len(state)}];"
    yield "equation"
    yield from broken(f"  rates = Functions.rhs(time, {_array(state)}, p);")
    yield from (f"  der({name}) = rates[{k}];" for k, name in enumerate(state, 1))
    for name, quantity in zip(results, shown, strict=True):
        yield from broken(f"  {name} = Functions.{quantity.name}(time, {_array(state)}, p);")
    yield f"  annotation(experiment(StopTime = {LITERALS.real(run.t_end)}, Tolerance = {LITERALS.real(run.rtol)}));"
    yield "end Motion;"


def _array(names: Sequence[str]) -> str:
    return f"{{{', '.join(names)}}}" if names else "fill(0.0, 0)"


def _unit(module: SourceModule, name: str, before: str = "") -> str:
    unit = plain(module.units.get(name, "")).replace('"', "'")
    return "" if not unit else f'{before}unit = "{unit}"' if before else f'(unit = "{unit}")'


TEST = Script("modelica", comment=marked("//"), literals=LITERALS)


@register
class Modelica(Target):
    """Target `modelica`, version 3.3. A singular matrix ends a simulation by an assertion."""

    name = "modelica"
    about = "Modelica: a package with functions and a model of the motion, without a library"
    contents = frozenset(("main",))
    always = ("rhs", "main")
    reserved_files = RESERVED

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the exported files by name: the package, its test, and a script that runs the test."""
        name = self.file_name(module)
        fields = {
            "package": name,
            "size": len(module.parameters),
            "defaults": "\n".join(broken(f"    {_array(list(map(LITERALS.real, module.values)))}")).strip(),
            "prepared_size": PrintedFunctions(module, LANGUAGE, statuses=False).hoisted.size,
            "calls": " +\n          ".join(f"test_{check.name}()" for check in module.checks),
        }
        return {
            f"{name}.mo": "\n".join([*text(module, name), ""]),
            f"{name}_test.mo": test_text(module, TEST, **fields),
            f"{name}_test.mos": f"{filled('modelica', 'run', name=name)}\n",
        }

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs the test in OpenModelica."""
        return [f"omc {self.file_name(module)}_test.mos"]
