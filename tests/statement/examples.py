"""Texts, scene files and systems with inputs for the tests of statements."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sympy import cos, sin

import lagrange as lg

FIELDS: dict[str, Any] = {
    "name": "pendulum",
    "coordinates": ["theta"],
    "kinetic": "m*l**2*theta_dot**2/2",
    "potential": "-m*g*l*cos(theta)",
    "forces": {"theta": "-c*theta_dot"},
    "parameters": {"m": 1.0, "l": 1.0, "g": 9.81, "c": 0.1},
    "initial": {"theta": 2.0},
    "positions": {"bob": ["l*sin(theta)", "-l*cos(theta)"]},
    "links": [["origin", "bob"]],
    "run": {"t_end": 10.0},
}

LEAN: dict[str, Any] = {"coordinates": ["theta"], "kinetic": "theta_dot**2/2"}
"""The least that a scene may hold."""

DROP = object()
"""As a value: leave the field out."""


def toml(value: Any) -> str:
    """Return a value as TOML. A text becomes a basic string with escaped special characters."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in value) + '"'
    return json.dumps(value)


def write(folder: Path, base: Mapping[str, Any] = FIELDS, **fields: Any) -> Path:
    """Write a scene with one line for each field, and return its path."""
    path = folder / "scene.toml"
    lines = [f"{key} = {toml(value)}" for key, value in {**base, **fields}.items() if value is not DROP]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


# --- texts that must not become expressions: code, escapes, huge expressions, look-alike characters, nonsense ---
# CANARY is replaced by the path of a file that must not be created.


CANARY = "CANARY"

CODE = [
    *("__import__('os').system('touch CANARY')", '__import__("os").system("touch CANARY")'),
    *("__import__('pathlib').Path('CANARY').touch()", "__import__", "__import__('os')", "__builtins__"),
    *("__builtins__['open']('CANARY', 'w')", "__name__", "__file__", "__doc__", "__debug__"),
    *('eval(\'open("CANARY", "w")\')', 'exec(\'open("CANARY", "w")\')', "eval(1)", "exec(1)", "compile(1, 2, 3)"),
    *("os.system('touch CANARY')", "subprocess.run(['touch', 'CANARY'])", "sys.exit()", "import os"),
    *("1)\n__import__('os').system('touch CANARY')\n(1", "1) + __import__('os').getpid() + (1", "del x", "pass"),
    *("with open('CANARY', 'w') as f: pass", "try: pass", "def f(): pass", "class A: pass", "@sin"),
]

OBJECTS = [
    *("().__class__", "().__class__.__bases__[0].__subclasses__()", "''.__class__.__mro__", "x.__class__", "x.func"),
    *("x.diff", "x.dot", "x._sympy_", "cos.eval.__func__.__globals__['__builtins__']['open']('CANARY', 'w')"),
    *("{1}", "{1: 2}", "{'a': 1}['a']", "lambda: 1", "(lambda x: x)(1)", "lambda x: x"),
    *("(lambda: open('CANARY', 'w'))()", "[x for x in (1, 2)]", "{x for x in (1, 2)}", "{x: x for x in (1, 2)}"),
]

TEXTS = [
    *("'1'", '"1"', "'''1'''", "f'{x}'", 'f"{open(1)}"', 'f\'{__import__("os").system("touch CANARY")}\'', "r'x'"),
    *("\\", "\\x31", "$x", "x?", "x!", "?", ";", "1;", ":", "@"),
]

SYMPY = [
    *("Symbol('x')", "symbols('x y')", "Function('f')(1)", "sympify('1')", "parse_expr('1')", "S('1')", "S(1)"),
    *("Infinity", "I", "1*I", "Matrix([1])", "Piecewise((1, True))", "DiracDelta(1)", "gamma(5)", "factorial(5)"),
    *("arg(1)", "simplify(1)", "solve(1)", "init_printing()"),
]

