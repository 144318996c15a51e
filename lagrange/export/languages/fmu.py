"""Export to FMUs of FMI 2.0 and FMI 3.0: C sources, model description, and a compiled library for this platform."""

from __future__ import annotations

import hashlib
import math
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files as resources
from io import BytesIO
from itertools import accumulate, count
from pathlib import Path
from xml.sax.saxutils import quoteattr

from lagrange.errors import LagrangeError
from lagrange.export.languages.c import LITERALS, header, numbers, programs, source, statement_comment
from lagrange.export.module import OUTCOMES, SourceModule, continued, generator, run_of
from lagrange.export.programs import filled
from lagrange.export.target import Target, register

STATE, DERIVATIVE, PARAMETER, INPUT = "state", "derivative", "parameter", "input"
RESULT, INDICATOR = "result", "indicator"
"""Further kinds of variables: a result of a quantity, and an event indicator."""


@dataclass(frozen=True)
class ScalarVariable:
    """A real variable of an FMU; `reference` is its number, and `start` its initial value or None.

    For the time derivative of an entry of the state, `of` is the reference number of that entry.
    """

    name: str
    reference: int
    kind: str
    about: str = ""
    unit: str = ""
    start: float | None = None
    of: int = 0


def places(module: SourceModule) -> dict[str, int]:
    """Return the reference number of the first result of each quantity, by the name of the quantity.

    Reference numbers of results follow those of the state and the parameters.
    """
    sizes = [len(quantity.results) for quantity in module.quantities]
    first = 1 + len(module.state) + len(module.parameters)
    references = accumulate(sizes, initial=first)
    return {quantity.name: reference for quantity, reference in zip(module.quantities, references, strict=False)}


def variables(module: SourceModule) -> list[ScalarVariable]:
    """Return the variables of an FMU in the order of reference numbers: state, parameters, derivatives, other results.

    Names are those of the statement; a name that is taken gets a number as suffix.
    """
    taken = {"time"}
    unique = []
    for variable in _variables(module):
        tries = (variable.name if k == 1 else f"{variable.name}_{k}" for k in count(1))
        name = next(attempt for attempt in tries if attempt not in taken)
        taken.add(name)
        unique.append(replace(variable, name=name))
    return unique


def _variables(module: SourceModule) -> Iterator[ScalarVariable]:
    """Yield the variables of an FMU in the order of their reference numbers. Names may occur several times.

    The results of the quantity "rhs" are the derivatives of the state.
    """
    run, _ = run_of(module)
    half = len(module.state) // 2
    for k, (name, value) in enumerate(zip(module.state, run.initial, strict=True)):
        about = f"velocity of {module.state[k - half]}" if k >= half else "coordinate"
        yield ScalarVariable(name, 1 + k, STATE, about, module.units.get(name, ""), value)
    for k, (name, value) in enumerate(zip(module.parameters, module.values, strict=True), 1 + len(module.state)):
        kind, about = (INPUT, "input: may change at any time") if name in module.inputs else (PARAMETER, "parameter")
        yield ScalarVariable(name, k, kind, about, module.units.get(name, ""), value)
    first = places(module)
    for quantity in module.quantities:
        for k, name in enumerate(quantity.results):
            reference = first[quantity.name] + k
            if quantity.name == "rhs":
                state = module.state[k]
                about = f"time derivative of {state}"
                yield ScalarVariable(f"der({state})", reference, DERIVATIVE, about, _rate_unit(module, k), of=1 + k)
            elif quantity.name != "jacobian":  # it serves directional derivatives only
                kind = INDICATOR if quantity.name == "events" else RESULT
                yield ScalarVariable(name, reference, kind, quantity.about, quantity.unit)


def _rate_unit(module: SourceModule, k: int) -> str:
    """Return the unit of the derivative of entry k of the state, or "" if it is not stated."""
    half = len(module.state) // 2
    if k < half:
        return module.units.get(module.state[k + half], "")
    unit, time = module.units.get(module.state[k - half], ""), module.units.get("t", "")
    return f"{unit}/{time}2" if unit and time.isalpha() else ""


