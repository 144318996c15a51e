"""The program of a Fortran file that tests its module, under a macro."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.export.descriptions import TEST
from lagrange.export.languages.fortran_printer import comment, short
from lagrange.export.languages.fortran_spelling import LITERALS
from lagrange.export.module import Check, SourceModule
from lagrange.export.programs import macro, tested

CHUNK = 120
"""Numbers of a table in one statement, of which a compiler need not take more than 256 lines."""

ENVIRONMENT = "use, intrinsic :: iso_fortran_env, only: dp => real64, int64"


def _table(name: str, rows: Sequence[Sequence[float]]) -> Iterator[str]:
    """Yield the assignment of a table of numbers, one behind the other."""
    values = [LITERALS.real(value) for row in rows for value in row]
    for k in range(0, len(values), CHUNK):
        part = values[k : k + CHUNK]
        yield from short(f"    {name}({k + 1}:{k + len(part)}) = [{', '.join(part)}]")


COMPARE = """\
  subroutine compare(name, state, found, wanted, allowed)
    character(*), intent(in) :: name
    integer, intent(in) :: state
    real(dp), intent(in) :: found(:), wanted(:), allowed(:)
    integer :: i
    do i = 1, size(found)
      checked = checked + 1
      if (.not. abs(found(i) - wanted(i)) <= allowed(i)) then
        failures = failures + 1
        write (*, '(2a, i0, a, i0, a, es25.16e3, a, es25.16e3)') &
          name, ', state ', state, ', result ', i, ': ', found(i), ' instead of ', wanted(i)
      end if
    end do
  end subroutine compare

  subroutine missing(name, count)
    character(*), intent(in) :: name
    integer, intent(in) :: count
    write (*, '(a)') name
    checked = checked + count
    failures = failures + count
  end subroutine missing
"""


def test_program(module: SourceModule, name: str) -> Iterator[str]:
    """Yield the test: a program that compares results with those of multiple precision."""
    yield ""
    yield f"#ifdef {macro(module, 'test')}"
    yield from comment(f"{TEST} Exit status 0 if all are right.", "")
    yield f"program {name}_test"
    yield f"  {ENVIRONMENT}"
    yield f"  use {name}"
    yield "  implicit none"
    yield "  real(dp) :: p(prepared_size)"
    yield "  integer :: failures = 0, checked = 0"
    yield "  logical :: no_values"
    yield "  call prepare(default_parameters, p, no_values)"
    yield "  if (no_values) call missing('prepare: a matrix is singular', 1)"
    yield from (f"  call test_{one}()" for one in tested(module))
    text = f"'{name}: ', checked - failures, ' of ', checked, ' results are right'"
    yield "  write (*, '(a, i0, a, i0, a)') &"
    yield f"    {text}"
    yield "  if (failures > 0) stop 1"
    yield ""
    yield "contains"
    yield ""
    yield COMPARE
    for check in module.checks:
        yield from _quantity_test(module, check)
    yield f"end program {name}_test"
    yield "#endif"


def _quantity_test(module: SourceModule, check: Check) -> Iterator[str]:
    """Yield the test of one subroutine."""
    count, states, size = len(check.results[0]), len(check.times), len(module.state)
    yield f"  subroutine test_{check.name}()"
    yield f"    real(dp), save :: times({states}), states({states * size})"
    yield f"    real(dp), save :: wanted({states * count}), allowed({states * count}), out({count})"
    yield "    logical :: singular"
    yield "    integer :: k"
    yield from _table("times", [check.times])
    for name, table in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from _table(name, table)
    yield f"    do k = 0, {states - 1}"
    yield f"      call {check.name}(times(k + 1), states({size} * k + 1), p, out, singular)"
    yield "      if (singular) then"
    yield f"        call missing('{check.name}: a matrix is singular', {count})"
    yield "      else"
    rows = f"wanted({count} * k + 1:{count} * (k + 1)), allowed({count} * k + 1:{count} * (k + 1))"
    yield from short(f"        call compare('{check.name}', k + 1, out, {rows})")
    yield "      end if"
    yield "    end do"
    yield f"  end subroutine test_{check.name}"
    yield ""
