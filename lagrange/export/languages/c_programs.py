"""The programs of a C file, each under a macro: one tests its functions, one runs the initial state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.export.descriptions import TEST, columns, integrator_of
from lagrange.export.languages.c_printer import WIDTH, CNames, broken, comment
from lagrange.export.languages.c_spelling import LITERALS
from lagrange.export.lines import continued
from lagrange.export.module import Check, SourceModule, StepCheck
from lagrange.export.programs import arguments_in_test, macro, main_fields


def numbers(values: Sequence[float]) -> str:
    """Return a list of numbers."""
    return ", ".join(map(LITERALS.real, values))


def _table(name: str, rows: Sequence[Sequence[float]]) -> Iterator[str]:
    """Yield the lines of a table of numbers, row by row."""
    values = [LITERALS.real(value) for row in rows for value in row]
    yield f"static const double {name}[] = {{"
    yield from broken(values, "    ", WIDTH)[:-1]
    yield broken(values, "    ", WIDTH)[-1][:-1]
    yield "};"


COMPARE = """\
static int compare(const char *name, int state, int count, const double *found, const double *wanted,
                   const double *allowed) {
    int failures = 0;
    for (int i = 0; i < count; i++) {
        if (!(fabs(found[i] - wanted[i]) <= allowed[i])) {
            printf("%s, state %d, result %d: %.17g instead of %.17g\\n", name, state, i, found[i], wanted[i]);
            failures++;
        }
    }
    return failures;
}
"""


def programs(module: SourceModule, c_names: CNames) -> str:
    """Return both programs, each under a macro."""
    return "\n".join([*_test(module, c_names), *_run(module, c_names)])


def _test(module: SourceModule, c_names: CNames) -> Iterator[str]:
    """Yield the test: a program that compares results with those of multiple precision."""
    prepare = f"{c_names.function('prepare')}({c_names.defaults}, p)"
    yield f"#ifdef {macro(module, 'test')}"
    yield from comment(f"{TEST} Exit status 0 if all are right.")
    yield "#include <stdio.h>"
    yield ""
    yield COMPARE
    yield "int main(void) {"
    body = [f"double p[{max(module.prepared, 1)}];", "int failures = 0;", "int checked = 0;"]
    body += [f"if ({prepare}) {{"]
    body += ['    printf("prepare: a matrix is singular\\n");', "    failures++;", "}"]
    for check in module.checks:
        body += _quantity_test(module, check, c_names)
    for step in module.step_checks:
        body += _integrator_test(module, step, c_names)
    body.append(f'printf("{module.name}: %d of %d results are right\\n", checked - failures, checked);')
    yield from (f"    {line}" if line else "" for line in body)
    yield "    return failures == 0 ? 0 : 1;"
    yield "}"
    yield "#endif"


def _quantity_test(module: SourceModule, check: Check, c_names: CNames) -> Iterator[str]:
    """Yield the test of one function."""
    count, states = len(check.results[0]), len(check.times)
    size = len(module.state)
    yield "{"
    yield from continued(f"    static const double times[] = {{{numbers(check.times)}}};", WIDTH)
    for name, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from (f"    {line}" for line in _table(name, rows))
    yield f"    for (int k = 0; k < {states}; k++) {{"
    yield f"        double out[{count}];"
    yield f"        const int singular = {c_names.function(check.name)}(times[k], states + {size} * k, p, out);"
    yield "        if (singular) {"
    yield f'            printf("{check.name}, state %d: a matrix is singular\\n", k);'
    yield f"            failures += {count};"
    yield "        } else {"
    given = f'"{check.name}", k, {count}, out, wanted + {count} * k, allowed + {count} * k'
    yield f"            failures += compare({given});"
    yield "        }"
    yield f"        checked += {count};"
    yield "    }"
    yield "}"


def _integrator_test(module: SourceModule, check: StepCheck, c_names: CNames) -> Iterator[str]:
    """Yield the test of an integrator."""
    count = len(check.state)
    yield "{"
    for name, row in (("wanted", check.result), ("allowed", check.allowed)):
        yield from (f"    {line}" for line in _table(name, [row]))
    yield from continued(f"    double y[] = {{{numbers(check.state)}}};", WIDTH)
    if integrator_of(module, check.name).adaptive:
        yield f"    double t[] = {{{LITERALS.real(check.time)}}};"
    given = arguments_in_test(module, check, LITERALS, "t")
    yield f"    const int64_t outcome = {c_names.function(check.name)}({given});"
    yield "    if (outcome != 0) {"
    yield f'        printf("{check.name}: outcome %d\\n", (int)outcome);'
    yield f"        failures += {count};"
    yield "    } else {"
    yield f'        failures += compare("{check.name}", 0, {count}, y, wanted, allowed);'
    yield "    }"
    yield f"    checked += {count};"
    yield "}"


MAIN = """\
int main(int count, char **words) {{
    static const char *const outcomes[] = {{
{outcomes}
    }};
    double p[{prepared}];
    double t[] = {{0.0}};
    double y[] = {{{initial}}};
    char *rest = NULL;
    const double t_end = count > 1 ? strtod(words[1], &rest) : {t_end};
    if (count > 3 || (count > 1 && (rest == words[1] || *rest != 0)) || !(fabs(t_end) <= 1e300)) {{
        fprintf(stderr, "t_end: give a number, such as 10.0\\n");
        return 2;
    }}
    const long intervals = count > 2 ? strtol(words[2], &rest, 10) : {intervals};
    if ((count > 2 && (rest == words[2] || *rest != 0)) || intervals < 1) {{
        fprintf(stderr, "intervals: give a whole number from 1\\n");
        return 2;
    }}
    if ({prepare}({defaults}, p)) {{
        fprintf(stderr, "prepare: a matrix is singular\\n");
        return 1;
    }}
    printf("{columns}\\n");
    for (long k = 0; k <= intervals; k++) {{
        const double end = k == intervals ? t_end : t_end * (double)k / (double)intervals;
        const int64_t outcome = {method}(t, end, y, p, {rtol}, {rtol}, {steps});
        if (outcome != 0) {{
            fprintf(stderr, "the run stopped at t = %.17g: %s\\n", t[0], outcomes[outcome]);
            return 1;
        }}
        char text[32];
        snprintf(text, sizeof text, "%.15g", t[0]);
        printf("%.*g", strtod(text, NULL) == t[0] ? 15 : 17, t[0]);
        for (int i = 0; i < {count}; i++) {{
            printf(",%.17g", y[i]);
        }}
        printf("\\n");
    }}
    return 0;
}}
#endif"""


def _run(module: SourceModule, c_names: CNames) -> Iterator[str]:
    """Yield a program that integrates the initial state and writes a table."""
    fields = main_fields(module, LITERALS)
    if fields is None:
        return
    yield ""
    yield f"#ifdef {macro(module, 'main')}"
    yield from comment(
        f"Integrate the initial state and write a table with commas: {module.name}_main [t_end [intervals]]."
    )
    yield "#include <stdio.h>"
    yield "#include <stdlib.h>"
    yield ""
    text = MAIN.format(
        **{**fields, "method": c_names.function(fields["method"])},
        prepare=c_names.function("prepare"),
        defaults=c_names.defaults,
        prepared=max(module.prepared, 1),
        columns=columns(module),
        count=len(module.state),
    )
    for line in text.splitlines():
        yield from continued(line)
