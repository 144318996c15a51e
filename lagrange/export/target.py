"""The languages to which `system.export` writes: their names, aliases and base class; register your own here.

The module of a target, in the folder `languages`, is loaded at its first use.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, ClassVar

from lagrange.errors import StatementError, UnknownKey, listing, shown
from lagrange.export.module import SourceModule, distinct
from lagrange.show.notebook.html_card import table
from lagrange.statement.display import text_table
from lagrange.statement.expression import one_of

TARGETS: Mapping[str, str] = {
    "c": "lagrange.export.languages.c",
    "fortran": "lagrange.export.languages.fortran",
    "julia": "lagrange.export.languages.julia",
    "octave": "lagrange.export.languages.octave",
    "javascript": "lagrange.export.languages.javascript",
    "rust": "lagrange.export.languages.rust",
    "python": "lagrange.export.languages.python",
    "jax": "lagrange.export.languages.jax",
    "casadi": "lagrange.export.languages.casadi",
    "modelica": "lagrange.export.languages.modelica",
    "fmu": "lagrange.export.languages.fmu",
}
"""Module of each target by the name of the target; a module is loaded at its first use."""

ALIASES: Mapping[str, str] = {
    **dict.fromkeys(("c99", "ansi-c", "cpp", "c++", "cxx"), "c"),
    **dict.fromkeys(("js", "node", "es", "esm"), "javascript"),
    **dict.fromkeys(("rs",), "rust"),
    **dict.fromkeys(("numpy", "py"), "python"),
    **dict.fromkeys(("f90", "f08", "fortran2008"), "fortran"),
    **dict.fromkeys(("jl",), "julia"),
    **dict.fromkeys(("matlab", "m"), "octave"),
    **dict.fromkeys(("fmi", "fmi2", "fmi3"), "fmu"),
}
"""Name of a target by its alias."""


def load(name: str) -> ModuleType:
    """Import and return the module of the target `name`, a key of `TARGETS`."""
    return import_module(TARGETS[name])


QUANTITIES = (
    *("rhs", "accelerations", "energy", "energies", "jacobian", "mass_matrix", "momenta", "multipliers", "positions"),
    "events",
)
"""Contents that are functions of time and state."""

SOLVED = ("rhs", "accelerations", "jacobian")  # Quantities whose formulas divide by entries of the mass matrix


class Target(ABC):
    """A language or a format to which models are exported.

    - `name` is the name for users, and `about` a one-line description of the target.
    - `contents` are the kinds of content that a file may have besides functions such as "rhs" and "energy". "steps"
      allows integrators of any number of explicit methods: functions that take one step, or compute a run if the method
      has error control. "runs" allows one integrator only, a run by a method with error control. "taylor" allows an
      integrator by Taylor series. "main" allows a program or model that runs from the initial state.
    - `always` are names of functions and contents that every file has because its format needs them.
    - `inexpressible` are the operations, such as erf, for which the language has no function.
    - `shell` are the shell lines that build and run a program, with the fields {name} of the module's file and
      {program}, which is "test" or "main".
    - `reserved_files` are words that must not be the name of the module's file.

    A target without "steps" and "runs" exports no integrator: the program that reads the file integrates the motion.
    Register a class with `register`.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    contents: ClassVar[frozenset[str]] = frozenset(("steps", "main"))
    always: ClassVar[tuple[str, ...]] = ()
    inexpressible: ClassVar[frozenset[str]] = frozenset()
    shell: ClassVar[tuple[str, ...]] = ()
    reserved_files: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def files(self, module: SourceModule) -> Mapping[str, str | bytes]:
        """Return the content of each file of the export of a module, by file name."""

    def file_name(self, module: SourceModule) -> str:
        """Return the name of the module's file without its suffix."""
        return distinct([module.name], self.reserved_files)[0]

    def commands(self, module: SourceModule) -> list[str]:
        """Return shell lines that build and run the self-test in the folder of the files; they fail if it fails."""
        return [line.format(name=self.file_name(module), program="test") for line in self.shell]

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return shell lines that build and run `main`, which prints a table; empty if the target has no `main`."""
        return [line.format(name=self.file_name(module), program="main") for line in self.shell]


REGISTERED: dict[str, Target] = {}  # The targets whose modules are loaded, by name


def target_of(name: str) -> Target:
    """Return a target by its name, which is one of `target_names`."""
    if name not in REGISTERED:
        load(name)
    return REGISTERED[name]


def target_names() -> list[str]:
    """Return the names of all targets, the built-in ones first."""
    return list(dict.fromkeys((*TARGETS, *REGISTERED)))


def able_targets(able: Callable[[Target], bool]) -> str:
    """Return the names of the targets for which `able` returns True, as text for a message."""
    return listing(name for name in target_names() if able(target_of(name)))


def register(target: type[Target]) -> type[Target]:
    """Register a class as a target of `system.export` in this process; use this function as a decorator.

    Raises StatementError for an argument that is not a subclass of `Target`, and for a name that another class has.
    """
    if not (isinstance(target, type) and issubclass(target, Target)):
        raise StatementError(f"{target!r} is not a target: give a subclass of lagrange.export.target.Target.")
    if TARGETS.get(target.name, target.__module__) != target.__module__:
        target_of(target.name)
    present = REGISTERED.get(target.name)
    if present is not None and type(present).__qualname__ != target.__qualname__:
        raise StatementError(f"there is a target {target.name!r} already: give another name.")
    REGISTERED[target.name] = target()
    return target


class TargetTable(dict[str, str]):
    """Dict from the name of each target to a line about it; prints as a table."""

    def __repr__(self) -> str:
        return text_table(("", ""), list(self.items()))

    def __missing__(self, name: Any) -> str:
        raise UnknownKey(f"there is no target {shown(name)}; the targets are {listing(self)}.")

    def _repr_html_(self) -> str:
        return table(("target", "about"), list(self.items()))


def targets() -> TargetTable:
    """Return a dict from the name of each target of `System.export` to a line about it."""
    return TargetTable({name: target_of(name).about for name in target_names()})


def find(name: str) -> Target:
    """Return a target by name or alias. Raises StatementError for an unknown name, and lists the known names."""
    known = target_names()
    if isinstance(name, str) and name not in known:
        name = ALIASES.get(name.lower(), name)
    return target_of(one_of(name, known, "there is no target {given}; the targets are {known}."))


def missing_operation(target: Target, module: SourceModule) -> tuple[str, str] | None:
    """Return the first operation in `module` that the target cannot express, as (quantity, operation), or None."""
    operations = ((quantity.name, code.op) for quantity in module.quantities for code in quantity.program.instructions)
    return next((pair for pair in operations if pair[1] in target.inexpressible), None)


def check_operations(target: Target, module: SourceModule) -> None:
    """Raise StatementError for a function that a target cannot express; the message names the targets that can."""
    missing = missing_operation(target, module)
    if missing is not None:
        quantity, op = missing
        raise StatementError(
            f"{quantity} of {module.name} contains {op}, which target {target.name!r} has no function for: "
            f"{able_targets(lambda candidate: op not in candidate.inexpressible)} have one."
        )
