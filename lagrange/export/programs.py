"""Write the self-test of an exported file, with its data and tolerance, and the program `main`, which makes a run.

Both programs are filled in from the texts in the folder `templates`, in the same way for all languages.
"""

from __future__ import annotations

import math
import operator
import re
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files as resources
from itertools import chain, islice
from string import Template
from typing import Any, NamedTuple

import mpmath

from lagrange.algorithm.constants import Outcome
from lagrange.errors import StatementError, listing
from lagrange.export.module import (
    OUTCOMES,
    TEST,
    Check,
    ExportedIntegrator,
    SourceModule,
    StepCheck,
    columns,
    commented,
    number_lines,
    run_of,
)
from lagrange.graph.evaluate import FUNCTIONS, precise
from lagrange.machine.kernel.interpreted import Arithmetic
from lagrange.machine.python_source import loaded
from lagrange.procedure.form import Procedure
from lagrange.procedure.spelling import Literals
from lagrange.program.program import Program
from lagrange.statement.random_states import SampleKind, Sampler
from lagrange.statement.statement import Statement


class Fields(Template):
    """Template of a text with fields such as @{name}; @@ is the sign @."""

    delimiter = "@"


@cache
def templates(language: str) -> Mapping[str, Fields]:
    """Return the templates of a language by name, from its file in the folder `templates`.

    A line such as "@@@ head" precedes the template of this name.
    """
    text = resources("lagrange.export").joinpath("templates", f"{language}.txt").read_text("ascii")
    _, *parts = re.split(r"^@@@ ([\w ]+)\n", text, flags=re.MULTILINE)
    return dict(zip(parts[::2], map(Fields, parts[1::2]), strict=True))


def filled(language: str, name: str, /, **fields: object) -> str:
    """Return the template `name` of a language with its fields replaced by `fields`, without line ends after it."""
    return templates(language)[name].substitute(fields).rstrip()


def words(language: str, name: str) -> list[str]:
    """Return the words of the template `name` of a language, such as the list "reserved"."""
    return templates(language)[name].template.split()


def helpers(language: str) -> dict[str, str]:
    """Return the definitions of a language's helper functions by operation: the templates such as "helper min"."""
    mark = "helper "
    return {
        name.removeprefix(mark): fields.substitute().rstrip()
        for name, fields in templates(language).items()
        if name.startswith(mark)
    }


def named_helpers(language: str) -> dict[str, tuple[str, str]]:
    """Return the name and the definition of each helper function in C or JavaScript, by operation."""
    names = re.compile(r"^(?:function|double|int64_t) (\w+)", re.MULTILINE)
    return {op: (names.findall(text)[0], text) for op, text in helpers(language).items()}


MOST_STEPS_PER_ROW = 10_000_000  # Largest number of steps between two rows of the table of `main`

TEST_TOLERANCE, TEST_STEPS = 1e-13, 100_000
"""Tolerances of an adaptive run in the test, and its largest number of steps."""


@dataclass(frozen=True)
class Script:
    """Templates and spellings for the self-test and the program `main` in a language.

    - `language` is the name of the file with the templates. Its templates `head` and `tail` are the text before and
      after all tests. `quantity` is the test of a quantity, and `integrator` the test of a step or a run. Their field
      `tables` has lists of numbers, and `table` is the template of one list. `main` is the program, if there is one.
    - `comment` returns a text as comment lines.
    - `literals` spells numbers, and `quoted` spells a name as a string.
    - `time` writes the start time of a run, as an argument that the run changes.
    - `more` ends a line of numbers that continues on the next line.
    - If `chunk` is not 0, a list is split into parts of at most `chunk` numbers.
    """

    language: str
    comment: Callable[[str], Sequence[str]]
    literals: Literals
    time: str = "{0}"
    more: str = ""
    chunk: int = 0
    quoted: Callable[[str], str] = '"{}"'.format

    def filled(self, template: str, fields: Mapping[str, object], **extra_fields: object) -> str:
        """Return the template `template` of the language with its fields replaced by `fields` and `extra_fields`."""
        return templates(self.language)[template].substitute(fields, **extra_fields)


