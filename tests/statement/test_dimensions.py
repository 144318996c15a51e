"""Dimensions: right statements pass, and for wrong ones the message names the wrong term."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import pytest
import sympy as sp
from sympy import cos, exp, sin, sqrt
from sympy.physics import units

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.statement.units.dimension import read_dimension
from tests.refusals import refusal

m, M, g, l, k, c, R, w, q0, B = lg.parameters("m M g l k c R w q0 B")
theta, phi, x, y, r = lg.coordinates("theta phi x y r")

KNOWN = {
    m: "mass",
    M: "mass",
    g: "acceleration",
    l: "length",
    R: "length",
    k: "stiffness",
    c: "damping",
    w: "frequency",
    q0: "charge",
    B: "magnetic_density",
    theta: "angle",
    phi: "angle",
    x: "length",
    y: "length",
    r: "length",
}

PENDULUM = {"kinetic": m * l**2 * theta.dot**2 / 2, "potential": -m * g * l * cos(theta)}
SLIDING = {
    "kinetic": (M + m) * x.dot**2 / 2 + m * l * x.dot * theta.dot * cos(theta) + m * l**2 * theta.dot**2 / 2,
    "potential": k * x**2 / 2 - m * g * l * cos(theta),
    "forces": {x: -c * x.dot, theta: -c * l**2 * theta.dot},
    "dissipation": c * x.dot**2 / 2,
    "positions": {"bob": (x + l * sin(theta), -l * cos(theta))},
}
HOOP = {
    "kinetic": m * R**2 * (theta.dot**2 + w**2 * sin(theta) ** 2) / 2 + M * x.dot**2 / 2,
    "potential": m * g * R * (1 - cos(theta)) + k * R**2 * (theta - phi) ** 2 / 2,
    "constraints": {"gear": R * phi - x},
    "coordinates": [theta, phi, x],
}
SPRING = {
    "kinetic": m * (r.dot**2 + r**2 * theta.dot**2) / 2,
    "potential": k * (r - l) ** 2 / 2 - m * g * r * cos(theta) + k * R**2 * exp(-(r**2) / R**2),
    "forces": {r: k * l * cos(w * lg.t)},
}
ROD = {
    "kinetic": m * (x.dot**2 + y.dot**2) / 2,
    "potential": m * g * y + k * (sqrt(x**2 + y**2) - l) ** 2 / 2,
    "constraints": {"rod": x**2 + y**2 - l**2},
}
CHARGE = {"lagrangian": m * (x.dot**2 + y.dot**2) / 2 + q0 * B * (x * y.dot - y * x.dot) / 2}
SYSTEMS: dict[str, dict[str, Any]] = {
    "pendulum": PENDULUM,
    "sliding": SLIDING,
    "hoop": HOOP,
    "spring": SPRING,
    "rod": ROD,
    "charge": CHARGE,
}


def stated(given: dict[str, Any], dimensions: Any = None) -> lg.System:
    return lg.System(**given, dimensions=KNOWN if dimensions is None else dimensions)


PLANTED: list[tuple[dict[str, Any], str, Any, Any]] = [
    # statement, part, the wrong term as it is told, and what the part becomes
    (PENDULUM, "kinetic", m * l * theta.dot**2 / 2, m * l * theta.dot**2 / 2),
    (PENDULUM, "potential", -m * g * cos(theta), -m * g * cos(theta)),
    (PENDULUM, "potential", l * theta, -m * g * l * cos(l * theta)),
    (SLIDING, "kinetic", m * x.dot * theta.dot * cos(theta), M * x.dot**2 / 2 + m * x.dot * theta.dot * cos(theta)),
    (SLIDING, "potential", k * theta**2 / 2, SLIDING["potential"] + k * theta**2 / 2),
    (SLIDING, "forces", -c * theta.dot, {x: -c * x.dot, theta: -c * theta.dot}),
    (SLIDING, "positions", sin(theta), {"bob": (x + sin(theta), -l * cos(theta))}),
    (HOOP, "constraints", -x, {"gear": phi - x + 2 * theta}),
    (SPRING, "potential", -1, k * (r - 1) ** 2 / 2 - m * g * r * cos(theta)),
    (SPRING, "potential", -(r**2) / R, k * (r - l) ** 2 / 2 + k * R**2 * exp(-(r**2) / R)),
    (ROD, "potential", -(l**2), m * g * y + k * (sqrt(x**2 + y**2) - l**2) ** 2 / 2),
    (CHARGE, "lagrangian", -x.dot, m * (x.dot**2 + y.dot**2) / 2 + q0 * B * (x * y.dot - x.dot) / 2),
]


@pytest.mark.parametrize("case", range(len(PLANTED)))
def test_the_wrong_term_is_named(case: int) -> None:
    given, part, term, wrong = PLANTED[case]
    with pytest.raises(StatementError) as refusal:
        stated({**given, part: wrong})
    plain = {q.diff(lg.t): sp.Symbol(f"{q.func}_dot") for q in (theta, phi, x, y, r)}
    plain |= {q: sp.Symbol(str(q.func)) for q in (theta, phi, x, y, r)}
    assert re.search(
        rf"has the term {re.escape(str(sp.sympify(term).xreplace(plain)))}(, in [^;]*)?, whose", str(refusal.value)
    )


@pytest.mark.parametrize(
    ("given", "term"),
    [
        ({"kinetic": m * (r.dot**2 + r * theta.dot**2) / 2, "potential": -k / r}, "r*theta_dot**2"),
        ({"kinetic": m * l * theta.dot**2 / 2}, "l*m*theta_dot**2/2"),
        ({"kinetic": m * (x.dot + l * theta.dot**2) ** 2 / 2}, "l*theta_dot**2"),
    ],
)
def test_an_angle_that_was_not_stated_has_no_root_of_a_length(given: dict[str, Any], term: str) -> None:
    with pytest.raises(StatementError, match=rf"has the term {re.escape(term)}(, in .*)?, whose dimension"):
        stated(given, {m: "mass", r: "length", l: "length", x: "length"})


def test_messages_have_what_it_is_and_what_it_should_be() -> None:
    assert refusal(stated, {**PENDULUM, "potential": -m * g * cos(theta)}) == (
        "the potential energy has the term -g*m*cos(theta), whose dimension is force (mass*length/time**2); it should "
        "be energy (mass*length**2/time**2)."
    )


def test_what_is_not_stated_follows_from_the_terms() -> None:
    sizes = stated(SLIDING, {m: "mass", l: "length"}).statement.dimensions
    result = {str(key): str(size) for key, size in sizes.items()}
    assert (
        result["g"] == "acceleration (length/time**2)" and result["k"] == "mass/time**2" and result["c"] == "mass/time"
    )
    assert result["x(t)"] == "length" and result["theta(t)"] == "a number"


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("moment of inertia", "mass*length**2"),
        ("kg*m/s**2", "force (mass*length/time**2)"),
        (units.newton, "force (mass*length/time**2)"),
        (units.length / units.time, "velocity (length/time)"),
        (units.meter / units.second**2, "acceleration (length/time**2)"),
        ("1/time**(1/2)", "1/time**(1/2)"),
        (1, "a number"),
    ],
)
def test_dimensions_are_read_from_text_and_from_sympy(given: Any, shown: str) -> None:
    assert str(read_dimension(given, "it")) == shown


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("mass", "dimensions is 'mass': give a dict from symbols to dimensions, such as {m: 'mass', l: 'length'}."),
        ({m: "mas"}, "the dimension of m is 'mas', which is neither a dimension nor a unit. Did you mean 'mass'?"),
        ({g: "n/kg"}, "the dimension of g is 'n/kg', and 'n' is neither a dimension nor a unit. Did you mean 'N'?"),
        ({m: 3}, "the dimension of m is 3: give a dimension or a unit, such as 'length', 'm/s**2' or sympy.physics"),
        ({m: "__import__('os')"}, "the dimension of m is \"__import__('os')\", which is not a product of dimensions"),
        ({"n": "mass"}, "dimensions names 'n', which this system does not have; its symbols are t, theta, "),
        ({m: "mass**w"}, "the dimension of m is 'mass**w', and 'w' is neither a dimension nor a unit. "),
    ],
)
def test_refusals(given: Any, message: str) -> None:
    assert refusal(stated, PENDULUM, given).startswith(message)


def test_for_a_number_without_a_unit_a_parameter_is_advised() -> None:
    with pytest.raises(StatementError, match=r"it should be length\. A number has no unit: put a parameter in its"):
        lg.System(m * x.dot**2 / 2, k * x**2, positions={"mass": (x, 1)}, dimensions={m: "kg", x: "m"})


def test_powers_that_are_no_numbers_need_a_base_without_dimension() -> None:
    stated({**PENDULUM, "potential": -m * g * l * (1 + theta**2) ** k}, {m: "mass", l: "length", k: "dimensionless"})
    with pytest.raises(StatementError, match=r"term x, in k\*x\*\*w, whose dimension is length; under a power"):
        lg.System(m * x.dot**2, k * x**w, dimensions={x: "length", m: "mass"})


def test_sizes_stay_with_a_system_that_is_copied_or_rewritten() -> None:
    whole = stated(SLIDING)
    sizes = {key: str(size) for key, size in whole.statement.dimensions.items()}
    copied = pickle.loads(pickle.dumps(whole)).statement.dimensions
    assert {str(key): str(size) for key, size in copied.items()} == {str(key): text for key, text in sizes.items()}
    left = whole.substitute({l: 1}).statement.dimensions
    assert {key: str(size) for key, size in left.items()} == {key: s for key, s in sizes.items() if key != l}


def test_a_force_on_a_held_coordinate_without_inertia_has_its_dimension() -> None:
    """The equation of y has a multiplier, so its terms are forces: energy divided by length."""
    force = lg.parameters("F")
    stated: dict[str, Any] = {"kinetic": m * x.dot**2 / 2, "forces": {y: force}, "constraints": {"rod": x - y}}
    lg.System(**stated, dimensions={m: "kg", x: "m", force: "N"})
    with pytest.raises(StatementError, match=r"the force on y has the term F, whose dimension is"):
        lg.System(**stated, dimensions={m: "kg", x: "m", force: "kg"})


def test_scenes_have_dimensions(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    text = (
        'coordinates = ["theta"]\nkinetic = "m*l**2*theta_dot**2/2"\npotential = "-m*g*l*cos(theta)"\n'
        '[parameters]\nm = 1\ng = 9.81\nl = 1\n[dimensions]\nm = "kg"\nl = "m"\n'
    )
    path.write_text(text)
    assert str(lg.System.from_scene(path).statement.dimensions[lg.coordinate("theta")]) == "a number"
    path.write_text(text.replace("l**2*theta_dot", "l*theta_dot"))
    with pytest.raises(lg.SceneError, match=r"s\.toml:8:2: the kinetic energy has the term l\*m\*theta_dot\*\*2/2"):
        lg.System.from_scene(path)
    path.write_text(text + 'q = "kg"\n')
    with pytest.raises(lg.SceneError, match=r"s\.toml:11:1: 'q' is not a symbol of this scene"):
        lg.System.from_scene(path)
