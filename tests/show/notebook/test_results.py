"""A law over all public result types: readable in text, and in a notebook bounded and without anybody's markup."""

import copy
import pickle
import re
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from sympy import Piecewise, cos, sin

import lagrange as lg
from lagrange.show.notebook.html_card import sentences, table
from lagrange.show.notebook.page_writer import PageWriter
from tests.models import g, l, m, shared_scene, theta
from tests.public import surface
from tests.refusals import refusal
from tests.show.examples import free
from tests.show.notebook.shown import HOSTILE, held, rich
from tests.systems import chain, pendulum

STATED = (
    *(lg.Claims, lg.Event, lg.Problem, lg.methods.CVODE, lg.methods.Taylor, lg.methods.ScipyRK45, lg.methods.ScipyRK23),
    *(lg.methods.ScipyDOP853, lg.methods.ScipyRadau, lg.methods.ScipyBDF, lg.methods.ScipyLSODA),
)
"""What users write themselves: its repr is how they write it."""

DUMP = re.compile(r"[A-Z]\w+\(\w+=|.* object at 0x")


SYSTEM = pendulum(
    dimensions={m: "kg", l: "m", g: "m/s**2", theta: "angle", lg.t: "s"},
    positions={"bob": (l * sin(theta), -l * cos(theta))},
    name=HOSTILE,
)
AT = {"theta": 0}


def race() -> lg.Race:
    return lg.race(SYSTEM, 1.0, methods=["rk4", "dop853"], tolerances=[1e-6], steps=[0.1], repeats=1)


RESULTS: dict[str, tuple[Callable[[], Any], str]] = {
    "system": (lambda: SYSTEM, "markdown"),
    "equations": (SYSTEM.equations, "markdown"),
    "accelerations": (SYSTEM.accelerations, "markdown"),
    "momenta": (lambda: SYSTEM.momenta, "markdown"),
    "derivation": (SYSTEM.derivation, "markdown"),
    "conserved": (SYSTEM.conserved, "markdown"),
    "one conserved": (lambda: SYSTEM.conserved()[0], "markdown"),
    "equilibria": (SYSTEM.equilibria, "markdown"),
    "one equilibrium": (lambda: SYSTEM.equilibria()[0], "markdown"),
    "modes": (lambda: SYSTEM.modes(AT), "markdown"),
    "linearization": (lambda: SYSTEM.linearize(AT), "markdown"),
    "hamiltonian": (SYSTEM.hamiltonian, "markdown"),
    "right equations": (lambda: SYSTEM.compare("l*theta_ddot = -g*sin(theta)"), "markdown"),
    "wrong equations": (lambda: SYSTEM.compare("l*theta_ddot = g*sin(theta)"), "markdown"),
    "report": (lambda: SYSTEM.check(points=1), "markdown"),
    "solution": (lambda: SYSTEM.run(1.0), "html"),
    "plot": (lambda: SYSTEM.run(1.0).plot(), "png"),
    "race": (race, "html"),
    "plot of a race": (lambda: race().plot(), "png"),
    "plot of eigenvalues": (lambda: SYSTEM.plot_eigenvalues("l", np.array([1.0, 2.0]), AT), "png"),
    "targets": (lg.targets, "html"),
    "scenes": (lg.scenes, "html"),
    "methods": (lg.methods.table, "markdown"),
    "plot of stability": (lambda: lg.methods.plot_stability("rk4"), "png"),
    "a long chain": (lambda: chain(30), "markdown"),
    "its derivation": (lambda: chain(30).derivation(), "markdown"),
    "a run of thirty coordinates": (lambda: free(30), "html"),
    "the run of a long chain": (lambda: chain(30).run(0.05, check=False), "html"),
    "a chain with long formulas": (lambda: chain(7).derivation(), "markdown"),
}
"""What a notebook shows as more than its repr, and how."""


LONG = pytest.mark.slow
"""What compiles a chain of thirty links, for some seconds."""


@pytest.mark.few
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=LONG if name == "the run of a long chain" else ()) for name in RESULTS]
)
def test_a_result_is_readable_and_bounded(name: str) -> None:
    make, kind = RESULTS[name]
    result = make()
    text = repr(result)
    assert len(text) <= 20_000 and not DUMP.match(text)
    shown = rich(result)
    assert set(shown) == {kind}
    for way, what in shown.items():
        held(way, what)


@pytest.mark.few
@pytest.mark.parametrize("kind", [kind for kind in surface.INSTANCES if kind not in STATED], ids=lambda k: k.__name__)
def test_no_public_class_shows_its_fields(kind: type) -> None:
    made = surface.INSTANCES[kind]()
    assert len(repr(made)) <= 20_000
    assert not DUMP.match(repr(made))
    for way, what in rich(made).items():
        held(way, what)


@pytest.mark.slow
def test_what_is_left_out_of_a_long_chain_is_said() -> None:
    page = chain(30)._repr_markdown_()
    assert "T: not shown here, it has 6633 operations" in page
    assert "the equations of motion: not shown here, they are derived from 8582 operations" in page
    assert "`print(system.derivation())` has it as text" in page
    assert "the energy is conserved" in page and "<details><summary>" not in page.split("Structure")[1]