def marked(mark: str) -> Callable[[str], Sequence[str]]:
    """Return a function that returns a text as comment lines, each of which begins with `mark`."""
    return lambda text: commented(text, mark)


def test_text(module: SourceModule, script: Script, **extra_fields: object) -> str:
    """Return the text of the self-test, a program that compares results of the exported functions with expected ones.

    The expected results of quantities were computed in multiple precision. `extra_fields` are values for further
    fields of the templates of `script`.
    """
    fields = {**fields_of(module), **extra_fields}
    text = ["\n".join([*script.comment(f"Self-test of {module.name}. {TEST} Exit status 0 if all are right."), "", ""])]
    text.append(script.filled("head", fields))
    for check in module.checks:
        rows = {"states": check.states, "expected": check.results, "allowed": check.allowed}
        lists = {"times": check.times} | {name: tuple(chain(*values)) for name, values in rows.items()}
        sizes = {"results": len(check.results[0]), "samples": len(check.times)}
        text.append(script.filled("quantity", fields, **sizes, **_named(check.name, script, lists)))
    for step in module.step_checks:
        lists = {"state": step.state, "expected": step.result, "allowed": step.allowed}
        call = {"arguments": _arguments(module, step, script), "time": script.literals.real(step.time)}
        text.append(script.filled("integrator", fields, **call, **_named(step.name, script, lists)))
    return "".join([*text, script.filled("tail", fields)])


def fields_of(module: SourceModule) -> dict[str, object]:
    """Return the values of the fields that all templates have: names, lengths, and the number of tested results."""
    quantities = sum(len(check.results) * len(check.results[0]) for check in module.checks)
    return {
        "module": module.name,
        "states": len(module.state),
        "prepared": max(module.prepared, 1),
        "count": quantities + sum(len(check.result) for check in module.step_checks),
    }


def _named(name: str, script: Script, lists: Mapping[str, Sequence[float]]) -> dict[str, str]:
    """Return the values for the template of a test: its name, its name in quotes, and its tables of numbers.

    `lists` maps the name of each table to its numbers.
    """
    tables = ""
    for table, values in lists.items():
        for begin in range(0, len(values), script.chunk or len(values) or 1):
            part = values[begin : begin + script.chunk] if script.chunk else values
            numbers = number_lines(map(script.literals.real, part), " " * 12)
            fields = {"table": table, "first": begin + 1, "last": begin + len(part), "size": len(values)}
            tables += script.filled("table", fields, numbers=f"{script.more}\n".join(numbers).removesuffix(","))
    return {"name": name, "quoted": script.quoted(name), "tables": tables}


def _arguments(module: SourceModule, check: StepCheck, script: Script) -> str:
    """Return the text of the arguments with which a test calls an integrator."""
    integrator = next(candidate for candidate in module.integrators if candidate.name == check.name)
    literals = script.literals
    begin = literals.real(check.time)
    texts = {"y": "y", "p": "p"}
    if integrator.adaptive:
        tolerances = dict.fromkeys(("rtol", "atol"), literals.real(TEST_TOLERANCE))
        end = literals.real(check.time + check.length)
        texts |= {"t": script.time.format(begin), "t_end": end, **tolerances, "max_steps": literals.whole(TEST_STEPS)}
    else:
        texts |= {"t": begin, "h": literals.real(check.length)}
    return ", ".join(texts[parameter.name] for parameter in integrator.procedure.parameters)


def main_text(module: SourceModule, script: Script, **extra_fields: object) -> str:
    """Return the text of the program `main`, which runs the initial state and prints a table of states over time.

    `extra_fields` are values for further fields of the template in `script`. The module must have a run.
    """
    (run, integrator), literals = run_of(module), script.literals
    meanings = (OUTCOMES.get(code, "the run ended early") for code in Outcome)
    about = (
        f"Integrate the initial state of {module.name} and write a table with commas. Arguments: [t_end [intervals]]."
    )
    fields = {
        **fields_of(module),
        "initial": ", ".join(map(literals.real, run.initial)),
        "t_end": literals.real(run.t_end),
        "intervals": literals.whole(run.intervals),
        "method": integrator.name,
        "rtol": literals.real(run.rtol),
        "steps": literals.whole(MOST_STEPS_PER_ROW),
        "outcomes": "".join(f'    "{meaning}",\n' for meaning in meanings).rstrip(),
        "columns": columns(module),
        **extra_fields,
    }
    return "\n".join([*script.comment(about), "", script.filled("main", fields)])


