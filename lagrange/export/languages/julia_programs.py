"""The files of a model in Julia that test it, and that run its initial state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.export.descriptions import TEST, columns, integrator_of
from lagrange.export.languages.julia_printer import WIDTH, comment, in_order
from lagrange.export.languages.julia_spelling import LITERALS
from lagrange.export.module import Check, SourceModule, StepCheck
from lagrange.export.programs import arguments_in_test, main_fields, results_tested, tested

COMPARE = """\
function compare(name, state, found, wanted, allowed)
    failures = 0
    for i in 1:length(wanted)
        if !(abs(found[i] - wanted[i]) <= allowed[i])
            println("$name, state $state, result $i: $(found[i]) instead of $(wanted[i])")
            failures += 1
        end
    end
    return failures
end
"""


def _table(name: str, values: Sequence[float]) -> Iterator[str]:
    """Yield a list of numbers."""
    yield f"    {name} = ["
    line = " " * 8
    for value in values:
        text = f"{LITERALS.real(value)}, "
        if len(line) + len(text) > WIDTH:
            yield line.rstrip()
            line = " " * 8
        line += text
    yield line.rstrip()
    yield "    ]"


def _rows(name: str, rows: Sequence[Sequence[float]]) -> Iterator[str]:
    """Yield a list of lists of numbers."""
    yield f"    {name} = ["
    for row in rows:
        _, *lines, last = _table("", row)
        yield "        ["
        yield from (f"    {line}" for line in lines)
        yield f"    {last},"
    yield "    ]"


def test_file(module: SourceModule, name: str) -> str:
    """Return the program that compares results with those of multiple precision."""
    count = results_tested(module)
    lines = [
        *comment(f"{TEST} Exit status 0 if all are right."),
        "",
        f'include(joinpath(@__DIR__, "{module.name}.jl"))',
        "",
        COMPARE,
    ]
    for check in module.checks:
        lines += _quantity_test(check, name)
    for step in module.step_checks:
        lines += _integrator_test(module, step, name)
    lines += [
        "function test_all()",
        f"    p = zeros({name}.PREPARED_SIZE)",
        f"    if {name}.prepare!(p, {name}.DEFAULT_PARAMETERS)",
        '        println("prepare: a matrix is singular")',
        "        return 1",
        "    end",
        "    failures = 0",
        *(f"    failures += test_{one}(p)" for one in tested(module)),
        f'    println("{module.name}: ", {count} - failures, " of ", {count}, " results are right")',
        "    return failures",
        "end",
        "",
        "exit(test_all() > 0 ? 1 : 0)",
        "",
    ]
    return "\n".join(lines)


def _quantity_test(check: Check, name: str) -> Iterator[str]:
    """Yield the test of one function."""
    yield f"function test_{check.name}(p)"
    yield from _table("times", check.times)
    for table, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from _rows(table, rows)
    yield f"    out = zeros({len(check.results[0])})"
    yield "    failures = 0"
    yield f"    for k in 1:{len(check.times)}"
    yield f"        if {name}.{check.name}!(out, times[k], states[k], p)"
    yield f'            println("{check.name}, state $k: a matrix is singular")'
    yield "            out .= NaN"
    yield "        end"
    yield f'        failures += compare("{check.name}", k, out, wanted[k], allowed[k])'
    yield "    end"
    yield "    return failures"
    yield "end"
    yield ""


def _integrator_test(module: SourceModule, check: StepCheck, name: str) -> Iterator[str]:
    """Yield the test of an integrator."""
    yield f"function test_{check.name}(p)"
    for table, row in (("y", check.state), ("wanted", check.result), ("allowed", check.allowed)):
        yield from _table(table, row)
    if integrator_of(module, check.name).adaptive:
        yield f"    t = [{LITERALS.real(check.time)}]"
    given = arguments_in_test(module, check, LITERALS, "t", order=in_order)
    yield f"    outcome = {name}.{check.name}!({given})"
    yield "    if outcome != 0"
    yield f'        println("{check.name}: outcome $outcome")'
    yield "        y .= NaN"
    yield "    end"
    yield f'    return compare("{check.name}", 1, y, wanted, allowed)'
    yield "end"
    yield ""


MAIN = """\
# Integrate the initial state and write a table with commas: julia {file}_main.jl [t_end [intervals]].

include(joinpath(@__DIR__, "{file}.jl"))

const OUTCOMES = [
{outcomes}
]

function run_all(words)
    t_end = length(words) > 0 ? parse(Float64, words[1]) : {t_end}
    intervals = length(words) > 1 ? parse(Int64, words[2]) : {intervals}
    if intervals < 1
        println(stderr, "intervals: a whole number from 1")
        return 2
    end
    p = zeros({name}.PREPARED_SIZE)
    if {name}.prepare!(p, {name}.DEFAULT_PARAMETERS)
        println(stderr, "prepare: a matrix is singular")
        return 1
    end
{initial}
    t = [0.0]
    println("{columns}")
    for k in 0:intervals
        next = k == intervals ? t_end : t_end * k / intervals
        outcome = {name}.{method}!(t, y, next, p, {rtol}, {rtol}, {steps})
        if outcome != 0
            println(stderr, "the run stopped at t = $(t[1]): $(OUTCOMES[outcome + 1])")
            return 1
        end
        println(join([t[1]; y], ","))
    end
    return 0
end

exit(run_all(ARGS))
"""


def main_file(module: SourceModule, name: str) -> str:
    """Return the program that integrates the initial state and writes a table."""
    fields = main_fields(module, LITERALS)
    assert fields is not None and module.run is not None
    return MAIN.format(
        **{**fields, "initial": "\n".join(_table("y", module.run.initial))},
        file=module.name,
        name=name,
        columns=columns(module),
    )
