"""Formulas as a book prints them, and the formulas of all scenes' pages by number."""

import io
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy
from sympy import Abs, Float, Function, Max, Piecewise, Rational, cos, exp, log, pi, sin, sqrt

import lagrange as lg
from lagrange.page.document import filled
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.latex_mathml import LatexNotation, MathmlNotation
from lagrange.show.notation.line_breaks import FormulaLine, LineWriter
from lagrange.show.notation.sections import (
    READABLE,
    ExpressionRows,
    Formula,
    Partial,
    Product,
    Rate,
    ShownQuantity,
    SignedTerms,
    Transpose,
    sections,
)
from lagrange.show.notation.text import Notation, UnicodeNotation, latex_text, markdown_text, plain_text
from lagrange.statement.declare import declare
from lagrange.statement.display import terminal_style, text_table
from lagrange.statement.typed.reader import TypedReader
from tests.models import SCENE_NAMES, shared_scene, stated_in

x, y, theta, phi = lg.coordinates("x y theta phi")
m, M, l, g, R, a, k, omega, c, G = lg.parameters("m M l g R a k omega c G")
t = lg.t
STATED = declare(
    kinetic=m * (x.dot**2 + y.dot**2 + theta.dot**2 + phi.dot**2) / 2,
    potential=M * (g + k + omega + c + G) * (R - a) * x + l,
    coordinates=[theta, phi, x, y],
    parameters={m: 1, M: 1, g: 1, k: 1, c: 1, G: 1, l: 1, R: 2, a: 1, omega: 1},
)


def written(expression: Any, notation: type[Notation]) -> str:
    return LineWriter(STATED, notation).setter.write(sympy.S(0) + expression)


@pytest.mark.parametrize(
    ("expression", "ascii_", "unicode_", "latex"),
    [
        (m * l**2 * theta.ddot, "m*l**2*theta_ddot", "m l² θ̈", r"m l^2 \ddot\theta"),
        (G * M * m / x, "G*m*M/x", "G m M/x", r"\frac{G m M}{x}"),
        (-g * sin(theta) / l, "-g*sin(theta)/l", "−(g/l) sin θ", r"-\frac{g}{l} \sin \theta"),
        (k * x / m, "k*x/m", "(k/m) x", r"\frac{k}{m} x"),
        (x / m, "x/m", "x/m", r"\frac{x}{m}"),
        (R - a, "R - a", "R − a", "R - a"),
        (a - R, "a - R", "a − R", "a - R"),
        ((a - R) * g * sin(theta), "-g*(R - a)*sin(theta)", "−g (R − a) sin θ", r"-g (R - a) \sin \theta"),
        (2 * g * sin(theta) / 3 / (R - a), None, "(2 g/(3 (R − a))) sin θ", r"\frac{2 g}{3 (R - a)} \sin \theta"),
        (
            sqrt(2 - sqrt(2)) * sqrt(g) / sqrt(l),
            "sqrt((2 - sqrt(2))*g/l)",
            "√((2 − √2) g/l)",
            r"\sqrt{\frac{(2 - \sqrt{2}) g}{l}}",
        ),
        (
            m * x.dot * y.dot + m * x.dot**2 - y.dot,
            "m*x_dot**2 + m*x_dot*y_dot - y_dot",
            "m ẋ² + m ẋ ẏ − ẏ",
            r"m \dot{x}^2 + m \dot{x} \dot{y} - \dot{y}",
        ),
        (
            m * g * x - k * sin(x) * cos(x),
            "m*g*x - k*sin(x)*cos(x)",
            "m g x − k sin x cos x",
            r"m g x - k \sin x \cos x",
        ),
        (
            m * g * x + k * sin(x) * cos(x),
            "k*sin(x)*cos(x) + m*g*x",
            "k sin x cos x + m g x",
            r"k \sin x \cos x + m g x",
        ),
        (x**2 + y**2 - l**2, "x**2 + y**2 - l**2", "x² + y² − l²", "x^2 + y^2 - l^2"),
        (l + x, "l + x", "l + x", "l + x"),
        (sin(theta) * cos(theta) * phi.dot**2, None, "φ̇² sin θ cos θ", r"\dot\phi^2 \sin \theta \cos \theta"),
        (cos(2 * theta), "cos(2*theta)", "cos 2θ", r"\cos 2 \theta"),
        (cos(omega * t), "cos(omega*t)", "cos(ω t)", r"\cos(\omega t)"),
        (sin(theta) ** 2 * sqrt(x), None, "√x sin² θ", r"\sqrt{x} \sin^2 \theta"),
        (
            (x**2 + y**2) ** Rational(-3, 2),
            "1/(x**2 + y**2)**(3/2)",
            "1/(x² + y²)^(3/2)",
            r"\frac{1}{(x^2 + y^2)^{3/2}}",
        ),
        (exp(-t / 2) * x, "x*exp(-t/2)", "x e^(−½ t)", r"x e^{-\frac{1}{2} t}"),
        (2 * pi * log(x), "2*pi*log(x)", "2 π ln(x)", r"2 \pi \ln(x)"),
        (Abs(x) * k, "k*abs(x)", "k |x|", r"k \left|x\right|"),
        (Float("6.674e-11") * m, "6.674e-11*m", "6.674·10⁻¹¹ m", r"6.674 \cdot 10^{-11} m"),
        (Float(2.0) * m, "2*m", "2 m", "2 m"),
        (Rational(7, 12) * m, "7*m/12", "(7/12) m", r"\frac{7}{12} m"),
        (Max(x, 0), None, "max(0, x)", r"\max(0, x)"),
        (sympy.Integer(0), "0", "0", "0"),
        (-x, "-x", "−x", "-x"),
        (c**x, "c**x", "c^x", "c^x"),
    ],
)
def test_formulas(expression: Any, ascii_: str | None, unicode_: str, latex: str) -> None:
    if ascii_ is not None:
        assert written(expression, Notation) == ascii_
    assert written(expression, UnicodeNotation).replace("θ̈", "θ̈") == unicode_
    assert written(expression, LatexNotation) == latex
    assert written(expression, MathmlNotation).count("<") % 2 == 0


