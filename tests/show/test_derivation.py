"""Derivations on paper: stored pages, their structure, and texts that must not occur in them."""

import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from matplotlib.mathtext import MathTextParser
from sympy import cos, sin

import lagrange as lg
from lagrange.equations import derivation as equations
from lagrange.show.notation.text import GREEK
from lagrange.show.notebook.shown_derivation import ShownDerivation, written_derivation
from lagrange.statement.coordinate import coordinate, coordinates, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.display import FORMATS
from tests.models import SCENE_NAMES, shared_scene
from tests.refusals import refusal

m, g, l, k, c = parameters("m g l k c")
theta, x = coordinates("theta x")


def cart(*remarks: str) -> ShownDerivation:
    return written_derivation(
        declare(
            kinetic=m * (x.dot**2 + (l + x) ** 2 * theta.dot**2) / 2,
            potential=-m * g * (l + x) * cos(theta) + k * x**2 / 2,
            coordinates=[x, theta],
            forces={x: sin(t)},
            dissipation=c * theta.dot**2 / 2,
            name="elastic pendulum",
            about="A swinging spring.",
            source="A book.",
        ),
        remarks,
    )


def test_forces_and_dissipation_have_their_place() -> None:
    page = cart("The energy is not conserved.").text()
    assert page.startswith("elastic pendulum\n\nStated\n    A swinging spring.\n    Source: A book.\n    T = ")
    for lines in (
        "    Q_x = sin(t)\n    D = c*theta_dot**2/2\n",
        "    d/dt(dL/dx_dot) = m*x_ddot\n    dL/dx = m*(l + x)*theta_dot**2 - k*x + m*g*cos(theta)\n    Q_x = sin(t)\n",
        "    d/dt(dL/dx_dot) - dL/dx = Q_x\n",
        "    dD/dtheta_dot = c*theta_dot\n    d/dt(dL/dtheta_dot) - dL/dtheta + dD/dtheta_dot = 0\n",
        "    m*x_ddot - m*(l + x)*theta_dot**2 + k*x - m*g*cos(theta) = sin(t)\n",
        "    M*(x_ddot, theta_ddot).T = h\n    M = [m,  0           ]\n        [0,  m*(l + x)**2]\n    h = [m*(l + x)*",
        "    theta_ddot = -2*x_dot*theta_dot/(l + x) - c*theta_dot/(m*(l + x)**2) - g*sin(theta)/(l + x)\n",
        "\nRemarks\n    The energy is not conserved.\n",
    ):
        assert lines in page


def test_a_lagrangian_is_shown_as_stated() -> None:
    page = written_derivation(declare(lagrangian=m * x.dot**2 / 2 - k * x**2 / 2)).text()
    assert "Stated\n    L = m*x_dot**2/2 - k*x**2/2\n" in page
    assert "V =" not in page and "Remarks" not in page


def test_what_is_too_large_is_said_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(equations, "BUDGET", 3)
    page = cart().text()
    assert "Equations of motion\n    Not written out: elastic pendulum is too large for the equations of motion" in page
    assert "Q_x = sin(t)" in page


def test_unknown_format_is_refused() -> None:
    assert refusal(cart().written, "markdwon") == (
        "'markdwon' is not a format of a derivation; they are text, unicode, latex, markdown and html. Did you mean "
        "'markdown'?"
    )


HOSTILE_NAMES = [
    *("input", "write18", "left", "edef", "Symbol", "Add", "Float", "Function", "gamma", "E", "S", "I"),
    "zeta_mathbf",
]


@pytest.mark.few
@pytest.mark.parametrize("style", FORMATS)
def test_names_are_never_commands(style: str) -> None:
    qs = [coordinate(name) for name in HOSTILE_NAMES]
    words = [parameters(f"{name}_par") for name in HOSTILE_NAMES]
    kinetic: Any = sum(word * q.dot**2 for word, q in zip(words, qs, strict=True))
    statement = declare(kinetic=kinetic, coordinates=qs, name="a\\input{b}$_c", about="\\write18{x} *y* \x1b[0m")
    page = written_derivation(statement).written(style)
    assert "\x1b" not in page
    if style in ("latex", "markdown"):
        commands = set(re.findall(r"\\([A-Za-z]+)", page.replace("\\\\", "")))
        assert not commands & {"input", "write", "edef", "mathbf"}
        assert re.search(r"\\left(?![(\[{.|])", page) is None


