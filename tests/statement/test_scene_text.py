"""Statements as scene files: what is written reads back as the same statement, and what no scene holds is refused."""

from __future__ import annotations

import random
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
import sympy
from sympy import Abs, Function, Max, Piecewise, Rational, cos, exp, sin, sqrt

import lagrange as lg
from lagrange.statement import same_statement
from lagrange.statement.expression_text import expression_text
from lagrange.statement.same_statement import difference
from lagrange.statement.scene import scene_from_text
from lagrange.statement.scene_text import scene_text
from lagrange.statement.statement import Statement
from lagrange.statement.text import read_expression

x, y = lg.coordinates("x y")
m, k, w = lg.parameters("m k w")
TABLE = ([0.0, 1.0, 2.5, 4.0], [0.0, 0.1, 0.3, -0.1])


def again(statement: Statement, folder: Path) -> Statement:
    path = lg.System.from_statement(statement).to_scene(folder / "written.toml")
    return lg.System.from_scene(path).statement


@pytest.mark.few
@pytest.mark.parametrize("name", lg.scenes())
def test_a_scene_reads_back_as_the_same_statement(name: str, tmp_path: Path) -> None:
    stated = lg.scene(name).statement
    found = again(stated, tmp_path)
    for field in stated.__dataclass_fields__:
        assert getattr(found, field) == getattr(stated, field), field


def rich() -> lg.System:
    """Return a system with all that a scene holds."""
    X, Y = lg.given("X", sin(w * lg.t)), lg.given("Y", TABLE)
    choice = Piecewise((x**3, (x > 0) & (x < 2)), (Abs(x) * sympy.pi, (x < -1) | (y > 3)), (k * x, True))
    return lg.System(
        kinetic=m * (x.dot**2 + (y.dot + X.dot) ** 2) / 2,
        potential=k * (x - Y) ** 2 / 2 + 0.1 * m * choice + 0.5 * sqrt(m * k) * sympy.E * y**2 - (x + y) * m * y / 7,
        forces={x: -x.dot / (8 * (x**2 + k))},
        dissipation=Max(x.dot, 0) ** 2 / 7,
        constraints={"line": y - x - sympy.sinc(x) / 9 + Rational(1, 9)},
        parameters={m: 1, k: 2.5, w: 3},
        initial={x.dot: 0.25, y.dot: 0.25},
        positions={"p": (x, y), "q": (0, -y)},
        links=[("origin", "p"), ("p", "q", "spring")],
        name="rich",
    )


def test_a_system_of_python_reads_back_as_the_same_motion(tmp_path: Path) -> None:
    stated = rich()
    read = lg.System.from_scene(stated.to_scene(tmp_path / "rich.toml"))
    assert difference(stated.statement, read.statement) == ""
    models = [system.compile("numpy", check=False) for system in (stated, read)]
    ours, theirs = (model.accelerations([0.4, 0.3], [0.2, -0.1], 0.7) for model in models)
    # the same operations but for the order of factors and terms, some hundred roundings
    assert abs(ours - theirs).max() < 1e-12 * abs(ours).max()


def test_dimensions_units_and_greek_names_are_kept(tmp_path: Path) -> None:
    theta = lg.coordinate("θ")
    omega, length, mass = lg.parameters("ω l m")
    stated = lg.System(
        kinetic=mass * length**2 * theta.dot**2 / 2,
        potential=mass * length**2 * omega**2 * (1 - cos(theta)),
        parameters={omega: 1, length: 2, mass: 3},
        dimensions={mass: "kg", length: "2*m", omega: "angular_velocity"},
    ).statement
    found = {str(symbol): one for symbol, one in again(stated, tmp_path).dimensions.items()}
    assert found == {str(symbol): one for symbol, one in stated.dimensions.items()}
    assert difference(stated, again(stated, tmp_path)) == ""