def test_a_sum_has_the_sign_that_was_stated() -> None:
    turned = declare(kinetic=m * x.dot**2 / 2, potential=k * (a - R) ** 2 * x)
    assert LineWriter(turned, UnicodeNotation).setter.write(k * (R - a) * x) == "−k (a − R) x"


def test_cases_and_functions_of_time() -> None:
    switch = Piecewise((x, (x >= 0) & (y < 1)), (-x, True))
    assert written(switch, UnicodeNotation) == "{x if (x ≥ 0) and (y < 1); −x otherwise}"
    assert written(switch, LatexNotation) == (
        r"\begin{cases} x & (x \ge 0)\text{ and }(y < 1) \\ -x & \text{otherwise} \end{cases}"
    )
    pivot, u = Function("X")(t), Function("U")
    assert written(pivot.diff(t, 2) * m, UnicodeNotation) == "m Ẍ"
    assert written(m * l * pivot.diff(t) * theta.dot * cos(theta), UnicodeNotation) == "m l θ̇ Ẋ cos θ"
    assert written(m * pivot.diff(t) ** 2 / 2 + k * pivot / l, UnicodeNotation) == "½ m Ẋ² + (k/l) X"
    assert written(u(x), UnicodeNotation) == "U(x)"
    assert written(u(x).diff(x), UnicodeNotation) == "U'(x)"


@pytest.mark.parametrize("notation", [Notation, UnicodeNotation, LatexNotation, MathmlNotation])
def test_two_names_never_look_the_same(notation: type[Notation]) -> None:
    names = ["x1", "x_1", "theta", "theta_", "m_bob", "lambda[rod]", "lambda_rod", "p_x", "θ", "ω", "omega1"]
    writer = notation(names)
    assert len({writer.letter(name) for name in names}) == len(names)


def clashing() -> lg.System:
    names = lg.parameters("E T V L D Q_x p_x")
    energy, period, volume, length, drag, force, momentum = names
    return lg.System(
        m * length * x.dot**2 / 2,
        energy * x + period * volume * x**2,
        dissipation=drag * x.dot**2 / 2,
        forces={x: force - momentum},
        name="clashes",
    )


