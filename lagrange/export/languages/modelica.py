"""Modelica: one package with functions, a model of the motion, and a model that tests the functions.

Functions are printed straight from programs: they have no loops and no memory but their results.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.comments import plain, wrapped
from lagrange.export.descriptions import TEST, places, statement_comment
from lagrange.export.identifiers import distinct
from lagrange.export.module import Check, Quantity, SourceModule
from lagrange.export.target import Target, register
from lagrange.machine.kernel.python_text import FLAG_OPERATIONS, uses_of
from lagrange.procedure.form import REAL
from lagrange.procedure.linear.pivoted import PIVOT
from lagrange.procedure.source_printer import LONGEST_VALUE
from lagrange.procedure.spelling import ATOM, WORDS, Literals, Operator, call
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.program.program import Instruction, Program
from lagrange.statement.elementary import ELEMENTARY

SYSTEMS = ("factor", "solve", "component")

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    **WORDS,
    "select": Operator(1, "if {0} then {1} else {2}"),
    "neg": Operator(6, "-{0}", (7,)),
    "power": Operator(8, "{0} ^ {1}", (9, 9)),
}
"""Operators with precedences; a sign applies to the whole sum after it."""

LITERALS = Literals("exp(1000.0)", "sqrt(-1.0)", signed=OPERATORS["neg"].binds)
"""Literals; infinity and NaN are expressions, since Modelica has no literals for them."""

SUM = OPERATORS["add"].binds

_BUILT_IN = ("sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh")

EXTERNAL = tuple(name for name in ELEMENTARY if name not in _BUILT_IN)
"""Functions of the C library, which the language gives access to."""

CHOSEN = {
    "min": ("smaller", "if a < b or a <> a then a else b"),
    "max": ("larger", "if a > b or a <> a then a else b"),
    "sign": ("sign_of", "if a > 0.0 then 1.0 elseif a < 0.0 then -1.0 else a"),
}
"""Operations that are functions of the package, in which NaN stays NaN."""

CONDITIONS: Mapping[str, tuple[int, ...]] = {"select": (0,), "and": (0, 1), "or": (0, 1), "not": (0,)}

ELIMINATION = f"""
// L U of a symmetric matrix in units in which its diagonal is one, if that is positive; behind it where each row
// stood, and the units. A matrix that is singular to round-off ends the simulation.
function factored
  input Integer n;
  input Real lower[:];
  output Real a[n + 2, n];
protected
  Real largest[n];
  Real kept;
  Integer best;
  Boolean positive;
algorithm
  positive := true;
  for i in 1:n loop
    for j in 1:i loop
      a[i, j] := lower[div(i * (i - 1), 2) + j];
      a[j, i] := a[i, j];
    end for;
    positive := positive and a[i, i] > 0.0;
  end for;
  for i in 1:n loop
    a[n + 1, i] := i;
    a[n + 2, i] := if positive then 1.0 / sqrt(a[i, i]) else 1.0;
  end for;
  for i in 1:n loop
    largest[i] := 0.0;
    for j in 1:n loop
      a[i, j] := a[n + 2, i] * a[i, j] * a[n + 2, j];
      largest[i] := if abs(a[i, j]) > largest[i] then abs(a[i, j]) else largest[i];
    end for;
  end for;
  for j in 1:n loop
    best := j;
    for i in j + 1:n loop
      best := if abs(a[i, j]) * largest[best] > abs(a[best, j]) * largest[i] then i else best;
    end for;
    assert(not abs(a[best, j]) <= {PIVOT!r} * largest[best], "a matrix is singular to round-off");
    kept := largest[j];
    largest[j] := largest[best];
    largest[best] := kept;
    kept := a[n + 1, j];
    a[n + 1, j] := a[n + 1, best];
    a[n + 1, best] := kept;
    for k in 1:n loop
      kept := a[j, k];
      a[j, k] := a[best, k];
      a[best, k] := kept;
    end for;
    for i in j + 1:n loop
      a[i, j] := a[i, j] / a[j, j];
      for k in j + 1:n loop
        a[i, k] := a[i, k] - a[i, j] * a[j, k];
      end for;
    end for;
  end for;
end factored;

