"""C99: one source file and its header."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.comments import plain
from lagrange.export.descriptions import (
    MOST_STEPS,
    TEST,
    TEST_STEPS,
    TEST_TOLERANCE,
    about_of,
    columns,
    integrator_of,
    outcomes,
    places,
    records_of,
    run_of,
    sizes,
)
from lagrange.export.languages.c_printer import WIDTH, Dialect, broken, comment, function
from lagrange.export.languages.c_spelling import HELPERS, KINDS, real_literal
from lagrange.export.module import Check, Integrator, SourceModule, StepCheck
from lagrange.export.target import Target
from lagrange.procedure.form import Kind, Procedure


class C(Target):
    """C99; see `Target`."""

    name = "c"
    about = "C99: a source file and its header, no dependencies, no allocation, re-entrant"
    contents = frozenset(("steps", "main", "taylor"))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the source file and its header; the test and the run are switched on by macros."""
        return {f"{module.name}.h": header(module), f"{module.name}.c": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the test."""
        name = module.name
        return [
            f"cc -std=c99 -O2 -D{test_macro(module)} -o {name}_test {name}.c -lm",
            f"./{name}_test",
        ]


def dialect_of(module: SourceModule) -> Dialect:
    """Return the dialect of a module."""
    return Dialect(f"{module.name}_")


def test_macro(module: SourceModule) -> str:
    """Return the macro that switches the test on."""
    return f"{module.name.upper()}_TEST"


def main_macro(module: SourceModule) -> str:
    """Return the macro that switches the run of the initial state on."""
    return f"{module.name.upper()}_MAIN"


def names_of(procedure: Procedure) -> list[str]:
    """Return the names of the parameters of a public function."""
    return [one.name for one in procedure.parameters]


# --- the header


def header(module: SourceModule) -> str:
    """Return the header: sizes, names and prototypes."""
    dialect, guard = dialect_of(module), f"{module.name.upper()}_H"
    lines = [
        *statement_comment(module),
        "",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *defined_sizes(module),
        "",
        *comment(places("y", module.state)),
        *comment(places("parameters", module.parameters)),
        f"extern const double {module.name}_default_parameters[];",
        "",
        *comment(
            "Each function of t, y and p returns 0, or 1 where a matrix is singular to round-off: out is then not to "
            "be used."
        ),
        *(comment(outcomes()) if module.integrators else []),
        "",
    ]
    for procedure in module.public:
        *head, last = dialect.signature(procedure, names_of(procedure), qualified=False)
        lines += [*comment(about_of(module, procedure)), *head, f"{last};", ""]
    return "\n".join([*lines, "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def defined_sizes(module: SourceModule) -> Iterator[str]:
    """Yield the lengths of all arrays."""
    for name, count, about in sizes(module):
        yield f"#define {module.name.upper()}_{name.upper()} {count} /* {about} */"


def statement_comment(module: SourceModule) -> list[str]:
    """Return the comment at the top: the statement that the file was made from."""
    lines = [plain(line) for line in module.statement]
    return [f"/* {lines[0]}", *(f"   {line}".rstrip() for line in lines[1:]), "*/"]


# --- the source file


def source(module: SourceModule) -> str:
    """Return the source file."""
    dialect = dialect_of(module)
    functions, public = [], dict.fromkeys(module.public)
    for procedure in module.procedures:
        text = function(procedure, dialect)
        functions.append(text if procedure in public else hidden(text, dialect, procedure))
    lines = [
        *statement_comment(module),
        "",
        f'#include "{module.name}.h"',
        "",
        "#include <math.h>",
        "",
        *(f"static {HELPERS[op][1]}\n" for op in sorted(dialect.helpers)),
        *records(module.procedures, dialect),
        f"const double {module.name}_default_parameters[] = {{{numbers(module.values) or '0.0'}}};",
        "",
        *functions,
        *test(module),
        *run(module),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def hidden(text: str, dialect: Dialect, procedure: Procedure) -> str:
    """Return a function that only this file sees."""
    head = f"{dialect.result(procedure)} {dialect.prefix}{procedure.name}("
    return text.replace(head, f"static {head}", 1)


def records(procedures: Sequence[Procedure], dialect: Dialect) -> Iterator[str]:
    """Yield the types of records and of several results."""
    for record in records_of(procedures):
        yield structure(dialect.record(record), record.fields)
    for procedure in procedures:
        if len(procedure.results) > 1:
            yield structure(dialect.result(procedure), [(f"r{k}", kind) for k, kind in enumerate(procedure.results)])


def structure(name: str, fields: Sequence[tuple[str, Kind]]) -> str:
    """Return a type of named numbers."""
    return "\n".join(["typedef struct {", *(f"    {KINDS[kind]} {one};" for one, kind in fields), f"}} {name};", ""])


def numbers(values: Sequence[float]) -> str:
    """Return a list of numbers."""
    return ", ".join(map(real_literal, values))


def table(name: str, rows: Sequence[Sequence[float]]) -> Iterator[str]:
    """Yield a table of numbers, one behind the other."""
    values = [real_literal(value) for row in rows for value in row]
    yield f"static const double {name}[] = {{"
    yield from broken(values, "    ", WIDTH)[:-1]
    yield broken(values, "    ", WIDTH)[-1][:-1]
    yield "};"


# --- the test

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


def test(module: SourceModule) -> Iterator[str]:
    """Yield the test: a program that compares results with those of multiple precision."""
    name, upper = module.name, module.name.upper()
    yield f"#ifdef {test_macro(module)}"
    yield from comment(f"{TEST} Exit status 0 if all are right.")
    yield "#include <stdio.h>"
    yield ""
    yield COMPARE
    yield "int main(void) {"
    body = [f"double p[{upper}_PREPARED];", "int failures = 0;", "int checked = 0;"]
    body += [f"if ({name}_prepare({name}_default_parameters, p)) {{"]
    body += ['    printf("prepare: a matrix is singular\\n");', "    failures++;", "}"]
    for check in module.checks:
        body += quantity_test(module, check)
    for step in module.step_checks:
        body += integrator_test(module, step)
    body.append(f'printf("{name}: %d of %d results are right\\n", checked - failures, checked);')
    yield from (f"    {line}" if line else "" for line in body)
    yield "    return failures == 0 ? 0 : 1;"
    yield "}"
    yield "#endif"


def quantity_test(module: SourceModule, check: Check) -> Iterator[str]:
    """Yield the test of one function."""
    count, states = len(check.results[0]), len(check.times)
    size = len(module.state)
    yield "{"
    yield f"    static const double times[] = {{{numbers(check.times)}}};"
    for name, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from (f"    {line}" for line in table(name, rows))
    yield f"    for (int k = 0; k < {states}; k++) {{"
    yield f"        double out[{count}];"
    yield f"        const int singular = {module.name}_{check.name}(times[k], states + {size} * k, p, out);"
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


def integrator_test(module: SourceModule, check: StepCheck) -> Iterator[str]:
    """Yield the test of an integrator."""
    integrator = integrator_of(module, check.name)
    count = len(check.state)
    yield "{"
    for name, row in (("wanted", check.result), ("allowed", check.allowed)):
        yield from (f"    {line}" for line in table(name, [row]))
    yield f"    double y[] = {{{numbers(check.state)}}};"
    yield from (f"    {line}" for line in call_lines(module, integrator, check))
    yield "    if (outcome != 0) {"
    yield f'        printf("{check.name}: outcome %d\\n", (int)outcome);'
    yield f"        failures += {count};"
    yield "    } else {"
    yield f'        failures += compare("{check.name}", 0, {count}, y, wanted, allowed);'
    yield "    }"
    yield f"    checked += {count};"
    yield "}"


def call_lines(module: SourceModule, integrator: Integrator, check: StepCheck) -> list[str]:
    """Return the call of an integrator for its test."""
    end = real_literal(check.time + check.length)
    limits = f"{TEST_TOLERANCE}, {TEST_TOLERANCE}, {TEST_STEPS}"
    if integrator.adaptive:
        return [
            f"double t[] = {{{real_literal(check.time)}}};",
            f"const int64_t outcome = {module.name}_{check.name}(t, {end}, y, p, {limits});",
        ]
    given = f"{real_literal(check.time)}, {real_literal(check.length)}, y, p"
    return [f"const int64_t outcome = {module.name}_{check.name}({given});"]


# --- the run of the initial state

MAIN = """\
int main(int count, char **words) {{
    double p[{prepared}];
    double t[] = {{0.0}};
    double y[] = {{{initial}}};
    const double t_end = count > 1 ? strtod(words[1], NULL) : {t_end};
    const long intervals = count > 2 ? strtol(words[2], NULL, 10) : {intervals};
    if (intervals < 1) {{
        fprintf(stderr, "intervals: a whole number from 1\\n");
        return 2;
    }}
    if ({name}_prepare({name}_default_parameters, p)) {{
        fprintf(stderr, "prepare: a matrix is singular\\n");
        return 1;
    }}
    printf("{columns}\\n");
    for (long k = 0; k <= intervals; k++) {{
        const double end = k == intervals ? t_end : t_end * ((double)k / (double)intervals);
        const int64_t outcome = {call};
        if (outcome != 0) {{
            fprintf(stderr, "the run stopped at t = %.17g: outcome %d\\n", t[0], (int)outcome);
            return 1;
        }}
        printf("%.17g", t[0]);
        for (int i = 0; i < {count}; i++) {{
            printf(",%.17g", y[i]);
        }}
        printf("\\n");
    }}
    return 0;
}}
#endif"""


def run(module: SourceModule) -> Iterator[str]:
    """Yield a program that integrates the initial state and writes a table."""
    found = run_of(module)
    if found is None:
        return
    settings, integrator = found
    upper, count = module.name.upper(), len(module.state)
    yield ""
    yield f"#ifdef {main_macro(module)}"
    yield from comment(
        f"Integrate the initial state and write a table with commas: {module.name}_main [t_end [intervals]]."
    )
    yield "#include <stdio.h>"
    yield "#include <stdlib.h>"
    yield ""
    rtol = real_literal(settings.rtol)
    yield MAIN.format(
        name=module.name,
        prepared=f"{upper}_PREPARED",
        initial=numbers(settings.initial),
        t_end=real_literal(settings.t_end),
        intervals=settings.intervals,
        columns=columns(module),
        call=f"{module.name}_{integrator.name}(t, end, y, p, {rtol}, {rtol}, {MOST_STEPS})",
        count=count,
    )
