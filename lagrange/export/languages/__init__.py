"""The targets of `System.export`: add a target here, and its module to this folder."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType

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
"""Module by the name of the target; it is loaded when the target is asked for."""

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
"""Target by alias."""


def load(name: str) -> ModuleType:
    """Return the module of a target, given by its name in `TARGETS`; most programs need none of them."""
    return import_module(TARGETS[name])
