"""The page as a file: its contents, its permissions, and refusals."""

import base64
import hashlib
import json
import re
from collections.abc import Callable
from functools import cache
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sympy import cos, erf, sin

import lagrange as lg
from lagrange.cli.program import main
from lagrange.errors import StatementError
from lagrange.page.document import COMPUTED, PICTURES, RECORDED, TEMPLATE, as_json, contents, in_script, rate_of
from lagrange.page.web_page import FoldedFormulas, nice, parameter_bounds
from lagrange.show.figures.paths import AZIMUTH, ELEVATION, from_side, spring
from lagrange.show.notation.sections import sections
from tests.models import shared_scene
from tests.refusals import refusal
from tests.systems import pendulum

Captured = pytest.CaptureFixture[str]
Pages = Callable[[str], Path]
"""The fixture `page_of`: the name of a scene -> its page."""


def parts(page: Path) -> tuple[list[str], list[str]]:
    """Return the scripts and the styles of a page."""
    text = page.read_text("utf-8")
    scripts, styles = (re.findall(rf"<{tag}\b[^>]*>(.*?)</{tag}>", text, re.DOTALL) for tag in ("script", "style"))
    return scripts, styles


def data(page: Path) -> dict[str, Any]:
    """Return the data about the system in a page."""
    return data_of(page.read_text("utf-8"))


def data_of(text: str) -> dict[str, Any]:
    """Return the data about the system in the text of a page."""
    result: dict[str, Any] = json.loads(text.partition('id="data">')[2].partition("</script>")[0])
    return result


@pytest.fixture(scope="module")
def page_of(tmp_path_factory: pytest.TempPathFactory) -> Pages:
    """Return a function that writes the page of a scene, once for all tests. "" is a pendulum without positions."""

    @cache
    def written(scene: str) -> Path:
        system = shared_scene(scene) if scene else pendulum()
        return system.to_page(tmp_path_factory.mktemp("page") / "page.html")

    return written


def test_a_double_pendulum_takes_less_than_200_kb_and_nothing_from_elsewhere(page_of: Pages) -> None:
    page = page_of("double-pendulum")
    assert page == page.resolve()
    assert page.stat().st_size < 200_000
    text = page.read_text("utf-8")
    assert not re.search(r"""\b(src|href|url|import)\b\s*[=(]""", text)
    assert set(re.findall(r"https?://[^\"' ]*", text)) == {"http://www.w3.org/1998/Math/MathML"}


@pytest.mark.parametrize(
    "scene", ["double-pendulum", *(pytest.param(x, marks=pytest.mark.slow) for x in ("four-bar", "two-point-vortices"))]
)
def test_the_page_has_the_exported_bytes(scene: str, tmp_path: Path, page_of: Pages) -> None:
    system = shared_scene(scene)
    file, _ = system.export("javascript", tmp_path, contents(system.statement)).files
    module = parts(page_of(scene))[0][2]
    assert module.startswith(file.read_text())
    assert module.removeprefix(file.read_text()).startswith(
        "\nstartPage({ prepare, STATE, PREPARED, rhs, energy, dop853"
    )


def test_the_policy_allows_what_is_there_alone(page_of: Pages) -> None:
    page = page_of("pendulum")
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page.read_text("utf-8"))
    (_, *scripts), (style,) = parts(page)
    hashes = [
        f"'sha256-{base64.b64encode(hashlib.sha256(item.encode()).digest()).decode()}'" for item in (*scripts, style)
    ]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules == {
        "default-src": "'none'",
        "script-src": " ".join(hashes[:2]),
        "style-src": hashes[2],
        "base-uri": "'none'",
        "form-action": "'none'",
        "require-trusted-types-for": "'script'",
        "trusted-types": "'none'",
    }
    assert not re.search(r"<[^>]*\s(style|on\w+)=", page.read_text("utf-8"))


def test_the_same_statement_gives_the_same_page(tmp_path: Path, page_of: Pages) -> None:
    assert pendulum().to_page(tmp_path / "page.html").read_bytes() == page_of("").read_bytes()


def test_every_file_of_the_template_is_used() -> None:
    names = {path.name for path in TEMPLATE.iterdir()}
    pages = {"page.html", "player.html", "page.css", "system.css", "player.css", "loader.js"}
    assert names == {*pages, *(f"{name}.js" for name in (*PICTURES, *COMPUTED, *RECORDED))}
    assert all(path.read_text("utf-8").count("\n") <= 400 for path in TEMPLATE.iterdir())


