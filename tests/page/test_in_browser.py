"""The page in Chromium: it moves like our runs, reacts to sliders, keys and touch, and runs only its own code."""

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser
from sympy import Abs, sqrt

import lagrange as lg
from lagrange.page.document import TOLERANCE
from lagrange.page.web_page import rates_at
from lagrange.show.figures.curve import around
from lagrange.show.figures.paths import Box
from tests.models import SCENE_NAMES, shared_scene, stated_in
from tests.page.browser import Tab, opened, program, started
from tests.page.test_page import data
from tests.systems import pendulum

pytestmark = pytest.mark.skipif(program() is None, reason="there is no Chromium on this machine")

EQUAL = 1e-9
"""How far a trajectory may be from ours, relative to the size of the entry.

What is left of the steps' own error is 2e-10 in the long run of Kepler's ellipse, and of rounding 7e-11 with Sun, Earth
and Moon.
"""

PHONE = 390, 844
"""Width and height of a phone."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with started() as made:
        yield made


def moves_as_ours(tab: Tab, system: lg.System, times: Sequence[float], result: Any = None) -> bool:
    """Return True if the states of a page, `found` or its trajectory, equal ours up to rounding."""
    values = tab.value("lagrange.values()")
    names = [*system.statement.names, *(f"{name}_dot" for name in system.statement.names)]
    run = system.run(
        times[-1],
        dict(zip(names, values["initial"], strict=True)),
        parameters=dict(zip(system.statement.parameters, values["parameters"], strict=True)),
        method="dop853",
        rtol=TOLERANCE,
        atol=TOLERANCE,
    ).require()
    if result is None:
        result = tab.value(f"lagrange.trajectory({json.dumps(list(times))})")
    sizes = np.abs(run.y).max(axis=1)
    off = np.abs(np.array(result) - run.at(times).T)
    return bool((off <= EQUAL * np.maximum(sizes, 1e-3 * sizes.max())).all())


def set_start(tab: Tab, system: lg.System) -> None:
    """Move the slider of the first initial value that no constraint fixes."""
    count, first = len(system.statement.names), len(system.statement.parameters)
    for k in range(2 * count):
        value = slide(tab, first + k)
        if tab.text("#said") == "":
            entry = k // 2 + k % 2 * count  # a velocity stands below its coordinate
            assert tab.value(f"lagrange.values().initial[{entry}]") == pytest.approx(value, rel=1e-12)
            return
    pytest.fail("no initial value could be set")


def slide(tab: Tab, place: int) -> float:
    """Move a slider by a part of its range, and return its new value."""
    low, high, value = (
        float(tab.value(f"document.querySelector('#slider{place}').{of}")) for of in ("min", "max", "value")
    )
    moved = value + 0.03 * (high - low)
    tab.type(f"#number{place}", moved)
    return moved


def scenes(quick: str, names: Sequence[str]) -> list[Any]:
    """Return scenes as test parameters, all but one of them slow."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name != quick)) for name in names]


TURNING = scenes("heavy-top", [name for name in SCENE_NAMES if "rotations" in stated_in(name)])


@pytest.mark.parametrize("scene", TURNING)
def test_a_scene_with_rotations_follows_the_sliders_of_its_rates(scene: str, browser: Browser, tmp_path: Path) -> None:
    """The sliders are the initial rates about the axes of the body. Constraints may change other values."""
    system = shared_scene(scene)
    page = system.to_page(tmp_path / "page.html")
    kinds = [slider["kind"] for slider in data(page)["sliders"]]
    assert kinds.count("rate") == 3 * len(system.statement.rotations)
    with opened(browser, page) as tab:
        tab.click("#play")
        assert moves_as_ours(tab, system, [0.0, 0.1])
        moved = slide(tab, kinds.index("rate") + 2)
        assert tab.text("#said") == ""
        initial = tab.value("lagrange.values().initial")
        assert np.linalg.norm(initial[system.statement.names.index("R_w") :][:4]) == pytest.approx(1, abs=1e-12)
        if not system.statement.constraints:
            assert rates_at(system.statement, initial)[2] == pytest.approx(moved, rel=1e-12)
        assert moves_as_ours(tab, system, [0.0, 0.1])


