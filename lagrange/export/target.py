"""The base class of targets; `languages/__init__.py` lists them, and a language is loaded at its first use."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import ClassVar

from lagrange.errors import StatementError
from lagrange.export.languages import TARGETS
from lagrange.export.module import SourceModule

QUANTITIES = (
    *("rhs", "accelerations", "energy", "energies", "jacobian", "mass_matrix", "momenta", "multipliers", "positions"),
    "events",
)
"""Contents that are functions of time and state."""

SOLVED = ("rhs", "accelerations", "jacobian")
"""The quantities that divide by entries of the matrix."""


class Target(ABC):
    """A language or a format that models are written in.

    `name` is the name for users, `about` a line about it. `contents` are the possible contents beside the quantities:
    "steps" (a step of any explicit method, and runs with error control) or "runs" (one run with error control),
    "taylor", and "main". A target without steps and runs leaves "main" to the program that reads the file. `always`
    are contents that every file has because its format needs them. `inexpressible` are the operations without a
    function in the language. Register a new class with `register`.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    contents: ClassVar[frozenset[str]] = frozenset(("steps", "main"))
    always: ClassVar[tuple[str, ...]] = ()
    inexpressible: ClassVar[frozenset[str]] = frozenset()

    @abstractmethod
    def files(self, module: SourceModule) -> Mapping[str, str | bytes]:
        """Return the text of each file by its name."""

    @abstractmethod
    def commands(self, module: SourceModule) -> list[str]:
        """Return shell lines that build and run the test in the folder of the files; exit status 0 if it passes."""

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return shell lines that build and run `main`, which writes its table, for a module with a run."""
        del module
        return []


REGISTERED: dict[str, Target] = {}
"""The targets whose modules are loaded, by name."""


def target_of(name: str) -> Target:
    """Return a target by its name, which is one of `target_names`."""
    if name not in REGISTERED:
        import_module(TARGETS[name])
    return REGISTERED[name]


def target_names() -> list[str]:
    """Return the names of all targets, the built-in ones first."""
    return list(dict.fromkeys((*TARGETS, *REGISTERED)))


def every_target() -> dict[str, Target]:
    """Return all targets by name."""
    return {name: target_of(name) for name in target_names()}


def register(target: type[Target]) -> type[Target]:
    """Register a target, so that `system.export` finds it in this process; a decorator of its class.

    Raises StatementError for an argument that is not a subclass of `Target`, and for the name of another class.
    """
    if not (isinstance(target, type) and issubclass(target, Target)):
        raise StatementError(f"{target!r} is no target: give a subclass of lagrange.export.target.Target.")
    if TARGETS.get(target.name, target.__module__) != target.__module__:
        target_of(target.name)
    known = REGISTERED.get(target.name)
    if known is not None and type(known).__qualname__ != target.__qualname__:
        raise StatementError(f"there is a target {target.name!r} already: give another name.")
    REGISTERED[target.name] = target()
    return target
