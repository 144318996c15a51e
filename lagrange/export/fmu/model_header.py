"""The C header that connects the common sources of every FMU with its model."""

from __future__ import annotations

from lagrange.export.descriptions import OUTCOMES, run_of
from lagrange.export.fmu.variables import places
from lagrange.export.languages.c import numbers, statement_comment
from lagrange.export.languages.c_printer import LITERALS
from lagrange.export.lines import continued
from lagrange.export.module import SourceModule


def model_header(module: SourceModule, token: str, version: int) -> str:
    """Return the header: the version of the standard, sizes, functions, and the initial state."""
    asked = run_of(module)
    assert asked is not None  # an FMU always has a run
    run, integrator = asked
    name, first = module.name, places(module)
    quantities = [one.name for one in module.quantities]
    events = module.quantity("events")
    sizes = {
        "TOKEN": f'"{token}"',
        "STATES": len(module.state),
        "PARAMETERS": len(module.parameters),
        "FIRST_INPUT": len(module.parameters) - len(module.inputs),
        "PREPARED": max(module.prepared, 1),
        "QUANTITIES": len(quantities),
        "RESULTS": sum(len(one.results) for one in module.quantities),
        "INDICATORS": 0 if events is None else len(events.results),
        "FIRST_INDICATOR": first.get("events", 0),
        **({"JACOBIAN": quantities.index("jacobian")} if "jacobian" in quantities else {}),
        "RTOL": LITERALS.real(run.rtol),
        "PREPARE": f"{name}_prepare",
        "DEFAULTS": f"{name}_default_parameters",
        "RUN": f"{name}_{integrator.name}",
    }
    base = 1 + len(module.state) + len(module.parameters)
    lines = [
        *statement_comment(module),
        "",
        "#ifndef Model_H",
        "#define Model_H",
        "",
        f'#include "{name}.h"',
        "",
        f"#define FMI_VERSION {version}",
        *(f"#define Model_{key} {value}" for key, value in sizes.items()),
        "",
        "/* A function of time, state and prepared numbers, and the place of its first result. */",
        "typedef struct {",
        "    int (*function)(double t, const double *y, const double *p, double *out);",
        "    int first;",
        "} Quantity;",
        "",
        "static const Quantity model_quantities[] = {",
        *(f"    {{{name}_{one}, {first[one] - base}}}," for one in quantities),
        "};",
        "",
        *continued(f"static const double model_initial[] = {{{numbers(run.initial)}}};"),
        "",
        "static const char *model_outcome(int outcome) {",
        "    switch (outcome) {",
        *(f'    case {int(code)}:\n        return "{text}";' for code, text in OUTCOMES.items()),
        "    default:",
        '        return "the run stopped";',
        "    }",
        "}",
        "",
        "#endif",
    ]
    return "\n".join([*lines, ""])