STATES = 6  # Number of states of each test, the initial state among them if the quantity has values there
TOLERANCE = 1e-12  # Allowed relative error of a result

WELL_CONDITIONED = 2e-14  # Largest relative error of doubles at a preferred test state: a fiftieth of the allowed error

STATE_DRAWS = 60  # Number of random states from which well-conditioned ones are chosen
ULP = 2.0**-52  # Relative change of a state, from which the sensitivity of results to rounding is estimated

NEAR_INITIAL_STATE = SampleKind("near the initial state", "initial", "default")
"""Kind of random states for tests: near the initial state, with the default parameters."""


Evaluation = Callable[[float, Sequence[float]], list[float] | None]
"""Function that returns the results at a time and a state (2n,) as doubles, or None if a matrix is singular."""


def in_python(procedure: Procedure, prepared: memoryview, count: int) -> Evaluation:
    """Return a Python function that runs the procedure of a quantity at t and y, and returns its results as a list.

    The function returns None if a matrix is singular. `prepared` is the array of values that depend on parameters
    alone, and `count` is the number of results.
    """
    run = loaded(procedure)

    def evaluation(t: float, y: Sequence[float]) -> list[float] | None:
        out = memoryview(array("d", [0.0] * max(count, 1)))
        singular = run(t, memoryview(array("d", y)), prepared, out)
        return None if singular else [float(value) for value in out[:count]]

    return evaluation


def check_of(
    name: str, program: Program, evaluate: Evaluation, statement: Statement, parameters: Sequence[float]
) -> Check:
    """Return the test of a quantity at `STATES` states; `evaluate` runs the exported procedure in double precision.

    States are drawn near the initial state, with the default parameters. States at which double precision reproduces
    every result with a relative error of 2e-14 are preferred. At any other state the allowed error is 1e-12 of the
    largest result, and the comments of the file say so. Raises StatementError if too few states have values.
    """
    states = list(_states(statement))
    states.sort(key=lambda state: _sensitivity(evaluate, *state) > WELL_CONDITIONED)
    good: list[_Case] = []
    sensitive: list[_Case] = []
    for t, y in states:
        if pair := _case(program, evaluate, t, y, parameters):
            case, relative = pair
            (good if relative else sensitive).append(case)
        if len(good) == STATES or len(sensitive) == STATES:
            break
    chosen = [*good, *sensitive][:STATES]
    if len(chosen) < STATES:
        missing = f"{name} of {statement.name} has no values at {STATES} states near the initial one"
        raise StatementError(missing + _no_states(program, states, statement, parameters))
    return Check(name, *zip(*chosen, strict=True))


def _no_states(
    program: Program,
    states: Sequence[tuple[float, tuple[float, ...]]],
    statement: Statement,
    parameters: Sequence[float],
) -> str:
    """Return the end of the error message for a quantity with too few test states: the cause, and what to do.

    The cause is a parameter that is zero, or an initial state near which the quantity has no value.
    """

    def some(values: Sequence[float]) -> bool:
        return any(_exact(program, t, y, values) for t, y in states)

    if some(parameters) or not some([value or 1.0 for value in parameters]):
        return ", which the self-test needs: state an initial state at which it has values."
    return f" with {_zeros(statement, parameters)}, which the self-test needs: give other values of parameters."


def _zeros(statement: Statement, parameters: Sequence[float]) -> str:
    """Return the parameters that are zero as text, such as "k = 0", for a message."""
    zeros = [
        f"{parameter.name} = 0" for parameter, value in zip(statement.parameters, parameters, strict=True) if not value
    ]
    return listing(zeros) if zeros else "these parameters"