// The solution of a system whose matrix is factored.
function solved
  input Integer n;
  input Real a[n + 2, n];
  input Real right[n];
  output Real x[n];
protected
  Integer row;
algorithm
  for i in 1:n loop
    row := integer(a[n + 1, i] + 0.5);
    x[i] := a[n + 2, row] * right[row];
    for k in 1:i - 1 loop
      x[i] := x[i] - a[i, k] * x[k];
    end for;
  end for;
  for j in 1:n loop
    for k in n + 2 - j:n loop
      x[n + 1 - j] := x[n + 1 - j] - a[n + 1 - j, k] * x[k];
    end for;
    x[n + 1 - j] := x[n + 1 - j] / a[n + 1 - j, n + 1 - j];
  end for;
  for i in 1:n loop
    x[i] := a[n + 2, i] * x[i];
  end for;
end solved;
"""


FINITE = """\
  for k in 1:{count} loop
    assert(abs(out[k]) <= 1.7976931348623157e+308, "a matrix is singular to round-off, or a result is not finite");
  end for;
"""
"""Behind what divides by inertias: where one is zero, results are not finite, and a simulation could not go on."""


def broken(line: str, width: int) -> list[str]:
    """Return a line as several lines of a width; all but the first are indented."""
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.wrap(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def helpers_of(programs: Sequence[Program]) -> Iterator[str]:
    """Yield the functions that some programs need beside those of the language."""
    used = dict.fromkeys(one.op for program in programs for one in program.instructions)
    for op in sorted(used):
        if op in EXTERNAL:
            yield from ("", f"function {op}", "  input Real x;", "  output Real y;")
            yield f'  external "C" y = {op}(x) annotation(Include = "#include <math.h>");'
            yield f"end {op};"
        elif op in CHOSEN:
            name, chosen = CHOSEN[op]
            inputs = ["  input Real a;", *(["  input Real b;"] if op != "sign" else [])]
            yield from ("", f"function {name}", *inputs, "  output Real c;", "algorithm", f"  c := {chosen};")
            yield f"end {name};"
    if "factor" in used:
        yield from ELIMINATION.rstrip().splitlines()


class Hoisted:
    """Values that depend on parameters alone and are read by other values, numbered after the parameters, from 1 on.

    Linear systems and values that read them are not hoisted: their factors are not numbers.
    """

    def __init__(self, programs: Sequence[Program], parameters: int) -> None:
        self.programs = programs
        self.places: dict[tuple[Program, int], int] = {}
        self.early: dict[Program, dict[int, None]] = {}
        self.size = parameters
        for program in programs:
            early: dict[int, None] = {}
            for i, one in enumerate(program.instructions[: program.hoisted]):
                if one.op not in SYSTEMS and all(arg in early for arg in one.args):
                    early[i] = None
            read = [arg for i, one in enumerate(program.instructions) if i not in early for arg in one.args]
            for i in dict.fromkeys((*read, *program.outputs)):
                one = program.instructions[i]
                if i in early and one.op not in ("constant", "parameter", *FLAG_OPERATIONS):
                    self.size += 1
                    self.places[program, i] = self.size
            self.early[program] = early
        self.parameters = parameters


def _read(program: Program, kept: Mapping[int, int]) -> dict[int, None]:
    """Return the values that the outputs need where some are known."""
    found: dict[int, None] = {}
    todo = list(program.outputs)
    while todo:
        ref = todo.pop()
        if ref not in found and ref not in kept:
            found[ref] = None
            todo += program.instructions[ref].args
    return found


def _call_of(one: Instruction) -> Operator:
    """Return an operation as a call, of a function of the package where the language has none."""
    name = CHOSEN[one.op][0] if one.op in CHOSEN else one.op
    return call(f"{name}({', '.join(f'{{{k}}}' for k in range(len(one.args)))})")


class FunctionPrinter:
    """Prints the part of a function after its inputs: declarations, and the statements of its algorithm."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.declared: list[str] = []
        self.texts: dict[int, tuple[int, str]] = {}

    def preparation(self, hoisted: Hoisted) -> list[str]:
        """Return the lines of the function that computes the hoisted values."""
        self.lines = [f"  p[{k}] := parameters[{k}];" for k in range(1, hoisted.parameters + 1)]
        for which, program in enumerate(hoisted.programs, 1):
            self.texts = {}
            self.values(program, list(hoisted.early[program]), "parameters", f"x{which}_")
            for (owner, ref), place in hoisted.places.items():
                if owner is program:
                    self.lines.append(f"  p[{place}] := {self.text(ref)};")
        return self.ended()

    def function(self, program: Program, hoisted: Hoisted) -> list[str]:
        """Return the lines of the function of a program."""
        kept = {ref: place for (owner, ref), place in hoisted.places.items() if owner is program}
        self.texts = {ref: (ATOM, f"p[{place}]") for ref, place in kept.items()}
        self.values(program, sorted(_read(program, kept)), "p", "x")
        self.lines += [f"  out[{k}] := {self.number(program, ref)};" for k, ref in enumerate(program.outputs, 1)]
        if program.solved:
            self.lines += FINITE.format(count=len(program.outputs)).splitlines()
        return self.ended()

    def ended(self) -> list[str]:
        """Return the declarations and the lines."""
        head = ["protected", *(f"  {one};" for one in self.declared)] if self.declared else []
        return [*head, "algorithm", *(part for line in self.lines for part in broken(line, 110))]

    def values(self, program: Program, refs: Sequence[int], parameters: str, stem: str) -> None:
        """Print some values of a program, those that are read once where they are read."""
        uses = uses_of(program)
        for i in refs:
            one = program.instructions[i]
            match one.op:
                case "state":
                    self.texts[i] = ATOM, f"y[{one.place + 1}]"
                case "parameter":
                    self.texts[i] = ATOM, f"{parameters}[{one.place + 1}]"
                case "time":
                    self.texts[i] = ATOM, "t"
                case "constant":
                    self.texts[i] = LITERALS.spelled(REAL, one.value)
                case "factor" | "solve" | "component":
                    self.system(program, i, one, stem)
                case _:
                    self.operation(program, i, one, stem, uses[i])

    def system(self, program: Program, i: int, one: Instruction, stem: str) -> None:
        """Print the factors of a matrix, a solution, or keep an entry of one."""
        if one.op == "component":
            self.texts[i] = ATOM, f"{self.text(one.args[0])}[{one.place + 1}]"
            return
        name, n = f"{stem}{i}", one.order
        if one.op == "factor":
            entries = ", ".join(self.text(arg) for arg in one.args)
            self.declared.append(f"Real {name}[{n + 2}, {n}]")
            self.lines.append(f"  {name} := factored({n}, {{{entries}}});")
        else:
            entries = ", ".join(self.text(arg) for arg in one.args[1:])
            n = len(one.args) - 1
            self.declared.append(f"Real {name}[{n}]")
            self.lines.append(f"  {name} := solved({n}, {self.text(one.args[0])}, {{{entries}}});")
        self.texts[i] = ATOM, name

    def operation(self, program: Program, i: int, one: Instruction, stem: str, uses: int) -> None:
        """Print an operation, or keep it for the one place where it is read."""
        conditions = CONDITIONS.get(one.op, ())
        operator = OPERATORS.get(one.op) or _call_of(one)
        args = [
            self.condition(program, arg, need) if k in conditions else self.text(arg, need)
            for k, (arg, need) in enumerate(zip(one.args, operator.operands or (0,) * len(one.args), strict=True))
        ]
        level, found = operator.binds, operator.text.format(*args)
        if uses > 1 or len(found) >= LONGEST_VALUE:
            kind = "Boolean" if one.op in FLAG_OPERATIONS else "Real"
            self.declared.append(f"{kind} {stem}{i}")
            self.lines.append(f"  {stem}{i} := {found};")
            level, found = ATOM, f"{stem}{i}"
        self.texts[i] = level, found

    def text(self, ref: int, least: int = 0) -> str:
        """Return a value as an operand, in parentheses where it binds less tightly than it must."""
        level, found = self.texts[ref]
        return found if level >= least else f"({found})"

    def condition(self, program: Program, ref: int, least: int) -> str:
        """Return a condition; a number is one unless it is zero."""
        if program.instructions[ref].op in FLAG_OPERATIONS:
            return self.text(ref, least)
        found = f"{self.text(ref, SUM)} <> 0.0"
        return found if least <= OPERATORS["equal"].binds else f"({found})"

    def number(self, program: Program, ref: int) -> str:
        """Return a result: a condition is one or zero."""
        if program.instructions[ref].op in FLAG_OPERATIONS:
            return f"if {self.text(ref)} then 1.0 else 0.0"
        return self.text(ref)


