"""A stiff run by an explicit method gets a message about stiffness, and no other run does."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.evidence.method_stability import growth, stability, step_of
from lagrange.show.figures import dynamics_figures
from lagrange.trajectory.measures.stiffness import (
    LIMITS,
    stability_limit,
    stability_polynomial,
    taylor_polynomial,
    with_stiff_end,
)
from lagrange.trajectory.methods.registry import BUILT_IN, find
from lagrange.trajectory.methods.splitting import Splitting
from lagrange.trajectory.tableaux import explicit as tableaux
from lagrange.trajectory.tableaux.explicit import dopri5
from tests.models import SCENE_NAMES, shared_scene, stated_in
from tests.refusals import refusal

UNDAMPED = ("bs3", "dopri5", "tsit5")
EXPLICIT = ("dopri5", "dop853", "taylor", "bs3")

x, y = lg.coordinates("x y")


def oscillator(force: Any, k: float = 1.0) -> lg.System:
    return lg.System(kinetic=x.dot**2 / 2, potential=k * x**2 / 2, forces={x: force}, initial={x: 2.0})


def pendulum(k: float, stretch: float = 0.0, **options: Any) -> Any:
    """Return a pendulum on a stiff spring, released at 1 rad, with the spring at its equilibrium length or longer."""
    g, m, rest = math.pi**2, 1.0, 0.75
    initial = {"r": rest + m * g * math.cos(1.0) / k + stretch, "theta": 1.0}
    return shared_scene("elastic-pendulum").run(parameters={"k": k}, initial=initial, **options)


# --- limits -----------------------------------------------------------------------------------------------------


def test_limits_are_those_of_the_books() -> None:
    # Hairer, Wanner, Solving ODE II, IV.2: 2 for Euler, 2.785 for four stages of order 4, 3.31 for Dormand-Prince 5.
    # A growth of 1 % moves the real limits by less than 0.01.
    for tableau, real in ((tableaux.EULER, 2.0), (tableaux.RK4, 2.785), (dopri5(), 3.307), (tableaux.BS3, 2.513)):
        assert stability_limit(stability_polynomial(tableau), math.pi) == pytest.approx(real, abs=0.015)
    assert stability_limit(stability_polynomial(tableaux.RK4), math.pi / 2) == pytest.approx(2**1.5, abs=0.01)
    assert stability_polynomial(tableaux.RK4) == pytest.approx(taylor_polynomial(4))


# --- stiff runs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", EXPLICIT)
@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
@pytest.mark.parametrize(
    ("system", "t_end", "rate"),
    [
        (oscillator(1e5 * (1 - x**2) * x.dot), 0.2, 3e5),
        (oscillator(-1e4 * x.dot), 1.0, 1e4),
        (oscillator(-300 * x.dot), 30.0, 300.0),
    ],
    ids=["van der Pol", "damped", "weakly damped"],
)
def test_stiff_decay_is_seen(method: str, rtol: float, system: lg.System, t_end: float, rate: float) -> None:
    result = system.run(t_end, method=method, rtol=rtol, atol=rtol / 1e3).stiff
    assert result and result.share >= 0.8
    assert result.rate == pytest.approx(rate, rel=0.1)
    assert result.product == pytest.approx(result.limit, rel=0.3) and result.slower > 1e3


@pytest.mark.parametrize("method", EXPLICIT)
def test_a_stiff_spring_is_seen_where_it_hardly_moves(method: str) -> None:
    result = pendulum(1e8, t_end=0.3, method=method, rtol=1e-6, atol=1e-9).stiff
    assert result and result.rate == pytest.approx(1e4, rel=0.05) and result.slower > 30


@pytest.mark.parametrize("method", UNDAMPED)
@pytest.mark.parametrize("rtol", [1e-9, 1e-6, 1e-5])
def test_an_undamped_stiff_oscillation_is_seen(method: str, rtol: float) -> None:
    """A stiff spring at rest beside a slow one: on the imaginary axis the limit is where |R| exceeds 1."""
    springs = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, potential=(1e8 * x**2 + y**2) / 2, initial={x: 1e-12, y: 1.0}
    )
    solution = springs.run(2.0, method=method, rtol=rtol, atol=rtol / 1e3)
    result = solution.stiff
    assert result and result.rate == pytest.approx(1e4, rel=1e-6) and "use radau5" in repr(solution)
    assert result.product == pytest.approx(result.limit, rel=0.3)


def test_the_limit_on_the_imaginary_axis_is_where_growth_begins() -> None:
    # Where |R(iy)| first exceeds 1: 1.0 for Dormand and Prince, sqrt(3) for Bogacki and Shampine's third order.
    for tableau, limit in ((dopri5(), 1.0), (tableaux.BS3, 3**0.5)):
        polynomial = stability_polynomial(tableau)
        for angle in (math.pi / 2, math.pi / 2 + 1e-9, math.pi / 2 - 1e-9):
            assert stability_limit(polynomial, angle) == pytest.approx(limit, abs=0.03)


def test_fixed_steps_near_the_limit_are_seen() -> None:
    system = oscillator(-1e3 * x.dot)
    assert (result := system.run(1.0, method="rk4", step=2.5e-3).stiff) and result.limit == pytest.approx(
        2.785, abs=0.01
    )
    assert system.run(1.0, method="rk4", step=1e-3).stiff is None
    lost = system.run(2.0, method="euler", step=1e-2)
    assert lost.stiff and "h * 1e+03 = 10 is beyond the stability limit 2 of euler" in repr(lost)


def test_backwards_and_with_output_times_too() -> None:
    grows = oscillator(1e4 * x.dot)
    solution = grows.run(-1.0, method="dopri5", t_eval=[0.0, -1.0])
    assert solution.stiff and len(solution.t) == 2


# --- runs that are not ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", EXPLICIT)
@pytest.mark.parametrize("scene", [name for name in SCENE_NAMES if "contacts" not in stated_in(name)])
def test_no_scene_of_the_library_is_called_stiff(scene: str, method: str) -> None:
    system = shared_scene(scene)
    for rtol in (1e-4, 1e-6, 1e-9) if method != "bs3" else (1e-4, 1e-6):
        assert system.run(method=method, rtol=rtol, atol=rtol / 1e3).stiff is None, rtol


@pytest.mark.parametrize("method", EXPLICIT)
@pytest.mark.parametrize("rtol", [1e-3, 1e-6])
def test_a_fast_oscillation_that_is_resolved_is_not_stiff(method: str, rtol: float) -> None:
    fast = oscillator(0 * x.dot, 1e8)
    assert fast.run(0.02, method=method, rtol=rtol, atol=rtol / 1e3).stiff is None
    assert pendulum(1e6, 1e-4, t_end=0.3, method=method, rtol=rtol, atol=rtol / 1e4).stiff is None


def test_what_cannot_be_told_is_none() -> None:
    stiff = oscillator(-1e4 * x.dot)
    assert stiff.run(1.0, method="scipy-radau").stiff is None
    assert stiff.run(1.0, method="dopri5", max_steps=30).stiff is None


# --- the card ---------------------------------------------------------------------------------------------------


def test_the_card_says_it_in_numbers_and_names_a_remedy() -> None:
    solution = oscillator(-1e4 * x.dot).run(1.0, method="dopri5")
    assert solution.stiff
    words = solution.stiff.sentence()
    assert words.startswith("stiff: at 100% of the examined steps, h * 1e+04 = 3.3 is near the stability limit 3.3 ")
    assert "the solution changes " in words and words.endswith("use radau5.")
    assert solution.card()["stiff"] == words and words in repr(solution) and "stability limit" in solution._repr_html_()
    gentle = oscillator(-0.1 * x.dot).run(10.0, method="dopri5")
    assert gentle.card()["stiff"] is None and "stiff" not in repr(gentle)


def test_nothing_is_analysed_until_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr("lagrange.trajectory.solution.stiffness", lambda *arguments: asked.append(1))
    solution = oscillator(-1e4 * x.dot).run(1.0, method="dopri5")
    assert solution.t[-1] == 1.0 and not asked
    assert solution.stiff is None and solution.stiff is None and asked == [1]


# --- A run that gave up because it was stiff says so ---


theta, phi = lg.coordinates("theta phi")

DAMPED = lg.System(
    kinetic=(theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2,
    potential=-9.81 * cos(theta),
    dissipation=0.3 * (theta.dot**2 + phi.dot**2) / 2,
    initial={theta: 1.0, phi.dot: 1.0},
)
"""A spherical pendulum whose damping is that of its angles: towards the lowest point phi has hardly any inertia, and
the damping of phi becomes stiff without bound, while the motion comes to rest in phi and goes on in theta."""


@pytest.mark.parametrize("method", ["taylor", "dop853", "tsit5"])
def test_a_stiff_run_that_gives_up_names_the_cause_and_an_implicit_method(method: str) -> None:
    result = DAMPED.run(5.0, method=method, max_steps=8000)
    assert result.status is lg.Status.MAX_STEPS
    reached = f"{result.trajectory.span[1]:.6g}"
    assert reached.startswith("0.88") and result.message.startswith(
        f"{method} stopped at t = {reached} on the way from 0 to 5, after {result.steps} steps: max_steps is used up. "
        "The run is stiff: at "
    )
    assert result.message.endswith(
        "times more slowly; use radau5. radau5 is an implicit method, whose steps stability does not limit."
    )


@pytest.mark.parametrize("status", LIMITS)
def test_each_limit_is_said(status: lg.Status) -> None:
    result = DAMPED.run(5.0, method="dop853", max_steps=8000)
    ended = with_stiff_end(result.model, replace(result.trajectory, status=status), result.parameters, 5.0)
    assert f"steps: {LIMITS[status]}. The run is stiff: at " in ended.message
    assert "singularity" not in ended.message


def test_other_ends_keep_their_message() -> None:
    gone = shared_scene("double-pendulum").run(50.0, method="dop853", max_steps=300)
    assert gone.status is lg.Status.MAX_STEPS and gone.message.startswith("dop853 used up max_steps = 300 at t = ")
    whole = DAMPED.run(0.5, method="dop853")
    assert whole.message == "dop853 reached t = 0.5."


# --- Linear stability from steps themselves ---


STEPS = [name for name in BUILT_IN if name != "taylor"]
DISSIPATING = [name for name in STEPS if not isinstance(find(name), Splitting)]


@pytest.mark.parametrize(
    ("name", "real", "imaginary"),
    [
        ("euler", 2.0, 0.0),
        ("midpoint", 2.0, 0.0),
        ("bs3", 2.5127, math.sqrt(3)),
        ("rk4", 2.7853, math.sqrt(8)),
        ("dopri5", 3.3066, 0.9972),
        ("trapezoidal", math.inf, math.inf),
        ("symplectic-euler", math.nan, 2.0),
        ("verlet", math.nan, 2.0),
        ("velocity-verlet", math.nan, 2.0),
        ("forest-ruth4", math.nan, 1.5734),
    ],
)
def test_published_limits(name: str, real: float, imaginary: float) -> None:
    """Hairer, Wanner, Solving ODE II, IV.2: figures 2.1 and 2.2, and the polynomials 1 + z + ... + z^s / s!.

    The imaginary axis is unstable from the start for orders 1 and 2, by y^2/2 and y^4/8. Splittings have no other limit
    (Hairer, Lubich, Wanner, Geometric Integration, VIII.4).
    """
    result = stability(name)
    assert result.real == pytest.approx(real, rel=1e-4, nan_ok=True)
    assert result.imaginary == pytest.approx(imaginary, rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("name", DISSIPATING)
def test_a_stable_methods_are_those_that_claim_it(name: str) -> None:
    angles = np.linspace(math.pi / 2, 0.999 * math.pi, 60)
    plane = 10.0 ** np.linspace(-3, 4, 60)[:, None] * np.exp(1j * angles)
    assert find(name).claims.a_stable == bool((growth(name, plane) < 1 + 1e-9).all())


@pytest.mark.few(6)
@pytest.mark.parametrize("name", DISSIPATING)
def test_the_matrix_is_what_a_step_does(name: str) -> None:
    """The matrix equals the compiled step of an oscillator from both unit vectors, for methods without memory."""
    step, z = step_of(name), -0.3 + 0.8j
    if step.starter is not None or step.control is not None:
        pytest.skip("two steps at once, or steps of its own")
    x = lg.coordinate("x")
    damped = lg.System(kinetic=x.dot**2 / 2, potential=abs(z) ** 2 * x**2 / 2, forces={x: 2 * z.real * x.dot})
    flow = lg.flow(damped.compile(), method=name, step=1.0)
    matrix = np.array([flow(unit, 0.0, 1.0) for unit in np.eye(2)]).T
    assert np.abs(np.linalg.eigvals(matrix)).max() == pytest.approx(growth(name, z), rel=1e-12)


def test_what_has_no_stability() -> None:
    assert "taylor has no fixed step function" in refusal(stability, "taylor")
    assert "verlet moves coordinates and velocities in turn, without damping" in refusal(growth, "verlet", -1.0)
    assert "verlet moves coordinates and velocities in turn, wi" in refusal(lg.methods.plot_stability, "rk4", "verlet")
    assert "name at least one" in refusal(lg.methods.plot_stability)


def test_the_picture_of_regions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamics_figures, "_POINTS", 41)
    figure = lg.methods.plot_stability("rk4", "radau5")
    (axis,) = figure.axes
    legend = axis.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["rk4", "radau5"]


def test_a_pole_is_infinite_growth() -> None:
    """Backward Euler's function 1/(1 - z) has a pole. One pole among many rates does not affect the others."""
    result = growth("backward-euler", [1.0, -1.0, 3.0])
    assert result == pytest.approx([math.inf, 1 / 1.99, 1 / 1.97])
