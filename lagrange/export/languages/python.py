"""Export to Python with NumPy only: a module, its self-test, and the run of the initial state."""

from __future__ import annotations

import keyword
import sys
from collections.abc import Iterator, Mapping

from lagrange.errors import LagrangeError
from lagrange.export.module import (
    SourceModule,
    about_of,
    ascii_name,
    columns,
    commented,
    lengths,
    named_places,
    outcome_codes,
    sizes,
    statement_comment,
    statuses,
)
from lagrange.export.programs import Script, filled, helpers, main_text, marked, test_text
from lagrange.export.target import Target, register
from lagrange.machine.python_source import LITERALS, OPERATORS, Printer
from lagrange.procedure.form import REAL, Array, Part, Procedure
from lagrange.statement.vocabulary.functions import ELEMENTARY


def _total(name: str, rest: str = "") -> str:
    return f"def _{name}(x):\n    return _total(math.{name}, x{rest})"


_TEXTS = helpers("python")

HELPERS: Mapping[str, str] = {
    "total": _TEXTS["total"],
    **{name: _total(name) for name in ("sqrt", *ELEMENTARY)},
    **{name: f"_{name} = math.{name}" for name in ("atan", "atan2", "tanh", "asinh", "erf", "copysign")},
    "log": _total("log", ", -inf"),
    "atanh": "def _atanh(x):\n    return math.copysign(inf, x) if abs(x) == 1.0 else _total(math.atanh, x)",
    "div": _TEXTS["div"],
    "power": _TEXTS["power"],
    "min": "def _min(a, b):\n    return a if a < b or a != a else b",
    "max": "def _max(a, b):\n    return a if a > b or a != a else b",
    "magnitude": "def _magnitude(a, b):\n    return _max(abs(a), abs(b))",
    "sign": "def _sign(x):\n    return 1.0 if x > 0.0 else -1.0 if x < 0.0 else x",
    "round": "def _round(x):\n    return math.copysign(float(round(x)), x) if x - x == 0.0 else x",
    "quotient": "def _quotient(a, b):\n    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)",
    "two_to": "def _two_to(k):\n    return math.ldexp(1.0, k)",
    "exponent": _TEXTS["exponent"],
    "mantissa": "def _mantissa(x):\n    return 2.0 * math.frexp(abs(x))[0]",
}
"""Helper functions that the file defines. They return NaN or infinity where functions of Python raise an error."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    **{name: ("total",) for name, text in HELPERS.items() if " _total(" in text},
    "magnitude": ("max",),
}
"""Helper functions that other helpers call."""

_RESERVED = "abs float int range math np numpy sys nan inf SimpleNamespace test main y p out t h parameters "
RESERVED = (*keyword.kwlist, *_RESERVED.split())  # Words that must not be names of values

FILES = (*keyword.kwlist, *sys.stdlib_module_names, "numpy")
"""Words that must not be the name of the file: keywords, and modules that NumPy imports, since NumPy would import the
exported file instead."""


def helper_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the definitions of the helper functions that the operations `ops` need, and of helpers that they call."""
    needed = {op for op in ops if op not in OPERATORS}
    needed |= {need for op in needed for need in NEEDS.get(op, ())}
    return [line for op, text in HELPERS.items() if op in needed for line in (*text.splitlines(), "", "")]


@register
class Python(Target):
    """Target `python`: a module that needs only NumPy, its test, and the run of the initial state."""

    name = "python"
    about = "Python: one module that needs NumPy only"
    shell = ("python {name}_{program}.py",)
    reserved_files = FILES

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the exported files by file name: the module, the self-test and, if exported, `main`."""
        name = self.file_name(module)
        texts = {f"{name}.py": source(module), f"{name}_test.py": test_text(module, SCRIPT, file=name)}
        if module.run is not None:
            texts[f"{name}_main.py"] = main_text(module, SCRIPT, file=name, head=ascii(columns(module)))
        return texts


class _ExportPrinter(Printer):
    """Prints one procedure as a Python function on memory views of arrays; its name begins with an underscore.

    `needed` collects the operations whose definitions the file needs.
    """

    def __init__(self, procedure: Procedure, needed: dict[str, None]) -> None:
        self.needed = needed
        super().__init__(procedure, RESERVED)

    def function_name(self, procedure: Procedure) -> str:
        return f"_{procedure.name}"

    def legal(self, stem: str) -> str:
        return ascii_name(stem)

    def function_of(self, op: str) -> str:
        if op not in HELPERS:
            raise LagrangeError(f"Python has no function for {op}.")
        self.needed[op] = None
        return f"_{op}"

    def reserve(self, ref: int, array: Array) -> None:
        kind = "" if array.kind is REAL else ", np.int64"
        self.put(f"{self.name(ref)} = np.zeros({array.length}{kind}).data")

    def part(self, part: Part) -> None:
        self.write(f"{self.name(part.ref)} = {self.text(part.array)}[{self.text(part.start)}:]")


def source(module: SourceModule) -> str:
    """Return the text of the Python module."""
    needed: dict[str, None] = {}
    functions = [_ExportPrinter(procedure, needed).function() for procedure in module.procedures]
    lines = [
        *statement_comment(module, "#"),
        "",
        "import math",
        "from types import SimpleNamespace as _record",
        "",
        "import numpy as np",
        "",
        "nan, inf = math.nan, math.inf",
        "",
        *constants(module),
        "",
        "",
        *(line for procedure in module.public for line in wrapper(module, procedure)),
        *filled("python", "access").splitlines(),
        "",
        "",
        *helper_lines(needed),
        *(line for text in functions for line in [*text.splitlines(), "", ""]),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def constants(module: SourceModule) -> Iterator[str]:
    """Yield the lines at the top of the module: array sizes, names, defaults, and comments on functions."""
    for name, count, about in sizes(module):
        yield f"{name.upper()} = {count}  # {about}"
    yield from named_places(module, "parameters")
    yield from commented(
        f"{statuses('False', 'True')} Arrays that are written are of float64.",
        "#",
    )
    if module.integrators:
        yield "# The codes that integrators return:"
        yield from (f"{name} = {code}  # {text}" for name, code, text in outcome_codes())


def wrapper(module: SourceModule, procedure: Procedure) -> Iterator[str]:
    """Yield the lines of a public function, which takes NumPy arrays and calls the private function on memory views."""
    names = [parameter.name for parameter in procedure.parameters]
    passed = [_passed(parameter.name, parameter.type) for parameter in procedure.parameters]
    first, *rest = commented(about_of(module, procedure).replace('"', "'"), "")
    yield f"def {procedure.name}({', '.join(names)}):"
    yield f'    """{first.strip()}{"" if rest else chr(34) * 3}'
    yield from (f"    {line.strip()}" for line in rest)
    if rest:
        yield '    """'
    yield "    try:"
    yield f"        return _{procedure.name}({', '.join(passed)})"
    yield "    except (IndexError, NotImplementedError):"
    checked = (f"{name}=({name}, {length})" for name, length in lengths(module, procedure).items())
    yield f"        _check_lengths({', '.join(checked)})"
    yield "        raise"
    yield ""
    yield ""


def _passed(name: str, kind: object) -> str:
    if isinstance(kind, Array):
        return f"_read({name})" if kind.read else f"_written({name})"
    return f"float({name})" if kind is REAL else f"int({name})"


# --- the programs

SCRIPT = Script("python", comment=marked("#"), literals=LITERALS, time="np.array([{0}])")
