"""Exported Julia and Modelica, which do not run here: their functions are translated to Python and evaluated."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.export.contents import contents_of, module_of
from lagrange.export.languages import julia, modelica
from lagrange.export.module import SourceModule
from lagrange.export.straight_line import PrintedFunctions
from lagrange.export.target import find
from lagrange.machine.python_source import defined
from tests.covering import Share
from tests.export.callers import as_module, every_scene, graph, held, named, points, wrong
from tests.export.test_contents import accepted, awkward
from tests.export.test_modules import coupled, on_a_sphere
from tests.models import shared_scene

ROOTS = ("sqrt", "sin", "cos", "tan", "exp", "log", "sinh", "cosh", "tanh")
ARCS = ("asin", "acos", "atan", "asinh", "acosh", "atanh")


class Places:
    """An array of doubles whose indices begin at 1."""

    def __init__(self, values: Any) -> None:
        self.values = np.array(values, float)

    def __len__(self) -> int:
        return len(self.values)

    def _at(self, place: Any) -> Any:
        places = place if isinstance(place, tuple) else (place,)
        assert all(1 <= item <= size for item, size in zip(places, self.values.shape, strict=True)), place
        return tuple(item - 1 for item in places)

    def __getitem__(self, place: Any) -> Any:
        return self.values[self._at(place)]

    def __setitem__(self, place: Any, value: Any) -> None:
        self.values[self._at(place)] = value


def _real(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of reals that raises an error outside its domain, as in Julia."""

    def checked(*args: float) -> Any:
        value = function(*map(np.float64, args))
        assert not np.isnan(value) or np.isnan(args).any(), f"DomainError: {function.__name__}{args}"
        return value

    return checked


def _span(start: int, *rest: int) -> range:
    step, last = rest if len(rest) == 2 else (1, *rest)
    return range(start, last + (1 if step > 0 else -1), step)


def _filled(value: float, *sizes: int) -> Places:
    return Places(np.full(sizes, value))


BOTH: Mapping[str, Any] = {
    **{name: getattr(np, name) for name in ROOTS},
    **{name: getattr(np, f"arc{name[1:]}") for name in ARCS},
    "_double": np.float64,
    "_list": lambda *values: Places(values),
    "_span": _span,
    "fill": _filled,
    "integer": math.floor,
    "atan2": np.arctan2,
    "_copied": lambda value: Places(value.values) if isinstance(value, Places) else value,
}
JULIA: Mapping[str, Any] = {
    **BOTH,
    **{name: _real(BOTH[name]) for name in (*ROOTS, *ARCS)},
    "atan": lambda a, b=None: np.arctan(a) if b is None else np.arctan2(a, b),
    "max": np.maximum,
    "min": np.minimum,
    "ifelse": lambda condition, a, b: a if condition else b,
    "trunc": lambda x: int(x) if np.isfinite(x) else x,
    "isinf": np.isinf,
    "isfinite": np.isfinite,
    "oftype": lambda _, value: value,
    "one": lambda _: np.float64(1.0),
    "length": len,
    "zeros": lambda *sizes: _filled(0.0, *sizes),
    "Float64": np.float64,
    "Int": int,
    "Inf": np.inf,
    "NaN": np.nan,
}
MODELICA: Mapping[str, Any] = {**BOTH, **{f"{name}_in_c": BOTH[name] for name in ARCS[3:]}, "erf_in_c": math.erf}

GROUP = re.compile(r"(\w?)([(\[{])([^()\[\]{}]*)[)\]}]")
CHOICE = re.compile(r"if (?P<holds>.+?) then (?P<then>.+?) else(?P<other>.+)|(.+?) \? (.+?) : (.+)")
WHOLE = re.compile(r"\s*(//.*|(package|function|end) .*|.*;|.*\b(loop|then|algorithm|protected)|)")
"""A line of Modelica that ends what it says; others go on in the next."""

SPELLINGS = (
    (r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)", r"_double(\1)"),
    (r"\b(lambda|def|del|from|is|pass|with|class|yield|raise|except|assert|None|as|nonlocal|async|await)\b", r"\1_"),
    *((r"&&", " and "), (r"\|\|", " or "), (r"!(?=[=(])", "!"), (r"<>", "!="), (r"\^", "**")),
    *((r"!(?![=(])", " not "), (r"\btrue\b", "True"), (r"\bfalse\b", "False")),
)


