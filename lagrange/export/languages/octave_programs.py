"""The function of a model in MATLAB and Octave that tests it."""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.export.descriptions import TEST
from lagrange.export.languages.octave_printer import comment, table
from lagrange.export.module import Check, SourceModule
from lagrange.export.programs import results_tested, tested

COMPARE = """\
function failures = compare(name, state, found, wanted, allowed)
    failures = 0;
    for i = 1:numel(wanted)
        if ~(abs(found(i) - wanted(i)) <= allowed(i))
            fprintf('%s, state %d, result %d: %.17g instead of %.17g\\n', name, state, i, found(i), wanted(i));
            failures = failures + 1;
        end
    end
end
"""


def test_file(module: SourceModule, prefix: str) -> str:
    """Return the function that compares results with those of multiple precision, and returns the failures."""
    count = results_tested(module)
    lines = [
        f"function failures = {prefix}test()",
        f"% failures = {prefix}test(): how many results are wrong; 0 is right.",
        *comment(f"{TEST} Those that are not right are printed."),
        f"    [p, singular] = {prefix}prepare({prefix}default_parameters());",
        "    failures = double(singular);",
        "    if singular",
        "        fprintf('prepare: a matrix is singular\\n');",
        "    end",
        *(f"    failures = failures + test_{one}_results(p);" for one in tested(module)),
        f"    fprintf('{module.name}: %d of %d results are right\\n', {count} - failures, {count});",
        "end",
        "",
        COMPARE,
    ]
    for check in module.checks:
        lines += _quantity_test(check, prefix)
    return "\n".join(lines).rstrip("\n") + "\n"


def _quantity_test(check: Check, prefix: str) -> Iterator[str]:
    """Yield the test of one function."""
    yield f"function failures = test_{check.name}_results(p)"
    yield from table("times", [check.times])
    for name, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from table(name, rows)
    yield "    failures = 0;"
    yield f"    for k = 1:{len(check.times)}"
    yield f"        [out, singular] = {prefix}{check.name}(times(k), states(k, :).', p);"
    yield "        if singular"
    yield f"            fprintf('{check.name}, state %d: a matrix is singular\\n', k);"
    yield "        end"
    yield f"        failures = failures + compare('{check.name}', k, out, wanted(k, :), allowed(k, :));"
    yield "    end"
    yield "end"
    yield ""