# --- constraints -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_a_turning_frame_conserves_is_the_jacobi_integral() -> None:
    theta, (m, g, R, w) = lg.coordinate("theta"), lg.parameters("m g R w")
    place = (R * sin(theta) * cos(w * lg.t), R * sin(theta) * sin(w * lg.t), -R * cos(theta))
    hoop = lg.System(lg.kinetic_energy(m, place), lg.gravity(m, place, g))
    text, paper = hoop.derivation().text(), hoop.derivation().latex()
    assert "\nJacobi integral\n    J = m*R**2*theta_dot**2/2 - m*R**2*w**2*sin(theta)**2/2 - m*g*R*cos(theta)\n" in text
    assert "\nEnergy\n" not in text
    assert r"the Jacobi integral $\sum_i \dot q_i p_i - L$ is conserved" in paper
    assert "Jacobi" not in shared_scene("charge-in-field").derivation().text()
    y = lg.coordinate("y")
    free = lg.System(m * ((x.dot - w * y) ** 2 + (y.dot + w * x) ** 2) / 2, 0).derivation().text()
    assert "\nJacobi integral\n    J = " in free and "\nEnergy\n" not in free
    wound = lg.System(m * (x.dot**2 + y.dot**2) / 2 + w * (x * y.dot - y * x.dot), m * g * y).derivation().text()
    assert "\nEnergy\n    E = " in wound and "the energy is conserved" in wound
    assert "Jacobi integral" not in hoop.derivation(detail="short").text().split("Remarks")[0]


def test_a_top_has_one_factor_for_each_acceleration_and_one_fraction() -> None:
    phi, theta, psi = lg.coordinates("phi theta psi")
    inertia, axial = lg.parameters("I1 I3")
    m, g, l = lg.parameters("m g l")
    spin = (
        inertia * (theta.dot**2 + phi.dot**2 * sin(theta) ** 2) / 2 + axial * (psi.dot + phi.dot * cos(theta)) ** 2 / 2
    )
    text = lg.System(spin, m * g * l * cos(theta)).derivation().text()
    assert (
        "\n    (I1*sin(theta)**2 + I3*cos(theta)**2)*phi_ddot + I3*psi_ddot*cos(theta)\n        + 2*(I1 - I3)" in text
    )
    assert "\n    p_psi = dL/dpsi_dot = I3*(phi_dot*cos(theta) + psi_dot)\n" in text
    phi_ddot = next(line for line in text.splitlines() if line.startswith("    phi_ddot = "))
    assert phi_ddot.endswith("/(I1*sin(theta))") and phi_ddot.count("/") == 1


def test_an_acceleration_is_its_equation_divided_by_its_mass_where_that_is_shorter() -> None:
    s, (m, g, k, d) = lg.coordinate("s"), lg.parameters("m g k d")
    hung = lg.System(m * s.dot**2 / 2, k * (s - d) ** 2 / 2 - m * g * s)
    assert "\n    s_ddot = g - k*(s - d)/m\n" in hung.derivation().text()


def test_matrices_are_multiplied_into_columns_and_one_of_zeros_is_left_out() -> None:
    x, psi, (m, k) = lg.coordinate("x"), lg.coordinate("psi"), lg.parameters("m k")
    free = lg.System(m * x.dot**2 / 2 + k * psi.dot**2 / 2, 0, constraints={"roll": x.dot - k * psi.dot}).derivation()
    assert "\n    M*(x_ddot, psi_ddot).T = G.T*lambda[roll]\n    M = " in free.text() and "    h = " not in free.text()
    assert r"M (\ddot{x}, \ddot\psi)^T = G^T \lambda_{\mathrm{roll}}" in free.latex()
    assert r"f_{\mathrm{roll}} = " in free.latex() and r"\psi_{" not in free.latex()


def test_an_energy_is_merged_where_it_is_stated() -> None:
    y = lg.coordinate("y")
    wheel = lg.System(m * (x.dot**2 + y.dot**2) / 2, m * g * y - m * g * (y + x))
    text = wheel.derivation().text()
    assert "    V = m*g*y - m*g*(x + y)\n      = -m*g*x\n" in text and text.count("    V = ") == 1
    assert "V &= m g y - m g (x + y) \\\\   &= -m g x" in wheel.derivation().latex()


