"""C99: a header with its source file, the self-test and the run of the initial state; C++ reads the header, too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.descriptions import (
    about_of,
    continued,
    indices,
    outcome_codes,
    places,
    plain,
    records_of,
    sizes,
    statuses,
)
from lagrange.export.languages.c_printer import KINDS, LITERALS, CNames, comment, function
from lagrange.export.module import SourceModule
from lagrange.export.programs import Script, main_text, test_text
from lagrange.export.target import Target, register
from lagrange.procedure.form import Kind, Procedure


@register
class C(Target):
    """Target `c`: a header and a source file in C99, a test, and the run of the initial state."""

    name = "c"
    about = "C99: a source file and its header, no dependencies, no allocation, re-entrant"
    contents = frozenset(("steps", "main", "taylor"))
    shell = ("cc -std=c99 -O2 -o {name}_{program} {name}.c {name}_{program}.c -lm", "./{name}_{program}")

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the header, the source file, and the programs for the test and for `main`, by file name."""
        return {f"{module.name}.h": header(module), f"{module.name}.c": source(module), **programs(module)}


def numbers(values: Sequence[float]) -> str:
    """Return C literals of numbers as one comma-separated list."""
    return ", ".join(map(LITERALS.real, values))


# --- the header


def header(module: SourceModule) -> str:
    """Return the text of the C header: array sizes, indices of states, codes of integrators, and prototypes."""
    c_names, guard = CNames(f"{module.name}_"), f"{module.name.upper()}_H"
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
        *(
            f"#define {module.name.upper()}_{name.upper()} {count} /* {about} */"
            for name, count, about in sizes(module)
        ),
        "",
        *comment(places("y", module.state)),
        *comment(places("parameters", module.parameters)),
        *_enumerations(module),
        f"extern const double {module.name}_default_parameters[];",
        "",
        *comment(statuses("0", "1")),
        "",
    ]
    for procedure in module.public:
        names = [parameter.name for parameter in procedure.parameters]
        *head, last = c_names.signature(procedure, names, qualified=False)
        lines += [*comment(about_of(module, procedure)), *head, f"{last};", ""]
    return "\n".join([*lines, "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def _enumerations(module: SourceModule) -> Iterator[str]:
    """Yield the indices of states and parameters by name, and the codes that integrators return."""
    before = module.name.upper()
    named = [f"    {before}_{name} = {k}," for name, k in indices(module)]
    if named:
        yield from ("enum {", *named, "};")
    if module.integrators:
        yield f"enum {module.name}_outcome {{"
        yield from (f"    {before}_{name} = {code}, /* {text} */" for name, code, text in outcome_codes())
        yield "};"


def statement_comment(module: SourceModule) -> list[str]:
    """Return the lines of the comment at the top of a file: the statement of the system."""
    lines = [plain(line) for line in module.statement]
    return [f"/* {lines[0]}", *(f"   {line}".rstrip() for line in lines[1:]), "*/"]


# --- the source file


def source(module: SourceModule) -> str:
    """Return the text of the C source file."""
    c_names, public = CNames(f"{module.name}_"), dict.fromkeys(module.public)
    functions = [function(procedure, c_names, hidden=procedure not in public) for procedure in module.procedures]
    # C has no empty arrays: without parameters there is one number.
    values = numbers(module.values) or "0.0"
    lines = [
        *statement_comment(module),
        "",
        f'#include "{module.name}.h"',
        "",
        "#include <math.h>",
        *(["#include <string.h>"] if c_names.copies_bits else []),
        "",
        *c_names.definitions(),
        *records(module.procedures, c_names),
        *continued(f"const double {c_names.defaults}[] = {{{values}}};"),
        "",
        *functions,
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def records(procedures: Sequence[Procedure], c_names: CNames) -> Iterator[str]:
    """Yield definitions of C structs: for records, and for results of functions that return several numbers."""
    for record in records_of(procedures):
        yield structure(c_names.record(record), record.fields)
    for procedure in procedures:
        if len(procedure.results) > 1:
            results = [(f"r{k}", kind) for k, kind in enumerate(procedure.numbers)]
            yield structure(c_names.result(procedure), results)


def structure(name: str, fields: Sequence[tuple[str, Kind]]) -> str:
    """Return the C declaration of a struct with a name and these fields, each a number."""
    return "\n".join(
        ["typedef struct {", *(f"    {KINDS[kind]} {field};" for field, kind in fields), f"}} {name};", ""]
    )


# --- the programs


def programs(module: SourceModule) -> dict[str, str]:
    """Return the sources of the self-test, and of `main` if it is exported, by file name."""
    files = {f"{module.name}_test.c": test_text(module, SCRIPT)}
    if module.run is not None:
        text = main_text(module, SCRIPT).splitlines()
        files[f"{module.name}_main.c"] = "\n".join([*(part for line in text for part in continued(line)), ""])
    return files


SCRIPT = Script(
    comment=comment,
    head="""\
#include <math.h>
#include <stdio.h>

#include "{module}.h"

static double p[{prepared}];
static int failures = 0;

static void fail(const char *name, const char *why, int code, int count) {{
    printf("%s: %s %d\\n", name, why, code);
    failures += count;
}}

static void compare(const char *name, int state, int count, const double *found, const double *expected,
                    const double *allowed) {{
    for (int i = 0; i < count; i++) {{
        if (!(fabs(found[i] - expected[i]) <= allowed[i])) {{
            printf("%s, state %d, result %d: %.17g instead of %.17g\\n", name, state, i, found[i], expected[i]);
            failures++;
        }}
    }}
}}

int main(void) {{
    if ({module}_prepare({module}_default_parameters, p)) {{
        fail("prepare", "a matrix is singular", 1, 1);
    }}
""",
    quantity="""\
    {{
{tables}        double out[{results}];
        for (int k = 0; k < {samples}; k++) {{
            if ({module}_{name}(times[k], states + {states} * k, p, out)) {{
                fail({quoted}, "a matrix is singular at state", k, {results});
            }} else {{
                compare({quoted}, k, {results}, out, expected + {results} * k, allowed + {results} * k);
            }}
        }}
    }}
""",
    integrator="""\
    {{
{tables}        double y[{states}], t[1] = {{{time}}};
        for (int i = 0; i < {states}; i++) {{
            y[i] = state[i];
        }}
        (void)t;
        const int outcome = (int){module}_{name}({arguments});
        if (outcome != 0) {{
            fail({quoted}, "outcome", outcome, {states});
        }} else {{
            compare({quoted}, 0, {states}, y, expected, allowed);
        }}
    }}
""",
    table="        static const double {table}[] = {{\n{numbers}\n        }};\n",
    tail="""\
    printf("{module}: %d of %d results are right\\n", {count} - failures, {count});
    return failures == 0 ? 0 : 1;
}}
""",
    literals=LITERALS,
    time="t",
    main="""\
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "{module}.h"

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
    if ({module}_prepare({module}_default_parameters, p)) {{
        fprintf(stderr, "prepare: a matrix is singular\\n");
        return 1;
    }}
    printf("{columns}\\n");
    for (long k = 0; k <= intervals; k++) {{
        const double end = k == intervals ? t_end : t_end * (double)k / (double)intervals;
        const int64_t outcome = {module}_{method}(t, end, y, p, {rtol}, {rtol}, {steps});
        if (outcome != 0) {{
            fprintf(stderr, "the run stopped at t = %.17g: %s\\n", t[0], outcomes[outcome]);
            return 1;
        }}
        char text[32];
        snprintf(text, sizeof text, "%.15g", t[0]);
        printf("%.*g", strtod(text, NULL) == t[0] ? 15 : 17, t[0]);
        for (int i = 0; i < {states}; i++) {{
            printf(",%.17g", y[i]);
        }}
        printf("\\n");
    }}
    return 0;
}}
""",
)
