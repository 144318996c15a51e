"""The functions of a model in MATLAB and Octave that test it, and that run its initial state."""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.export.descriptions import TEST, columns, integrator_of, outcome_texts
from lagrange.export.languages.octave_printer import comment, table
from lagrange.export.languages.octave_spelling import LITERALS
from lagrange.export.module import Check, SourceModule, StepCheck
from lagrange.export.programs import arguments_in_test, main_fields, results_tested, tested

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
    for step in module.step_checks:
        lines += _integrator_test(module, step, prefix)
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


def _integrator_test(module: SourceModule, check: StepCheck, prefix: str) -> Iterator[str]:
    """Yield the test of an integrator."""
    yield f"function failures = test_{check.name}_results(p)"
    for name, row in (("y", check.state), ("wanted", check.result), ("allowed", check.allowed)):
        yield from table(name, [row])
    results = "~, y, outcome" if integrator_of(module, check.name).adaptive else "y, outcome"
    given = arguments_in_test(module, check, LITERALS, "{0}", "y.'")
    yield f"    [{results}] = {prefix}{check.name}({given});"
    yield "    if outcome ~= 0"
    yield f"        fprintf('{check.name}: outcome %d\\n', outcome);"
    yield "        y(:) = NaN;"
    yield "    end"
    yield f"    failures = compare('{check.name}', 1, y, wanted, allowed);"
    yield "end"
    yield ""


MAIN = """\
function {prefix}main(t_end, intervals)
% {prefix}main(t_end, intervals)
% Integrate the initial state and write a table with commas.
    outcomes = {{
{outcomes}
    }};
    if nargin < 1
        t_end = {t_end};
    end
    if nargin < 2
        intervals = {intervals};
    end
    if intervals < 1 || intervals ~= fix(intervals)
        error('intervals: a whole number from 1');
    end
    [p, singular] = {prefix}prepare({prefix}default_parameters());
    if singular
        error('prepare: a matrix is singular');
    end
{initial}
    y = y(:);
    t = 0;
{columns}
    for k = 0:intervals
        next = t_end;
        if k < intervals
            next = t_end * k / intervals;
        end
        [t, y, outcome] = {prefix}{method}(t, next, y, p, {rtol}, {rtol}, {steps});
        if outcome ~= 0
            error('the run stopped at t = %.17g: %s', t, outcomes{{outcome + 1}});
        end
        fprintf('%.*g', 15 + 2 * (str2double(sprintf('%.15g', t)) ~= t), t);
        fprintf(',%.17g', y);
        fprintf('\\n');
    end
end
"""


def main_file(module: SourceModule, prefix: str) -> str:
    """Return the function that integrates the initial state and writes a table."""
    fields = main_fields(module, LITERALS)
    assert fields is not None and module.run is not None
    heads = columns(module).split(",")
    return MAIN.format(
        **{
            **fields,
            "initial": "\n".join(table("y", [module.run.initial])),
            "outcomes": "\n".join(f"        {text}" for text in outcome_texts("'")),
        },
        prefix=prefix,
        columns="\n".join(
            f"    fprintf('{one}{',' if k < len(heads) - 1 else chr(92) + 'n'}');" for k, one in enumerate(heads)
        ),
    )