def expression(text: str) -> str:
    """Return an expression in Python: operators, literals, conditional expressions and lists are translated."""
    text = re.sub(r"(\w+)!\(", r"\1(", text)
    text = re.sub(r"!\(", " not (", text)
    for pattern, spelling in SPELLINGS:
        text = re.sub(pattern, spelling, text)
    stashed: list[str] = []

    def stash(group: re.Match[str]) -> str:
        inside = ", ".join(_chosen(part.strip()) for part in group[3].split(",")) if group[3].strip() else ""
        is_list = group[2] == "{" or (group[2] == "[" and not group[1])
        stashed.append(f"_list({inside})" if is_list else f"{group[2]}{inside}{')' if group[2] == '(' else ']'}")
        return f"{group[1]}§{len(stashed) - 1}§"

    while GROUP.search(text):
        text = GROUP.sub(stash, text)
    text = _chosen(text)
    while "§" in text:
        text = re.sub(r"§(\d+)§", lambda result: stashed[int(result[1])], text)
    return text.strip()


def _chosen(text: str) -> str:
    """Return a text without parentheses, with its conditional expression in Python's order."""
    result = CHOICE.fullmatch(text)
    if result is None:
        return text
    holds, then, second = (first for first in result.groups() if first is not None)
    return f"(({then}) if ({holds}) else ({_chosen(second.strip())}))"


def _loop(rest: str) -> str:
    index, _, places = rest.removesuffix(" loop").partition(" in ")
    return f"for {index} in _span({', '.join(map(expression, places.split(':')))}):"


def of_julia(text: str) -> dict[str, Any]:
    """Return the functions and constants of a module by name, without the ! of their names."""
    out, depth = [], 0
    for line in re.sub(r'"""\n(.|\n)*?"""\n', "", text).splitlines():
        body = line.partition("#")[0].strip()
        word, _, rest = body.partition(" ")
        if not body or word == "module" or (line == "end" and not depth):
            continue
        if word == "end":
            depth -= 1
            continue
        short = re.fullmatch(r"(\w+\([\w, ]+\)) = (.+)", body)
        guard, _, thrown = body.partition(" && throw(")
        indent = "    " * (depth - (word == "else"))
        if short:
            out.append(f"{indent}def {short[1]}: return {expression(short[2])}")
        elif thrown:
            out.append(f"{indent}assert not ({expression(guard)})")
        elif word in ("function", "if", "while"):
            out.append(f"{indent}{'def' if word == 'function' else word} {expression(rest)}:")
        else:
            text = (
                _loop(rest) if word == "for" else expression(rest.replace("Float64[", "[") if word == "const" else body)
            )
            out.append(indent + ("else:" if word == "else" else text))
        depth += word in ("function", "if", "while", "for")
    assert depth == 0
    return _names(out, JULIA)


def of_modelica(lines: list[str]) -> dict[str, Any]:
    """Return the functions of a package by name. An array that is assigned is copied; every name is declared."""
    out: list[str] = []
    depth, name, inputs, sizes, result = 0, "", [""], dict[str, str](), ""
    before = ""
    for part in lines:
        line = f"{before} {part}"
        if not WHOLE.fullmatch(line):
            before = line
            continue
        before = ""
        body = line.partition("//")[0].strip().removesuffix(";")
        word, _, rest = body.partition(" ")
        declared = re.fullmatch(r"(?:(input|output) )?(?:Real|Integer|Boolean) (\w+)(?:\[(.+)\])?", body)
        if word == "function":
            name, inputs, sizes = rest, [], {}
        elif declared:
            sizes[declared[2]] = declared[3] or ""
            inputs += [declared[2]] * (declared[1] == "input")
            result = declared[2] if declared[1] == "output" else result
        elif word in ("algorithm", "external"):
            out.append(f"def {name}({', '.join(inputs)}):")
            out += [
                f"    {item} = fill(_double('nan'), {size})"
                for item, size in sizes.items()
                if size and item not in inputs
            ]
            depth = 1
            if word == "external":
                out.append(f"    y = {name}_in_c(x)")
        elif word == "end" and rest == name:
            out.append(f"    return {result}")
            depth = 0
        elif word == "end":
            depth -= 1
        elif depth and body:
            out.append("    " * depth + _statement(body, sizes))
            depth += word in ("for", "if")
    assert depth <= 0
    return _names(out, MODELICA)


