"""Texts that must not become expressions: code, escapes, huge expressions, look-alike characters, nonsense.

CANARY is replaced by the path of a file that must not be created.
"""

from __future__ import annotations

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