def test_texts_in_a_script_end_no_script() -> None:
    assert in_script("// </script> <!-- <SCRIPT> a < b") == "// <\\/script> <\\!-- <\\SCRIPT> a < b"
    text = as_json({"name": "</script><!--&\u2028"})
    assert json.loads(text) == {"name": "</script><!--&\u2028"}
    assert not re.search("[<>&\u2028]", text)


def test_what_is_given_is_in_the_page(tmp_path: Path) -> None:
    system = pendulum()
    page = system.to_page(tmp_path / "page.html", parameters={"l": 2.5}, initial={"theta_dot": 3.0})
    assert data(page)["parameters"] == [1.0, 9.81, 2.5]
    assert data(page)["initial"] == [2.0, 3.0]
    assert "default_parameters = Object.freeze([1.0, 9.81, 2.5])" in page.read_text("utf-8")


def test_springs_rods_and_points_are_in_the_page(page_of: Pages) -> None:
    result = data(page_of("double-pendulum"))
    assert (result["points"], result["dimension"]) == (["bob1", "bob2"], 2)
    assert result["links"] == [[2, 0, "rod"], [0, 1, "rod"]]
    result = data(page_of("elastic-pendulum"))
    assert result["links"] == [[1, 0, "spring"]]


def test_springs_and_directions_of_space_are_those_of_figures(page_of: Pages) -> None:
    result = data(page_of("elastic-pendulum"))
    start, end = np.array([1.0, 2.0]), np.array([4.0, 6.0])
    along, aside = np.array(result["spring"]).T
    corners = start[:, None] + np.outer(end - start, along) + 0.5 * np.outer([-0.8, 0.6], aside)
    assert corners == pytest.approx(spring(start, end, 0.5), abs=1e-3)  # four digits of a unit
    seen = from_side(*np.degrees(result["view"]))
    assert seen.matrix == pytest.approx(from_side(AZIMUTH, ELEVATION).matrix, abs=1e-15)


def test_fixed_points_have_no_colour_and_no_entry_in_the_legend(tmp_path: Path) -> None:
    theta, l = lg.coordinate("theta"), lg.parameters("l")
    positions = {"pivot": (0, l), "bob": (l * sin(theta), l - l * cos(theta)), "tip": (2 * l * sin(theta), l)}
    page = pendulum(positions=positions, links=[("pivot", "bob")]).to_page(tmp_path / "page.html")
    assert data(page)["colours"] == [None, 0, 1]
    entries = re.findall(r'<li><i class="(\w+)"></i>(\w+)</li>', page.read_text("utf-8"))
    assert entries == [("colour0", "bob"), ("colour1", "tip")]


def test_a_velocity_has_no_dot_beside_its_slider_or_plot(page_of: Pages) -> None:
    page = page_of("")
    assert [state["letter"] for state in data(page)["states"]] == ["θ", "dθ/dt"]
    label = re.findall(r'<label for="slider4">(.*?)</label>', page.read_text("utf-8"))
    assert re.sub("<[^>]*>", "", label[0]) == "dθ/dt"


def test_a_system_without_energies_or_positions(page_of: Pages) -> None:
    assert contents(shared_scene("two-point-vortices").statement) == ("rhs", "energy", "dop853", "positions")
    page = page_of("")
    assert "No positions are stated for this system" in page.read_text("utf-8")
    assert data(page)["dimension"] == 0


def test_what_can_be_turned_says_so(page_of: Pages) -> None:
    said = '<p class="hint">Drag to turn</p>'
    assert said in page_of("spherical-pendulum").read_text("utf-8")
    assert said not in page_of("pendulum").read_text("utf-8")


def test_formulas_that_are_too_long_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lagrange.page.web_page.LONGEST_SECTION", 400)
    text = pendulum().to_page(tmp_path / "page.html").read_text("utf-8")
    assert text.count("These formulas are too long to be read here: `lagrange derive` prints them.") > 1
    assert "<summary>Equations of motion</summary>" in text


# --- sliders


def test_formulas_that_are_surely_too_long_are_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """The energies of 50 particles took half a minute to print before they were left out."""
    x = lg.coordinate("x")
    monkeypatch.setattr("lagrange.page.web_page.LONGEST_SECTION", 600)
    system = lg.System(kinetic=x.dot**2 / 2, potential=sum(sin(k * x) for k in range(1, 20)), coordinates=[x])
    page = FoldedFormulas(system.statement)
    monkeypatch.setattr(page, "lines", None)
    (section, *_) = sections(system.derivation())
    assert "too long to be read here" in page.section(section)