TAKEN = """
    algorithm and annotation assert block break class connect connector constant constrainedby der discrete each else
    elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow for function if
    import impure in initial inner input loop model not operator or outer output package parameter partial protected
    public pure record redeclare replaceable return stream then true type when while within Real Integer Boolean String
    time abs sign sqrt div mod rem ceil floor integer sin cos tan asin acos atan atan2 sinh cosh tanh exp log log10
    delay cardinality homotopy pre edge change reinit sample terminal noEvent smooth size ndims min max sum product
    fill zeros ones identity linspace array cat scalar vector matrix transpose cross skew Clock StateSelect
    AssertionLevel Modelica Functions Motion Test p rates
"""
RESERVED = tuple(TAKEN.split())
"""Words that are not names of variables: keywords, functions of the language, and names of the package."""

WIDTH = 100


@register
class Modelica(Target):
    """Modelica 3.3; see `Target`. A singular matrix ends a simulation by an assertion."""

    name = "modelica"
    about = "Modelica: a package with functions, a model of the motion and a test, without a library"
    contents = frozenset(("main",))
    always = ("rhs", "main")

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the package, and a script that has OpenModelica run its test."""
        name = package(module)
        return {f"{name}.mo": "\n".join([*text(module), ""]), f"{name}_test.mos": script(name)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs the test."""
        return [f"omc {package(module)}_test.mos"]


