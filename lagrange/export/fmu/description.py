"""The description of an FMU in XML, for FMI 2.0 and FMI 3.0: its variables, and the header of its C sources."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from xml.sax.saxutils import quoteattr

from lagrange.export.descriptions import OUTCOMES, generator, run_of
from lagrange.export.identifiers import continued
from lagrange.export.languages.c import numbers, statement_comment
from lagrange.export.languages.c_printer import LITERALS
from lagrange.export.module import SourceModule

HIDDEN = ("jacobian",)
"""Quantities without variables: they serve directional derivatives only."""

STATE, DERIVATIVE, PARAMETER, INPUT = "state", "derivative", "parameter", "input"
RESULT, INDICATOR = "result", "indicator"
"""Kinds of variables: a result of a quantity, and an event indicator."""


@dataclass(frozen=True)
class ScalarVariable:
    """A real variable of an FMU, with its reference number; `start` is its initial value, None without one.

    For the derivative of a state, `of` is the reference of the state.
    """

    name: str
    reference: int
    kind: str
    about: str = ""
    unit: str = ""
    start: float | None = None
    of: int = 0


def places(module: SourceModule) -> dict[str, int]:
    """Return for each quantity the reference number of its first result, the quantities in order with rhs first."""
    references, reference = {}, 1 + len(module.state) + len(module.parameters)
    for quantity in module.quantities:
        references[quantity.name] = reference
        reference += len(quantity.results)
    return references


def variables(module: SourceModule) -> list[ScalarVariable]:
    """Return the variables in the order of their reference numbers: state, parameters, derivatives, other results.

    Names are those of the statement; a name that is taken gets a number as suffix.
    """
    named = _namer()
    exported_run = run_of(module)
    assert exported_run is not None  # an FMU always has a run
    initial = exported_run[0].initial
    half, first = len(module.state) // 2, []
    for k, name in enumerate(module.state):
        about = f"velocity of {module.state[k - half]}" if k >= half else "coordinate"
        first.append(ScalarVariable(named(name), 1 + k, STATE, about, module.units.get(name, ""), initial[k]))
    for k, name in enumerate(module.parameters, 1 + len(module.state)):
        value = module.values[k - 1 - len(module.state)]
        kind = INPUT if name in module.inputs else PARAMETER
        about = "input: may change at any time" if kind == INPUT else "parameter"
        first.append(ScalarVariable(named(name), k, kind, about, module.units.get(name, ""), value))
    return [*first, *_results(module, named)]


def _results(module: SourceModule, named: Callable[[str], str]) -> Iterator[ScalarVariable]:
    """Yield the variables for the results of each quantity; the results of `rhs` are the derivatives of the state.

    `named` makes a name unique.
    """
    first = places(module)
    for quantity in module.quantities:
        for k, name in enumerate(quantity.results):
            reference = first[quantity.name] + k
            if quantity.name == "rhs":
                state = module.state[k]
                about = f"time derivative of {state}"
                yield ScalarVariable(
                    named(f"der({state})"), reference, DERIVATIVE, about, _rate_unit(module, k), of=1 + k
                )
            elif quantity.name not in HIDDEN:
                kind = INDICATOR if quantity.name == "events" else RESULT
                yield ScalarVariable(named(name), reference, kind, quantity.about, quantity.unit)


def _rate_unit(module: SourceModule, k: int) -> str:
    """Return the unit of the derivative of entry k of the state, or "" if it is not stated."""
    half = len(module.state) // 2
    if k < half:
        return module.units.get(module.state[k + half], "")
    unit, time = module.units.get(module.state[k - half], ""), module.units.get("t", "")
    return f"{unit}/{time}2" if unit and time.isalpha() else ""


def _namer() -> Callable[[str], str]:
    """Return a function that makes names unique by a number as suffix."""
    used = {"time": None}

    def named(name: str) -> str:
        tries = (name if k == 1 else f"{name}_{k}" for k in count(1))
        free = next(attempt for attempt in tries if attempt not in used)
        used[free] = None
        return free

    return named


CAUSALITY = {
    STATE: ("output", "continuous", "exact"),
    PARAMETER: ("parameter", "tunable", "exact"),
    INPUT: ("input", "continuous", None),
    DERIVATIVE: ("local", "continuous", "calculated"),
    RESULT: ("local", "continuous", "calculated"),
    INDICATOR: ("local", "continuous", "calculated"),
}
"""Causality, variability and initial of each kind of variable. Parameters may be changed between steps."""

TITLE = '<?xml version="1.0" encoding="UTF-8"?>'


def number(value: float) -> str:
    """Return a number in the syntax of XML Schema, with all its digits."""
    if math.isfinite(value):
        return repr(value)
    return "NaN" if math.isnan(value) else "INF" if value > 0 else "-INF"


def element(name: str, attributes: Mapping[str, object], inside: Sequence[str] = ()) -> Iterator[str]:
    """Yield the lines of an XML element; attributes that are None or empty are left out."""
    written = "".join(
        f" {key}={quoteattr(str(value))}" for key, value in attributes.items() if value is not None and value != ""
    )
    if not inside:
        yield f"<{name}{written}/>"
        return
    yield f"<{name}{written}>"
    yield from (f"  {line}" for line in inside)
    yield f"</{name}>"


def text_of(lines: Sequence[str]) -> str:
    """Return an XML document in ASCII: other characters as numeric references."""
    return "\n".join([TITLE, *lines, ""]).encode("ascii", "xmlcharrefreplace").decode("ascii")


def _head(module: SourceModule, fmi: str, token: tuple[str, str]) -> dict[str, object]:
    about = next((line for line in module.statement[1:] if line), "")
    return {
        "fmiVersion": fmi,
        "modelName": module.name,
        token[0]: token[1],
        "description": about,
        "generationTool": generator(),
        "variableNamingConvention": "flat",
    }


def _common(module: SourceModule, found: Sequence[ScalarVariable]) -> Iterator[str]:
    """Yield the elements that both FMI versions share: units, log categories, the default experiment."""
    units = sorted({*(category.unit for category in found), module.units.get("t", "")} - {""})
    if units:
        yield from element(
            "UnitDefinitions", {}, [line for category in units for line in element("Unit", {"name": category})]
        )
    categories = [
        line for category in ("logStatusDiscard", "logStatusError") for line in element("Category", {"name": category})
    ]
    yield from element("LogCategories", {}, categories)
    asked = run_of(module)
    assert asked is not None  # an FMU always has a run
    run = asked[0]
    yield from element(
        "DefaultExperiment",
        {
            "startTime": "0.0",
            "stopTime": number(run.t_end),
            "tolerance": number(run.rtol),
            "stepSize": number(run.t_end / run.intervals),
        },
    )


def _attributes(one: ScalarVariable) -> dict[str, object]:
    causality, variability, initial = CAUSALITY[one.kind]
    return {
        "name": one.name,
        "valueReference": one.reference,
        "description": one.about,
        "causality": causality,
        "variability": variability,
        "initial": initial,
    }


def _derivatives(module: SourceModule) -> str:
    """Return "true" if the FMU has directional derivatives, else "false".

    Directional derivatives need a Jacobian. The exported one has derivatives by the state alone, so an FMU with inputs
    has no directional derivatives.
    """
    return "true" if module.quantity("jacobian") and not module.inputs else "false"


def _start(one: ScalarVariable) -> str | None:
    return None if one.start is None else number(one.start)


def fmi2_description(module: SourceModule, token: str) -> str:
    """Return the text of modelDescription.xml for FMI 2.0; `token` identifies the model."""
    found = variables(module)
    index = {variable.reference: k for k, variable in enumerate(found, 1)}
    files = [
        line for name in ("fmi-functions.c", f"{module.name}.c") for line in element("File", {"name": name})
    ]  # fmt: skip
    can = {
        "modelIdentifier": module.name,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": _derivatives(module),
    }
    sources = list(element("SourceFiles", {}, files))
    scalars: list[str] = []
    for variable in found:
        of = index[variable.of] if variable.kind == DERIVATIVE else None
        real = list(element("Real", {"unit": variable.unit, "start": _start(variable), "derivative": of}))
        scalars += element("ScalarVariable", _attributes(variable), real)
    unknowns = [
        list(element("Unknown", {"index": index[variable.reference]}))
        for variable in found
        if variable.kind == DERIVATIVE
    ]
    outputs = [
        list(
            element("Unknown", {"index": k, "dependencies": k, "dependenciesKind": "constant"})
        )
        for k in (index[variable.reference] for variable in found if variable.kind == STATE)
    ]  # fmt: skip
    structure = [
        *element("Outputs", {}, [line for variable in outputs for line in variable]),
        *element("Derivatives", {}, [line for variable in unknowns for line in variable]),
        *element("InitialUnknowns", {}, [line for variable in unknowns for line in variable]),
    ]
    events = sum(variable.kind == INDICATOR for variable in found)
    inside = [
        *element("ModelExchange", can, sources),
        *element("CoSimulation", {**can, "canHandleVariableCommunicationStepSize": "true"}, sources),
        *_common(module, found),
        *element("ModelVariables", {}, scalars),
        *element("ModelStructure", {}, structure),
    ]
    head = {**_head(module, "2.0", ("guid", token)), "numberOfEventIndicators": events}
    return text_of(list(element("fmiModelDescription", head, inside)))


def fmi3_description(module: SourceModule, token: str) -> str:
    """Return the text of modelDescription.xml for FMI 3.0; `token` identifies the model."""
    scalars = variables(module)
    can = {
        "modelIdentifier": module.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": _derivatives(module),
    }
    time = {"name": "time", "valueReference": 0, "causality": "independent", "variability": "continuous"}
    reals = [*element("Float64", {**time, "unit": module.units.get("t", "")})]
    for variable in scalars:
        of = variable.of if variable.kind == DERIVATIVE else None
        reals += element(
            "Float64", {**_attributes(variable), "unit": variable.unit, "start": _start(variable), "derivative": of}
        )
    structure: list[str] = []
    for tag, kind in (
        ("Output", STATE),
        ("ContinuousStateDerivative", DERIVATIVE),
        ("InitialUnknown", DERIVATIVE),
        ("EventIndicator", INDICATOR),
    ):
        for variable in scalars:
            if variable.kind == kind:
                dependencies = (
                    {"dependencies": variable.reference, "dependenciesKind": "constant"} if tag == "Output" else {}
                )
                structure += element(tag, {"valueReference": variable.reference, **dependencies})
    inside = [
        *element("ModelExchange", can),
        *element("CoSimulation", {**can, "canHandleVariableCommunicationStepSize": "true"}),
        *_common(module, scalars),
        *element("ModelVariables", {}, reals),
        *element("ModelStructure", {}, structure),
    ]
    head = _head(module, "3.0", ("instantiationToken", token))
    return text_of(list(element("fmiModelDescription", head, inside)))


def build_description(module: SourceModule) -> str:
    """Return the text of sources/buildDescription.xml for FMI 3.0: how the sources are compiled."""
    files = [line for name in ("fmi-functions.c", f"{module.name}.c") for line in element("SourceFile", {"name": name})]
    inside = [*element("SourceFileSet", {"language": "C99"}, files), *element("Library", {"name": "m"})]
    configuration = list(element("BuildConfiguration", {"modelIdentifier": module.name}, inside))
    return text_of(list(element("fmiBuildDescription", {"fmiVersion": "3.0"}, configuration)))


def model_header(module: SourceModule, token: str, version: int) -> str:
    """Return the C header of an FMU: the major `version` of FMI, `token`, sizes, functions and the initial state."""
    asked = run_of(module)
    assert asked is not None  # an FMU always has a run
    run, integrator = asked
    name, first = module.name, places(module)
    quantities = [quantity.name for quantity in module.quantities]
    events = module.quantity("events")
    sizes = {
        "TOKEN": f'"{token}"',
        "STATES": len(module.state),
        "PARAMETERS": len(module.parameters),
        "FIRST_INPUT": len(module.parameters) - len(module.inputs),
        "PREPARED": max(module.prepared, 1),
        "QUANTITIES": len(quantities),
        "RESULTS": sum(len(quantity.results) for quantity in module.quantities),
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
        *(f"    {{{name}_{quantity}, {first[quantity] - base}}}," for quantity in quantities),
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
