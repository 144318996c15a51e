"""Reads and runs the part of Modelica that exported functions are written in: a grammar of its own, and its meaning."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

TOKEN = re.compile(
    r'\s+|//[^\n]*|(?P<number>\d+\.?\d*(?:[eE][-+]?\d+)?)|(?P<string>"[^"]*")|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)'
    r"|(?P<sign>:=|<=|>=|<>|==|[-+*/^=<>(),;:\[\]{}])"
)
RELATIONS: Mapping[str, Callable[[Any, Any], bool]] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
}
LIBRARY = ("sqrt", "sin", "cos", "tan", "exp", "log", "sinh", "cosh", "tanh")
LIBRARY_ARC = ("asin", "acos", "atan")
EXTERNAL: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, f"arc{name[1:]}") for name in ("asinh", "acosh", "atanh")},
    "erf": math.erf,
}


class Failed(AssertionError):
    """An assertion of the program."""


def tokens(text: str) -> list[str]:
    """Return the words of a text. Raises ValueError for what is none."""
    found, at = [], 0
    while at < len(text):
        match = TOKEN.match(text, at)
        if match is None:
            raise ValueError(f"no word of Modelica: {text[at : at + 30]!r}")
        found += [match[0]] if match.lastgroup else []
        at = match.end()
    return found


@dataclass(frozen=True)
class Function:
    """A function: inputs, outputs, declared names with dimensions and values, and statements."""

    inputs: list[str]
    output: str
    declared: list[tuple[str, str, list[Any], Any]]
    body: list[Any]


class Reader:
    """Reads packages, functions and models by recursive descent."""

    def __init__(self, *texts: str) -> None:
        self.functions: dict[str, Function] = {}
        self.models: dict[str, dict[str, Any]] = {}
        self.packages: list[str] = []
        for text in texts:
            self.words, self.at = tokens(text), 0
            self.packages.append(self.words[1])
            self.package("")
            assert self.at == len(self.words)

    def peek(self) -> str:
        return self.words[self.at]

    def take(self, *wanted: str) -> str:
        found = self.words[self.at]
        if wanted and found not in wanted:
            raise ValueError(f"{' or '.join(wanted)} is missing before {' '.join(self.words[self.at : self.at + 8])}")
        self.at += 1
        return found

    def found(self, word: str) -> bool:
        if self.at < len(self.words) and self.peek() == word:
            self.at += 1
            return True
        return False

    def package(self, before: str) -> None:
        self.take("package")
        name = self.take()
        while self.peek() != "end":
            match self.peek():
                case "package":
                    self.package(f"{self.words[self.at + 1]}.")
                case "function":
                    self.function(before)
                case _:
                    self.model()
        self.ended(name)

    def ended(self, name: str) -> None:
        self.take("end")
        self.take(name)
        self.take(";")

    def declaration(self) -> tuple[str, str, list[Any], Any]:
        kind, name, sizes, value = self.take("Real", "Integer", "Boolean", "String"), self.take(), [], None
        if self.found("["):
            sizes = self.several("]")
        if self.found("("):
            self.several(")", named=True)
        if self.found("="):
            value = self.expression()
        self.take(";")
        return kind, name, sizes, value

    def function(self, before: str) -> None:
        self.take("function")
        name, inputs, output, declared, body = self.take(), [], "", [], []
        while self.peek() not in ("algorithm", "external"):
            word = self.peek()
            if word in ("input", "output", "protected", "constant"):
                self.take()
            if word == "protected":
                continue
            declared.append(self.declaration())
            inputs += [declared[-1][1]] if word == "input" else []
            output = declared[-1][1] if word == "output" else output
        if self.found("external"):
            while not self.found(";"):
                self.take()
            body = [("external", name)]
        else:
            self.take("algorithm")
            body = self.statements()
        self.ended(name)
        self.functions[before + name] = Function(inputs, output, declared, body)

    def model(self) -> None:
        self.take("model")
        name, declared, equations = self.take(), [], []
        while self.peek() not in ("equation", "algorithm"):
            while self.peek() in ("parameter", "protected"):
                self.take()
            declared.append(self.declaration())
        if self.found("algorithm"):
            self.take("when")
            condition = self.expression()
            self.take("then")
            equations = [condition, self.statements()]
            self.take("end")
            self.take("when")
            self.take(";")
        else:
            self.take("equation")
            while self.peek() not in ("end", "annotation"):
                left = self.expression()
                self.take("=")
                equations.append((left, self.expression()))
                self.take(";")
            if self.found("annotation"):
                self.take("(")
                self.several(")", named=True)
                self.take(";")
        self.ended(name)
        self.models[name] = {"declared": declared, "equations": equations}

    def statements(self) -> list[Any]:
        found: list[Any] = []
        while self.peek() not in ("end", "else", "elseif"):
            if self.found("for"):
                index = self.take()
                self.take("in")
                first = self.expression()
                self.take(":")
                last = self.expression()
                step = ("value", 1)
                if self.found(":"):
                    step, last = last, self.expression()
                self.take("loop")
                found.append(("for", index, first, step, last, self.statements()))
                self.take("end")
                self.take("for")
            elif self.found("if"):
                condition = self.expression()
                self.take("then")
                found.append(("if", condition, self.statements()))
                self.take("end")
                self.take("if")
            else:
                target = self.primary()
                found.append(("set", target, self.expression()) if self.found(":=") else ("do", target))
            self.take(";")
        return found

    def several(self, closing: str, *, named: bool = False) -> list[Any]:
        found: list[Any] = []
        while not self.found(closing):
            if self.found(":"):
                found.append(("all",))
            else:
                found.append(self.expression())
                if self.found(":"):
                    found[-1] = ("slice", found[-1], self.expression())
            if self.found("="):
                assert named or closing == ")"
                found[-1] = ("named", found[-1][1], self.expression())
            if self.peek() != closing:
                self.take(",")
        return found

    def expression(self) -> Any:
        if self.found("if"):
            condition = self.expression()
            self.take("then")
            chosen = self.expression()
            if self.peek() == "elseif":
                self.words[self.at] = "if"
                return ("choose", condition, chosen, self.expression())
            self.take("else")
            return ("choose", condition, chosen, self.expression())
        found = self.both()
        while self.found("or"):
            found = ("or", found, self.both())
        return found

    def both(self) -> Any:
        found = self.factual()
        while self.found("and"):
            found = ("and", found, self.factual())
        return found

    def factual(self) -> Any:
        if self.found("not"):
            return ("not", self.relation())
        return self.relation()

    def relation(self) -> Any:
        found = self.sum()
        if self.peek() in RELATIONS:
            found = (self.take(), found, self.sum())
        return found

    def sum(self) -> Any:
        found = ("neg", self.product()) if self.found("-") else self.product()
        while self.peek() in ("+", "-"):
            found = (self.take(), found, self.product())
        return found

    def product(self) -> Any:
        found = self.power()
        while self.peek() in ("*", "/"):
            found = (self.take(), found, self.power())
        return found

    def power(self) -> Any:
        found = self.primary()
        return ("^", found, self.primary()) if self.found("^") else found

    def primary(self) -> Any:
        word = self.take()
        if word == "(":
            found = self.expression()
            self.take(")")
            return found
        if word == "{":
            return ("array", self.several("}"))
        if word[0].isdigit():
            return ("value", float(word) if re.search("[.eE]", word) else int(word))
        if word[0] == '"':
            return ("value", word[1:-1])
        if not re.match(r"[A-Za-z_]", word) or word in ("then", "else", "loop", "end", "and", "or", "in"):
            raise ValueError(f"an operand is missing before {word}")
        if self.found("("):
            return ("call", word, self.several(")"))
        if self.found("["):
            return ("item", word, self.several("]"))
        return ("name", word)


class Machine:
    """Runs functions, as Modelica says: arrays are values, and are counted from one."""

    def __init__(self, *texts: str) -> None:
        self.reader = Reader(*texts)
        self.warnings: list[str] = []

    def call(self, name: str, *args: Any) -> Any:
        prefix = name.rpartition(".")[0]
        function = self.reader.functions[name]
        own: dict[str, Any] = {".": prefix, "true": True, "false": False}
        own |= {
            key: np.array(value, float) if np.ndim(value) else value
            for key, value in zip(function.inputs, args, strict=True)
        }
        for _, declared, sizes, value in function.declared:
            counts = [None if size == ("all",) else self.value(size, own) for size in sizes]
            if declared in function.inputs:
                shape = np.shape(own[declared])
                assert len(shape) == len(counts)
                assert all(count in (None, held) for count, held in zip(counts, shape, strict=True)), (name, declared)
            elif value is not None:
                own[declared] = self.value(value, own)
                assert list(np.shape(own[declared])) == counts
            else:
                own[declared] = np.full(counts, np.nan) if counts else None
        with np.errstate(all="ignore"):
            self.run(function.body, own)
        return own[function.output]

    def run(self, body: Sequence[Any], own: dict[str, Any]) -> None:
        for statement in body:
            match statement:
                case ("for", index, first, step, last, inside):
                    by = self.value(step, own)
                    for k in range(self.value(first, own), self.value(last, own) + by, by):
                        own[index] = k
                        self.run(inside, own)
                case ("if", condition, inside):
                    if self.truth(condition, own):
                        self.run(inside, own)
                case ("set", ("name", name), value):
                    assert name in own, f"{name} is not declared"
                    own[name] = self.value(value, own)
                case ("set", ("item", name, places), value):
                    own[name][self.places(places, own)] = self.value(value, own)
                case ("do", call):
                    self.value(call, own)
                case ("external", name):
                    own["y"] = EXTERNAL[name](own["x"])

    def places(self, given: Sequence[Any], own: dict[str, Any]) -> tuple[Any, ...]:
        found = tuple(self.place(one, own) for one in given)
        assert all(isinstance(one, slice) or one >= 0 for one in found)
        return found

    def place(self, one: Any, own: dict[str, Any]) -> Any:
        if one == ("all",):
            return slice(None)
        if one[0] == "slice":
            return slice(self.value(one[1], own) - 1, self.value(one[2], own))
        return self.value(one, own) - 1

    def truth(self, what: Any, own: dict[str, Any]) -> bool:
        found = self.value(what, own)
        assert isinstance(found, (bool, np.bool_)), what
        return bool(found)

    def value(self, what: Any, own: dict[str, Any]) -> Any:
        match what:
            case ("value", found):
                return np.float64(found) if isinstance(found, float) else found
            case ("name", name):
                return own[name]
            case ("item", name, places):
                return own[name][self.places(places, own)]
            case ("array", entries):
                return np.array([self.value(one, own) for one in entries], float)
            case ("choose", condition, chosen, other):
                return self.value(chosen if self.truth(condition, own) else other, own)
            case ("and" | "or" as op, a, b):
                left, right = self.truth(a, own), self.truth(b, own)
                return (left and right) if op == "and" else (left or right)
            case ("not", a):
                return not self.truth(a, own)
            case ("neg", a):
                return -self.value(a, own)
            case ("call", name, args):
                return self.called(name, args, own)
            case (op, a, b):
                left, right = self.value(a, own), self.value(b, own)
                if op in RELATIONS:
                    return RELATIONS[op](left, right)
                return self.computed(op, left, right)
        raise ValueError(what)

    def computed(self, op: str, a: Any, b: Any) -> Any:
        if op == "+":
            return a + b
        if op == "-":
            return a - b
        if op == "*":
            return a * b
        return np.divide(a, b) if op == "/" else np.power(np.float64(a), b)

    def called(self, name: str, given: Sequence[Any], own: dict[str, Any]) -> Any:
        if name == "assert":
            if not self.truth(given[0], own):
                message = self.value(given[1], own)
                if len(given) < 3:
                    raise Failed(message)
                self.warnings.append(message)
            return None
        args = [self.value(one, own) for one in given if one[0] != "named"]
        if name == "String":
            return str(args[0])
        if name in LIBRARY:
            return getattr(np, name)(np.float64(args[0]))
        if name in LIBRARY_ARC:
            return getattr(np, f"arc{name[1:]}")(np.float64(args[0]))
        own_name = f"{own['.']}.{name}" if own["."] else name
        package, _, rest = name.partition(".")
        own_name = rest if package in self.reader.packages else own_name
        simple: Mapping[str, Callable[..., Any]] = {
            "abs": abs,
            "div": lambda a, b: int(a / b),
            "integer": math.floor,
            "atan2": np.arctan2,
            "fill": lambda value, *counts: np.full(counts, value),
            "size": lambda array, place: np.shape(array)[place - 1],
        }
        return simple[name](*args) if name in simple else self.call(own_name, *args)
