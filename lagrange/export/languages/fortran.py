"""Fortran 2008: one source file with a module, its test, and a run of the initial state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.descriptions import about_of, outcomes, places, records_of, sizes, statement_comment
from lagrange.export.identifiers import LONGEST, distinct
from lagrange.export.languages.fortran_printer import Names, comment, listed, record_type, short, subroutine
from lagrange.export.languages.fortran_programs import programs
from lagrange.export.languages.fortran_spelling import CONSTANTS, HELPERS, KINDS, LITERALS, RESERVED
from lagrange.export.module import SourceModule
from lagrange.export.programs import compiled
from lagrange.export.target import Target
from lagrange.procedure.form import Kind, Procedure, Record


class Fortran(Target):
    """Fortran 2008; see `Target`."""

    name = "fortran"
    about = "Fortran 2008: a module of pure subroutines in one source file, no dependencies"

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the source file; the test and the run are switched on by macros."""
        return {f"{module.name}.F90": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the test."""
        return compiled(module, "test", COMPILER, f"{module.name}.F90")

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the integration of the initial state."""
        return compiled(module, "main", COMPILER, f"{module.name}.F90")


COMPILER = "gfortran -std=f2008 -O2"


def module_name(module: SourceModule) -> str:
    """Return the name of the Fortran module, which no other name of the file has."""
    taken = (*RESERVED, *CONSTANTS, *(one.name for one in module.procedures), *(name for name, _ in HELPERS.values()))
    ending = ("_test", "_main")
    stem = module.name[: LONGEST - max(map(len, ending))]
    return distinct([stem], taken, key=str.lower)[0]


def names_of(module: SourceModule) -> Names:
    """Return what the procedures of a module share."""
    results = {one.procedure: "singular" for one in module.quantities}
    results |= {one.procedure: "outcome" for one in module.integrators}
    abouts = {one: about_of(module, one) for one in module.public}
    return Names(module_name(module), {module.prepare: "singular", **results}, abouts)


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
        *(line for record in records_of(module.procedures) for line in _type(record)),
        "contains",
        "",
        *printed,
        *(HELPERS[op][1] for op in sorted(names.needed)),
        f"end module {names.module}",
        *programs(module, names.module),
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
    if module.integrators:
        yield from comment(outcomes())
    yield ""
    for name, count, about in sizes(module):
        yield f"  integer, parameter, public :: {name}_size = {count} ! {about}"
    count = len(module.values)
    values = ", ".join(map(LITERALS.real, module.values))
    given = f"[real(dp) :: {values}]" if count else "[real(dp) ::]"
    yield from short(f"  real(dp), parameter, public :: default_parameters({count}) = {given}")
    for name, value in CONSTANTS.items():
        yield f"  real(dp), parameter :: {name} = {value}"


def _type(record: Record) -> Iterator[str]:
    """Yield the type of a record of zeros."""
    zeros = {Kind.REAL: "0.0_dp", Kind.WHOLE: "0_int64", Kind.FLAG: ".false."}
    yield f"  type :: {record_type(record)}"
    for name, kind in record.fields:
        yield f"    {KINDS[kind]} :: {name} = {zeros[kind]}"
    yield f"  end type {record_type(record)}"
    yield ""
