"""JavaScript: an ES module for browsers and node."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

from lagrange.export.descriptions import (
    about_of,
    columns,
    indices,
    lengths,
    outcome_codes,
    places,
    sizes,
    statement_comment,
    statuses,
)
from lagrange.export.identifiers import commented, continued
from lagrange.export.languages.javascript_printer import (
    LITERALS,
    File,
    function,
    helper_lines,
    shifted_parameters,
)
from lagrange.export.module import SourceModule
from lagrange.export.programs import Script, main_text, marked, test_text
from lagrange.export.target import Target, register


@register
class JavaScript(Target):
    """Target `javascript`: an ES module, its test, and the run of the initial state."""

    name = "javascript"
    about = "JavaScript: one ES module for browsers and node, no dependencies, calls that allocate nothing"
    inexpressible = frozenset(("erf",))
    shell = ("node {name}_{program}.mjs",)

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the module, and the programs for the test and for the run of the initial state, by file name."""
        texts = {f"{module.name}.mjs": source(module), f"{module.name}_test.mjs": test_text(module, SCRIPT)}
        if module.run is not None:
            text = main_text(module, SCRIPT, head=json.dumps(columns(module))).splitlines()
            texts[f"{module.name}_main.mjs"] = "\n".join([*(part for line in text for part in continued(line)), ""])
        return texts


def source(module: SourceModule) -> str:
    """Return the text of the JavaScript module.

    Functions that are called once a run check the lengths of arrays. The functions of quantities do not check them,
    which would take 3% of their time.
    """
    quantities = [quantity.procedure for quantity in module.quantities]
    # Users may pass an offset for y and out of each quantity.
    names = {quantity: [parameter.name for parameter in quantity.parameters] for quantity in quantities}
    shifted = {
        quantity: frozenset((names[quantity].index("y"), names[quantity].index("out"))) for quantity in quantities
    }
    file = File(
        shifted_parameters(module.procedures, shifted),
        module.public,
        [quantity.name for quantity in module.procedures],
        {quantity: lengths(module, quantity) for quantity in module.public if quantity not in quantities},
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
        *(["// Local arrays and records: calls make none."] if file.memory else []),
        *(line for declaration in file.memory.values() for line in continued(declaration)),
        *([""] if file.memory else []),
        *functions,
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


CHECK_LENGTH = """\
function check_length(name, array, least) {
    if (!(array.length >= least)) {
        throw new RangeError(`${name} has ${array.length} numbers: give ${least}`);
    }
}
"""


def constants(module: SourceModule) -> Iterator[str]:
    """Yield the lines with sizes, names, and comments on arrays and functions."""
    for name, count, about in sizes(module):
        yield f"export const {name.upper()} = {count}; // {about}"
    yield ""
    yield from commented(places("y", module.state), "//")
    yield from commented(places("parameters", module.parameters), "//")
    for name, names in (("state_names", module.state), ("parameter_names", module.parameters)):
        yield from continued(f"export const {name} = Object.freeze({json.dumps(list(names))});")
    yield from (f"export const {name} = {k};" for name, k in indices(module))
    values = ", ".join(map(LITERALS.real, module.values))
    yield from continued(f"export const default_parameters = Object.freeze([{values}]);")
    yield ""
    yield from commented(
        f"{statuses('false', 'true')} Arrays are Float64Array. y_at and out_at are the places where state and results "
        "begin. Where an array of such a function is too short, results are NaN or missing.",
        "//",
    )
    if module.integrators:
        yield "// The codes that integrators return:"
        codes = (f"    {name}: {code}, // {text}" for name, code, text in outcome_codes())
        yield from ("export const OUTCOMES = Object.freeze({", *codes, "});")
    for procedure in module.public:
        arguments = ", ".join(parameter.name for parameter in procedure.parameters)
        yield from commented(f"{procedure.name}({arguments}): {about_of(module, procedure)}", "//")


# --- the programs

SCRIPT = Script(
    comment=marked("//"),
    head="""\
import * as model from "./{module}.mjs";

const p = new Float64Array(model.PREPARED);
let failures = 0;
const fail = (text, count) => {{
    console.log(text);
    failures += count;
}};
const compare = (name, state, found, expected, allowed) => {{
    expected.forEach((value, i) => {{
        if (!(Math.abs(found[i] - value) <= allowed[i])) {{
            fail(`${{name}}, state ${{state}}, result ${{i}}: ${{found[i]}} instead of ${{value}}`, 1);
        }}
    }});
}};
const quantity = (name, evaluate, times, states, expected, allowed) => {{
    const count = expected.length / times.length;
    times.forEach((t, k) => {{
        const y = Float64Array.from(states.slice({states} * k, {states} * (k + 1)));
        const out = new Float64Array(count);
        const row = [count * k, count * (k + 1)];
        if (evaluate(t, y, p, out)) {{
            fail(`${{name}}, state ${{k}}: a matrix is singular`, count);
        }} else {{
            compare(name, k, out, expected.slice(...row), allowed.slice(...row));
        }}
    }});
}};
const integrator = (name, run, state, expected, allowed) => {{
    const y = Float64Array.from(state);
    const outcome = run(y);
    if (outcome !== 0) {{
        fail(`${{name}}: outcome ${{outcome}}`, {states});
    }} else {{
        compare(name, 0, y, expected, allowed);
    }}
}};

if (model.prepare(model.default_parameters, p)) {{
    fail("prepare: a matrix is singular", 1);
}}
""",
    quantity="quantity(\n    {quoted},\n    model.{name},\n{tables});\n",
    integrator="integrator(\n    {quoted},\n    (y) => model.{name}({arguments}),\n{tables});\n",
    time="[{0}]",
    table="    [\n{numbers},\n    ],\n",
    tail="""\
console.log(`{module}: ${{{count} - failures}} of {count} results are right`);
process.exitCode = failures === 0 ? 0 : 1;
""",
    literals=LITERALS,
    main="""\
import * as model from "./{module}.mjs";

const outcomes = [
{outcomes}
];

function main(words) {{
    const p = new Float64Array(model.PREPARED);
    const t = new Float64Array(1);
    const y = Float64Array.of({initial});
    const t_end = words.length > 0 ? Number(words[0]) : {t_end};
    const intervals = words.length > 1 ? Number(words[1]) : {intervals};
    if (!Number.isFinite(t_end) || !Number.isInteger(intervals) || intervals < 1) {{
        console.error("give t_end, a number, and intervals, a whole number from 1");
        return 2;
    }}
    if (model.prepare(model.default_parameters, p)) {{
        console.error("prepare: a matrix is singular");
        return 1;
    }}
    console.log({head});
    for (let k = 0; k <= intervals; k++) {{
        const end = k === intervals ? t_end : (t_end * k) / intervals;
        const outcome = model.{method}(t, end, y, p, {rtol}, {rtol}, {steps});
        if (outcome !== 0) {{
            console.error(`the run stopped at t = ${{t[0]}}: ${{outcomes[outcome]}}`);
            return 1;
        }}
        console.log([t[0], ...y].join(","));
    }}
    return 0;
}}

process.exitCode = main(process.argv.slice(2));
""",
)