SHOWN = scenes(
    "cartesian-pendulum", [name for name in SCENE_NAMES if stated_in(name).isdisjoint({"contacts", "rotations"})]
)
"""A page has no contacts. Those with rotations have sliders of rates, see below."""


@pytest.mark.parametrize("scene", SHOWN)
def test_a_scene_moves_as_ours_and_follows_its_sliders(scene: str, browser: Browser, tmp_path: Path) -> None:
    system = shared_scene(scene)
    end = system.statement.run.t_end
    with opened(browser, system.to_page(tmp_path / "page.html")) as tab:
        tab.click("#play")
        assert tab.text("#play") == "Play"
        assert tab.value("lagrange.values()") == {
            "parameters": [system.parameters[p] for p in system.statement.parameters],
            "initial": list(system.statement.initial),
        }
        assert moves_as_ours(tab, system, np.linspace(0.0, end, 21).tolist())
        tab.click("#reset")
        tab.click("#step", 5)
        state = tab.value("lagrange.state()")
        assert moves_as_ours(tab, system, [0.0, state["t"]], [list(system.statement.initial), state["y"]])
        if system.statement.parameters:
            moved = slide(tab, 0)
            assert tab.value("lagrange.values().parameters[0]") == pytest.approx(moved, rel=1e-12)
            assert tab.text("#said") == ""
            assert moves_as_ours(tab, system, np.linspace(0.0, end / 4, 6).tolist())
        set_start(tab, system)
        assert moves_as_ours(tab, system, np.linspace(0.0, end / 4, 6).tolist())
        assert tab.complaints == []


RUNS = "document.title = 'run'"


def evil() -> str:
    return f'</script><script>{RUNS}</script><img src=x onerror="{RUNS}"><!-- <script> {{{{data}}}}'