def test_a_system_shows_energies_values_with_units_equations_and_what_is_kept() -> None:
    page = SYSTEM._repr_markdown_()
    assert r"T &= \frac{1}{2} m l^2 \dot\theta^2" in page and r"V &= -m g l \cos \theta" in page
    assert r"$m = 1$ kg" in page and r"$g = 9.81$ m/s\*\*2" in page
    assert r"$\theta = 2$ rad, all else 0" in page
    assert r"m l^2 \ddot\theta + m g l \sin \theta = 0" in page
    assert "the energy is conserved" in page


def test_a_parameter_without_a_value_is_said_to_have_none() -> None:
    x, (m, k) = lg.coordinate("x"), lg.parameters("m k")
    page = lg.System(m * x.dot**2 / 2, k * x**2 / 2, parameters={m: 2.0})._repr_markdown_()
    assert "$m = 2$" in page and "$k$ without a value" in page and "**Initial state**  all 0" in page


def test_a_short_derivation_leaves_out_the_steps() -> None:
    full, short = SYSTEM.derivation(), SYSTEM.derivation(detail="short")
    headings = [line for line in short.text().splitlines() if line[:1].isupper()]
    assert headings == ["Stated", "Lagrangian", "Equations of motion", "Accelerations", "Remarks"]
    assert "Coordinate" in full.text() and "Coordinate" not in short._repr_markdown_()
    assert pickle.loads(pickle.dumps(short)).text() == short.text()
    assert refusal(SYSTEM.derivation, detail="long").startswith("detail = 'long': choose one of full and short.")


def test_a_paper_has_author_title_date_and_problem() -> None:
    paper = SYSTEM.derivation().latex(title="A & B", author="Ada", date="1 May", problem="Derive 100 % of it.")
    assert r"\title{A \& B}" in paper and r"\author{Ada}" in paper and r"\date{1 May}" in paper
    assert r"\textbf{Problem.} Derive 100 \% of it.\par" in paper
    assert refusal(lambda: SYSTEM.derivation().latex(author=cast("Any", 5))).startswith("author")


def test_a_system_has_no_page() -> None:
    with pytest.raises(AttributeError, match=r"use derivation\(\), or to_page\(path\), which writes a web page"):
        assert SYSTEM.page is None


@pytest.mark.parametrize("copied", [copy.copy, lambda value: pickle.loads(pickle.dumps(value))], ids=["copy", "pickle"])
def test_lists_and_dicts_are_pythons_own_and_copy(copied: Callable[[Any], Any]) -> None:
    for made in (SYSTEM.equations(), SYSTEM.accelerations(), SYSTEM.conserved(), lg.scenes()):
        again = copied(made)
        assert again == made and rich(again) == rich(made) and repr(again) == repr(made)
    assert SYSTEM.equations() == list(SYSTEM.equations()) and dict(SYSTEM.momenta) == SYSTEM.momenta


def test_a_condition_is_no_tag() -> None:
    g, l = lg.parameters("g l")
    writer = PageWriter(SYSTEM.statement)
    assert writer.condition(g < l) == r"g \lt  l"
    assert "<" not in writer.side(Piecewise((g, g < l), (l, True)))


def test_modes_have_their_numbers_beside_the_formulas() -> None:
    stable = SYSTEM.modes(AT)._repr_markdown_()
    assert r"\omega_{1} = \sqrt{\frac{g}{l}} \approx 3.13209,\qquad \begin{pmatrix} 1 \end{pmatrix}" in str(stable)
    above = SYSTEM.modes(SYSTEM.equilibria()[1].at)
    assert r"\approx 3.13209 i,\qquad" in str(above._repr_markdown_())
    numbers = SYSTEM.modes({"theta": 0.0})._repr_markdown_()
    assert re.search(r"\\omega_\{1\} = 3\.1320", str(numbers)) and not re.search(r"\d\.\d{7}", str(numbers))


@pytest.mark.slow
def test_modes_with_long_formulas_have_their_numbers_alone() -> None:
    wide = shared_scene("double-pendulum").modes({"theta1": 0, "theta2": 0})._repr_markdown_()
    assert r"**Mode 1** $\omega_{1} \approx 2.3972$" in str(wide)


def test_a_run_without_output_has_a_card_and_no_picture() -> None:
    run = SYSTEM.run(1.0, t_eval=[1.0], max_steps=1)
    shown = run._repr_html_()
    assert not len(run.t) and "<img" not in shown and "max_steps" in shown


def test_a_table_has_as_many_rows_as_there_is_room_for() -> None:
    shown = table(("a", "b"), [["<x>", "y" * 900]] * 300)
    assert len(shown) < 13_000 and shown.count("<tr>") < 30 and "<x>" not in shown
    assert f"<p>{301 - shown.count('<tr>')} more rows: print() shows all.</p>" in shown
    assert "print() shows all" not in table(("a",), [["1"]] * 3)
    assert sentences(["s"] * 20).endswith("<p>12 more remarks: print() shows all.</p>")