def test_our_letters_give_way_to_the_symbols_of_the_statement() -> None:
    text, latex = clashing().derivation().text(), clashing().derivation().latex()
    for line in (
        "kinetic_energy = m*L*x_dot**2/2",
        "dissipation = D*x_dot**2/2",
        "force_x = Q_x - p_x",
        "Lagrangian = kinetic_energy - potential_energy = m*L*x_dot**2/2 - T*V*x**2 - E*x",
        "momentum_x = dLagrangian/dx_dot = m*L*x_dot",
        "energy = m*L*x_dot**2/2 + T*V*x**2 + E*x",
    ):
        assert f"    {line}\n" in text
    assert r"\mathcal{E} = \frac{1}{2} m L \dot{x}^2 + T V x^2 + E x" in latex
    assert "ℒ = 𝒯 − 𝒱 = ½ m L ẋ² − T V x² − E x" in clashing().derivation().unicode()
    assert not re.search(r"\n    [ETVLD] = ", text)


def test_a_word_for_a_letter_has_no_underscore_in_latex() -> None:
    atwood = shared_scene("atwood-machine").derivation()  # the letter h is a length
    assert r"\mathrm{right\ side} = \begin{pmatrix}" in atwood.latex() and "<mi>right side</mi>" in atwood.html()


def test_energies_and_sentences_of_rotations_are_shown_as_stated_and_as_formulas() -> None:
    latex = shared_scene("heavy-top").derivation().latex()
    square = r"J_1 (R_{\mathrm{body}, x}^2 + R_{\mathrm{body}, y}^2)"
    assert latex.count(square) == 3 and "R\\_" not in latex  # in T, L and E


def test_our_letters_give_way_to_given_functions_too() -> None:
    field = lg.given("E")
    page = lg.System(m * x.dot**2 / 2, -k * field * x).derivation().unicode()
    assert "    ℰ = ½ m ẋ² − k x E\n" in page and "    m ẍ − k E = 0\n" in page