def test_texts_of_a_scene_file_stay_texts(browser: Browser, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    name = "</script><img src=x>"
    texts = f"name = '{name}'\nabout = '''{evil()}'''\nsource = '''{evil()}'''\n"
    scene.write_text(texts + 'coordinates = ["x"]\nkinetic = "x_dot**2/2"\npotential = "x**2/2"\n')
    with opened(browser, lg.System.from_scene(scene).to_page(tmp_path / "page.html")) as tab:
        assert tab.text("h1") == tab.value("document.title") == name
        assert tab.text("header p") == " ".join(evil().split())
        assert f"Source: {evil()}" in tab.text(".formulas")
        assert tab.value("document.querySelectorAll('script, img').length") == 3
        assert tab.complaints == []


AS_THE_PAGE = {"awaitPromise": True, "returnByValue": True, "allowUnsafeEvalBlockedByCSP": False}
"""Options that evaluate a script as the page's own policy allows."""

REFUSED = {
    "(b) => b.setAttribute('onclick', '0')": "TypeError: .*requires 'TrustedScript'",
    "(b) => { b.innerHTML = '<img src=x>' }": "TypeError: .*requires 'TrustedHTML'",
    "(b) => Function('return 1')()": "EvalError: .*Content Security Policy",
    "(b) => fetch('data:text/plain,x')": "TypeError: Failed to fetch",
}
"""What a script of another could try, and how the policy of the page answers."""


@pytest.fixture(scope="module")
def swinging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a pendulum."""
    return pendulum().to_page(tmp_path_factory.mktemp("page") / "page.html")


def test_nothing_else_runs_and_nothing_is_fetched(browser: Browser, swinging: Path) -> None:
    with opened(browser, swinging) as tab:
        for tried, answer in REFUSED.items():
            script = f"(async () => ({tried})(document.body))().catch(String)"
            result = tab.call("Runtime.evaluate", expression=script, **AS_THE_PAGE)["result"]
            assert re.match(answer, result["value"]), tried


def collapsing() -> lg.System:
    """Return a mass that falls into a centre of attraction at t = pi/(2 sqrt(2))."""
    x = lg.coordinate("x")
    m, k = lg.parameters("m k")
    return lg.System(
        kinetic=m * x.dot**2 / 2,
        potential=-k / Abs(x),
        parameters={m: 1, k: 1},
        initial={x: 1.0},
        positions={"mass": (x, 0)},
        links=[("origin", "mass", "spring")],
    )


def test_a_singular_state_stops_the_picture_with_a_sentence(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, collapsing().to_page(tmp_path / "page.html")) as tab:
        tab.click("#step", 40)
        assert tab.text("#said").startswith("The steps become too small near t = 1.111: a force grows without bound")
        assert tab.text("#play") == "Play"
        assert np.isfinite(tab.value("lagrange.state().y")).all()
        tab.type("#number2", 2.0)
        assert tab.text("#said") == ""
        tab.type("#number2", 0.0)
        assert tab.text("#said") == "The accelerations have no finite value at the start. Choose other values."
        tab.wait("document.querySelector('#time').textContent === '0.00'")
        assert "NaN" not in tab.value("document.body.innerText")
        assert tab.complaints == []


def test_a_state_off_the_domain_is_not_drawn(browser: Browser, tmp_path: Path) -> None:
    x = lg.coordinate("x")
    m = lg.parameters("m")
    system = lg.System(
        kinetic=m * x.dot**2 / 2, potential=m * x, parameters={m: 1}, initial={x: 0.5}, positions={"p": (x, sqrt(x))}
    )
    with opened(browser, system.to_page(tmp_path / "page.html")) as tab:
        tab.click("#step", 40)
        assert tab.text("#said").startswith("A position has no finite value near t = 1")
        assert tab.complaints == []


def test_the_start_stays_on_the_constraints(browser: Browser, tmp_path: Path) -> None:
    system = shared_scene("cartesian-pendulum")
    place = len(system.statement.parameters)
    with opened(browser, system.to_page(tmp_path / "page.html")) as tab:
        tab.type(f"#number{place}", 0.3)
        x, y, _, _ = tab.value("lagrange.values().initial")
        length = system.parameters[next(p for p in system.statement.parameters if p.name == "l")]
        assert x == pytest.approx(0.3, rel=1e-12)
        assert x**2 + y**2 == pytest.approx(length**2, rel=1e-12)
        before = tab.value("lagrange.values().initial")
        tab.type(f"#number{place}", 5.0)
        assert tab.text("#said") == "The constraints have no state near this one with x = 5."
        assert tab.value("lagrange.values().initial") == before
        tab.click("#defaults")
        assert tab.value("lagrange.values().initial") == list(system.statement.initial)
        assert tab.text("#said") == ""


@pytest.mark.slow
def test_a_value_that_jumps_moves_a_linkage_as_one_that_is_dragged(browser: Browser, tmp_path: Path) -> None:
    system = shared_scene("four-bar")
    place = [p.name for p in system.statement.parameters].index("l1")
    crank = []
    with opened(browser, system.to_page(tmp_path / "page.html")) as tab:
        for lengths in ([0.3], [0.825, 0.65, 0.475, 0.3]):
            tab.click("#defaults")
            for length in lengths:
                tab.type(f"#number{place}", length)
            crank.append(tab.value("lagrange.values().initial[0]"))
    # A single projection from afar ends 0.28 off the limit of small changes, one in parts 0.02.
    assert crank[0] == pytest.approx(crank[1], abs=0.05)


def test_a_browser_that_asks_for_less_motion_gets_a_page_at_rest(browser: Browser, swinging: Path) -> None:
    with opened(browser, swinging) as tab:
        assert tab.text("#play") == "Pause"
        tab.page.emulate_media(reduced_motion="reduce")
        tab.page.reload()
        tab.wait("lagrange.frames() < 30")
        assert tab.text("#play") == "Play"
        assert tab.value("lagrange.state().t") == 0


def test_keys(browser: Browser, swinging: Path) -> None:
    with opened(browser, swinging) as tab:
        tab.press("Space")
        assert tab.text("#play") == "Play"
        tab.press("r")
        assert tab.value("lagrange.state().t") == 0
        tab.press("ArrowRight")
        assert tab.value("lagrange.state().t") == pytest.approx(8 / 240)
        tab.press("-")
        assert tab.text("#speed-value") == "× 1/2"
        tab.press("+")
        tab.press("+")
        assert tab.text("#speed-value") == "× 2"
        tab.value("document.querySelector('#number0').focus()")
        tab.press("r")
        assert tab.value("lagrange.state().t") > 0  # a letter that is typed into a number is not a command
        tab.value("document.querySelector('#play').focus()")
        tab.press("Space")
        assert tab.text("#play") == "Pause"


def middle(tab: Tab, selector: str) -> tuple[float, float]:
    box = tab.value(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_fingers(browser: Browser, tmp_path: Path) -> None:
    system = shared_scene("spherical-pendulum")
    with opened(browser, system.to_page(tmp_path / "page.html"), *PHONE) as tab:
        x, y = middle(tab, "#play")
        tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        tab.wait("document.querySelector('#play').textContent === 'Play'")
        picture = "document.querySelector('#picture').toDataURL().length"
        tab.wait(f"(window.before = window.now) === (window.now = {picture})")  # what moves has come to rest
        drawn = tab.value("document.querySelector('#picture').toDataURL()")
        x, y = middle(tab, "#picture")
        tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        for k in range(1, 5):
            tab.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x + 15 * k, "y": y + 5 * k}])
        tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        tab.wait(f"document.querySelector('#picture').toDataURL() !== {json.dumps(drawn)}")
        assert tab.complaints == []


@pytest.mark.parametrize("scene", scenes("double-pendulum", ("double-pendulum", "pleiades", "four-bar")))
def test_a_phone_shows_everything_in_its_width(scene: str, browser: Browser, tmp_path: Path) -> None:
    with opened(browser, shared_scene(scene).to_page(tmp_path / "page.html"), *PHONE) as tab:
        assert tab.value("document.documentElement.scrollWidth") == PHONE[0]


def test_everything_that_is_operated_has_a_name(browser: Browser, tmp_path: Path) -> None:
    operated = ("button", "slider", "spinbutton", "combobox")
    with opened(browser, shared_scene("spherical-pendulum").to_page(tmp_path / "page.html")) as tab:
        nodes = tab.call("Accessibility.getFullAXTree")["nodes"]
        names = [node["name"]["value"] for node in nodes if node.get("role", {}).get("value") in operated]
        assert len(names) > 20
        assert all(names)
        pictures = [node["name"]["value"] for node in nodes if node.get("role", {}).get("value") == "image"]
        assert "Moving picture of spherical-pendulum: the points bob" in pictures


def test_light_and_dark(browser: Browser, swinging: Path) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    with opened(browser, swinging) as tab:
        assert tab.value(paper) == "rgb(255, 255, 255)"
        tab.click("#style")
        assert tab.value(paper) == "rgb(22, 25, 29)"
        assert tab.text("#style") == "Light"
    with opened(browser, swinging, dark=True) as tab:
        assert tab.value(paper) == "rgb(22, 25, 29)"
        tab.click("#style")
        assert tab.value(paper) == "rgb(255, 255, 255)"


def test_a_run_ends_where_a_given_function_does(browser: Browser, tmp_path: Path) -> None:
    x = lg.coordinate("x")
    m, k = lg.parameters("m k")
    wall = lg.given("wall", ([0.0, 0.5, 1.0, 1.5], [0.0, 1.0, 0.0, 1.0]))
    system = lg.System(
        kinetic=m * x.dot**2 / 2, potential=k * (x - wall) ** 2 / 2, parameters={m: 1, k: 5}, positions={"p": (x, 0)}
    )
    with opened(browser, system.to_page(tmp_path / "page.html")) as tab:
        tab.click("#step", 50)
        assert tab.text("#said") == "The given functions of time have values up to t = 1.5. Reset to see it again."
        assert tab.value("lagrange.state().t") == 1.5


@pytest.mark.slow
def test_the_change_of_an_energy_that_is_lost_is_negative(browser: Browser, tmp_path: Path) -> None:
    theta = lg.coordinate("theta")
    damped = pendulum(dissipation=theta.dot**2 / 4)
    with opened(browser, damped.to_page(tmp_path / "page.html")) as tab:
        tab.press("Space")
        tab.press("r")
        for _ in range(30):
            tab.press("ArrowRight")
        at = tab.value("lagrange.state().t")
        change = float(tab.text("#drift").replace("−", "-"))
        energy = damped.run(at, rtol=TOLERANCE).energy
        assert tab.text("#drift-name") == "energy change"
        assert change == pytest.approx(energy[-1] - energy[0], rel=1e-3)  # four digits are shown


def test_limits_and_the_floor_are_those_of_figures(browser: Browser, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    sizes = 10.0 ** np.arange(-9, 9, 3)[:, None]
    rows = [np.full(3, 1.0), np.array([1.0, 1.0 + 1e-12]), np.zeros(2), *(sizes * rng.normal(size=(6, 4)))]
    with opened(browser, shared_scene("spherical-pendulum").to_page(tmp_path / "page.html")) as tab:
        for row in rows:
            assert tab.value(f"around({row.min()!s}, {row.max()!s})") == pytest.approx(around(row), rel=1e-12)
        for _ in range(5):
            points = rng.normal(size=(3, 9)) * [[1.0], [3.0], [0.02]]
            bounds = json.dumps(np.stack([points.min(axis=1), points.max(axis=1)], axis=1).tolist())
            result = tab.value(f"(() => {{ const v = new View(3, [-1, 0.4]); v.bounds = {bounds}; return v.room; }})()")
            box = Box.around(points)
            np.testing.assert_allclose(result, np.stack([box.low, box.high], axis=1), atol=1e-12)


def test_axes_are_fixed_before_the_motion_begins(browser: Browser, tmp_path: Path) -> None:
    """The page computes the motion ahead in the frames before it, however many that takes."""
    system = shared_scene("double-pendulum")
    run = system.run(method="dop853", rtol=TOLERANCE).sampled(np.linspace(0.0, 20.0, 401))
    low, high, kinetic = run.y.min(axis=1), run.y.max(axis=1), run.evaluate(system.statement.kinetic).max()
    ends = [*low, *-high, -kinetic * (1 - 1e-6)]
    with opened(browser, system.to_page(tmp_path / "page.html")) as tab:
        tab.click("#play")
        tab.click("#reset")
        tab.wait(f"""(([low, high]) => [...low.slice(0, 4), ...[0, 1, 2, 3, 5].map((k) => -high[k])].every(
            (value, k) => value < {json.dumps(ends)}[k] + 1e-6))(lagrange.limits())""")
        before = tab.value("lagrange.limits()")
        assert before[0][:4] == pytest.approx(low, abs=1e-6)
        assert before[1][:4] == pytest.approx(high, abs=1e-6)
        assert before[1][5] == pytest.approx(kinetic, rel=1e-6)
        tab.click("#step", 40)
        for old, new in zip(before, tab.value("lagrange.limits()"), strict=True):
            assert new[:7] == old[:7]
