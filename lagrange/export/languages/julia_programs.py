"""The file of a model in Julia that tests it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.export.descriptions import TEST
from lagrange.export.languages.julia_printer import WIDTH, comment
from lagrange.export.languages.julia_spelling import LITERALS
from lagrange.export.module import Check, SourceModule
from lagrange.export.programs import results_tested, tested

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
