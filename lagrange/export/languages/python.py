"""Python with NumPy only: one module."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from lagrange.errors import LagrangeError
from lagrange.export.comments import commented
from lagrange.export.descriptions import TEST, about_of, columns, lengths, outcomes, sizes, statement_comment, statuses
from lagrange.export.identifiers import ascii_name, distinct
from lagrange.export.languages.python_spelling import FILES, HELPERS, RESERVED, helper_lines
from lagrange.export.module import Check, SourceModule, StepCheck
from lagrange.export.programs import arguments_in_test, main_fields, tables
from lagrange.export.python_module import named_places
from lagrange.export.target import Target, register
from lagrange.machine.python_source import LITERALS, Printer
from lagrange.procedure.form import REAL, Array, Part, Procedure


@register
class Python(Target):
    """Python with NumPy only; see `Target`."""

    name = "python"
    about = "Python: one module that needs NumPy only"

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the module, which tests itself when it is run."""
        return {f"{file_name(module)}.py": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs the test."""
        return [f"python {file_name(module)}.py"]

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs `main`."""
        return [f"python {file_name(module)}.py main"]


def file_name(module: SourceModule) -> str:
    """Return the name of the module, which no keyword and no module that NumPy imports has."""
    return distinct([module.name], FILES)[0]


@dataclass(frozen=True)
class _File:
    """State shared by the functions of one file; `needed` collects the operations whose definitions it needs."""

    needed: dict[str, None] = field(default_factory=dict)


class _ExportPrinter(Printer):
    """Prints one procedure, whose name begins with an underscore: arrays are memory views of NumPy's."""

    def __init__(self, procedure: Procedure, file: _File) -> None:
        self.file = file
        super().__init__(procedure, RESERVED)

    def function_name(self, procedure: Procedure) -> str:
        return f"_{procedure.name}"

    def legal(self, stem: str) -> str:
        return ascii_name(stem)

    def function_of(self, op: str) -> str:
        if op not in HELPERS:
            raise LagrangeError(f"Python has no function for {op}.")
        self.file.needed[op] = None
        return f"_{op}"

    def reserve(self, ref: int, array: Array) -> None:
        kind = "" if array.kind is REAL else ", np.int64"
        self.put(f"{self.name(ref)} = np.zeros({array.length}{kind}).data")

    def part(self, part: Part) -> None:
        self.write(f"{self.name(part.ref)} = {self.text(part.array)}[{self.text(part.start)}:]")


def source(module: SourceModule) -> str:
    """Return the module."""
    file = _File()
    functions = [_ExportPrinter(procedure, file).function() for procedure in module.procedures]
    lines = [
        *statement_comment(module, "#"),
        "",
        "import math",
        "import sys",
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
        *ACCESS.splitlines(),
        "",
        "",
        *helper_lines(file.needed),
        *(line for text in functions for line in [*text.splitlines(), "", ""]),
        *test(module),
        *run(module),
        *START.format(run="main(words[1:]) if words[:1] == ['main'] else " if module.run else "").splitlines(),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


ACCESS = '''\
def _given(values):
    """Return numbers that are read, as they are quickest."""
    return np.asarray(values, dtype=np.float64).data


def _written(values):
    """Return an array that is written. Raises TypeError for what is no array of float64."""
    if not (isinstance(values, np.ndarray) and values.dtype == np.float64 and values.ndim == 1):
        raise TypeError("an array that is written must be of NumPy, one-dimensional, with dtype float64")
    return values.data


def _check_lengths(**arrays):
    """Raise ValueError for an array that is no list of as many numbers as are needed."""
    for name, (values, length) in arrays.items():
        shape = np.shape(values)
        if len(shape) != 1 or shape[0] < length:
            raise ValueError(f"{name} has shape {shape}: give {length} numbers") from None'''

START = """\


if __name__ == "__main__":
    words = sys.argv[1:]
    sys.exit({run}test())"""


def constants(module: SourceModule) -> Iterator[str]:
    """Yield sizes, names, and comments on arrays and functions."""
    for name, count, about in sizes(module):
        yield f"{name.upper()} = {count}  # {about}"
    yield from named_places(module, "parameters")
    yield from commented(
        f"{statuses('False', 'True')} Arrays that are written are of float64.",
        "#",
    )
    if module.integrators:
        yield from commented(outcomes(), "#")


def wrapper(module: SourceModule, procedure: Procedure) -> Iterator[str]:
    """Yield a public function, which takes arrays of NumPy."""
    names = [one.name for one in procedure.parameters]
    passed = [_passed(one.name, one.type) for one in procedure.parameters]
    first, *rest = commented(about_of(module, procedure).replace('"', "'"), "")
    yield f"def {procedure.name}({', '.join(names)}):"
    yield f'    """{first.strip()}{"" if rest else chr(34) * 3}'
    yield from (f"    {line.strip()}" for line in rest)
    if rest:
        yield '    """'
    yield "    try:"
    yield f"        return _{procedure.name}({', '.join(passed)})"
    yield "    except (IndexError, NotImplementedError):"
    given = (f"{name}=({name}, {length})" for name, length in lengths(module, procedure).items())
    yield f"        _check_lengths({', '.join(given)})"
    yield "        raise"
    yield ""
    yield ""


def _passed(name: str, kind: object) -> str:
    if isinstance(kind, Array):
        return f"_given({name})" if kind.read else f"_written({name})"
    return f"float({name})" if kind is REAL else f"int({name})"


# --- the test

COMPARE = '''\
class _Tests:
    """Counts results and failures, and prints these."""

    def __init__(self):
        self.p = np.zeros(PREPARED)
        self.checked = self.failures = 0
        if prepare(DEFAULT_PARAMETERS, self.p):
            print("prepare: a matrix is singular")
            self.failures += 1

    def compare(self, name, state, found, wanted, allowed):
        for i, value in enumerate(found.tolist()):
            if not abs(value - wanted[i]) <= allowed[i]:
                print(f"{name}, state {state}, result {i}: {value!r} instead of {wanted[i]!r}")
                self.failures += 1

    def quantity(self, name, evaluate, times, states, wanted, allowed):
        count = len(wanted) // len(times)
        for k, t in enumerate(times):
            out, row = np.zeros(count), slice(count * k, count * (k + 1))
            self.checked += count
            if evaluate(t, states[STATE * k : STATE * (k + 1)], self.p, out):
                print(f"{name}, state {k}: a matrix is singular")
                self.failures += count
            else:
                self.compare(name, k, out, wanted[row], allowed[row])

    def integrator(self, name, run, state, wanted, allowed):
        y = np.array(state)
        outcome = run(y, self.p)
        self.checked += STATE
        if outcome != 0:
            print(f"{name}: outcome {outcome}")
            self.failures += STATE
        else:
            self.compare(name, 0, y, wanted, allowed)


def test():
    """Compare results with those of multiple precision; return 0 if all are right, else 1."""
    tests = _Tests()'''


def test(module: SourceModule) -> Iterator[str]:
    """Yield the test: a function that compares results with those of multiple precision."""
    yield from commented(f"{TEST} Failures are printed. Exit status 0 if all are right, else 1.", "#")
    yield from COMPARE.splitlines()
    for check in module.checks:
        yield from _quantity_test(check)
    for step in module.step_checks:
        yield from _integrator_test(module, step)
    given = f'f"{module.name}: {{tests.checked - tests.failures}} of {{tests.checked}} results are right"'
    yield f"    print({given})"
    yield "    return 0 if tests.failures == 0 else 1"


def _quantity_test(check: Check) -> Iterator[str]:
    yield "    tests.quantity("
    yield f'        "{check.name}",'
    yield f"        {check.name},"
    yield from tables(check.flat, LITERALS)
    yield "    )"


def _integrator_test(module: SourceModule, check: StepCheck) -> Iterator[str]:
    yield "    tests.integrator("
    yield f'        "{check.name}",'
    yield f"        lambda y, p: {check.name}({arguments_in_test(module, check, LITERALS, 'np.array([{0}])')}),"
    yield from tables((check.state, check.result, check.allowed), LITERALS)
    yield "    )"


# --- the run of the initial state

MAIN = '''\


def main(words):
    """Integrate the initial state and write a table with commas: main [t_end [intervals]]."""
    outcomes = (
{outcomes}
    )
    try:
        t_end = float(words[0]) if words else {t_end}
        intervals = int(words[1]) if len(words) > 1 else {intervals}
    except ValueError:
        intervals = 0
    if intervals < 1:
        print("give t_end, a number, and intervals, a whole number from 1", file=sys.stderr)
        return 2
    p, t, y = np.zeros(PREPARED), np.zeros(1), np.array([{initial}])
    if prepare(DEFAULT_PARAMETERS, p):
        print("prepare: a matrix is singular", file=sys.stderr)
        return 1
    print({columns})
    for k in range(intervals + 1):
        end = t_end if k == intervals else t_end * k / intervals
        outcome = {method}(t, end, y, p, {rtol}, {rtol}, {steps})
        if outcome != 0:
            print(f"the run stopped at t = {{t[0]}}: {{outcomes[outcome]}}", file=sys.stderr)
            return 1
        print(",".join(map(repr, [*t.tolist(), *y.tolist()])))
    return 0'''


def run(module: SourceModule) -> Iterator[str]:
    """Yield a function that integrates the initial state and writes a table."""
    fields = main_fields(module, LITERALS)
    if fields is None:
        return
    yield from MAIN.format(**fields, columns=ascii(columns(module))).splitlines()