@pytest.mark.parametrize(
    ("terminal", "encoding", "style"), [(True, "utf-8", "unicode"), (True, "latin-1", "text"), (False, "utf-8", "text")]
)
def test_a_terminal_that_has_unicode_gets_it(
    terminal: bool, encoding: str, style: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminal(io.TextIOWrapper):
        def isatty(self) -> bool:
            return terminal

    monkeypatch.setattr(sys, "stdout", Terminal(io.BytesIO(), encoding=encoding))
    assert terminal_style() == style
    assert str(shared_scene("pendulum").derivation()) == shared_scene("pendulum").derivation().written(style)


def test_no_standard_output_is_plain_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert terminal_style() == "text"


def test_long_sums_are_broken_and_lines_are_bounded() -> None:
    total = sum((m * g * x**i * sin(theta) ** i for i in range(1, 12)), sympy.S.Zero)
    lines = LineWriter(STATED, UnicodeNotation).formula(Formula((x, total)))
    assert len(lines) > 1 and all(len(line.right) <= 103 for line in lines)
    assert [line.goes_on for line in lines] == [False] + [True] * (len(lines) - 1)
    assert lines[1].right.startswith("+ ")


def test_an_energy_that_is_merged_to_the_same_text_is_printed_once() -> None:
    """SymPy may change (R - a)**2 to (a - R)**2, which is printed with the stated sign."""
    stated, turned, another = (R - a) ** 2, (a - R) ** 2, R**2
    for second, count in ((turned, 1), (another, 2)):
        assert len(LineWriter(STATED, UnicodeNotation).formula(Formula((ShownQuantity("V"), stated, second)))) == count


@pytest.mark.slow
def test_accelerations_that_nobody_reads_are_a_sentence() -> None:
    system = shared_scene("spinning-top")
    page = system.derivation().text()
    longest = max(value.count_ops() for value in {**system.accelerations(), **system.derivation().multipliers}.values())
    assert (
        f"    The formulas are too long to be read: the longest has {longest} operations, and a page shows up to "
        f"{READABLE}. accelerations() has them as expressions; compile() gives them as numbers.\n"
    ) in page
    assert "q0_ddot = " not in page


@pytest.mark.slow
def test_a_part_of_the_accelerations_is_shown() -> None:
    page = shared_scene("cartesian-double-pendulum").derivation().text()
    assert "    The formulas are too long" in page or "    The other formulas are too long" in page


def test_html_folds_and_speaks_no_markup_of_the_statement() -> None:
    page = replace(shared_scene("chain-of-springs").derivation(), remarks=("a < b & c",)).html()
    assert page.startswith("<!doctype html>") and page.endswith("</html>\n")
    assert "<p>a &lt; b &amp; c</p>" in page
    assert "<details open><summary>Energy</summary>" in page and "http" not in page.replace(
        "http://www.w3.org/1998", ""
    )


@pytest.mark.slow
def test_html_folds_what_is_long() -> None:
    assert "<details><summary>" in shared_scene("spinning-top").derivation().html()


@pytest.mark.parametrize(
    ("factor", "ends"),
    [
        (m / 2, ("½ m (", ")", "m*(", ")/2")),
        (m * Rational(2, 7), ("(2/7) m (", ")", "2*m*(", ")/7")),
        (m / (2 * l), ("½ m (", ")/l", "m*(", ")/(2*l)")),
    ],
)
def test_a_number_stands_before_a_parenthesis_on_several_lines(factor: Any, ends: tuple[str, ...]) -> None:
    total = sum((x.dot * cos(theta + k * n) + y.dot * sin(phi + k * n)) ** 2 for n in range(1, 6))
    whole = sympy.Mul(factor, total, evaluate=False)
    book, text = (LineWriter(STATED, notation).broken(whole, 80) for notation in (UnicodeNotation, Notation))
    assert len(book) > 1 and book[0].startswith(ends[0]) and book[-1].endswith(ends[1])
    assert len(text) > 1 and text[0].startswith(ends[2]) and text[-1].endswith(ends[3])


# --- test_names ---


@pytest.mark.parametrize(
    ("name", "spelled"),
    [
        ("x", "x"),
        ("theta", r"\theta"),
        ("theta1", r"\theta_1"),
        ("m_bob", r"m_{\mathrm{bob}}"),
        ("omega_x_2", r"\omega_{x, 2}"),
        ("x_theta1", r"x_{\theta1}"),
        ("length", r"\mathrm{length}"),
        ("input", r"\mathrm{input}"),
        ("pi", r"\mathrm{pi}"),
        ("Alpha", r"\mathrm{Alpha}"),
        ("a__b", "a_b"),
        ("a_", "a"),
        ("θ1", r"\theta_1"),
        ("x_Ω", r"x_\Omega"),
        ("θx", r"\mathrm{thetax}"),
    ],
)
def test_letters(name: str, spelled: str) -> None:
    assert LatexNotation([name]).letter(name) == spelled


HOSTILE = "\\input{/etc/passwd} $x$ _a_ #1 & 50% ~^{}<b>|\"'`*[a](b)!\x1b[31m\nnew  line"


def test_latex_text_has_no_command_of_the_author() -> None:
    spelled = latex_text(HOSTILE)
    assert spelled.startswith(
        r"\textbackslash{}input\{/etc/passwd\} \$x\$ \_a\_ \#1 \& 50\% \textasciitilde{}\textasciicircum{}\{\}"
    )
    assert "\x1b" not in spelled and "\n" not in spelled
    assert r"\textless{}b\textgreater{}\textbar{}\textquotedbl{}" in spelled


def test_markdown_text_has_no_mark_of_the_author() -> None:
    spelled = markdown_text(HOSTILE)
    assert not set("\\`*_{}[]<>()#!|$~&") & set(re.sub(r"\\.", "", spelled))


def test_plain_text_is_one_line_without_controls() -> None:
    assert plain_text(" a\tb\n c\x1b[2J\u202e ") == "a b c[2J"


# --- Tables in plain text ---


def test_text_is_aligned_and_numbers_are_flush_right() -> None:
    table = text_table(("name", "n"), [("a", 1), ("long one", 200)])
    assert table.splitlines() == ["name        n", "--------  ---", "a           1", "long one  200"]


# --- Templates of pages are filled once: nothing that is put in is read as a field ---


def test_parts_stay_text() -> None:
    assert filled("<{{a}}|{{b}}>{ {{{a}}}", {"a": "{{b}}", "b": r"\1 {{a}}"}) == r"<{{b}}|\1 {{a}}>{ {{{b}}}"


# --- all formulas of all pages of scenes: both sides against the compiled model, and read back -----------------


LONG = (
    *("pleiades", "seven-body-mechanism", "hanging-chain", "spinning-top", "slider-crank", "free-flip"),
    *("sun-earth-moon", "four-bar", "four-bar-ladder", "four-bar-change-point"),
)
SCENES = [
    pytest.param(name, marks=[pytest.mark.slow] * (name in LONG))
    for name in SCENE_NAMES
    if "rotations" not in stated_in(name)
]
"""Equations in rates of rotations are read back by `compare` in tests of typed answers."""
DIGITS = 80
STEP = mpmath.mpf(10) ** -20
"""Central differences, nested once, leave 20 digits or more of what they are taken of."""
AGREEMENT = 1e-7
"""States that are on the constraints to 1e-10, relative, leave this much of the largest term."""


class Motion:
    """A state of a scene that satisfies its constraints, near the initial one, and values of the model there."""

    def __init__(self, system: lg.System, seed: int) -> None:
        self.system, self.statement = system, system.statement
        statement = system.statement
        self.model = system.compile(check=False)
        draw = np.random.default_rng(seed)
        scale = np.array([abs(x) or 1.0 for x in statement.initial])
        y = np.array(statement.initial) + 0.05 * scale * draw.uniform(-1, 1, len(scale))
        self.t, n = 0.3, len(statement.coordinates)
        keys = (*statement.coordinates, *statement.velocities)
        if statement.constraints or statement.name == "two-point-vortices":
            result = system.consistent(dict(zip(keys, y, strict=True)), t=self.t).initial
            y = np.array([result[key] for key in keys])
        self.q, self.v = y[:n], y[n:]
        self.a = self.model.accelerations(self.q, self.v, self.t)
        held = statement.constraints
        self.multipliers = self.model.multipliers(self.q, self.v, self.t) if held else np.zeros(0)
        plain = list(statement.plain.values())
        point = dict(zip(plain, np.column_stack([self.q, self.v, self.a]).ravel(), strict=True))
        point |= {p: statement.defaults[p] for p in statement.parameters}
        point |= {item.multiplier: x for item, x in zip(held, self.multipliers, strict=True)} | {lg.t: self.t}
        self.point = {symbol: mpmath.mpf(float(value)) for symbol, value in point.items()}
        self.functions: dict[Any, Callable[..., Any]] = {}

    def value(self, expression: Any, moved: Any = None) -> Any:
        """Return the value of an expression at the state, in multiple precision."""
        if expression not in self.functions:
            plain = expression.xreplace(self.statement.plain)
            assert plain.free_symbols <= set(self.point), expression
            self.functions[expression] = sympy.lambdify(list(self.point), plain, "mpmath", cse=True)
        with mpmath.workdps(DIGITS):
            return mpmath.mpmathify(self.functions[expression](*(self.point | (moved or {})).values()))

    def number(self, expression: Any) -> float:
        value = self.value(expression)
        assert isinstance(value, mpmath.mpf), expression
        return float(value)

    def slope(self, expression: Any, by: Any, moved: Any = None) -> Any:
        """Return the derivative of a stated expression by central differences."""
        at = {**self.point, **(moved or {})}
        symbol = by.xreplace(self.statement.plain)
        with mpmath.workdps(DIGITS):
            h = STEP * max(abs(at[symbol]), 1)
            ends = [self.value(expression, {**at, symbol: at[symbol] + sign * h}) for sign in (1, -1)]
            return (ends[0] - ends[1]) / (2 * h)

    def rate(self, value: Callable[[Any], Any]) -> float:
        """Return the time derivative along the motion of a function of the state."""
        plain = list(self.statement.plain.values())
        ends = []
        with mpmath.workdps(DIGITS):
            for s in (STEP, -STEP):
                moved = {lg.t: self.point[lg.t] + s}
                for q, v, a in zip(plain[::3], plain[1::3], plain[2::3], strict=True):
                    moved |= {q: self.point[q] + s * self.point[v], v: self.point[v] + s * self.point[a]}
                ends.append(value(moved))
            return float((ends[0] - ends[1]) / (2 * STEP))

    def side(self, side: Any) -> Any:
        match side:
            case ShownQuantity():
                value = self.quantity(side.letter, side.indices)
                return float(np.dot(*[np.asarray(value).ravel()] * 2)) if side.squared else value
            case Partial():
                return float(self.slope(self.stated(side.quantity), side.by))
            case Rate(inside=inside):
                by = inside.by if isinstance(inside, Partial) else self.velocity(inside.indices[0])
                return self.rate(partial(self.slope, self.statement.lagrangian, by))
            case Transpose():
                return np.asarray(self.side(side.matrix)).T
            case Product():
                factors = [np.asarray(self.side(factor)) for factor in side.factors]
                value = factors[0]
                for factor in factors[1:]:
                    value = value @ factor if value.ndim and factor.ndim else value * factor
                return value
            case SignedTerms():
                return sum((-1 if negative else 1) * np.asarray(self.side(term)) for negative, term in side.terms)
            case ExpressionRows():
                return np.array([[self.number(entry) for entry in row] for row in side.rows])
        return self.number(side)

    def velocity(self, name: str) -> Any:
        return next(q.dot for q in self.statement.coordinates if q.name == name)

    def stated(self, quantity: ShownQuantity) -> Any:
        s = self.statement
        table = {"L": s.lagrangian, "T": s.kinetic, "V": s.potential, "D": s.dissipation}
        held = {item.name: item.expression for item in s.constraints}
        return table[quantity.letter] if quantity.letter in table else held[quantity.indices[0]]

    def quantity(self, letter: str, indices: tuple[str, ...]) -> Any:
        s, names = self.statement, self.statement.names
        if letter in ("r", "v"):
            return self.point_of(letter, indices[0])
        if letter == "T" and indices:
            masses = {point.name: point.mass for point in self.system.derivation().points}
            return self.number(masses[indices[0]]) * self.side(ShownQuantity("v", indices, squared=True)) / 2
        if letter in ("L", "T", "V", "D", "f"):
            return self.number(self.stated(ShownQuantity(letter, indices)))
        rows = [item.name for item in s.constraints] if letter == "G" else list(names)
        values = {
            "E": lambda: self.model.energy(self.q, self.v, self.t),
            "J": lambda: self.model.energy(self.q, self.v, self.t),
            "p": lambda: self.model.momenta(self.q, self.v, self.t),
            "Q": lambda: np.array([self.number(force) for force in s.forces]),
            "M": self.mass,
            "h": lambda: (self.mass() @ self.a - self.gradient().T @ self.multipliers)[:, None],
            "G": self.gradient,
        }[letter]()
        places = tuple((rows if k == 0 else list(names)).index(index) for k, index in enumerate(indices))
        return np.squeeze(values[places]) if places else values

    def mass(self) -> Any:
        return self.model.mass_matrix(self.q, self.t, v=self.v)

    def gradient(self) -> Any:
        s = self.statement
        if not s.constraints:
            return np.zeros((0, len(s.coordinates)))
        return self.model.evaluate("constraint_gradient", self.q, self.v, self.t)

    def point_of(self, letter: str, name: str) -> Any:
        entries = self.statement.positions[name]
        if letter == "r":
            return np.array([[self.number(entry) for entry in entries]])
        return np.array([[self.rate(partial(self.value, entry)) for entry in entries]])


@cache
def page(name: str) -> tuple[lg.System, list[Formula]]:
    system = shared_scene(name)
    return system, [row for part in sections(system.derivation()) for row in part.rows if isinstance(row, Formula)]


@pytest.mark.few
@pytest.mark.parametrize("name", SCENES)
def test_each_side_is_what_the_compiled_model_gives(name: str) -> None:
    system, rows = page(name)
    motion = Motion(system, seed=1)
    for row in rows:
        first, *others = [np.asarray(motion.side(side), dtype=float) for side in row.sides]
        for side, value in zip(row.sides[1:], others, strict=True):
            scale = max(1e-9, *(np.max(np.abs(x), initial=0.0) for x in (first, value)))
            scale = max(scale, size(motion, side), size(motion, row.sides[0]))
            assert np.all(np.abs(first.squeeze() - value.squeeze()) <= AGREEMENT * scale), (row, first, value)


def size(motion: Motion, side: Any) -> float:
    """Return the largest term of a side, the scale of its rounding errors."""
    if isinstance(side, SignedTerms):
        return max((float(np.max(np.abs(motion.side(term)))) for _, term in side.terms), default=0.0)
    if isinstance(side, sympy.Expr):
        return max(abs(motion.number(term)) for term in sympy.Add.make_args(side))
    return 0.0


SIGNS = {"\N{MINUS SIGN}": "-", "·": "*", "×": "*", "\N{FUNCTION APPLICATION}": " "}


def strict(symbol: Any) -> str:
    """Return the name of a symbol as people type it: lambda_wire for lambda[wire]."""
    return str(symbol.name).replace("[", "_").removesuffix("]")


def typed(setter: Typesetter, text: str) -> str:
    """Return MathML as people type the formula."""
    for symbol, letter in sorted(setter.letters.items(), key=lambda pair: -len(pair[1])):
        text = text.replace(letter, f"<s>{strict(symbol)}</s>")
    return _typed(ElementTree.fromstring(f"<mrow>{text}</mrow>"))


def _typed(node: ElementTree.Element) -> str:
    parts = [_typed(child) for child in node]
    match node.tag:
        case "mfrac":
            return f"(({parts[0]})/({parts[1]}))"
        case "msup":
            return f"{parts[0].rstrip()}^({parts[1]})"
        case "msqrt":
            return f"sqrt({''.join(parts)})"
        case "mrow" | "mspace":
            return "".join(parts)
    return f" {SIGNS.get(node.text or '', node.text)} "


def printed(row: Formula, lines: list[FormulaLine]) -> Iterator[tuple[sympy.Expr, str]]:
    """Yield the expressions of a formula with their texts: the last side, and the side before it if there is one."""
    starts = [place for place, line in enumerate(lines) if not line.goes_on]
    texts = [" ".join(line.right for line in lines[a:b]) for a, b in pairwise([*starts, len(lines)])]
    sides = row.sides[-len(texts) :]
    if not lines[0].left:
        sides, texts = row.sides[:1], [re.split("<mo>=</mo>| = ", " ".join(texts))[0]]
    yield from ((side, text) for side, text in zip(sides, texts, strict=True) if isinstance(side, sympy.Expr))


@pytest.mark.parametrize("notation", [Notation, UnicodeNotation, LatexNotation, MathmlNotation])
@pytest.mark.parametrize("name", SCENES)
def test_what_is_printed_reads_back_as_the_same_numbers(name: str, notation: Any) -> None:
    system, rows = page(name)
    writer = LineWriter(system.statement, notation)
    reader = TypedReader({strict(symbol): symbol for symbol in writer.setter.letters}, {})
    draw = np.random.default_rng(2)
    point = {symbol: sympy.Float(float(draw.uniform(0.3, 1.7)), 30) for symbol in writer.setter.letters}
    for row in rows:
        for side, text in printed(row, writer.formula(row)):
            plain = typed(writer.setter, text) if notation is MathmlNotation else text
            (equation,) = reader.equations(f"{plain} - 1 = 0")
            expected = side.xreplace(system.statement.plain).xreplace(point)
            result = equation.zero.xreplace(point) + 1
            assert abs(sympy.N(result - expected, 25)) <= 1e-12 * max(1, abs(sympy.N(expected, 25))), (text, side)
