"""What is behind the module of a Fortran file: a program that tests it, and one that runs the initial state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.export.descriptions import TEST, columns, integrator_of, outcome_texts
from lagrange.export.languages.fortran_printer import comment, short
from lagrange.export.languages.fortran_spelling import LITERALS
from lagrange.export.module import Check, SourceModule, StepCheck
from lagrange.export.programs import arguments_in_test, macro, main_fields, tested

CHUNK = 120
"""Numbers of a table in one statement, of which a compiler need not take more than 256 lines."""

ENVIRONMENT = "use, intrinsic :: iso_fortran_env, only: dp => real64, int64"


def programs(module: SourceModule, name: str) -> Iterator[str]:
    """Yield both programs, each under a macro."""
    yield from _test(module, name)
    yield from _run(module, name)


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


def _test(module: SourceModule, name: str) -> Iterator[str]:
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
    for step in module.step_checks:
        yield from _integrator_test(module, step)
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


def _integrator_test(module: SourceModule, check: StepCheck) -> Iterator[str]:
    """Yield the test of an integrator."""
    count, adaptive = len(check.state), integrator_of(module, check.name).adaptive
    yield f"  subroutine test_{check.name}()"
    yield f"    real(dp) :: y({count}), wanted({count}), allowed({count}){', t(1)' * adaptive}"
    yield "    integer(int64) :: outcome"
    for array, row in (("y", check.state), ("wanted", check.result), ("allowed", check.allowed)):
        yield from _table(array, [row])
    if adaptive:
        yield f"    t = {LITERALS.real(check.time)}"
    yield from short(f"    call {check.name}({arguments_in_test(module, check, LITERALS, 't')}, outcome)")
    yield "    if (outcome /= 0_int64) then"
    yield f"      call missing('{check.name}: it did not come to the end', {count})"
    yield "    else"
    yield f"      call compare('{check.name}', 1, y, wanted, allowed)"
    yield "    end if"
    yield f"  end subroutine test_{check.name}"
    yield ""


MAIN = """\
program {name}_main
  use, intrinsic :: iso_fortran_env, only: dp => real64, int64, error_unit
  use {name}
  implicit none
  character(64) :: word
  character(60), parameter :: outcomes(0:{last}) = [character(60) :: &
{outcomes}]
  real(dp) :: p(prepared_size), y(state_size), t(1), t_end, next
  integer(int64) :: k, intervals, outcome
  integer :: unread
  logical :: no_values
{initial}
  t = 0.0_dp
  t_end = {t_end}
  intervals = {intervals}
  unread = 0
  if (command_argument_count() > 0) then
    call get_command_argument(1, word)
    read (word, *, iostat=unread) t_end
  end if
  if (command_argument_count() > 1 .and. unread == 0) then
    call get_command_argument(2, word)
    read (word, *, iostat=unread) intervals
  end if
  if (unread /= 0 .or. intervals < 1_int64) then
    write (error_unit, '(a)') 't_end: a number; intervals: a whole number from 1'
    stop 2
  end if
  call prepare(default_parameters, p, no_values)
  if (no_values) then
    write (error_unit, '(a)') 'prepare: a matrix is singular'
    stop 1
  end if
{columns}
  do k = 0_int64, intervals
    next = t_end
    if (k < intervals) next = t_end * real(k, dp) / real(intervals, dp)
    call {method}(t, next, y, p, {rtol}, {rtol}, {steps}, outcome)
    if (outcome /= 0_int64) then
      write (error_unit, '(a, g0.17, 2a)') 'the run stopped at t = ', t(1), ': ', trim(outcomes(outcome))
      stop 1
    end if
    write (*, '(g0.17, *(:, ",", g0.17))') t, y
  end do
end program {name}_main
#endif"""


def _run(module: SourceModule, name: str) -> Iterator[str]:
    """Yield a program that integrates the initial state and writes a table."""
    fields = main_fields(module, LITERALS)
    if fields is None or module.run is None:
        return
    texts = outcome_texts("'")
    heads = columns(module).split(",")
    shown = [f"  write (*, '(a)', advance='no') '{one}{',' * (k < len(heads) - 1)}'" for k, one in enumerate(heads)]
    yield ""
    yield f"#ifdef {macro(module, 'main')}"
    yield from comment(
        f"Integrate the initial state and write a table with commas: {name}_main [t_end [intervals]].", ""
    )
    yield MAIN.format(
        **{
            **fields,
            "initial": "\n".join(line[2:] for line in _table("y", [module.run.initial])),
            "outcomes": ", &\n".join(f"    {text}" for text in texts),
        },
        last=len(texts) - 1,
        name=name,
        columns="\n".join([*shown, "  write (*, '()')"]),
    )
