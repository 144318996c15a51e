"""The functions of a model in MATLAB and Octave that test it, and that run its initial state."""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.export.descriptions import (
    MOST_STEPS,
    TEST,
    TEST_STEPS,
    TEST_TOLERANCE,
    columns,
    integrator_of,
    run_of,
)
from lagrange.export.languages.octave_printer import comment, table
from lagrange.export.languages.octave_spelling import real_literal
from lagrange.export.module import Check, SourceModule, StepCheck

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
    checks = [*(one.name for one in module.checks), *(one.name for one in module.step_checks)]
    count = sum(len(one.results) * len(one.results[0]) for one in module.checks)
    count += sum(len(one.result) for one in module.step_checks)
    lines = [
        f"function failures = {prefix}test()",
        f"% failures = {prefix}test(): how many results are wrong; 0 is right.",
        *comment(f"{TEST} Those that are not right are printed."),
        f"    [p, singular] = {prefix}prepare({prefix}default_parameters());",
        "    failures = double(singular);",
        "    if singular",
        "        fprintf('prepare: a matrix is singular\\n');",
        "    end",
        *(f"    failures = failures + test_{one}_results(p);" for one in checks),
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
    time, step = real_literal(check.time), real_literal(check.length)
    if integrator_of(module, check.name).adaptive:
        tolerances = f"{TEST_TOLERANCE}, {TEST_TOLERANCE}, {TEST_STEPS}"
        end = real_literal(check.time + check.length)
        yield f"    [~, y, outcome] = {prefix}{check.name}({time}, {end}, y.', p, {tolerances});"
    else:
        yield f"    [y, outcome] = {prefix}{check.name}({time}, {step}, y.', p);"
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
            next = t_end * (k / intervals);
        end
        [t, y, outcome] = {call};
        if outcome ~= 0
            error('the run stopped at t = %.17g: outcome %d', t, outcome);
        end
        fprintf('%.17g', t);
        fprintf(',%.17g', y);
        fprintf('\\n');
    end
end
"""


def main_file(module: SourceModule, prefix: str) -> str:
    """Return the function that integrates the initial state and writes a table."""
    found = run_of(module)
    assert found is not None
    run, integrator = found
    rtol = real_literal(run.rtol)
    heads = columns(module).split(",")
    return MAIN.format(
        prefix=prefix,
        t_end=real_literal(run.t_end),
        intervals=run.intervals,
        initial="\n".join(table("y", [run.initial])),
        columns="\n".join(
            f"    fprintf('{one}{',' if k < len(heads) - 1 else chr(92) + 'n'}');" for k, one in enumerate(heads)
        ),
        call=f"{prefix}{integrator.name}(t, next, y, p, {rtol}, {rtol}, {MOST_STEPS})",
    )
