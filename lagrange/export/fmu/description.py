"""The description of an FMU in XML, for FMI 2.0 and for FMI 3.0."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from xml.sax.saxutils import quoteattr

from lagrange.export.descriptions import generator, run_of
from lagrange.export.fmu.variables import (
    DERIVATIVE,
    INDICATOR,
    INPUT,
    PARAMETER,
    RESULT,
    STATE,
    ScalarVariable,
    variables,
)
from lagrange.export.module import SourceModule

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
    given = "".join(
        f" {key}={quoteattr(str(value))}" for key, value in attributes.items() if value is not None and value != ""
    )
    if not inside:
        yield f"<{name}{given}/>"
        return
    yield f"<{name}{given}>"
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
    units = sorted({*(one.unit for one in found), module.units.get("t", "")} - {""})
    if units:
        yield from element("UnitDefinitions", {}, [line for one in units for line in element("Unit", {"name": one})])
    categories = [line for one in ("logStatusDiscard", "logStatusError") for line in element("Category", {"name": one})]
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

    They need a Jacobian, which is the derivative by the state alone: a system with inputs has none.
    """
    return "true" if module.quantity("jacobian") and not module.inputs else "false"


def _start(one: ScalarVariable) -> str | None:
    return None if one.start is None else number(one.start)


def fmi2_description(module: SourceModule, token: str) -> str:
    """Return modelDescription.xml of FMI 2.0."""
    found = variables(module)
    index = {one.reference: k for k, one in enumerate(found, 1)}
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
    for one in found:
        of = index[one.of] if one.kind == DERIVATIVE else None
        real = list(element("Real", {"unit": one.unit, "start": _start(one), "derivative": of}))
        scalars += element("ScalarVariable", _attributes(one), real)
    unknowns = [list(element("Unknown", {"index": index[one.reference]})) for one in found if one.kind == DERIVATIVE]
    outputs = [
        list(
            element("Unknown", {"index": k, "dependencies": k, "dependenciesKind": "constant"})
        )
        for k in (index[one.reference] for one in found if one.kind == STATE)
    ]  # fmt: skip
    structure = [
        *element("Outputs", {}, [line for one in outputs for line in one]),
        *element("Derivatives", {}, [line for one in unknowns for line in one]),
        *element("InitialUnknowns", {}, [line for one in unknowns for line in one]),
    ]
    events = sum(one.kind == INDICATOR for one in found)
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
    """Return modelDescription.xml of FMI 3.0."""
    found = variables(module)
    can = {
        "modelIdentifier": module.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": _derivatives(module),
    }
    time = {"name": "time", "valueReference": 0, "causality": "independent", "variability": "continuous"}
    reals = [*element("Float64", {**time, "unit": module.units.get("t", "")})]
    for one in found:
        of = one.of if one.kind == DERIVATIVE else None
        reals += element("Float64", {**_attributes(one), "unit": one.unit, "start": _start(one), "derivative": of})
    structure: list[str] = []
    for tag, kind in (
        ("Output", STATE),
        ("ContinuousStateDerivative", DERIVATIVE),
        ("InitialUnknown", DERIVATIVE),
        ("EventIndicator", INDICATOR),
    ):
        for one in found:
            if one.kind == kind:
                own = {"dependencies": one.reference, "dependenciesKind": "constant"} if tag == "Output" else {}
                structure += element(tag, {"valueReference": one.reference, **own})
    inside = [
        *element("ModelExchange", can),
        *element("CoSimulation", {**can, "canHandleVariableCommunicationStepSize": "true"}),
        *_common(module, found),
        *element("ModelVariables", {}, reals),
        *element("ModelStructure", {}, structure),
    ]
    head = _head(module, "3.0", ("instantiationToken", token))
    return text_of(list(element("fmiModelDescription", head, inside)))


def build_description(module: SourceModule) -> str:
    """Return sources/buildDescription.xml of FMI 3.0: how the sources are compiled."""
    files = [line for name in ("fmi-functions.c", f"{module.name}.c") for line in element("SourceFile", {"name": name})]
    inside = [*element("SourceFileSet", {"language": "C99"}, files), *element("Library", {"name": "m"})]
    configuration = list(element("BuildConfiguration", {"modelIdentifier": module.name}, inside))
    return text_of(list(element("fmiBuildDescription", {"fmiVersion": "3.0"}, configuration)))