BOMBS = [
    *("9**9**9", "9**9**9**9", "9**(9**9)", "(9**9)**9**9", "2**10**10", "2**(10**10)", "10**1000000"),
    *("1e308*10", "1e308**2", "1e200*1e200", "1e-200*1e-200", "-1e308 - 1e308", "1e999", "-1e999", "1e-999"),
    *("exp(exp(exp(9)))", "exp(exp(exp(exp(9))))", "exp(-10**9)", "exp(10**9*log(2))", "cosh(10**9)"),
    *("max(exp(exp(exp(9))), 1)", "abs(exp(exp(exp(9))))", "sinh(sinh(sinh(9)))", "tan(pi/2)", "1/0", "1/0.0"),
    *("(-1)**0.5", "(-8)**(1/3)", "log(-1)", "asin(2)", "acos(-2)", "(" * 1000 + "1" + ")" * 1000),
    *("(" * 65 + "1" + ")" * 65, "-" * 100 + "1", "-" * 9999 + "1", "- " * 4000 + "1", "1+" * 100000 + "1"),
    *("-" * 100000 + "1", "2**" * 100 + "1", "1**-" * 100 + "1", "sin(" * 70 + "1" + ")" * 70),
    *("1 if 1 < 2 else " * 100 + "1", "(1 if 1 < 2 else " * 70 + "1" + ")" * 70, "1" + " " * 10000, "x" * 20000),
    *("max(" + "1," * 99 + "1)", "+".join(f"1/{10**60 + i}" for i in range(150))),
    "*".join(f"({10**60 + i}/{10**60 - i})" for i in range(1, 70)),
]

NONSENSE = [
    *("True", "False", "None", "1j", "1J", "1.5j", "1e3j", "0j", "1_000", "0x10", "0b1", "0o7", "007", "1e", "1e+"),
    *("1.2.3", "1,5", "1 2", "1(2)", "(1)(2)", "(1)2", "2pi", "2 pi", "pi(2)", "pi pi", "2sin(1)", "1 if 1"),
    *("", " ", "\t", "\n", "+", "-", "*", "**", "1 +", "1 + * 2", "* 1", "/ 2", "1 ** ** 2", "(", ")", "(1", "1)"),
    *("((1)", ")(", "sin", "sin()", "sin(1, 2)", "sin(,)", "sin(1,)", "sin 1", "sin(sin)", "sin(*(1, 2))"),
]

# Cyrillic letters, letters and digits of full width (NFKC makes them plain), signs that look like ours, controls.
LOOK_ALIKES = [
    *("ѕin(1)", "сos(1)", "ｓｉｎ(1)", "ｐｉ", "𝐩𝐢", "𝓮𝓿𝓪𝓵(1)", "ℯ", "π", "θ"),
    *("1–2", "1×2", "1·2", "1÷2", "1∗2", "1⁄2", "√2", "∞", "1\u00a0+ 1", "1\u200b", "\ufeff1", "1\u202e+1"),
    *("_", "_x", "__", "__x__", "_1", "𝟏", "Ⅳ", "ª", "x̂", "💥"),
]

ATTACKS = [*CODE, *OBJECTS, *TEXTS, *SYMPY, *BOMBS, *NONSENSE, *LOOK_ALIKES]


# --- A pendulum with open inputs, the pivot X and the torque u, and the same with values -----------------------


X, u = lg.given("X"), lg.given("u")
theta = lg.coordinate("theta")
m, g, length = lg.parameters("m g l")

VALUES = {X: sin(3 * lg.t) / 5 + lg.t**2, u: -2 + cos(lg.t)}
BOB: Any = (X + length * sin(theta), -length * cos(theta))


def driven() -> lg.System:
    """Return the pendulum with its inputs left open."""
    return lg.System(
        lg.kinetic_energy(m, BOB),
        lg.gravity(m, BOB, g),
        forces={theta: u - theta.dot / 10},
        parameters={m: 1.5, g: 9.81, length: 2},
        initial={theta: 1},
        positions={"bob": BOB},
        name="driven",
    )


def at(t: float) -> dict[str, float]:
    """Return the values of the inputs and their rates at a time."""
    pivot: Any = VALUES[X]
    names = ("X", "X_dot", "X_ddot")
    result = {name: float(pivot.diff(lg.t, order).subs(lg.t, t)) for order, name in enumerate(names)}
    return {**result, "u": float(VALUES[u].subs(lg.t, t))}
