"""The form in plain symbols: names, numbers, printers, matrices whose pivots are zero."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from lagrange.errors import StatementError
from lagrange.program.program import Instruction, Program, ProgramBlock
from lagrange.recipes.sympy import _Writer, number
from lagrange.statement.coordinate import t
from tests.models import build, m, model, theta, x, y, z
from tests.recipes.agreement import apart, named, states


def test_symbols_are_plain_and_named_as_the_state() -> None:
    form = model("pendulum", "numpy").as_sympy()
    assert [symbol.name for symbol in form.arguments] == ["t", "theta", "theta_dot", "m", "g", "l"]
    for expression in (*form.results, *(one for _, one in form.replacements)):
        assert not expression.atoms(sp.Function("theta"), sp.Derivative) and not expression.has(t, theta)
    (g, l), (q,) = form.p[1:], form.q
    assert [sp.simplify(one) for one in form.expanded()] == [form.v[0], -g * sp.sin(q) / l]


def test_names_of_the_user_are_not_taken_again() -> None:
    first = sp.Symbol("x0", real=True)
    form = build("numpy", kinetic=x.dot**2 * sp.cos(x) ** 2, potential=first * sp.cos(x) ** 2).as_sympy()
    names = [symbol.name for symbol in (*form.arguments, *(symbol for symbol, _ in form.replacements))]
    assert len(dict.fromkeys(names)) == len(names) and "x0" in names and "x1" in names


@pytest.mark.parametrize("value", [0.1, -1e-320, 1e300, 1 / 3, 2.0, 0.25, -0.375, 2.0**60, math.pi])
def test_numbers_are_exact_and_short_where_they_can_be(value: float) -> None:
    assert float(number(value)) == value
    assert number(value).is_Rational or float(sp.ccode(number(value))) == float(str(number(value))) == value
    assert number(value).is_Rational == (value in (2.0, 0.25, -0.375))


def test_numbers_without_a_value() -> None:
    assert number(math.inf) is sp.oo and number(-math.inf) == -sp.oo and number(math.nan) is sp.nan


PRINTERS = [sp.ccode, sp.fcode, sp.pycode, sp.octave_code, sp.julia_code, sp.jscode, sp.rust_code, sp.cxxcode, sp.latex]


@pytest.mark.parametrize("printer", PRINTERS, ids=lambda printer: printer.__name__)
def test_every_printer_takes_every_expression(printer: object) -> None:
    assert callable(printer)
    for name in ("double-pendulum", "cartesian-pendulum"):
        form = named(name).as_sympy()
        for expression in (*form.results, *(one for _, one in form.replacements)):
            text = str(printer(expression))
            assert text and "Not supported" not in text and "Derivative" not in text


def test_the_c_that_sympy_prints_is_right(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("cc is not installed")
    of = model("cart and pole", "numpy")
    form = of.as_sympy()
    given = [f"double {form.t}", *(f"double {symbol}" for symbol in (*form.q, *form.v, *form.p)), "double *out"]
    lines = [f"const double {symbol} = {sp.ccode(expression)};" for symbol, expression in form.replacements]
    lines += [f"out[{i}] = {sp.ccode(expression)};" for i, expression in enumerate(form.results)]
    text = "\n".join(["#include <math.h>", f"void rhs({', '.join(given)})", "{", *lines, "}", ""])
    (tmp_path / "rhs.c").write_text(text, encoding="utf-8")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", "rhs.so", "rhs.c", "-lm"], cwd=tmp_path, check=True)
    rhs = ctypes.CDLL(str(tmp_path / "rhs.so")).rhs
    for time, state in states(of):
        out = np.empty(4)
        rhs(*map(ctypes.c_double, (time, *state, *of.parameter_array())), ctypes.c_void_p(out.ctypes.data))
        assert apart(of, "rhs", time, state, out) <= 1


def test_rows_are_exchanged_where_a_pivot_is_known_to_be_zero() -> None:
    form = model("saddle", "numpy").as_sympy()
    assert all(one.is_finite is not False for one in form.expanded())
    speeds = x.dot * y.dot + 2 * y.dot * z.dot + 3 * z.dot * x.dot + 2 * y.dot**2 + 5 * z.dot**2
    of = build("numpy", lagrangian=speeds - x**2 - sp.cos(y) * z - z**2 * x, coordinates=[x, y, z])
    form = of.as_sympy()
    rhs = sp.lambdify(form.arguments, form.results, modules="math", cse=form.common)
    for time, state in states(of):
        assert apart(of, "rhs", time, state, rhs(time, *state)) <= 1


def test_a_matrix_without_pivots_is_refused() -> None:
    code = [Instruction("constant", value=0.0), Instruction("state"), Instruction("factor", (0, 0, 0), order=2)]
    code += [Instruction("solve", (2, 1, 1), order=2), Instruction("component", (3,))]
    block = (ProgramBlock("y", 1),)
    program = Program("f", block, 0, tuple(code), 0, (4,), (ProgramBlock("value", 1),), (1,))
    with pytest.raises(StatementError, match="the mass matrix is singular at every state"):
        _Writer(program, t, [m], [], iter([y])).results()
