"""Contacts whose laws determine no motion, or not the forces: messages name contacts, rank and region."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sympy import cos, diff, sin

import lagrange as lg


def three_feet(*friction: float) -> lg.System:
    """A board that slides on three feet in a row."""
    x, y, theta = lg.coordinates("x y theta")
    contacts = {}
    for name, side, mu in zip("abc", (-1, 0, 1), friction, strict=True):
        across, up = x + side * cos(theta) + sin(theta) / 10, y + side * sin(theta) - cos(theta) / 10
        contacts[name] = lg.contact(up, diff(across, lg.t) if mu else None, friction=mu)
    kinetic = (x.dot**2 + y.dot**2) / 2 + theta.dot**2 / 6
    return lg.System(kinetic, 9.81 * y, contacts=contacts, simultaneous="newton", initial={y: 0.1, x.dot: 1})


def test_feet_without_friction_share_their_forces_and_the_message_says_so() -> None:
    run = three_feet(0, 0, 0).run(1.0).require()
    assert [contact.force[-1] for contact in run.contacts.values()] == pytest.approx([3.27] * 3)
    assert "The contacts 'a', 'b' and 'c' depend on each other (rank 2 of 3): their smallest forces" in run.message


def test_feet_with_equal_friction_stop_where_one_block_stops() -> None:
    run = three_feet(0.3, 0.3, 0.3).run(1.0).require()
    assert run["x"][-1] == pytest.approx(1 / (2 * 0.3 * 9.81), abs=1e-12)


def test_feet_that_slide_with_equal_friction_have_forces_of_which_the_message_says_which() -> None:
    run = three_feet(0.3, 0.3, 0.3).run(0.1).require()
    told = r"'a', 'b' and 'c' depend on each other \(rank 3 of 6\).* fewest sliding contacts are given"
    assert run.contacts["b"].force[-1] == 0 and re.search(told, run.message)


def test_feet_with_different_friction_are_refused_with_names_and_rank() -> None:
    with pytest.raises(lg.StatementError, match=r"'a', 'b' and 'c' depend on each other \(rank 2 of 3\) and have fric"):
        three_feet(0.3, 0.1, 0.5).run(1.0)


def test_the_region_of_painleve_is_told_in_symbols() -> None:
    (x, y, theta), (m, g, mu) = lg.coordinates("x y theta"), lg.parameters("m g mu")
    floor = lg.contact(y - sin(theta) / 2, slip=diff(x + cos(theta) / 2, lg.t), friction=mu)
    kinetic, values = m * (x.dot**2 + y.dot**2) / 2 + m * theta.dot**2 / 24, {m: 1, g: 9.81, mu: 1.4}
    start = {theta: np.pi / 3, y: np.sin(np.pi / 3) / 2, x.dot: 3.0}
    system = lg.System(kinetic, m * g * y, contacts={"floor": floor}, parameters=values, initial=start)
    with pytest.raises(lg.StatementError) as refusal:
        system.run(0.01)
    assert "where (-3*mu*sin(theta)*cos(theta) + 3*cos(theta)**2 + 1)/m <= 0" in str(refusal.value)
    assert len(str(refusal.value)) < 400
