"""JavaScript: an ES module for browsers and node."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

from lagrange.export.comments import commented
from lagrange.export.descriptions import (
    TEST,
    about_of,
    columns,
    lengths,
    outcomes,
    places,
    sizes,
    statement_comment,
    statuses,
)
from lagrange.export.languages.javascript_printer import File, function
from lagrange.export.languages.javascript_spelling import LITERALS, helper_lines
from lagrange.export.lines import continued
from lagrange.export.module import Check, SourceModule, StepCheck
from lagrange.export.offsets import Shifted, shifted_parameters
from lagrange.export.programs import arguments_in_test, main_fields, tables
from lagrange.export.target import Target, register
from lagrange.procedure.form import Procedure


@register
class JavaScript(Target):
    """JavaScript; see `Target`."""

    name = "javascript"
    about = "JavaScript: one ES module for browsers and node, no dependencies, calls that allocate nothing"
    inexpressible = frozenset(("erf",))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the module; the test and the run are functions of it."""
        return {f"{module.name}.mjs": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs the test."""
        return [_node(module, "test", "")]

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs `main`."""
        return [_node(module, "main", "process.argv.slice(1)")]


def _node(module: SourceModule, function: str, given: str) -> str:
    """Return a shell line that calls a function of the module and ends with its status."""
    script = f'import {{ {function} }} from "./{module.name}.mjs"; process.exitCode = {function}({given});'
    return f"node --input-type=module -e '{script}'"


def source(module: SourceModule) -> str:
    """Return the module.

    Functions that are called once for a run check the lengths of arrays; for a quantity that would be 3% of its time.
    """
    quantities = [one.procedure for one in module.quantities]
    file = File(
        shifted_parameters(module.procedures, _places_given(module)),
        module.public,
        [one.name for one in module.procedures],
        {one: lengths(module, one) for one in module.public if one not in quantities},
    )
    functions = [function(procedure, file) for procedure in module.procedures]
    lines = [
        *statement_comment(module, "//"),
        "",
        *constants(module),
        "",
        *CHECK_LENGTH.splitlines(),
        "",
        *helper_lines(file.needed),
        *(["// Local arrays and records: calls make none.", *_memory(file), ""] if file.memory else []),
        *functions,
        *test(module),
        *run(module),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


CHECK_LENGTH = """\
function check_length(name, array, least) {
    if (!(array.length >= least)) {
        throw new RangeError(`${name} has ${array.length} numbers: give ${least}`);
    }
}
"""


def _memory(file: File) -> Iterator[str]:
    for declaration in file.memory.values():
        yield from continued(declaration)


def _places_given(module: SourceModule) -> Shifted:
    """Return the arrays for which users may give a place: states and results of quantities."""
    given = {}
    for one in module.quantities:
        names = [parameter.name for parameter in one.procedure.parameters]
        given[one.procedure] = frozenset((names.index("y"), names.index("out")))
    return given


def constants(module: SourceModule) -> Iterator[str]:
    """Yield sizes, names, and comments on arrays and functions."""
    for name, count, about in sizes(module):
        yield f"export const {name.upper()} = {count}; // {about}"
    yield ""
    yield from commented(places("y", module.state), "//")
    yield from commented(places("parameters", module.parameters), "//")
    for name, names in (("state_names", module.state), ("parameter_names", module.parameters)):
        yield from continued(f"export const {name} = Object.freeze({json.dumps(list(names))});")
    values = ", ".join(map(LITERALS.real, module.values))
    yield from continued(f"export const default_parameters = Object.freeze([{values}]);")
    yield ""
    yield from commented(
        f"{statuses('false', 'true')} Arrays are Float64Array. y_at and out_at are the places where state and results "
        "begin. Where an array of such a function is too short, results are NaN or missing.",
        "//",
    )
    if module.integrators:
        yield from commented(outcomes(), "//")
    for procedure in module.public:
        yield from commented(f"{_call(procedure)}: {about_of(module, procedure)}", "//")


def _call(procedure: Procedure) -> str:
    return f"{procedure.name}({', '.join(one.name for one in procedure.parameters)})"


# --- the test

COMPARE = """\
    const p = new Float64Array(PREPARED);
    let checked = 0;
    let failures = 0;
    const compare = (name, state, found, wanted, allowed) => {
        wanted.forEach((value, i) => {
            if (!(Math.abs(found[i] - value) <= allowed[i])) {
                print(`${name}, state ${state}, result ${i}: ${found[i]} instead of ${value}`);
                failures += 1;
            }
        });
    };
    const quantity = (name, evaluate, times, states, wanted, allowed) => {
        const count = wanted.length / times.length;
        times.forEach((t, k) => {
            const y = Float64Array.from(states.slice(STATE * k, STATE * (k + 1)));
            const out = new Float64Array(count);
            checked += count;
            if (evaluate(t, y, p, out)) {
                print(`${name}, state ${k}: a matrix is singular`);
                failures += count;
            } else {
                const row = [count * k, count * (k + 1)];
                compare(name, k, out, wanted.slice(...row), allowed.slice(...row));
            }
        });
    };
    const integrator = (name, run, state, wanted, allowed) => {
        const y = Float64Array.from(state);
        const outcome = run(y);
        checked += STATE;
        if (outcome !== 0) {
            print(`${name}: outcome ${outcome}`);
            failures += STATE;
        } else {
            compare(name, 0, y, wanted, allowed);
        }
    };
    if (prepare(default_parameters, p)) {
        print("prepare: a matrix is singular");
        failures += 1;
    }
"""


def test(module: SourceModule) -> Iterator[str]:
    """Yield the test: a function that compares results with those of multiple precision."""
    yield from commented(f"{TEST} Failures are printed; returns 0 if all are right, else 1.", "//")
    yield "export function test(print = console.log) {"
    yield COMPARE.rstrip("\n")
    for check in module.checks:
        yield from _quantity_test(check)
    for step in module.step_checks:
        yield from _integrator_test(module, step)
    yield f"    print(`{module.name}: ${{checked - failures}} of ${{checked}} results are right`);"
    yield "    return failures === 0 ? 0 : 1;"
    yield "}"


def _quantity_test(check: Check) -> Iterator[str]:
    yield f'    quantity("{check.name}", {check.name},'
    yield from tables(check.flat, LITERALS)
    yield "    );"


def _integrator_test(module: SourceModule, check: StepCheck) -> Iterator[str]:
    given = arguments_in_test(module, check, LITERALS, "[{0}]")
    yield f'    integrator("{check.name}", (y) => {check.name}({given}),'
    yield from tables((check.state, check.result, check.allowed), LITERALS)
    yield "    );"


# --- the run of the initial state

MAIN = """\
export function main(words = [], print = console.log) {{
    const outcomes = [
{outcomes}
    ];
    const p = new Float64Array(PREPARED);
    const t = new Float64Array(1);
    const y = Float64Array.of({initial});
    const t_end = words.length > 0 ? Number(words[0]) : {t_end};
    const intervals = words.length > 1 ? Number(words[1]) : {intervals};
    if (!Number.isFinite(t_end) || !Number.isInteger(intervals) || intervals < 1) {{
        console.error("give t_end, a number, and intervals, a whole number from 1");
        return 2;
    }}
    if (prepare(default_parameters, p)) {{
        console.error("prepare: a matrix is singular");
        return 1;
    }}
    print({columns});
    for (let k = 0; k <= intervals; k++) {{
        const end = k === intervals ? t_end : (t_end * k) / intervals;
        const outcome = {method}(t, end, y, p, {rtol}, {rtol}, {steps});
        if (outcome !== 0) {{
            console.error(`the run stopped at t = ${{t[0]}}: ${{outcomes[outcome]}}`);
            return 1;
        }}
        print([t[0], ...y].join(","));
    }}
    return 0;
}}"""


def run(module: SourceModule) -> Iterator[str]:
    """Yield a function that integrates the initial state and writes a table."""
    fields = main_fields(module, LITERALS)
    if fields is None:
        return
    yield ""
    yield from commented(
        "Integrate the initial state and print a table with commas; words may be [t_end, intervals]. Returns 0, or 1 "
        "where the run stopped.",
        "//",
    )
    for line in MAIN.format(**fields, columns=json.dumps(columns(module))).splitlines():
        yield from continued(line)