class NoValue(ArithmeticError):
    """Error: an operation has no real, finite value."""


def evaluate(
    program: Program, t: float, y: Sequence[float], parameters: Sequence[float], digits: int = 40
) -> list[Any]:
    """Return the outputs of a program at (t, y), as mpmath numbers of `digits` digits.

    Raises NoValue if a value is not real or not finite, and if the matrix of a linear system is singular.
    """
    arithmetic = _arithmetic(digits)
    number = arithmetic.number
    try:
        outputs = arithmetic.evaluate(program, number(t), list(map(number, y)), list(map(number, parameters)))
    except (ZeroDivisionError, ValueError, OverflowError) as error:
        raise NoValue("an operation has no value, or a matrix is singular") from error
    if not all(map(mpmath.isfinite, outputs)):
        raise NoValue("a result is not finite")
    return outputs


@cache
def _arithmetic(digits: int) -> Arithmetic:
    """Return the operations of programs for mpmath numbers of `digits` digits; a complex result raises ValueError.

    The functions are those of `lagrange.graph.evaluate`, which also uses mpmath.
    """
    context = precise(digits)

    def real(function: Callable[..., Any]) -> Callable[..., Any]:
        def value(*args: Any) -> Any:
            result = function(*args)
            if isinstance(result, context.mpc):
                raise ValueError("the value is not real")
            return result

        return value

    def factored(n: int, *lower: Any) -> Any:
        """Return the LU factors and row exchanges of a symmetric matrix; `lower` is its lower triangle by rows."""
        matrix, entries = context.zeros(n), iter(lower)
        for i in range(n):
            for j in range(i + 1):
                matrix[i, j] = matrix[j, i] = next(entries)
        return context.LU_decomp(matrix)

    def solved(_: int, factors: Any, *right: Any) -> list[Any]:
        """Return the solution of a linear system with the right-hand side `right`; `factors` are from `factored`."""
        matrix, exchanges = factors
        return list(context.U_solve(matrix, context.L_solve(matrix, context.matrix(right), exchanges)))

    operations: dict[str, Callable[..., Any]] = {
        **{name: partial(function, context) for name, function in FUNCTIONS.items()},
        **{name: getattr(operator, name) for name in ("neg", "add", "sub", "mul")},
        "sqrt": context.sqrt,
        "power": context.power,
        "div": operator.truediv,
        "fma": lambda a, b, c: a * b + c,
        "select": lambda c, a, b: a if c else b,
    }
    systems: dict[str, Callable[..., Any]] = {"factor": factored, "solve": solved}
    return Arithmetic({name: real(function) for name, function in operations.items()}, context.mpf, object, systems)


class _Case(NamedTuple):
    """A test state (t, y) with the expected results and their allowed errors."""

    t: float
    y: tuple[float, ...]
    results: tuple[float, ...]
    allowed: tuple[float, ...]


def _states(statement: Statement) -> Iterator[tuple[float, tuple[float, ...]]]:
    sampler = Sampler(statement, seed=1)
    first = sampler.initial()
    yield first.t, (*first.q, *first.v)
    for attempt in range(STATE_DRAWS):
        point = sampler.point(NEAR_INITIAL_STATE, attempt % 8)
        yield point.t, (*point.q, *point.v)


def _sensitivity(evaluate: Evaluation, t: float, y: tuple[float, ...]) -> float:
    """Return the largest relative change of a result if each entry of the state `y` changes by a rounding error."""
    moved = tuple(x * (1.0 + (ULP if k % 2 else -ULP)) for k, x in enumerate(y))
    results, moved_results = evaluate(t, y), evaluate(t, moved)
    if results is None or moved_results is None:
        return math.inf
    changes = [abs(a - b) / abs(a) if a else abs(b) for a, b in zip(results, moved_results, strict=True)]
    return max((change if math.isfinite(change) else math.inf for change in changes), default=0.0)


