"""A reader of the part of Julia that exported files use: it checks them, and makes Python of them.

Every statement stands on a line of its own. What is not known here is refused, so that new text is looked at.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from lagrange.machine.python_source import defined

WORDS = ("function", "for", "while", "if", "module")
"""What opens a block that `end` closes."""

TOKEN = re.compile(r"\s+|[A-Za-z_]\w*!?(?!=)|[A-Za-z_]\w*|\d+(?:\.\d+)?(?:e[+-]?\d+)?|&&|\|\||[-+*/%^<>=!?:(),.\[\]]")
PYTHON_ALONE = [word for word in keyword.kwlist if word not in ("else", "for", "if", "in", "return", "break", "while")]
"""Words of Python that are names in Julia."""
CLOSING = {"(": ")", "[": "]"}


def _real(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of reals that raises an error outside of its domain, as Julia's do."""

    def found(*args: float) -> Any:
        value = function(*args)
        if np.isnan(value) and not np.isnan(args).any():
            raise ValueError(f"DomainError: {function.__name__}{args}")
        return value

    return found


NAMED = ("sin", "cos", "tan", "sqrt", "log", "exp", "sinh", "cosh", "tanh")
BASE: Mapping[str, Any] = {
    **{name: _real(getattr(np, name)) for name in NAMED},
    **{f"a{name}": _real(getattr(np, f"arc{name}")) for name in ("sin", "cos", "sinh", "cosh", "tanh")},
    "atan": lambda a, b=None: np.arctan(a) if b is None else np.arctan2(a, b),
    "abs": abs,
    "max": np.maximum,
    "min": np.minimum,
    "ifelse": lambda condition, a, b: a if condition else b,
    "trunc": lambda x: int(x) if np.isfinite(x) else x,
    "isinf": np.isinf,
    "isfinite": np.isfinite,
    "oftype": lambda _, value: value,
    "one": lambda _: np.float64(1.0),
    "length": len,
    "Float64": np.float64,
    "Int": int,
    "Inf": np.float64(math.inf),
    "NaN": np.float64(math.nan),
}


class Ones:
    """An array whose first place is 1; a matrix is a vector of rows."""

    def __init__(self, values: list[Any]) -> None:
        self.values = values

    def __len__(self) -> int:
        return len(self.values)

    def _place(self, place: int) -> int:
        assert 1 <= place <= len(self), f"there is no place {place} among {len(self)}"
        return place - 1

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, tuple):
            return self[place[0]][place[1]]
        return self.values[self._place(place)]

    def __setitem__(self, place: Any, value: Any) -> None:
        if isinstance(place, tuple):
            self[place[0]][place[1]] = value
        else:
            self.values[self._place(place)] = np.float64(value)


def reals(values: Iterable[float]) -> Ones:
    """Return an array of doubles."""
    return Ones([np.float64(value) for value in values])


def _zeros(*counts: int) -> Ones:
    """Return a vector, or a matrix as the vector of its rows."""
    if len(counts) == 1:
        return reals([0.0] * counts[0])
    return Ones([_zeros(*counts[1:]) for _ in range(counts[0])])


KNOWN: Mapping[str, Any] = {
    **BASE,
    "zeros": _zeros,
    "_list": lambda *values: reals(values),
    "_from_to": lambda start, *rest: range(start, rest[-1] + (1 if len(rest) == 1 else rest[0]), *rest[:-1]),
}


def statements(text: str) -> list[str]:
    """Return the lines of a file that say something: no comments, no texts for help."""
    without_help = re.sub(r'"""\n(.|\n)*?"""\n', "", text)
    lines = (re.sub(r"\s*#.*$", "", line) for line in without_help.splitlines())
    return [line for line in lines if line.strip()]


def check(text: str) -> None:
    """Check that all text is known, that brackets and blocks close, and that names are defined before they are used."""
    blocks: list[int] = []
    for line in statements(text):
        body, indent = line.strip(), len(line) - len(line.lstrip())
        plain = re.sub(r'"[^"]*"', "0", body).replace("::", ":")
        assert "".join(TOKEN.findall(plain)) == plain, line
        left: list[str] = []
        for letter in plain:
            if letter in CLOSING:
                left.append(CLOSING[letter])
            elif letter in CLOSING.values():
                assert left, line
                assert left.pop() == letter, line
        assert not left, line
        if body in ("end", "else"):
            assert blocks, line
            assert blocks[-1] == indent, line
            if body == "end":
                blocks.pop()
        elif body.startswith(tuple(f"{word} " for word in WORDS)):
            blocks.append(indent)
    assert not blocks
    tree = ast.parse(translated(text))
    known = dict.fromkeys(
        [*KNOWN, *(name for one in tree.body if isinstance(one, ast.Assign) for name in _targets(one))]
    )
    for one in tree.body:
        if isinstance(one, ast.FunctionDef):
            _scope(one.body, dict.fromkeys([*known, *(arg.arg for arg in one.args.args), one.name]))
            known[one.name] = None


