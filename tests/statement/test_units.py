"""Units and dimensions: terms with different units are refused in all fields."""

import math
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
from lagrange.statement.parameters import label_of
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
    message = refusal(stated, {**given, part: wrong})
    plain = {q.diff(lg.t): sp.Symbol(f"{q.func}_dot") for q in (theta, phi, x, y, r)}
    plain |= {q: sp.Symbol(str(q.func)) for q in (theta, phi, x, y, r)}
    assert re.search(rf"has the term {re.escape(str(sp.sympify(term).xreplace(plain)))}(, in [^;]*)?, whose", message)


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


# --- units: terms with different units are refused in all fields -----------------------------------------------


a, F, u = lg.parameters("a F u")
T = m * x.dot**2 / 2

OTHER = ", whose unit is "

WRONG: dict[str, tuple[dict[str, Any], dict[Any, Any], str, str]] = {
    # statement, units, what is told of, and the ratio of the units
    "force": (
        {"kinetic": T, "potential": k * (x - a) ** 2 / 2, "forces": {x: F}},
        {k: "N/m", a: "cm", F: "N", m: "kg"},
        "the force on x has the term F",
        "100",
    ),
    "dissipation": (
        {"kinetic": T, "dissipation": c * x.dot**2 / 2},
        {m: "kg", x: "m", c: "g/s"},
        "the dissipation has the term c*x_dot**2/2",
        "0.001",
    ),
    "time": (
        {"kinetic": T, "potential": k * x**2 / 2},
        {m: "kg", k: "N/m", lg.t: "ms"},
        "the potential energy has the term k*x**2/2",
        "1e-06",
    ),
    "constraint": (
        {"kinetic": T + m * y.dot**2 / 2, "constraints": {"rod": x**2 + y**2 - l**2}},
        {x: "m", l: "cm"},
        "the constraint rod has the term -l**2",
        "0.0001",
    ),
    "position": (
        {"kinetic": T, "positions": {"a": (x, 0), "b": (a, 0)}},
        {x: "m", a: "mm"},
        "the position of b has the term a",
        "0.001",
    ),
    "given motion": (
        {"kinetic": T, "potential": k * (x - lg.given("X", a * sin(w * lg.t))) ** 2 / 2},
        {x: "m", a: "cm"},
        "the given function X has the term a*sin(t*w)",
        "0.01",
    ),
    "speed of a given motion": (
        {"kinetic": T, "potential": k * (x - lg.given("X", a * sin(w * lg.t) + 0.1)) ** 2 / 2},
        {x: "m", a: "m", w: "1/min"},
        "the given function X has the term t*w in sin(t*w)",
        "0.0166667 rad",
    ),
    "angle in degrees": (
        {"kinetic": m * l**2 * theta.dot**2 / 2, "potential": -m * g * l * cos(theta)},
        {m: "kg", l: "m", theta: "deg"},
        "the potential energy has the term theta in cos(theta)",
        "0.0174533 rad",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_units_that_do_not_fit_are_refused(name: str) -> None:
    given, units, term, ratio = WRONG[name]
    message = refusal(lg.System, **given, dimensions=units)
    unit = ratio if "rad" in ratio else f"{ratio} times that of the other terms"
    assert message.startswith(f"{term}{OTHER}{unit}: state ") and len(message) <= 400
    remedies = re.findall(r"(\w+) in (\S+) instead of ([^\s,]+?)[,.](?= |$)", message)
    assert remedies
    for symbol, unit, stated in remedies:
        (key,) = (key for key in units if label_of(key) == symbol)
        assert units[key] == stated
        lg.System(**given, dimensions=units | {key: unit})


def test_units_of_which_two_are_wrong_are_listed() -> None:
    assert refusal(
        lg.System, T, k * (x - a) ** 2 / 2, forces={x: F}, dimensions={x: "m", a: "cm", F: "kN", k: "N/m", m: "kg"}
    ).endswith("Stated are a in cm, x in m, F in kN, k in N/m.")


i = lg.coordinate("i")

J, L = lg.parameters("J L")
MOTOR = {u: "V", R: "ohm", i: "A", J: "kg*m**2", L: "H", k: "N*m/A", c: "N*m*s", phi: "rad"}

ODD: dict[str, tuple[Any, str, str]] = {
    # the symbol in another unit, this unit, and what is told of
    "voltage": (u, "mV", "the equation of i has the term u, whose unit is 0.001"),
    "inductance": (L, "mH", "the equation of i has the term -L*i_dot, whose unit is 0.001"),
    "torque": (k, "N*cm/A", "the force on phi has the term i*k, whose unit is 0.01"),
    "damping": (c, "mN*m*s", "the force on phi has the term -c*phi_dot, whose unit is 0.001"),
}


@pytest.mark.parametrize("name", ODD)
def test_the_one_term_that_differs_is_named(name: str) -> None:
    symbol, unit, term = ODD[name]
    motor = {
        "kinetic": J * phi.dot**2 / 2,
        "coordinates": [phi, i],
        "forces": {phi: k * i - c * phi.dot, i: u - R * i - k * phi.dot},
        "dissipation": L * i.dot**2 / 2,
    }
    lg.System(**motor, dimensions=MOTOR)
    assert refusal(lg.System, **motor, dimensions=MOTOR | {symbol: unit}) == (
        f"{term} times that of the other terms: state {label_of(symbol)} in {MOTOR[symbol]} instead of {unit}."
    )


RATES: dict[str, tuple[dict[Any, str], str]] = {
    # units, and the unit of x
    "inferred": ({x.dot: "cm/s", m: "kg"}, "cm"),
    "of an acceleration": ({x.dot.diff(lg.t): "km/hour^2", lg.t: "hour"}, "km"),
    "beside a dimension": ({x: "length", x.dot: "mm/ms", lg.t: "ms"}, "mm"),
    "that fits": ({x: "km", x.dot: "m/s"}, ""),
}


@pytest.mark.parametrize("name", RATES)
def test_a_unit_of_a_rate_is_that_of_its_coordinate_over_time(name: str) -> None:
    units, unit = RATES[name]
    if unit:
        result = lg.System(T, k * x**2 / 2, dimensions=units).statement.dimensions[x]
        assert result.unit == unit and result.fits(read_dimension(unit, "x"))
        return
    message = "dimensions has x_dot in m/s and x in km, with t in s: state x_dot in km/s, or leave it out."
    with pytest.raises(StatementError, match=message if x in units else r"m\*x_dot\*\*2/2, whose dimension is mass"):
        lg.System(T, k * x**2 / 2, dimensions=units)


UNITS = {
    "SI": {"mass": "kg", "length": "m", "time": "s", "current": "A"},
    "small": {"mass": "mg", "length": "um", "time": "ms", "current": "uA"},
    "customary": {"mass": "lb", "length": "ft", "time": "min", "current": "kA"},
}


@pytest.mark.few(1)
@pytest.mark.parametrize("base", UNITS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_one_symbol_in_another_unit_is_refused(name: str, base: str) -> None:
    whole = lg.System(**SYSTEMS[name])
    symbols = [item for item in (lg.t, *whole.coordinates, *whole.statement.parameters) if item in (KNOWN | {lg.t: 0})]
    units: dict[Any, Any] = {lg.t: UNITS[base]["time"]}
    for symbol in symbols[1:]:
        powers = read_dimension(KNOWN[symbol], "it").exponents
        units[symbol] = "*".join(f"({UNITS[base][of]})**({power})" for of, power in powers) or "rad"
    lg.System(**SYSTEMS[name], dimensions=units)
    for symbol in set(symbols) - ({m} if name == "pendulum" else set()):  # no motion depends on a single mass
        with pytest.raises(StatementError, match=OTHER):
            lg.System(**SYSTEMS[name], dimensions=units | {symbol: f"1000*{units[symbol]}"})


def test_units_that_fit_are_taken() -> None:
    rubber = lg.System(
        T, k * (x - a) ** 2 / 2, forces={x: F - c * x.dot}, dimensions={m: "t", k: "kN/m", a: "m", F: "kN"}
    )
    result = {str(symbol): item for symbol, item in rubber.statement.dimensions.items()}
    assert result["x(t)"].fits(read_dimension("m", "x")) and result["c"].fits(read_dimension("kN*s/m", "c"))
    converted = lg.System(T, k * x**2 / 2, forces={x: u * F}, dimensions={m: "kg", k: "N/m", F: "kN", u: "N/kN"})
    assert converted.statement.dimensions[x].fits(read_dimension("m", "x"))


def test_a_unit_that_follows_is_made_of_stated_ones() -> None:
    assert refusal(lg.System, T + M * y.dot**2 / 2, m * g * x, dimensions={m: "kg", M: "g", g: "m/s**2"}) == (
        "no unit was stated for y. From its terms follows 31.6228 m, so the stated units do not fit together: "
        "state the unit of y, or state "
        "all symbols in units that fit together, such as kg, m and s, and angles in rad."
    )
    with pytest.raises(StatementError, match=r"unit was stated for m. From its terms follows 1000 kg, "):
        lg.System(T, k * x**2 / 2, forces={x: F}, dimensions={F: "N", k: "N/mm"})


EVENTS: dict[str, tuple[Any, str]] = {
    "terms": (x - a, rf"event 0 has the term x{OTHER}"),
    "dimensions": (x - x.dot, "event 0 has the term x, whose dimension is length; like the other terms"),
    "reset": (lg.event(x, reset={"x_dot": -a * w}), rf"the reset of event 0 has the term -a\*w{OTHER}"),
    "angle": (cos(w * lg.t) - x / a, rf"event 0 has the term cos\(t\*w\){OTHER}"),
    "multiplier": (lg.multiplier("wire") * a - F * x, rf"event 0 has the term -F\*x{OTHER}"),
    "time": (lg.t - u, rf"event 0 has the term -u{OTHER}60 times that of the other terms: state u in s instead of"),
    "ratio of times": (lg.t / u - 2, rf"event 0 has the term t/u{OTHER}"),
    "time as reset": (lg.event(x, reset={u: lg.t}), rf"the reset of event 0 has the term t{OTHER}"),
}


@pytest.mark.few(6)
@pytest.mark.parametrize("name", EVENTS)
def test_events_are_checked(name: str) -> None:
    wire = lg.System(
        T + m * y.dot**2 / 2, k * x**2 / 2, forces={x: F}, constraints={"wire": y - x}, coordinates=[x, y],
        parameters={m: 1, k: 1, a: 1, F: 1, w: 1, u: 1},
        dimensions={m: "kg", k: "N/m", x: "m", a: "cm", F: "N", w: "1/s", u: "min"},
    )  # fmt: skip
    event, message = EVENTS[name]
    assert re.search(message, refusal(wire.run, 1.0, events=[event]))


def test_numbers_in_events_have_the_units_beside_them_and_times_are_seconds() -> None:
    spring = lg.System(
        T, k * (x - lg.given("X", a * sin(2 * lg.t) + 0.1)) ** 2 / 2, forces={x: -F * u / M},
        parameters={m: 1, k: 1, a: 1, F: 0, u: 1, M: 1},
        dimensions={m: "kg", k: "N/m", x: "m", a: "m", F: "N", u: "s", M: "s"},
    )  # fmt: skip
    events = [
        *(x - 0.3, lg.t - 0.5, lg.event(x.dot - 0.1 * sin(3 * lg.t), reset={x.dot: 0.2, x: x + 0.1})),
        *(lg.t - u, 2 * lg.t / u - 3, lg.event(x, reset={u: lg.t + u}), lg.event(x.dot, reset={u: 2 * lg.t + 1})),
    ]
    assert spring.run(1.0, {x: 1.0}, events=events).status.name == "SUCCESS"


SUGGESTED = re.compile(r"state (\w+) in ([^ ]+) instead of")


@pytest.mark.parametrize("of_w", ["Hz", "1/min", "rpm", "1/h", "rad/s"])
@pytest.mark.parametrize("of_k", ["N/m", "g/min**2", "lbf/inch", "kg*Hz**2", "J/m**2"])
def test_suggested_units_can_be_typed_back(of_w: str, of_k: str) -> None:
    units = {"m": "mg", "k": of_k, "w": of_w, "x": "m"}
    message = refusal(lg.System, T, k * x**2 / 2 + m * w**2 * x**2, dimensions=units)
    suggested = SUGGESTED.findall(message)
    assert suggested or "that fit together" in message
    for name, text in suggested:
        assert read_dimension(text, name).like(read_dimension(units[name], name))
        lg.System(T, k * x**2 / 2 + m * w**2 * x**2, dimensions=units | {name: text})


@pytest.mark.parametrize(
    ("text", "same", "factor"),
    [
        ("mN", "g*m/s**2", 1),
        ("Nm", "J", 1),
        ("mNm", "J", 1e-3),
        ("N·m", "J", 1),
        ("1/min", "1/s", 1 / 60),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("m/s²", "m/s**2", 1),
        ("lbf", "pound*9.80665*m/s**2", 1),
        ("eV", "1.602176634e-19*kg*m**2/s**2", 1),
    ],
)
def test_units_of_mechanics_are_known(text: str, same: str, factor: float) -> None:
    first, second = read_dimension(text, "it"), read_dimension(same, "it")
    assert first.like(second) and first.factor is not None and second.factor is not None
    assert math.exp(first.factor - second.factor) == pytest.approx(factor, rel=1e-9)  # the digits of SymPy's factors
    assert first.unit == text


def test_units_that_follow_are_found_again_from_a_scene(tmp_path: Path) -> None:
    system = lg.System(
        T, k * (x - a) ** 2 / 2, parameters={m: 1, k: 1, a: 1}, dimensions={m: "g", k: "mN/m", a: "m", x: "length"}
    )
    path = system.to_scene(tmp_path / "s.toml")
    again, stated = (one.statement.dimensions for one in (lg.System.from_scene(path), system))
    assert [(str(q), again[q].exponents, again[q].factor) for q in again] == [
        (str(q), stated[q].exponents, stated[q].factor) for q in stated
    ]
    path.write_text(path.read_text().replace("mN/m", "N/m"))
    with pytest.raises(lg.SceneError, match=OTHER):
        lg.System.from_scene(path)
