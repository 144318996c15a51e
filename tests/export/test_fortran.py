"""What Fortran has that other languages do not: lines of 132 characters, names without case, arrays that are moved."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from tests.export.callers import LANGUAGES, Call, called, run, write
from tests.export.graphs import STATES, as_module, graph

needs_gfortran = pytest.mark.skipif(shutil.which("gfortran") is None, reason="gfortran is not installed")

ENERGY = """\
  pure subroutine energy(t, y, p, out, singular)
    ! The energy v.p - L, which is T + V where T is quadratic in the velocities. out: energy.
    real(dp), intent(in) :: t
    real(dp), intent(in) :: y(0:*)
    real(dp), intent(in) :: p(0:*)
    real(dp), intent(inout) :: out(0:*)
    logical, intent(out) :: singular
    real(dp) :: m, theta, theta_dot, x14
    associate (unused => t)
    end associate
    m = p(0)
    theta = y(0)
    theta_dot = y(1)
    x14 = p(3) * (theta_dot * theta_dot)
    out(0) = m * (x14 - (p(4) * cos(theta) + 0.5_dp * x14))
    singular = .false.
  end subroutine energy
"""


def test_the_text_of_the_pendulum(tmp_path: Path) -> None:
    (file,) = lg.scene("pendulum").export("fortran", tmp_path, ["rhs"]).files
    text = file.read_text()
    assert file.name == "pendulum.F90"
    assert text.startswith("! pendulum: equations of motion, made by lagrange\n! A plane pendulum, ")
    assert "  public :: prepare, rhs\n" in text
    assert "  ! y(1) theta, y(2) theta_dot\n" in text
    assert max(map(len, text.splitlines())) <= 132
    lg.scene("pendulum").export("fortran", tmp_path, ["energy"])
    assert f"\n{ENERGY}\n" in file.read_text()


def large() -> Procedure:
    """Return a procedure with a local array of 80 kB, and parts of arrays that begin at places computed before."""
    p = Builder("large", "A sum of squares, backwards.")
    p.given("t", REAL)
    y, _, out = p.array("y", size=STATES, read=True), p.array("p", size=1, read=True), p.array("out", size=1)
    work = p.reserve(10_000, name="work")
    with p.loop(0, 100) as i:
        part = p.part(p.part(work, i * 90), i * 10)
        with p.loop(0, 100) as j:
            part[j] = p.real(i) * y[0] + p.real(j)
    total = p.variable(p.real(0.0), "total")
    with p.loop(0, 100) as i:
        part = p.part(work, i * 99 + 1)
        total.value = total.value + part[99 - i] * y[1]
    out[0] = total.value
    p.leave(p.false)
    return p.finish(FLAG)


@needs_gfortran
def test_large_local_arrays_are_no_static_ones(tmp_path: Path) -> None:
    file = write("fortran", as_module([graph(0)], [large()]), tmp_path)
    text = file.with_suffix(".F90").read_text()
    assert "  pure recursive subroutine large(" in text
    assert "  pure subroutine graph_0(" in text
    for command in LANGUAGES["fortran"].strict:
        run(command.format(module=file.stem), tmp_path)
    _, found = called("fortran", file, [Call("large", 0.0, [0.5, 2.0, 0.0, 0.0], 1)])
    flat = [0.5 * i + j for i in range(100) for j in range(100)]
    assert found.values == [sum(flat[i * 99 + 1 + 99 - i] * 2.0 for i in range(100))]