def _scope(body: Iterable[ast.stmt], known: dict[str, None]) -> None:
    """Check statements in order; what a loop defines is unknown behind it, as in Julia."""
    for one in body:
        if isinstance(one, ast.For | ast.While):
            inside = dict(known)
            _used(one.iter if isinstance(one, ast.For) else one.test, known)
            if isinstance(one, ast.For):
                inside |= dict.fromkeys(_names(one.target))
            _scope(one.body, inside)
        elif isinstance(one, ast.If):
            _used(one.test, known)
            branches = [dict(known), dict(known)]
            _scope(one.body, branches[0])
            _scope(one.orelse, branches[1])
            known |= {name: None for name in branches[0] if name in branches[1]}
        elif isinstance(one, ast.Assign):
            _used(one.value, known)
            for target in one.targets:
                if not isinstance(target, ast.Name | ast.Tuple):
                    _used(target, known)
                known |= dict.fromkeys(_names(target))
        else:
            _used(one, known)


def _targets(one: ast.Assign) -> list[str]:
    return [name for target in one.targets for name in _names(target)]


def _names(target: ast.expr) -> list[str]:
    return [one.id for one in ast.walk(target) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)]


def _used(node: ast.AST, known: Mapping[str, None]) -> None:
    for one in ast.walk(node):
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load):
            assert one.id in known, f"{one.id} is not defined"


def lists(text: str) -> str:
    """Return a text with calls of `_list` in place of lists in brackets, which an index has, too."""
    out, closing = "", []
    for letter in text:
        if letter == "[":
            closing.append(")" if not re.search(r"\w$", out) else "]")
            out += "_list(" if closing[-1] == ")" else letter
        else:
            out += closing.pop() if letter == "]" else letter
    return out


def expression(text: str) -> str:
    """Return an expression or an assignment in Python."""
    text = re.sub(r"\b[A-Za-z]\w*\b", lambda word: f"{word[0]}_word" if word[0] in PYTHON_ALONE else word[0], text)
    text = re.sub(r"(?<![\w.])(\d+\.\d+(?:e[+-]?\d+)?|\d+e[+-]?\d+)", r"Float64(\1)", text)
    text = re.sub(r"\b(\w+)!\(", r"\1_changes(", text).replace("::", ":").replace("^", "**")
    text = text.replace("&&", " and ").replace("||", " or ")
    text = lists(text)
    text = re.sub(r"!(?!=)", " not ", text)
    return re.sub(r"\bfalse\b", "False", re.sub(r"\btrue\b", "True", text)).strip()


def chosen(text: str) -> str:
    """Return an expression with conditions in Python."""
    found = re.fullmatch(r"([^?]+) \? (\(.+\)|[^:]+) : (.+)", text)
    if found is None:
        return text
    then = found[2][1:-1] if found[2].startswith("(") else found[2]
    return f"(({chosen(then)}) if ({found[1]}) else ({chosen(found[3])}))"


def translated(text: str) -> str:
    """Return a module as Python: constants, records and functions; what changes its arguments is NAME_changes."""
    out: list[str] = []
    depth = 0
    for line in statements(text):
        word, _, rest = line.strip().partition(" ")
        if word == "module" or (line == "end" and not depth):
            continue
        if word == "end":
            depth -= 1
        else:
            out.append("    " * (depth - (word == "else")) + _line(word, rest))
            depth += word in ("for", "while", "if", "function")
    return "\n".join(out) + "\n"


def _line(word: str, rest: str) -> str:
    body = f"{word} {rest}".strip()
    short = re.fullmatch(r"(\w+)\(([\w, ]+)\) = (.+)", body)
    if short:
        return f"def {short[1]}({short[2]}): return {chosen(expression(short[3]))}"
    if " && throw(" in body:
        return f"assert not ({expression(body.partition(' && ')[0])})"
    match word:
        case "const":
            return rest.replace("Float64[", "[")
        case "else":
            return "else:"
        case "for":
            index, _, places = rest.partition(" in ")
            return f"for {index} in _from_to({', '.join(map(expression, places.split(':')))}):"
        case "while" | "if":
            return f"{word} {expression(rest)}:"
        case "function":
            return f"def {expression(rest)}:"
        case _:
            return expression(body)


def loaded(text: str) -> dict[str, Any]:
    """Return the names of a module."""
    known: dict[str, Any] = defined(f"{translated(text)}\ndef _names(): return globals()\n", "_names", KNOWN)()
    return known
