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
    *("open('CANARY', 'w')", "open('CANARY', 'w').close()", "open(1)", "input()", "print(1)", "breakpoint()"),
    *("help()", "quit()", "exit(1)", "globals()", "locals()", "vars()", "dir()", "getattr(1, 2)", "setattr(1, 2, 3)"),
    *("delattr(1, 2)", "type(1)", "type('X', (), {})", "object()", "super()", "memoryview(1)"),
    *("os.system('touch CANARY')", "subprocess.run(['touch', 'CANARY'])", "sys.exit()", "import os"),
    *("from os import system", "import os; os.system('touch CANARY')", "1; import os", "1\nimport os"),
    *("1)\n__import__('os').system('touch CANARY')\n(1", "1) + __import__('os').getpid() + (1", "del x", "pass"),
    *("return 1", "raise ValueError", "assert 1", "global x", "while True: pass", "for x in y: pass"),
    *("with open('CANARY', 'w') as f: pass", "try: pass", "def f(): pass", "class A: pass", "@sin"),
]

OBJECTS = [
    *("().__class__", "().__class__.__bases__[0].__subclasses__()", "''.__class__.__mro__", "x.__class__", "x.func"),
    *("x.diff", "x.dot", "x._sympy_", "cos.eval.__func__.__globals__['__builtins__']['open']('CANARY', 'w')"),
    *("sin.__class__", "sin.__init__.__globals__", "(1).__class__", "1 .real", "1..real", "1.5.hex()", "(x).y"),
    *("pi.evalf", "pi.__reduce__", "x[0]", "x[0:1]", "x[:, 1]", "[1]", "[1, 2][0]", "(1, 2)", "()", "1,", "{}"),
    *("{1}", "{1: 2}", "{'a': 1}['a']", "lambda: 1", "(lambda x: x)(1)", "lambda x: x"),
    *("(lambda: open('CANARY', 'w'))()", "[x for x in (1, 2)]", "{x for x in (1, 2)}", "{x: x for x in (1, 2)}"),
    *("(x for x in (1, 2))", "sum(x for x in (1, 2))", "max(x for x in (1, 2))", "(x := 1)", "x := 1", "x = 1"),
    *("x == 1", "x += 1", "await x", "yield x", "(yield)", "async x", "...", "Ellipsis", "NotImplemented"),
]

TEXTS = [
    *("'1'", '"1"', "'''1'''", "f'{x}'", 'f"{open(1)}"', 'f\'{__import__("os").system("touch CANARY")}\'', "r'x'"),
    *("b'x'", "u'x'", "rb'x'", "'a' 'b'", "'%s' % x", "`x`", "#", "1 # comment", "# coding: utf-7", "1 \\\n + 1"),
    *("\\", "\\x31", "$x", "x?", "x!", "?", ";", "1;", ":", "@"),
]

SYMPY = [
    *("Symbol('x')", "symbols('x y')", "Function('f')(1)", "sympify('1')", "parse_expr('1')", "S('1')", "S(1)"),
    *("Integer(1)", "Float('1')", "Rational(1, 2)", "Lambda(1, 2)", "lambdify(1, 2)", "Derivative(1, 2)"),
    *("Integral(1, 2)", "Sum(1, 2)", "Subs(1, 2, 3)", "N(1)", "E_", "zoo", "oo", "-oo", "nan", "inf", "NaN"),
    *("Infinity", "I", "1*I", "Matrix([1])", "Piecewise((1, True))", "DiracDelta(1)", "gamma(5)", "factorial(5)"),
    *("factorial2(99)", "binomial(9, 3)", "fibonacci(10**9)", "prime(10**9)", "zeta(3)", "erfc(1)", "re(1)"),
    *("arg(1)", "simplify(1)", "solve(1)", "init_printing()"),
]

BOMBS = [
    *("9**9**9", "9**9**9**9", "9**(9**9)", "(9**9)**9**9", "2**10**10", "2**(10**10)", "10**1000000"),
    *("10**-1000000", "(2**1000)**1000", "((2**100)**100)**100", "(1/2)**100000", "7**7**7**7", "2**2**2**2**2**2"),
    *("1e308*10", "1e308**2", "1e200*1e200", "1e-200*1e-200", "-1e308 - 1e308", "1e999", "-1e999", "1e-999"),
    *("1e99999999999", "9" * 200, "9" * 5000, "0." + "1" * 200, "9!", "9!!", "99999!", "exp(1000)"),
    *("exp(exp(exp(9)))", "exp(exp(exp(exp(9))))", "exp(-10**9)", "exp(10**9*log(2))", "cosh(10**9)"),
    *("max(exp(exp(exp(9))), 1)", "abs(exp(exp(exp(9))))", "sinh(sinh(sinh(9)))", "tan(pi/2)", "1/0", "1/0.0"),
    *("1/(1 - 1)", "0**-1", "0/0", "0.0/0", "1/sin(pi)", "log(0)", "log(1 - 1)", "atan2(0, 0)/0", "sqrt(-1)"),
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
    *("1 if 1 else 2", "1 if pi else 2", "1 else 2", "if 1 < 2 else 3", "1 < 2", "1 < 2 < 3", "(1 < 2)*3"),
    *("1 if (1 < 2) < 3 else 4", "not 1", "1 and 2", "1 or 2", "1 in 2", "1 is 1", "1 not in 2", "1 <> 2", "1 =< 2"),
    *("1 => 2", "1 === 2", "1 // 2", "1 % 2", "1 ^ 2", "1 & 2", "1 | 2", "~1", "1 << 2", "1 >> 2", "1 @ 2", "1 -> 2"),
    *("", " ", "\t", "\n", "+", "-", "*", "**", "1 +", "1 + * 2", "* 1", "/ 2", "1 ** ** 2", "(", ")", "(1", "1)"),
    *("((1)", ")(", "sin", "sin()", "sin(1, 2)", "sin(,)", "sin(1,)", "sin 1", "sin(sin)", "sin(*(1, 2))"),
    *("sin(**{})", "sin(x=1)", "sin(arg=1)", "sin(1)(2)", "sin(1, evaluate=0)", "atan2(1)", "atan2(1, 2, 3)"),
    *("max()", "Sin(1)", "sine(1)", "arcsin(1)", "log10(1)", "pow(1, 2)", "round(1)", "int(1)", "float('nan')"),
    *("float(1)", "complex(1)", "str(1)"),
]

# Cyrillic letters, letters and digits of full width (NFKC makes them plain), signs that look like ours, controls.
LOOK_ALIKES = [
    *("ѕin(1)", "сos(1)", "ｓｉｎ(1)", "ｐｉ", "𝐩𝐢", "𝓮𝓿𝓪𝓵(1)", "ℯ", "π", "θ"),
    *("μ", "é", "1²", "１", "１+１", "٣", "1−2"),
    *("1–2", "1×2", "1·2", "1÷2", "1∗2", "1⁄2", "√2", "∞", "1\u00a0+ 1", "1\u200b", "\ufeff1", "1\u202e+1"),
    *("1\u2028+1", "1\u3000+ 1", "1\x00", "\x00", "1\x00+1", "1\x0b+ 1", "1\x0c+ 1", "1\x1b[31m", "1\x7f", "1\x85+1"),
    *("_", "_x", "__", "__x__", "_1", "𝟏", "Ⅳ", "ª", "x̂", "💥"),
]

ATTACKS = [*CODE, *OBJECTS, *TEXTS, *SYMPY, *BOMBS, *NONSENSE, *LOOK_ALIKES]
