"""Letters and forms of textbooks in answers: forces and rates by other letters, momenta, operators, chains."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import lagrange as lg
from tests.mechanics.answered_systems import disc, orbit, oscillator, pulley, rolling, spun, strung, yoyo
from tests.models import shared_scene

RIGHT: list[tuple[Callable[[], lg.System], str]] = [
    *(
        (spun, f"J1 {w}1' = (J2 - J3) {w}2 {w}3\nJ2 {w}2' = (J3 - J1) {w}3 {w}1\nJ3 {w}3' = (J1 - J2) {w}1 {w}2")
        for w in ("w", "omega_", "ω")
    ),
    (spun, "J1 wx' = (J2 - J3) wy wz\nJ2 wy' = (J3 - J1) wz wx\nJ3 wz' = (J1 - J2) wx wy"),
    *((disc, f"m s'' = m g - {f}\nI phi'' = {f} R\ns = R phi") for f in ("f", "F", "F_R", "mu", "T")),
    (disc, "m s'' = m g - f\nI phi'' = f R\nN = 0 is the force of the wall"),
    (strung, "x'' = (m1 - m2) g/(m1 + m2)\nT = 2 m1 m2 g/(m1 + m2)"),
    (strung, "x'' = (m1 - m2) g/(m1 + m2)\nF_S = 2 m1 m2 g/(m1 + m2)"),
    (yoyo, "m y'' = m g - S, S R = I y''/R"),
    (pulley, "m1 x'' = m1 g - T1\nm2 x'' = T2 - m2 g\nI x''/R = (T1 - T2) R"),
    (orbit, "d/dt m r^2 phi' = 0\n(M + m) r'' = m r phi'^2 - M g"),
    (orbit, "m r^2 phi' = L = const.\n(M + m) r'' = L^2/(m r^3) - M g"),
    (orbit, "m r^2 phi' = L\n(M + m) r'' = L^2/(m r^3) - M g"),
    (oscillator, "x' = v\nm v' = -k x - c v + m g + F cos(w t)"),
    (oscillator, "0,5 m x'' + 0,5 c x' + 0,5 k x = 0,5 m g + 0,5 F cos(w t)"),
]
"""Right answers: rates of bodies, forces of constraints and momenta by other letters, operators, decimal commas."""


@pytest.mark.few(8)
@pytest.mark.parametrize(("system", "text"), RIGHT)
def test_letters_of_textbooks_are_read(system: Callable[[], lg.System], text: str) -> None:
    result = system().compare(text)
    assert result, result.message


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("system", "text"),
    [
        (disc, "m s'' = m g - f\nI phi'' = f R\ns = 2 R phi"),
        (disc, "m s'' = m g - f\nI phi'' = 2 f R\ns = R phi"),
        (rolling, "m s'' = m g sin(alpha) - f\nI phi'' = f R\ns = R phi + 1"),
        (strung, "x'' = (m1 - m2) g/(m1 + m2)\nT = 3 m1 m2 g/(m1 + m2)"),
        (strung, "x'' = (m1 - m2) g/(m1 + m2)\nF_S = 3 m1 m2 g/(m1 + m2)"),
        (yoyo, "m y'' = m g - S, S R = 2 I y''/R"),
        (pulley, "m1 x'' = m1 g - T1\nm2 x'' = T2 + m2 g\nI x''/R = (T1 - T2) R"),
        (orbit, "m r phi' = L\n(M + m) r'' = L^2/(m r) - M g"),
        (oscillator, "x' = v\nm v' = -k x + c v + m g + F cos(w t)"),
    ],
)
def test_a_letter_hides_no_error(system: Callable[[], lg.System], text: str) -> None:
    assert not system().compare(text)


def test_two_letters_for_one_force_are_unknown() -> None:
    with pytest.raises(lg.StatementError, match=r"'F' is not a symbol of this system.* 'T' is not a symbol"):
        strung().compare("m1 x'' = m1 g - F\nm2 y'' = m2 g - T")


def test_the_letter_of_a_force_and_an_integrated_constraint_are_told() -> None:
    message = disc().compare("m s'' = m g - f\nI phi'' = f R\ns = R phi").message
    assert "Equation 3 is right up to a constant. f is read as the force of the constraint roll." in message


def test_the_wrong_equality_of_a_chain_is_told() -> None:
    pendulum = shared_scene("pendulum")
    for answer in ("theta'' = -g sin theta/l = -g l sin theta", ["theta'' = -g sin theta/l = -g l sin theta"]):
        result = pendulum.compare(answer)
        assert result.message.startswith("In the second equality of equation 1, that of theta, on the right side")
        assert result.wrong == (0,)


def test_no_slip_repeats_the_factor_of_one_linear_term() -> None:
    assert "All is right" not in oscillator().compare("m x'' + c x' + k x = m g + 2 F cos(w t)").message