CAUSALITY = {
    STATE: ("output", "continuous", "exact"),
    PARAMETER: ("parameter", "tunable", "exact"),
    INPUT: ("input", "continuous", None),
    **dict.fromkeys((DERIVATIVE, RESULT, INDICATOR), ("local", "continuous", "calculated")),
}
"""The attributes causality, variability and initial in FMI for each kind of variable. Parameters may change between
steps."""


def number(value: float) -> str:
    """Return a number in the syntax of XML Schema, with all its digits."""
    if math.isfinite(value):
        return repr(value)
    return "NaN" if math.isnan(value) else "INF" if value > 0 else "-INF"


def element(name: str, attributes: Mapping[str, object], inside: Iterable[str] = ()) -> list[str]:
    """Return the lines of an XML element; attributes that are None or empty are left out."""
    written = "".join(f" {key}={quoteattr(str(value))}" for key, value in attributes.items() if value not in (None, ""))
    lines = [f"  {line}" for line in inside]
    return [f"<{name}{written}>", *lines, f"</{name}>"] if lines else [f"<{name}{written}/>"]


def elements(name: str, rows: Iterable[Mapping[str, object]]) -> list[str]:
    """Return the lines of several XML elements with the same name; `rows` has the attributes of each element."""
    return [line for attributes in rows for line in element(name, attributes)]


def document(lines: Sequence[str]) -> str:
    """Return an XML document in ASCII: other characters as numeric references."""
    text = "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *lines, ""])
    return text.encode("ascii", "xmlcharrefreplace").decode("ascii")


def _description(
    module: SourceModule,
    version: str,
    token: tuple[str, str],
    interfaces: Sequence[str],
    parts: Sequence[str],
    events: int | None = None,
) -> str:
    """Return the text of modelDescription.xml for a version of FMI.

    `token` is the name and the value of the attribute that identifies the model. `events` is the number of event
    indicators, None to leave it out. `interfaces` are the lines of the elements for model exchange and co-simulation.
    `parts` are the lines of the elements for variables and model structure.
    """
    run, _ = run_of(module)
    units = sorted({*(variable.unit for variable in _variables(module)), module.units.get("t", "")} - {""})
    definitions = elements("Unit", ({"name": unit} for unit in units))
    categories = elements("Category", ({"name": name} for name in ("logStatusDiscard", "logStatusError")))
    experiment = {
        "startTime": "0.0",
        "stopTime": number(run.t_end),
        "tolerance": number(run.rtol),
        "stepSize": number(run.t_end / run.intervals),
    }
    attributes = {
        "fmiVersion": version,
        "modelName": module.name,
        token[0]: token[1],
        "description": module.about,
        "generationTool": generator(),
        "variableNamingConvention": "flat",
        "numberOfEventIndicators": events,
    }
    inside = [
        *interfaces,
        *(element("UnitDefinitions", {}, definitions) if units else []),
        *element("LogCategories", {}, categories),
        *element("DefaultExperiment", experiment),
        *parts,
    ]
    return document(element("fmiModelDescription", attributes, inside))


def _attributes(variable: ScalarVariable) -> dict[str, object]:
    causality, variability, initial = CAUSALITY[variable.kind]
    return {
        "name": variable.name,
        "valueReference": variable.reference,
        "description": variable.about,
        "causality": causality,
        "variability": variability,
        "initial": initial,
    }


def _real(variable: ScalarVariable, of: int) -> dict[str, object]:
    """Return the XML attributes of a real variable: its unit, its initial value, and for a derivative its state.

    `of` is the number of the state whose time derivative the variable is; it is ignored for other variables.
    """
    start = None if variable.start is None else number(variable.start)
    return {"unit": variable.unit, "start": start, "derivative": of if variable.kind == DERIVATIVE else None}


def _interfaces(module: SourceModule, state: str, derivatives: str, sources: Sequence[str] = ()) -> list[str]:
    """Return the lines of the XML elements for model exchange and co-simulation.

    `state` and `derivatives` are the spellings of two attributes, which differ between versions of FMI. `sources` are
    lines inside of both elements. Directional derivatives need a Jacobian. The exported Jacobian has derivatives with
    respect to the state only, so an FMU with inputs has no directional derivatives.
    """
    can = {
        "modelIdentifier": module.name,
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
        derivatives: "true" if module.quantity("jacobian") and not module.inputs else "false",
    }
    simulation = {**can, "canHandleVariableCommunicationStepSize": "true"}
    return [*element("ModelExchange", can, sources), *element("CoSimulation", simulation, sources)]