def test_random_expressions_are_read_back_equal() -> None:
    chance = random.Random(5)
    a, b, c = sympy.symbols("a b c", real=True)
    names = {"a": a, "b": b, "c": c}

    def grown(depth: int) -> Any:
        if depth == 0:
            number = Rational(chance.randint(-5, 5) or 7, chance.randint(1, 4))
            return chance.choice([a, b, c, number, sympy.Float(chance.uniform(-2, 2))])
        left, right = grown(depth - 1), grown(depth - 1)
        makers = [
            lambda: left + right,
            lambda: left - right,
            lambda: left * right,
            lambda: left / (right**2 + 3),
            lambda: (left**2 + 1) ** chance.choice([Rational(1, 2), Rational(-1, 2), Rational(2, 3), -1, 3]),
            lambda: sin(left),
            lambda: exp(-(left**2)) * right,
            lambda: Piecewise((left, a < b), (right, True)),
        ]
        return chance.choice(makers)()

    for _ in range(150):
        made = grown(3)
        written = expression_text(made)
        found = read_expression(written, names)
        values = {a: Rational(3, 10), b: Rational(7, 9), c: Rational(-5, 11)}
        ours, theirs = made.xreplace(values).evalf(30), found.xreplace(values).evalf(30)
        # both are exact but for thirty digits; cancellation takes a few
        assert abs(ours - theirs) <= 1e-22 * max(1, abs(ours)), (made, written)


def test_what_is_the_same_in_another_form_is_the_same_and_another_number_is_not() -> None:
    u, v = sympy.symbols("u v", real=True)
    assert same_statement._same((u + v) ** 2, u**2 + 2 * u * v + v**2)
    assert not same_statement._same(u * v, u * v * (1 + Rational(1, 10**15)))
    assert not same_statement._same(Function("f")(u), u)


free = m * x.dot**2 / 2

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no value": ({"potential": k * x**2, "parameters": {m: 1}}, "k has no value"),
    "no formula": ({"potential": Function("U")(x)}, r"contains U\(x\(t\)\), which is not written out"),
    "open function": ({"potential": x * lg.given("X")}, "X is given without values"),
    "third rate": (
        {"potential": x * lg.given("X", sin(lg.t)).diff(lg.t, 3)},
        r"the potential energy contains the derivative Derivative\(X, \(t, 3\)\)",
    ),
    "digits": ({"potential": sympy.Float("0.1", 40) * x}, "more digits than a floating-point number"),
    "step at zero": ({"potential": sympy.Heaviside(x, 1)}, "potential: heaviside takes 1 argument, not 2"),
    "condition": (
        {"potential": Piecewise((x, (x > 0) & (lg.t > 1)), (0, True))},
        "the condition .* which is no chain of comparisons",
    ),
    "title": ({"name": "a\nb"}, "a scene's name has 1 to 64 printable characters"),
    "long": ({"potential": sympy.Add(*(Rational(1, 10**50 + i) * x**i for i in range(1, 201)))}, "more than 10000"),
    "deep": ({"potential": reduce(lambda e, _: sin(e) + x, range(70), x)}, "deep"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_no_scene_holds_is_refused_in_a_sentence(what: str, tmp_path: Path) -> None:
    stated, sentence = REFUSED[what]
    system = lg.System(**{"kinetic": free, "parameters": {m: 1}} | stated)
    with pytest.raises(lg.StatementError, match=f"cannot be written as a scene: .*{sentence}"):
        system.to_scene(tmp_path / "none.toml")
    assert list(tmp_path.iterdir()) == []


def test_a_scene_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match="there is no folder"):
        rich().to_scene(tmp_path / "missing" / "rich.toml")
    old = tmp_path / "old.toml"
    old.write_text("kept", encoding="utf-8")
    with pytest.raises(lg.StatementError):
        lg.System(kinetic=free).to_scene(old)
    assert old.read_text(encoding="utf-8") == "kept"
    assert scene_from_text(scene_text(rich().statement)).name == "rich"


def test_a_system_gives_the_energies_that_were_stated() -> None:
    system = rich()
    for found, stated in ((system.kinetic, system.statement.kinetic), (system.potential, system.statement.potential)):
        assert sympy.expand(found - stated).equals(0)
    assert (system.kinetic - system.potential - system.lagrangian).expand().equals(0)
    alone = lg.System(lagrangian=free - k * x)
    assert alone.kinetic == alone.lagrangian and alone.potential == 0
