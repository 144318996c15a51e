"""The languages that models are written in, one module each."""

from __future__ import annotations

from lagrange.export.languages.c import C
from lagrange.export.languages.casadi import CasADi
from lagrange.export.languages.cpp import Cpp
from lagrange.export.languages.fmu import Fmu
from lagrange.export.languages.fortran import Fortran
from lagrange.export.languages.javascript import JavaScript
from lagrange.export.languages.jax import Jax
from lagrange.export.languages.julia import Julia
from lagrange.export.languages.modelica import Modelica
from lagrange.export.languages.octave import Octave
from lagrange.export.languages.python import Python
from lagrange.export.languages.rust import Rust
from lagrange.export.target import Target

BUILT_IN: tuple[type[Target], ...] = (
    C,
    Cpp,
    Fortran,
    Julia,
    Octave,
    JavaScript,
    Rust,
    Python,
    Jax,
    CasADi,
    Modelica,
    Fmu,
)
"""In the order in which they are listed."""
