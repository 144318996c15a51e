"""The address of a kernel, called from C: the code on the page compiles without warnings and runs."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.models import model
from tests.recipes.agreement import singular

PAGE = Path(__file__).resolve().parents[2] / "docs" / "other-solvers.md"
LAW = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


def test_the_integrator_on_the_page(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("cc is not installed")
    (text,) = re.findall(r"^```c\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "heun.c").write_text(text, encoding="utf-8")
    warnings = ["-Wall", "-Wextra", "-Werror"]
    # Without contraction into multiply-adds the digits are those of NumPy, on any processor.
    given = [*warnings, "-ffp-contract=off", "-shared", "-fPIC", "-o", "heun.so", "heun.c"]
    subprocess.run([compiler, *given], cwd=tmp_path, check=True)
    heun = ctypes.CDLL(str(tmp_path / "heun.so")).heun
    for of, status in ((model("double pendulum"), 0), (singular(2, "llvm"), 1)):
        kernel: Any = of.kernel("rhs")
        p, h = of.parameter_array(), 1e-3
        start = np.array([0.0, 0.0, 1.0, 1.0]) if status else np.array(of.statement.initial)
        y, work = start.copy(), np.empty(12)
        prepared = kernel.prepare(p)
        law = LAW(kernel.address)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (prepared, y, work)]
        sizes = [ctypes.c_double(h), ctypes.c_int64(50), ctypes.c_int64(4)]
        assert heun(law, pointers[0], *sizes, *pointers[1:]) == status
        if status:
            continue
        expected = start
        for k in range(50):
            first = of.rhs(k * h, expected)
            expected = expected + h / 2 * (first + of.rhs((k + 1) * h, expected + h * first))
        np.testing.assert_allclose(y, expected, rtol=1e-14)
