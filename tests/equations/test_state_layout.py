"""Where the parts of a state stand: read from the layout, and nowhere taken for halves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import lagrange
from lagrange.equations.euler_lagrange import StateLayout
from lagrange.program.catalogue import program_of
from tests.models import laws

PACKAGE = Path(lagrange.__file__).parent
HALVES = re.compile(r"len\((y|y0|names|state\.y)\) // 2|shape\[\d\] // 2|np\.split\(\w+, 2\)|\.states // 2")


def test_parts_of_different_sizes() -> None:
    """As of a body whose place is a quaternion and whose rates are three."""
    layout = StateLayout(("a", "b", "c", "d"), ("x", "y", "z"))
    q, v = layout.split(np.arange(7.0))
    assert layout.size == 7 and q.tolist() == [0, 1, 2, 3] and v.tolist() == [4, 5, 6]
    assert layout.names() == ("a", "b", "c", "d", "x_dot", "y_dot", "z_dot")
    assert layout.names(".dot")[4:] == ("x.dot", "y.dot", "z.dot")


def test_programs_read_the_state_as_it_is_laid_out() -> None:
    equations = laws("cart and pole")
    sizes = [len(range(*rows.indices(equations.layout.size))) for rows in (equations.layout.q, equations.layout.v)]
    assert [block.size for block in program_of("rhs", equations).inputs] == sizes == [2, 2]
    assert equations.rate == equations.v and list(equations.state) == ["q", "v"]


def test_nothing_that_runs_or_shows_takes_a_state_for_two_halves() -> None:
    found = [
        f"{path.relative_to(PACKAGE)}:{number}"
        for folder in ("trajectory", "evidence", "show", "machine/kernel")
        for path in sorted((PACKAGE / folder).rglob("*.py"))
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if HALVES.search(line)
    ]
    assert not found
    assert HALVES.search("n = len(y0) // 2") and HALVES.search("q, v = np.split(after, 2)")
