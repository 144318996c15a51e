"""The visitor of statements: none is forgotten, and the table of fields says what a procedure reads and defines."""

from __future__ import annotations

from typing import get_args

import pytest

from lagrange.procedure.form import Note, Parameter, Statement, walk
from lagrange.procedure.visit import FIELDS, Visitor, defined, operands, visits
from tests.procedure.random_procedures import RandomProcedure


def test_a_visitor_that_forgets_statements_is_refused() -> None:
    with pytest.raises(TypeError, match="Forgetful has no method for Let, SineCosine, Reserve"):

        class Forgetful(Visitor):
            @visits(Note)
            def note(self, note: Note) -> None:
                pass


def test_the_table_has_every_statement_and_fields_that_it_has() -> None:
    kinds = get_args(Statement)
    assert tuple(FIELDS) == kinds
    for kind in kinds:
        assert set(FIELDS[kind].read) | set(FIELDS[kind].defined) <= set(kind._fields)


@pytest.mark.parametrize("seed", range(8))
def test_what_is_read_is_defined_once(seed: int) -> None:
    procedure = RandomProcedure(seed, fused=True).build()
    made = [one.ref for one in procedure.parameters if isinstance(one, Parameter)]
    made += [ref for statement in walk(procedure.body) for ref in defined(statement)]
    assert len(made) == len(dict.fromkeys(made))
    # An entry of a fold is made inside its loop, which the loop itself reads.
    assert {ref for statement in walk(procedure.body) for ref in operands(statement)} <= set(made)