def package(module: SourceModule) -> str:
    """Return the name of the package."""
    return distinct([module.name], RESERVED)[0]


def script(name: str) -> str:
    """Return a script of OpenModelica that runs the test, with exit status 1 where it fails."""
    return (
        f'loadFile("{name}.mo");\n'
        f"found := simulate({name}.Test, startTime = 0.0, stopTime = 1.0, numberOfIntervals = 1);\n"
        "getErrorString();\n"
        'exit(if found.resultFile == "" then 1 else 0);\n'
    )


def text(module: SourceModule) -> Iterator[str]:
    """Yield the lines of the package."""
    yield from statement_comment(module, "//")
    yield ""
    yield f"package {package(module)}"
    yield ""
    hoisted = Hoisted([one.program for one in module.quantities], len(module.parameters))
    yield from (f"  {line}".rstrip() for line in functions(module, hoisted))
    yield ""
    for line in (*motion(module, hoisted), "", *test(module, hoisted)):
        yield f"  {line}".rstrip()
    yield f"end {package(module)};"


def functions(module: SourceModule, hoisted: Hoisted) -> Iterator[str]:
    """Yield the package of the functions."""
    yield "package Functions"
    for line in (*helpers_of(hoisted.programs), *prepare(module, hoisted), *quantities(module, hoisted)):
        yield f"  {line}".rstrip()
    yield "end Functions;"


def remark(about: str) -> list[str]:
    """Return the lines of a comment."""
    return [f"// {line}" for line in wrapped(about, WIDTH)]


def prepare(module: SourceModule, hoisted: Hoisted) -> Iterator[str]:
    """Yield the function that computes once what depends on parameters alone."""
    yield ""
    yield from remark("The parameters, and behind them what depends on them alone.")
    yield from remark(places("parameters", module.parameters, first=1))
    yield "function prepare"
    yield f"  input Real parameters[{len(module.parameters)}];"
    yield f"  output Real p[{hoisted.size}];"
    yield from FunctionPrinter().preparation(hoisted)
    yield "end prepare;"


def quantities(module: SourceModule, hoisted: Hoisted) -> Iterator[str]:
    """Yield a function for each quantity."""
    for one in module.quantities:
        yield ""
        yield from remark(f"{one.about} out: {', '.join(one.results)}.")
        yield from remark(places("y", module.state, first=1))
        yield f"function {one.name}"
        yield "  input Real t;"
        yield f"  input Real y[{len(module.state)}];"
        yield f"  input Real p[{hoisted.size}];"
        yield f"  output Real out[{len(one.results)}];"
        yield from FunctionPrinter().function(one.program, hoisted)
        yield f"end {one.name};"