def _statement(body: str, declared: Mapping[str, str]) -> str:
    word, _, rest = body.partition(" ")
    if word == "for":
        return _loop(rest)
    if word == "if":
        return f"if {expression(rest.removesuffix(' then'))}:"
    if checked := re.fullmatch(r'assert\((.*), (".*")\)', body):
        return f"assert {expression(checked[1])}, {checked[2]}"
    target, _, value = body.partition(" := ")
    assert target.partition("[")[0] in declared, f"{target} is not declared"
    return f"{expression(target)} = _copied({expression(value)})"


def _names(lines: list[str], known: Mapping[str, Any]) -> dict[str, Any]:
    result: dict[str, Any] = defined("\n".join([*lines, "def _names(): return globals()", ""]), "_names", known)()
    return result


# --- exported Julia and Modelica, which do not run here: their functions are translated to Python and evaluated ---


QUANTITIES = ["rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations"]
both = pytest.mark.parametrize("target", ["julia", "modelica"])


class Singular(Exception):
    """Exception for a singular matrix."""


class Read:
    """The functions of a module by name, each a function of time, state and prepared parameters."""

    def __init__(self, target: str, made: SourceModule) -> None:
        self.julia, self.made = target == "julia", made
        if self.julia:
            self.known = of_julia(julia.source(made))
        else:
            functions = PrintedFunctions(made, modelica.LANGUAGE, statuses=False)
            self.known = of_modelica([*modelica.function_lines(functions)])
            self.size = functions.hoisted.size

    def prepared(self, parameters: Sequence[float]) -> Any:
        if not self.julia:
            return self.known["prepare"](Places(parameters))
        p = Places(np.zeros(self.known["PREPARED_SIZE"]))
        assert not self.known["prepare"](p, Places(parameters))
        return p

    def values(self, name: str, t: float, y: Sequence[float], p: Any, size: int) -> list[float]:
        """Return the results of a function at a state. Raises Singular for a singular matrix."""
        with np.errstate(all="ignore"):
            if self.julia:
                out = Places(np.zeros(size))
                if self.known[name](out, np.float64(t), Places(y), p):
                    raise Singular
                return [float(value) for value in out.values]
            try:
                return [float(value) for value in self.known[name](np.float64(t), Places(y), p).values]
            except AssertionError as error:
                if "a matrix is singular" in str(error):
                    raise Singular from None
                raise


def module(target: str, system: lg.System, contents: list[str]) -> SourceModule:
    model = system.compile("numpy")
    return module_of(model, contents_of(find(target), model, contents, (), None), ())


def right(target: str, made: SourceModule) -> Read:
    """Return the functions of a module, after a check that they give the results in its self-test."""
    read = Read(target, made)
    p = read.prepared(made.values)
    for item in made.checks:
        for t, y, expected, allowed in zip(item.times, item.states, item.results, item.allowed, strict=True):
            result = read.values(item.name, t, y, p, len(expected))
            assert (np.abs(np.subtract(result, expected)) <= allowed).all(), item.name
    return read


@both
@pytest.mark.parametrize("scene", every_scene("double-pendulum", "cartesian-double-pendulum"))
def test_a_scene_conforms(target: str, scene: str) -> None:
    system = shared_scene(scene)
    right(target, module(target, system, [*QUANTITIES, *held(system)]))


@both
def test_random_graphs(target: str, share: Share) -> None:
    programs = [graph(seed, without=sorted(find(target).inexpressible)) for seed in range(share(60))]
    read = Read(target, as_module(programs))
    p = read.prepared([])
    for k, item in enumerate(programs):
        for y in points(k, 6):
            assert list(wrong(item, y, read.values(item.name, 0.0, y, p, len(item.outputs)))) == []


RESERVED = {"julia": julia.RESERVED, "modelica": modelica.RESERVED}


@pytest.mark.few(1)
@both
def test_awkward_names(target: str) -> None:
    words = [*dict.fromkeys((*islice(awkward(), 30), *filter(accepted, RESERVED[target])))]
    right(target, module(target, named(words[:8], words[8:], "float64"), ["rhs", "energy"]))


@both
@pytest.mark.parametrize("stated", [coupled, on_a_sphere])
def test_a_singular_matrix_is_told(target: str, stated: Callable[[], lg.System]) -> None:
    made = module(target, stated(), ["rhs"])
    read = right(target, made)
    with pytest.raises(Singular):
        read.values("rhs", 0.0, [0.0, 0.0, 0.5, 0.1], read.prepared(made.values), 4)