def test_bounds_of_sliders() -> None:
    assert parameter_bounds(9.81) == (1.0, 30.0)
    assert parameter_bounds(-1.0) == (-3.0, -0.1)
    assert parameter_bounds(0.0) == (0.0, 1.0)
    assert [nice(size) for size in (0.03, 0.11, 2.5, 1.0, 7.0, 5e-324)] == [0.03, 0.2, 3.0, 1.0, 10.0, 5e-324]


def test_an_angle_goes_all_round_and_other_coordinates_keep_their_sign(page_of: Pages) -> None:
    text = page_of("elastic-pendulum").read_text("utf-8")
    bounds = {
        spoken: (float(low), float(high))
        for low, high, spoken in re.findall(r'min="([^"]*)" max="([^"]*)"[^>]*aria-label="([^"]*)"', text)
    }
    assert bounds["initial value of theta"] == pytest.approx((-3.141592653589793, 3.141592653589793))
    assert bounds["initial value of r"] == pytest.approx((0.11, 2.09))
    assert bounds["initial value of theta_dot"][1] > 0


def test_sliders_that_are_asked_for_stand_first(tmp_path: Path) -> None:
    system = pendulum()
    (theta,) = system.coordinates
    page = system.to_page(tmp_path / "page.html", sliders={theta.dot: (-2, 2), "l": (0.5, 2)})
    assert [(item["kind"], item["place"]) for item in data(page)["sliders"]] == [
        ("state", 1),
        ("parameter", 2),
        ("parameter", 0),
        ("parameter", 1),
        ("state", 0),
    ]
    assert 'id="slider1" min="0.5" max="2.0" step="any" value="1.0"' in page.read_text("utf-8")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"sliders": {"thetta": (0, 1)}}, "of pendulum: they are m, g, l, theta and theta_dot. Did you mean 'theta'?"),
        ({"sliders": {3: (0, 1)}}, "there is no slider of '3'"),
        ({"sliders": ["l"]}, "sliders is a list: give a dict from name to bounds, such as {'l': (0.5, 2.0)}."),
        ({"sliders": {"l": 3}}, "the slider of l is 3: give its lower and its upper bound, such as (0.5, 2.0)."),
        ({"sliders": {"l": (0, float("inf"))}}, "a bound of the slider of l is inf: give a finite number."),
        ({"sliders": {"l": (0, 0)}}, "the slider of l goes from 0 to 0, which is an empty range"),
        ({"sliders": {"l": (0.2, 0.5)}}, "but l is 1: give bounds with 1 between them, or l another value."),
        ({"sliders": {"l": (2, 0)}}, "the slider of l goes from 2 to 0: give the lower bound first, (0, 2)."),
        (
            {"sliders": {"l": (2, 3)}},
            "the slider of l goes from 2 to 3, but l is 1: give bounds with 1 between them, or l another value.",
        ),
        ({"initial": {"phi": 1}}, "initial names 'phi', which is not a coordinate or velocity"),
        ({"path": "/nowhere/page.html"}, "Cannot write /nowhere/page.html: there is no folder /nowhere."),
        ({"path": 3}, "the path is 3 (int)"),
    ],
)
def test_a_wrong_request_is_refused_and_leaves_nothing(given: dict[str, Any], said: str, tmp_path: Path) -> None:
    assert said in refusal(pendulum().to_page, **{"path": tmp_path / "page.html", **given})
    assert list(tmp_path.iterdir()) == []


def test_a_function_that_javascript_has_not() -> None:
    theta = lg.coordinate("theta")
    assert refusal(pendulum(potential=erf(theta)).to_page, "page.html") == (
        "a page of pendulum cannot be made: its energy contains erf, which JavaScript does not have. State the system "
        "without erf."
    )


@pytest.mark.parametrize(
    ("t_end", "shown"), [(10.0, 1.0), (60.0, 1.0), (1.0, 1.0), (0.03, 0.002), (365.0, 20.0), (-5.0, -1.0)]
)
def test_how_fast_time_passes(t_end: float, shown: float) -> None:
    assert rate_of(t_end) == shown


# --- the command