def motion(module: SourceModule, hoisted: Hoisted) -> Iterator[str]:
    """Yield the model of the motion from the initial state."""
    shown = [one for one in module.quantities if one.name not in ("rhs", "jacobian")]
    every = (*module.state, *module.parameters, *(one.name for one in shown))
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
    for name, one in zip(results, shown, strict=True):
        yield f"  Real {name}[{len(one.results)}];"
    yield "protected"
    prepared = "Real" if module.inputs else "parameter Real"
    yield from broken(f"  {prepared} p[{hoisted.size}] = Functions.prepare({_array(parameters)});", WIDTH)
    yield f"  Real rates[{len(state)}];"
    yield "equation"
    yield from broken(f"  rates = Functions.rhs(time, {_array(state)}, p);", WIDTH)
    yield from (f"  der({name}) = rates[{k}];" for k, name in enumerate(state, 1))
    for name, one in zip(results, shown, strict=True):
        yield from broken(f"  {name} = Functions.{one.name}(time, {_array(state)}, p);", WIDTH)
    yield f"  annotation(experiment(StopTime = {LITERALS.real(run.t_end)}, Tolerance = {LITERALS.real(run.rtol)}));"
    yield "end Motion;"


def _array(names: Sequence[str]) -> str:
    return f"{{{', '.join(names)}}}" if names else "fill(0.0, 0)"


def _unit(module: SourceModule, name: str, before: str = "") -> str:
    unit = plain(module.units.get(name, "")).replace('"', "'")
    return "" if not unit else f'{before}unit = "{unit}"' if before else f'(unit = "{unit}")'


def test(module: SourceModule, hoisted: Hoisted) -> Iterator[str]:
    """Yield the model that tests the functions: it warns of every wrong result, and fails if there is one."""
    yield from remark(f"{TEST} The simulation fails unless all are right.")
    yield "model Test"
    yield "  Integer failures;"
    yield "algorithm"
    yield "  when initial() then"
    counted = " + ".join(f"test_{one.name}()" for one in module.quantities)
    yield from broken(f"    failures := {counted};", WIDTH)
    yield '    assert(failures == 0, String(failures) + " results are wrong");'
    yield "  end when;"
    by_name = {check.name: check for check in module.checks}
    yield "end Test;"
    for one in module.quantities:
        yield ""
        yield from _check(module, one, by_name[one.name], hoisted)


def _check(module: SourceModule, one: Quantity, check: Check, hoisted: Hoisted) -> Iterator[str]:
    """Yield the test of a quantity, a function that counts the failures."""
    yield f"function test_{one.name}"
    yield "  output Integer failures;"
    yield "protected"
    yield from broken(f"  constant Real times[{len(check.times)}] = {_row(check.times)};", WIDTH)
    for name, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        table = f"{{{', '.join(map(_row, rows))}}}"
        yield from broken(f"  constant Real {name}[{len(rows)}, {len(rows[0])}] = {table};", WIDTH)
    yield f"  Real p[{hoisted.size}];"
    yield f"  Real out[{len(one.results)}];"
    yield "algorithm"
    values = f"{{{', '.join(map(LITERALS.real, module.values))}}}" if module.values else "fill(0.0, 0)"
    yield from broken(f"  p := Functions.prepare({values});", WIDTH)
    yield "  failures := 0;"
    yield f"  for k in 1:{len(check.times)} loop"
    yield f"    out := Functions.{one.name}(times[k], states[k, :], p);"
    yield f"    for i in 1:{len(one.results)} loop"
    yield "      if not abs(out[i] - wanted[k, i]) <= allowed[k, i] then"
    yield "        failures := failures + 1;"
    found = "String(out[i], significantDigits = 17)"
    message = f'"{one.name}, state " + String(k) + ", result " + String(i) + ": " + {found}'
    yield from ("        assert(false,", f"            {message},", "            AssertionLevel.warning);")
    yield "      end if;"
    yield "    end for;"
    yield "  end for;"
    yield f"end test_{one.name};"


def _row(values: Sequence[float]) -> str:
    return f"{{{', '.join(map(LITERALS.real, values))}}}"