def test_a_difference_of_constants_has_no_minus_before_it() -> None:
    m1, m2 = lg.parameters("m1 m2")
    atwood = lg.System((m1 + m2) * x.dot**2 / 2, m2 * g * x - m1 * g * x).derivation().text()
    assert "      = (m2 - m1)*g*x\n" in atwood and "(m1 + m2)*x_ddot + (m2 - m1)*g = 0" in atwood
    assert "    x_ddot = (m1 - m2)*g/(m1 + m2)\n" in atwood and "-(m" not in atwood


# --- whole derivation pages: stored ones, and the structure of the LaTeX and HTML of all scenes ----------------


PAGES = Path(__file__).parent / "pages"
GOLDEN = {
    "double-pendulum.tex": ("double-pendulum", "latex"),
    "spherical-pendulum.txt": ("spherical-pendulum", "unicode"),
    "cartesian-pendulum.md": ("cartesian-pendulum", "markdown"),
    "ladder.txt": ("ladder", "text"),
}
COMMANDS = GREEK | frozenset(
    [
        *("pi", "dot", "ddot", "frac", "sqrt", "left", "right", "bigl", "bigr", "quad", "qquad", "times", "sin"),
        *("cos", "ln", "partial", "begin", "end", "section", "mathrm", "mathcal", "text"),
    ]
)
"""Commands that LaTeX and its package amsmath have; the preamble aside, a page has no other."""
QUICK = ("bead-on-hoop", "double-pendulum", "kepler", "ladder", "thrown-ball")
SCENES = [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in SCENE_NAMES]


@pytest.mark.parametrize("file", GOLDEN)
def test_golden_pages(file: str) -> None:
    name, style = GOLDEN[file]
    assert getattr(shared_scene(name).derivation(), style)() == (PAGES / file).read_text("utf-8")


@pytest.mark.few(1)
@pytest.mark.parametrize("name", SCENES)
def test_latex_is_well_formed(name: str) -> None:
    page = shared_scene(name).derivation().latex()
    body = page[page.index("\\maketitle\n") + 10 : page.index("\\end{document}")]
    plain = re.sub(r"\\[{}$&#_%\\]", "", body)
    for begin, end in (("{", "}"), (r"\left", r"\right"), (r"\[", r"\]"), (r"\begin", r"\end"), (r"\bigl", r"\bigr")):
        assert plain.count(begin) == plain.count(end), begin
    assert set(re.findall(r"\\([A-Za-z]+)", plain)) - {"par"} <= COMMANDS
    script = r"(?:\{(?:[^{}]|\{[^{}]*\})*\}|\\[A-Za-z]+|\w)"
    assert not re.search(rf"\^{script}\s*\^|_{script}\s*_", body), "a double index or exponent"
    parser = MathTextParser("path")
    for formula in re.findall(r"\\\[ (.*) \\\]", body):
        if "begin{" not in formula:
            parser.parse("$" + re.sub(r"\\big[lr]", "", formula) + "$")


@pytest.mark.few(1)
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
@pytest.mark.parametrize("name", ["double-pendulum", "cartesian-pendulum", "bead-on-wire", "slider-crank"])
def test_pdflatex_sets_the_page(name: str, tmp_path: Path) -> None:
    (tmp_path / "page.tex").write_text(shared_scene(name).derivation().latex(), "utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"],
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Overfull" not in done.stdout


@pytest.mark.few
@pytest.mark.parametrize("name", SCENES)
def test_html_is_well_formed(name: str) -> None:
    page = shared_scene(name).derivation().html()
    ElementTree.fromstring(
        page.removeprefix("<!doctype html>\n").replace('<meta charset="utf-8">', "").replace(" open>", ">")
    )
    assert not re.search(r"<script|href=|src=", page)


def test_names_of_functions_have_thin_spaces_in_mathml() -> None:
    page = shared_scene("spherical-pendulum").derivation().html()
    space, theta = '<mspace width="0.17em"/>', "<mi>θ</mi>"
    assert f"<mi>l</mi>{space}<mrow><mi>sin</mi><mo>\N{FUNCTION APPLICATION}</mo>{space}{theta}</mrow>" in page
    assert f"{space}<mrow><msup><mi>sin</mi><mn>2</mn></msup>" in page
    assert f"(</mo>{space}" not in page