def test_the_command_writes_a_page(tmp_path: Path, capsys: Captured) -> None:
    file = tmp_path / "page.html"
    given = ["--set", "l=2", "--initial", "theta=30deg", "--slider", "l=0.5:3"]
    assert main(["page", "pendulum", "--out", str(file), *given]) == 0
    assert re.fullmatch(rf"wrote {file} \(\d+ kB\): open it in a browser\.\n", capsys.readouterr().out)
    assert data(file)["initial"][0] == pytest.approx(0.5235987755982988)
    assert main(["page", "pendulum", "--out", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(file), "bytes": file.stat().st_size}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--slider", "l"], "--slider l: write NAME=LOW:HIGH, such as --slider l=0.5:2."),
        (["--slider", "l=0:1", "--slider", "l=0:2"], "--slider gives l twice: give it once."),
        (["--slider", "l=0:x"], "--slider l: 'x' is not a number."),
    ],
)
def test_a_wrong_command(given: list[str], said: str, tmp_path: Path, capsys: Captured) -> None:
    assert main(["page", "pendulum", "--out", str(tmp_path / "page.html"), *given]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# --- Sliders in a notebook ---


def test_a_notebook_shows_the_page_with_the_chosen_sliders_first() -> None:
    system = shared_scene("double-pendulum")
    shown = system.explore(l1=(0.5, 0.8), theta2_dot=(-5, 5), t_end=4.0, play=False, style="dark")._repr_html_()
    assert shown.startswith('<iframe title="sliders of double-pendulum" sandbox="allow-scripts"')
    page = unescape(shown.partition('srcdoc="')[2])
    data = data_of(page)
    assert [(slider["kind"], slider["place"], slider["value"]) for slider in data["sliders"][:2]] == [
        ("parameter", 2, 0.8),
        ("state", 3, 0.0),
    ]
    assert (data["t_end"], data["play"]) == (4.0, False) and 'data-style="dark"' in page
    assert "class Motion" in page and "Equations of motion" not in page


@pytest.mark.parametrize(
    ("scene", "ranges", "words"),
    [
        ("double-pendulum", {"thetta1": (0, 1)}, "Did you mean 'theta1'?"),
        ("double-pendulum", {}, "no slider was asked for: give bounds such as explore(m1=(0, 2)), for one of m1, m2,"),
        ("double-pendulum", {"l1": (3, 3)}, "such as (1.5, 6.0)."),
        ("bouncing-ball", {"g": (1, 10)}, "explore() does not compute the motion of a system with contacts: system.to"),
        ("heavy-top", {"R_w": (0, 1)}, "they are m, g, a, J1, J3, R_body_x, R_body_y and R_body_z."),
    ],
)
def test_what_is_no_slider_is_refused(scene: str, ranges: dict[str, Any], words: str) -> None:
    assert words in refusal(shared_scene(scene).explore, **ranges)


def test_inputs_without_values_are_refused() -> None:
    x, force = lg.coordinate("x"), lg.given("u")
    pushed = lg.System(x.dot**2 / 2, forces={x: force})
    assert "u is a given function of time, and has no values" in refusal(pushed.explore, x=(0, 1))


def test_there_is_room_for_so_many_sliders() -> None:
    names = [f"{q.func.__name__}{rate}" for q in shared_scene("pleiades").coordinates for rate in ("", "_dot")]
    with pytest.raises(StatementError, match="28 sliders were asked for: give bounds for at most 12"):
        shared_scene("pleiades").explore(dict.fromkeys(names, (0, 1)))


def test_ranges_by_symbol_and_by_keyword_are_taken_together() -> None:
    system = shared_scene("pendulum")
    (theta,) = system.coordinates
    page = system.explore({theta.dot: (-1, 1), theta: (3, 4)}, l=(2, 3)).html
    sliders = [(slider["kind"], slider["value"]) for slider in data_of(page)["sliders"][:3]]
    assert sliders == [("state", 0.0), ("state", 3.0), ("parameter", 2.0)]
    assert "sliders is a list: give a dict" in refusal(system.explore, [("l", (1, 2))])


def test_page_of_contacts_plays_a_run(tmp_path: Path) -> None:
    ball = shared_scene("bouncing-ball")
    text = ball.to_page(tmp_path / "page.html", initial={"y": 2}).read_text("utf-8")
    assert "This page plays a recorded run" in text and 'id="data"' in text
    assert refusal(ball.to_page, tmp_path / "page.html", sliders={"e": (0, 1)}) == (
        "a page does not compute the motion of a system with contacts: leave sliders out, and the page plays a run "
        "with the given parameters and initial state."
    )
