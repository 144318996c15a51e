"""Modelica: one package with functions, a model of the motion, and a model that tests the functions.

Functions are printed straight from programs: they have no loops and no memory but their results.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.comments import plain, wrapped
from lagrange.export.descriptions import TEST, places, statement_comment
from lagrange.export.identifiers import distinct
from lagrange.export.languages.modelica_printer import LITERALS, FunctionPrinter, Hoisted, broken, helpers_of
from lagrange.export.module import Check, Quantity, SourceModule
from lagrange.export.target import Target, register

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
WORDS = tuple(TAKEN.split())
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
        """Return what runs the test."""
        return [f"omc {package(module)}_test.mos"]


def package(module: SourceModule) -> str:
    """Return the name of the package."""
    return distinct([module.name], WORDS)[0]


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
    """Return a comment, broken where it is long."""
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
    names = distinct(every, WORDS)
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