def _case(
    program: Program, evaluate: Evaluation, t: float, y: tuple[float, ...], parameters: Sequence[float]
) -> tuple[_Case, bool] | None:
    """Return the test at one state, and True if double precision reproduces each result to nearly all digits.

    Return None if a result has no value in multiple precision or in double precision.
    """
    computed = evaluate(t, y)
    if computed is None or not all(map(math.isfinite, computed)):
        return None
    exact = _exact(program, t, y, parameters)
    if exact is None:
        return None
    relative = all(abs(a - b) <= WELL_CONDITIONED * abs(a) for a, b in zip(exact, computed, strict=True))
    largest = max(map(abs, exact), default=0.0)
    allowed = tuple(TOLERANCE * (abs(a) if relative and a else largest) for a in exact)
    return _Case(t, y, exact, allowed), relative


def _exact(program: Program, t: float, y: tuple[float, ...], parameters: Sequence[float]) -> tuple[float, ...] | None:
    """Return the results of a program at a state in multiple precision, or None if one has no value."""
    try:
        return tuple(float(value) for value in evaluate(program, t, y, parameters))
    except NoValue:
        return None


STEP_LENGTH, RUN_LENGTH = 1e-3, 1e-1
"""Length of the tested step and of the tested run, as fractions of the stated duration, or of 1 if it is longer."""

STEP_TOLERANCE = 1e-11  # Allowed error of the state after a step or a short run, relative to its largest entry


def prepared_numbers(preparing: Procedure, size: int, statement: Statement, parameters: Sequence[float]) -> memoryview:
    """Return the array p (size,) for these parameters, as the procedure `preparing` computes it.

    It has the parameters, then all values that depend on them alone. Raises StatementError if a matrix is singular.
    """
    p = memoryview(array("d", [0.0] * max(size, 1)))
    if loaded(preparing)(memoryview(array("d", [*parameters, 0.0])), p):
        raise StatementError(
            f"the mass matrix of {statement.name} is singular in every state with "
            f"{_zeros(statement, parameters)}: give other values, which the self-test needs."
        )
    return p


MOST_STARTS = 20  # Largest number of states from which a step is tried: the initial state, then states near it


MOST_TRIES = 50
"""Largest number of trial steps in a tested run with error control: Python needs 10 ms per step for 50 bodies."""


def step_check(integrator: ExportedIntegrator, p: memoryview, statement: Statement) -> StepCheck:
    """Return the test of an integrator, whose expected result is computed by running its procedure in Python.

    The step or run starts from the initial state, or from a state near it if that fails. `p` is the array of values
    that depend on parameters alone. Raises StatementError if the step fails from `MOST_STARTS` states.
    """

    def adaptive(t: float, t_end: float, y: memoryview) -> tuple[Outcome, float]:
        time = memoryview(array("d", [t]))
        outcome = Outcome(step(time, t_end, y, p, 1e-13, 1e-13, MOST_TRIES))
        return outcome, time[0]

    length = min(1.0, statement.run.t_end) * (RUN_LENGTH if integrator.adaptive else STEP_LENGTH)
    step, outcome = loaded(integrator.procedure), Outcome.DONE
    for time, first in islice(_states(statement), MOST_STARTS):
        y = memoryview(array("d", first))
        if integrator.adaptive:
            outcome, reached = adaptive(time, time + length, y)
            if outcome is Outcome.PAUSED and reached > time:
                # The limit of trial steps was reached: half of that time takes fewer.
                length = (reached - time) / 2.0
                y = memoryview(array("d", first))
                outcome, _ = adaptive(time, time + length, y)
        else:
            outcome = Outcome(step(time, length, y, p))
        if outcome is Outcome.DONE:
            allowed = STEP_TOLERANCE * max(map(abs, y), default=0.0)
            return StepCheck(integrator.name, time, length, first, tuple(y), (allowed,) * len(first))
    raise StatementError(
        f"{integrator.name} cannot take a step of {statement.name} from its initial state or near it, which the "
        f"self-test needs ({outcome.name}): state an initial state from which the system can move."
    )
