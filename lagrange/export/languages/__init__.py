"""The languages that models are written in, one module each."""

from __future__ import annotations

from lagrange.export.languages.c import C
from lagrange.export.languages.cpp import Cpp
from lagrange.export.target import Target

BUILT_IN: tuple[type[Target], ...] = (C, Cpp)
"""In the order in which they are listed."""