def _source_names(module: SourceModule) -> list[dict[str, object]]:
    return [{"name": name} for name in ("fmi-functions.c", f"{module.name}.c")]


def fmi2_description(module: SourceModule, token: str) -> str:
    """Return the text of modelDescription.xml for FMI 2.0; `token` identifies the model."""
    declared = variables(module)
    index = {variable.reference: k for k, variable in enumerate(declared, 1)}
    scalars: list[str] = []
    for variable in declared:
        real = element("Real", _real(variable, index.get(variable.of, 0)))
        scalars += element("ScalarVariable", _attributes(variable), real)
    rates = [{"index": index[variable.reference]} for variable in declared if variable.kind == DERIVATIVE]
    states = [index[variable.reference] for variable in declared if variable.kind == STATE]
    outputs = ({"index": k, "dependencies": k, "dependenciesKind": "constant"} for k in states)
    structure = [
        *element("Outputs", {}, elements("Unknown", outputs)),
        *element("Derivatives", {}, elements("Unknown", rates)),
        *element("InitialUnknowns", {}, elements("Unknown", rates)),
    ]
    parts = [*element("ModelVariables", {}, scalars), *element("ModelStructure", {}, structure)]
    sources = element("SourceFiles", {}, elements("File", _source_names(module)))
    events = sum(variable.kind == INDICATOR for variable in declared)
    interfaces = _interfaces(module, "FMUstate", "providesDirectionalDerivative", sources)
    return _description(module, "2.0", ("guid", token), interfaces, parts, events)


def fmi3_description(module: SourceModule, token: str) -> str:
    """Return the text of modelDescription.xml for FMI 3.0; `token` identifies the model."""
    declared = variables(module)
    time = {"name": "time", "valueReference": 0, "causality": "independent", "variability": "continuous"}
    rows = [time | {"unit": module.units.get("t", "")}]
    rows += [_attributes(variable) | _real(variable, variable.of) for variable in declared]
    structure: list[str] = []
    for tag, kind in (
        ("Output", STATE),
        ("ContinuousStateDerivative", DERIVATIVE),
        ("InitialUnknown", DERIVATIVE),
        ("EventIndicator", INDICATOR),
    ):
        for reference in (variable.reference for variable in declared if variable.kind == kind):
            constant = {"dependencies": reference, "dependenciesKind": "constant"} if tag == "Output" else {}
            structure += element(tag, {"valueReference": reference, **constant})
    parts = [
        *element("ModelVariables", {}, elements("Float64", rows)),
        *element("ModelStructure", {}, structure),
    ]
    interfaces = _interfaces(module, "FMUState", "providesDirectionalDerivatives")
    return _description(module, "3.0", ("instantiationToken", token), interfaces, parts)


def model_header(module: SourceModule, token: str, version: int) -> str:
    """Return the C header of an FMU for the major `version` of FMI: sizes, functions and the initial state.

    `token` identifies the model: it is the guid of FMI 2, and the instantiation token of FMI 3.
    """
    run, integrator = run_of(module)
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
    text = filled(
        "fmu",
        "model",
        name=name,
        version=version,
        sizes="\n".join(f"#define Model_{key} {value}" for key, value in sizes.items()),
        quantities="\n".join(f"    {{{name}_{quantity}, {first[quantity] - base}}}," for quantity in quantities),
        initial="\n".join(continued(f"static const double model_initial[] = {{{numbers(run.initial)}}};")),
        outcomes="\n".join(f'    case {int(code)}:\n        return "{text}";' for code, text in OUTCOMES.items()),
    )
    return "\n".join([*statement_comment(module), "", text, ""])


DATE = (1980, 1, 1, 0, 0, 0)
"""Date of every file in the archive. It is constant, so that the same model always gives the same bytes."""

COMPILER = ("cc", "-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-s")
"""Compiler command for the library, which exports only the functions of FMI."""

