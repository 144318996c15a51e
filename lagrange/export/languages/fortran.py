"""Fortran 2008: one source file with a module and its test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.descriptions import about_of, places, sizes, statement_comment
from lagrange.export.identifiers import LONGEST, distinct
from lagrange.export.languages.fortran_printer import Names, comment, listed, short, subroutine
from lagrange.export.languages.fortran_programs import test_program
from lagrange.export.languages.fortran_spelling import CONSTANTS, HELPERS, LITERALS, RESERVED
from lagrange.export.module import SourceModule
from lagrange.export.programs import compiled
from lagrange.export.target import Target
from lagrange.procedure.form import Procedure


class Fortran(Target):
    """Fortran 2008; see `Target`."""

    name = "fortran"
    about = "Fortran 2008: a module of pure subroutines in one source file, no dependencies, quantities only"
    contents = frozenset()

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the source file; the test is switched on by a macro."""
        return {f"{module.name}.F90": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the test."""
        return compiled(module, "test", "gfortran -std=f2008 -O2", f"{module.name}.F90")


def module_name(module: SourceModule) -> str:
    """Return the name of the Fortran module, which no other name of the file has."""
    taken = (*RESERVED, *CONSTANTS, *(one.name for one in module.procedures), *(name for name, _ in HELPERS.values()))
    stem = module.name[: LONGEST - len("_test")]
    return distinct([stem], taken, key=str.lower)[0]


def names_of(module: SourceModule) -> Names:
    """Return what the procedures of a module share."""
    return Names(module_name(module), {one: about_of(module, one) for one in module.public})


def source(module: SourceModule) -> str:
    """Return the source file."""
    names = names_of(module)
    printed = [subroutine(one, names) for one in module.procedures]
    lines = [
        *statement_comment(module, "!"),
        "",
        f"module {names.module}",
        "  use, intrinsic :: iso_fortran_env, only: dp => real64, int64",
        "  implicit none",
        "  private",
        *_public(module.public),
        "",
        *_constants(module),
        "",
        "contains",
        "",
        *printed,
        *(HELPERS[op][1] for op in sorted(names.needed)),
        f"end module {names.module}",
        *test_program(module, names.module),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def _public(procedures: Sequence[Procedure]) -> Iterator[str]:
    yield from listed("  public :: ", [one.name for one in procedures])


def _constants(module: SourceModule) -> Iterator[str]:
    """Yield the lengths of all arrays, the default parameters, and what has no literal."""
    yield from comment("Arrays begin at 1 where you call, whatever they do here.")
    yield from comment(places("y", module.state, "{0}({1})", 1))
    yield from comment(places("parameters", module.parameters, "{0}({1})", 1))
    yield from comment(
        "Each subroutine of t, y and p says whether a matrix is singular to round-off: out is then not to be used."
    )
    yield ""
    for name, count, about in sizes(module):
        yield f"  integer, parameter, public :: {name}_size = {count} ! {about}"
    count = len(module.values)
    values = ", ".join(map(LITERALS.real, module.values))
    given = f"[real(dp) :: {values}]" if count else "[real(dp) ::]"
    yield from short(f"  real(dp), parameter, public :: default_parameters({count}) = {given}")
    for name, value in CONSTANTS.items():
        yield f"  real(dp), parameter :: {name} = {value}"
