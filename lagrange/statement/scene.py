"""Scene files: a TOML text becomes a `Statement`, and every refusal names file, line and column."""

from __future__ import annotations

import keyword
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import sympy

from lagrange.errors import SceneError, StatementError, listing, suggestion
from lagrange.statement import places
from lagrange.statement.coordinate import check_name, coordinate, velocity_of
from lagrange.statement.declare import declare
from lagrange.statement.lexer import FUNCTIONS
from lagrange.statement.number import real_number
from lagrange.statement.statement import RunSettings, Statement
from lagrange.statement.text import read_expression, read_number

LARGEST_FILE = 1_048_576
"""Bytes in a scene file."""

LIBRARY = Path(__file__).resolve().parents[1] / "scenes"

KEYS = (
    "name", "about", "source", "coordinates", "kinetic", "potential", "lagrangian", "forces", "dissipation",
    "constraints", "parameters", "initial", "positions", "links", "run",
)  # fmt: skip
RUN_KEYS = ("t_end", "method", "rtol", "atol", "step")