ARCHITECTURES = {"x86_64": "x86_64", "AMD64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}


@register
class Fmu(Target):
    """Target `fmu`: one FMU of FMI 2.0 and one of FMI 3.0, each for model exchange and for co-simulation."""

    name = "fmu"
    about = "FMUs of FMI 2.0 and 3.0: model exchange and co-simulation, C sources inside, a library for this platform"
    contents = frozenset(("runs", "main"))
    always = ("rhs", "main")
    shell = (
        "python3 -m zipfile -e {name}_fmi3.fmu {name}_fmi3",
        "cc -std=c99 -O2 -o {name}_{program} {name}_fmi3/sources/{name}.c {name}_fmi3/sources/{name}_{program}.c -lm",
        "./{name}_{program}",
    )
    """Shell lines that unpack the FMU of FMI 3.0, and compile and run a program of its sources."""

    def files(self, module: SourceModule) -> Mapping[str, bytes]:
        """Return the two FMUs, zip archives for FMI 2.0 and FMI 3.0, by file name."""
        return {f"{module.name}_fmi{major}.fmu": archive(contents(module, major)) for major in (2, 3)}


def contents(module: SourceModule, major: int) -> dict[str, str | bytes]:
    """Return the files in an FMU by name, for version `major` of FMI, 2 or 3.

    They include a compiled library if a C compiler is installed.
    """
    inside = resources("lagrange.export").joinpath("fmu")
    sources = {
        f"{module.name}.h": header(module),
        f"{module.name}.c": source(module),
        **{name: inside.joinpath(name).read_text("ascii") for name in ("fmi-instance.h", "fmi-functions.c")},
    }
    digest = hashlib.sha256("".join([*module.statement, *sources.values()]).encode()).hexdigest()
    token = f"{{{uuid.UUID(digest[:32])}}}"
    sources["fmi-model.h"] = model_header(module, token, major)
    described = fmi2_description(module, token) if major == 2 else fmi3_description(module, token)
    contained: dict[str, str | bytes] = {"modelDescription.xml": described}
    contained |= {f"sources/{name}": text for name, text in (sources | programs(module)).items()}
    if major == 3:
        files = element("SourceFileSet", {"language": "C99"}, elements("SourceFile", _source_names(module)))
        compiled = [*files, *element("Library", {"name": "m"})]
        configuration = element("BuildConfiguration", {"modelIdentifier": module.name}, compiled)
        built = document(element("fmiBuildDescription", {"fmiVersion": "3.0"}, configuration))
        contained["sources/buildDescription.xml"] = built
    where = binary_path(module.name, major)
    if where and shutil.which(COMPILER[0]):
        contained[where] = library(module.name, sources)
    return contained


def binary_path(name: str, major: int) -> str | None:
    """Return the path of this platform's library in an FMU; None if version `major` of FMI has no name for it."""
    architecture = ARCHITECTURES.get(platform.machine())
    system = {"linux": "linux", "darwin": "darwin"}.get(sys.platform)
    if architecture is None or system is None:
        return None
    suffix = "so" if system == "linux" else "dylib"
    if major == 3:
        return f"binaries/{architecture}-{system}/{name}.{suffix}"
    return f"binaries/{system}64/{name}.{suffix}" if architecture == "x86_64" or system == "darwin" else None


def library(name: str, sources: Mapping[str, str]) -> bytes:
    """Return a compiled shared library of the sources, as bytes. Raises LagrangeError if the compiler fails."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for file, text in sources.items():
            folder.joinpath(file).write_text(text, "ascii")
        command = [*COMPILER, "-o", "library", "fmi-functions.c", f"{name}.c", "-lm"]
        process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if process.returncode:
            raise LagrangeError(f"{' '.join(command)} failed: {process.stderr.strip()}")
        return folder.joinpath("library").read_bytes()


def archive(files: Mapping[str, str | bytes]) -> bytes:
    """Return a zip archive of `files`, contents by name, as bytes; the same files always give the same bytes."""
    data = BytesIO()
    with zipfile.ZipFile(data, "w") as packed:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            packed.writestr(entry, text)
    return data.getvalue()
