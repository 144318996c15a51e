"""Contacts and surfaces as they are stated: refusals, scene files, copies, runs by all doors, and drawings."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import I, cos, exp, nan, oo, pi, sin, sqrt

import lagrange as lg
from lagrange.page.document import description
from lagrange.show.animation.film import Pen
from tests.refusals import refusal

X, Y = lg.coordinates("x y")
TURN = lg.coordinate("phi")
M, GRAVITY, MU, E, RADIUS = lg.parameters("m g mu e R")
SPEED = lg.parameters("v", positive=False)
VALUES = {M: 1, GRAVITY: 9.81, MU: 0.3, E: 0.8}


def system(contacts: dict[str, Any] | None = None, **more: Any) -> lg.System:
    floor = lg.contact(Y, slip=X.dot, restitution=E, friction=MU)
    kinetic, given = M * (X.dot**2 + Y.dot**2) / 2, {"floor": floor} if contacts is None else contacts
    stated: dict[str, Any] = {"parameters": VALUES, "initial": {Y: 1, X.dot: 2}} | more
    return lg.System(kinetic, M * GRAVITY * Y, contacts=given, **stated)


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "friction without slip": (lambda: lg.contact(Y, friction=0.3), "without a slip"),
    "three slips": (lambda: lg.contact(Y, slip=(X.dot, Y.dot, X.dot)), "3 components"),
    "three coefficients": (lambda: lg.contact(Y, slip=X.dot, friction=(1, 2, 3)), r"\(static, kinetic\)"),
    "restitution above one": (lambda: lg.contact(Y, restitution=1.2), "is 1.2: give a number between 0 and 1"),
    "restitution that is not a number": (lambda: lg.contact(Y, restitution=nan), "restitution is nan: give a"),
    "friction that is not a number": (lambda: lg.contact(Y, X.dot, friction=(1, nan)), "friction is nan: give a"),
    "negative friction": (lambda: lg.contact(Y, slip=X.dot, friction=-0.1), "zero or positive"),
    "imaginary friction": (lambda: lg.contact(Y, slip=X.dot, friction=I), "friction is I: give a number zero"),
    "friction whose square overflows": (lambda: lg.contact(Y, slip=X.dot, friction=1e300), "at most 1e.100"),
    "static friction below kinetic": (
        lambda: lg.contact(Y, slip=X.dot, friction=(0.4, 0.6)),
        r"friction is \(0.4, 0.6\): give \(static, kinetic\), the static at least",
    ),
    "infinite friction": (lambda: lg.contact(Y, slip=X.dot, friction=oo), "friction is oo: give a number zero"),
    "gap without a coordinate": (lambda: system({"c": lg.contact(M - 1)}), "contains no coordinate"),
    "gap with a velocity": (lambda: system({"c": lg.contact(Y.dot)}), "contains a velocity"),
    "slip without a velocity": (lambda: system({"c": lg.contact(Y, slip=X)}), "contains no velocity"),
    "two equal slips": (lambda: system({"c": lg.contact(Y, slip=(X.dot, 2 * X.dot))}), "multiples of each other"),
    "slip that is not linear": (lambda: system({"c": lg.contact(Y, slip=X.dot**2)}), "not linear"),
    "one ball": (lambda: lg.contacts_between({"a": X}, 1), "give two or more"),
    "balls of other dimensions": (lambda: lg.contacts_between({"a": X, "b": (X, Y)}, 1), "of the same dimension"),
    "ball with a space": (lambda: lg.contacts_between({"ball 1": X, "b": Y}, 1), "'ball 1' cannot name a ball"),
    "pairs of one name": (
        lambda: lg.contacts_between({"a_b": X, "c": Y, "a": X, "b_c": Y}, 1),
        "two pairs of balls have the name 'a_b_c'",
    ),
    "a list for a radius": (lambda: lg.contacts_between({"a": X, "b": Y}, [1, 2]), "the radius of 'a'"),
    "ball without a radius": (lambda: lg.contacts_between({"a": X, "b": Y}, {"a": 1}), "no entry for 'b'"),
    "no contact": (lambda: system({"c": Y}), r"give lg.contact\(gap, ...\)"),
    "restitution of a coordinate": (lambda: system({"c": lg.contact(Y, restitution=X)}), "in parameters"),
    "normal force in a force": (
        lambda: system(forces={X: -M * lg.multiplier("floor")}),
        r"lambda\[floor\], the normal force of the contact 'floor'.*state friction in the contact",
    ),
    "law": (lambda: system(simultaneous="both"), "newton"),
    "name of a constraint": (lambda: system(constraints={"floor": X - Y}), "has the name of a constraint"),
    "friction below zero": (
        lambda: system().run(1.0, parameters={"mu": -0.2}),
        "the coefficient of friction mu is -0.2: give one that is not negative",
    ),
    "start inside": (lambda: system().run(1.0, {Y: -0.5}), r"inside a body: the gap 'floor' is -0.5.*has y = 0"),
    "start inside two": (
        lambda: system({"floor": lg.contact(Y), "wall": lg.contact(X)}).run(1.0, {Y: -0.4, X: -0.3}),
        r"the gaps are below zero: 'floor' is -0.4 and 'wall' is -0.3. The nearest start outside has x = 0 and y = 0",
    ),
    "start far outside an ellipse": (
        lambda: system({"wall": lg.contact(1 - X**2 / 4 - Y**2)}).run(1.0, {X: 3, Y: 2}),
        r"has x = 1.72541125\d* and y = 0.50570643\d*",
    ),
    "start in the centre": (
        lambda: system({"ball": lg.contact(sqrt(X**2 + Y**2) - 1)}).run(1.0, {X: 0, Y: 0}),
        r"the gap 'ball' is -1, below zero. Give a start",
    ),
    "value of restitution": (lambda: system().run(1.0, parameters={E: 2}), "restitution of the contact 'floor' is 2"),
    "backwards": (lambda: system().run(0.0, t_start=1.0), "run forwards"),
    "linear equations": (lambda: system().linearize(), r"has contacts \('floor'\)"),
    "eigenvalues": (lambda: system().eigenvalues(E, [0.5]), r"which eigenvalues\(\) leaves out: state the system"),
    "an expansion": (lambda: system().small({Y: 1}), r"has contacts \('floor'\), which small\(\) leaves out"),
    "SciPy": (lambda: system().compile().as_scipy(), r"which as_scipy\(\) leaves out"),
    "SymPy": (lambda: system().compile().as_sympy(), r"which as_sympy\(\) leaves out"),
    "source code": (lambda: system().export("c", "nowhere"), r"has contacts \('floor'\)"),
    "gap of another": (lambda: system().run(1.0, events=[lg.gap("wall") - 1]), "does not have"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_meaning_is_refused(case: str) -> None:
    call, message = REFUSED[case]
    assert re.search(message, refusal(call))


def with_units(floor: Any, units: dict[Any, str]) -> lg.System:
    """Return a disc over a floor with units of its symbols."""
    known = {X: "m", Y: "m", M: "kg", GRAVITY: "m/s**2", SPEED: "m/s", RADIUS: "m"} | units
    kinetic = M * (X.dot**2 + Y.dot**2 + RADIUS**2 * TURN.dot**2 / 2) / 2
    return lg.System(kinetic, M * GRAVITY * Y, contacts={"floor": floor}, dimensions=known)


WRONG_UNITS: dict[str, tuple[Any, dict[Any, str], str]] = {
    "a mass in the gap": ((Y - M,), {}, "the gap of the contact floor has the term y, whose dimension is length"),
    "another scale": ((Y - RADIUS, X.dot - SPEED), {SPEED: "cm/s"}, "state v in m/s instead of cm/s"),
    "an angle's rate": ((Y, X.dot + TURN.dot), {}, "the slip of the contact floor.*x_dot, in phi_dot"),
    "friction as a force": ((Y, X.dot, 0, MU), {MU: "N"}, "the friction of the contact floor.*should be a number"),
    "restitution": ((Y, None, E), {E: "kg"}, "the restitution of the contact floor.*should be a number"),
    "speed over a length": ((Y, None, exp(-lg.impact_speed / RADIUS)), {}, "-y_dot/R, whose dimension is 1/time"),
}


@pytest.mark.parametrize("case", WRONG_UNITS)
def test_wrong_units_of_a_contact_are_refused(case: str) -> None:
    parts, units, message = WRONG_UNITS[case]
    assert re.search(message, refusal(with_units, lg.contact(*parts), units))


def test_right_units_of_a_contact_are_inferred() -> None:
    floor = lg.contact(Y - RADIUS, X.dot + RADIUS * TURN.dot - SPEED, E * exp(-lg.impact_speed / SPEED), MU)
    sizes = with_units(floor, {}).statement.dimensions
    assert str(sizes[E]) == str(sizes[MU]) == "a number"


def test_parameters_are_put_into_contacts() -> None:
    """A parameter in the gap, and one in the friction; a wrong value is refused as in a statement."""
    stated = system({"floor": lg.contact(Y - E, slip=X.dot, friction=MU)}, simultaneous="newton")
    (floor,) = stated.substitute({E: 0.25, MU: 0.1}).statement.contacts
    assert (floor.gap, floor.friction) == (Y - 0.25, (0.1, 0.1))
    assert stated.substitute({E: 0.25}).statement.simultaneous == "newton"
    with pytest.raises(lg.StatementError, match="zero or positive"):
        system({"floor": lg.contact(Y, slip=X.dot, friction=SPEED)}).substitute({SPEED: -1})


def test_a_surface_that_moves_does_work() -> None:
    belt = lg.contact(Y, slip=X.dot - SPEED, friction=MU)
    table = lg.contact(Y - sin(lg.t) / 10, restitution=E)
    for floor, conserved in ((belt, False), (table, False), (lg.contact(Y, slip=X.dot, friction=MU), True)):
        run = system({"floor": floor}, parameters={**VALUES, SPEED: 1}).run(1.0)
        assert run.drift.conserved is conserved
    assert "moved surfaces change energy" in " ".join(system().structure)


def test_impacts_at_one_instant_need_a_stated_law() -> None:
    a, b, c = lg.coordinates("a b c")
    contacts = {"left": lg.contact(b - a, restitution=1), "right": lg.contact(c - b, restitution=1)}
    ends = {}
    for law in (None, "newton", "sequence"):
        kinetic, start = (a.dot**2 + b.dot**2 + c.dot**2) / 2, {a: -1, a.dot: 1}
        run = lg.System(kinetic, contacts=contacts, simultaneous=law, initial=start).run(2.0)
        ends[law] = run.status, run.y[3:, -1]
    assert ends["sequence"][1] == pytest.approx([0, 0, 1], abs=1e-12)
    # All at once, each gap opens with the speed at which it closed: b - a with 1, c - b with 0.
    assert ends["newton"][1] == pytest.approx([-1 / 3, 2 / 3, 2 / 3])
    assert ends[None][0] is lg.Status.SINGULAR


@pytest.mark.parametrize(
    ("third", "told"),
    [((0, 0), "left arrives while right is closed, and"), ((1, -1), "left and right meet at one instant, and")],
)
def test_contacts_that_are_closed_are_told_from_those_that_arrive(third: tuple[float, float], told: str) -> None:
    a, b, c = lg.coordinates("a b c")
    contacts = {"left": lg.contact(b - a, restitution=1), "right": lg.contact(c - b, restitution=1)}
    start = {a: -1, a.dot: 1, c: third[0], c.dot: third[1]}
    run = lg.System((a.dot**2 + b.dot**2 + c.dot**2) / 2, contacts=contacts, initial=start).run(2.0)
    assert run.status is lg.Status.SINGULAR and told in run.message


@pytest.mark.parametrize(
    ("gap", "inside"),
    [(Y - 1 / 3, {Y: 0.333333}), (Y - 1 / 3, {Y: 0.2}), (1 - X**2 / 4 - Y**2, {X: 3, Y: 2}), (Y - X / 7, {X: 1, Y: 0})],
)
def test_the_start_that_a_message_advises_is_taken(gap: Any, inside: dict[Any, float]) -> None:
    stated = system({"wall": lg.contact(gap)})
    _, _, advice = refusal(stated.run, 0.1, inside).partition("The nearest start outside has")
    advised = re.findall(r"\b(\w) = (\S+\d)", advice)
    run = stated.run(0.1, inside | {{"x": X, "y": Y}[name]: float(value) for name, value in advised})
    assert abs(run.contacts["wall"].gap[0]) < 1e-14


def test_a_start_that_a_constraint_forbids_is_not_advised() -> None:
    stated = system({"floor": lg.contact(Y)}, constraints={"rod": X**2 + Y**2 - 1})
    assert "'floor' is -0.6, below zero. Give a start" in refusal(stated.run, 1.0, {X: 0.8, Y: -0.6, X.dot: 0})


@pytest.mark.parametrize(("gap", "start"), [(Y - 1 / 3, 0.333333333), (Y - 1 / 3, 1 / 3 - 1e-13), (Y, -1e-13)])
def test_a_start_inside_by_the_rounding_of_typed_numbers_is_moved_onto_the_contact(gap: Any, start: float) -> None:
    run = system({"floor": lg.contact(gap)}).run(1.0, {Y: start, X.dot: 0})
    assert run.contacts["floor"].mode[0] == "closed" and np.abs(run.contacts["floor"].gap).max() < 1e-15


SCENE = """
coordinates = ["x", "y"]
kinetic = "x_dot**2/2 + y_dot**2/2"
potential = "9.81*y"
[initial]
y = 1
x_dot = 1
[contacts.floor]
gap = "y"
slip = "x_dot"
restitution = 0.5
friction = [0.3, 0.2]
"""


def test_a_scene_states_contacts(tmp_path: Any) -> None:
    (tmp_path / "s.toml").write_text(SCENE)
    run = lg.System.from_scene(tmp_path / "s.toml").run(3.0).require()
    assert run.contacts["floor"].mode[-1] == "sticking"
    (tmp_path / "s.toml").write_text(SCENE.replace("restitution", "restition"))
    with pytest.raises(lg.SceneError, match="restitution"):
        lg.System.from_scene(tmp_path / "s.toml")


def test_flows_and_ensembles_go_through_contacts() -> None:
    stated = system()
    run = stated.run(1.0)
    assert lg.flow(stated.compile())(run.y[:, 0], 0.0, 1.0) == pytest.approx(run.y[:, -1])
    runs = lg.ensemble(stated, 1.0, parameters={E: np.array([0.3, 0.8])})
    assert runs.y[:, 1] == pytest.approx(run.y[:, -1])


def test_results_name_gaps_and_forces() -> None:
    run = system().run(6.0)
    floor = run.contacts["floor"]
    assert run.evaluate(lg.gap("floor")) == pytest.approx(run["y"])
    assert run.evaluate(lg.multiplier("floor")) == pytest.approx(run.multipliers["floor"])
    closed = floor.mode != "open"
    assert floor.force[closed] == pytest.approx(9.81) and not floor.force[~closed].any()
    with pytest.raises(lg.StatementError, match="not a contact"):
        run.contacts["wall"]
    with pytest.raises(lg.StatementError, match=r"contains lambda\[flor\], but the contact is floor\. Did you mean"):
        run.evaluate(lg.multiplier("flor"))
    met = system().run(6.0, events=[lg.event(lg.gap("floor") - 0.5, terminal=1)])
    assert met.status is lg.Status.EVENT and met["y"][-1] == pytest.approx(0.5)


def test_a_file_keeps_the_contacts_of_a_run(tmp_path: Any) -> None:
    run = system().run(6.0)
    kept = lg.load(run.to_npz(tmp_path / "run.npz"))
    assert (kept.energy_lost == run.energy_lost).all()
    floor, other = run.contacts["floor"], kept.contacts["floor"]
    assert other.impacts == floor.impacts and other.rests == floor.rests and (other.mode == floor.mode).all()
    assert (other.force == floor.force).all() and (other.friction == floor.friction).all()


def test_a_file_with_modes_of_another_system_is_refused(tmp_path: Any) -> None:
    arrays = dict(np.load(system().run(1.0).to_npz(tmp_path / "run.npz")))
    for modes in (
        "[]",
        '[[["open", "open"], [null, null], null, [], 0.0]]',
        '[[["shut"], [null], null, [], 0.0]]',
        "[1]",
    ):
        np.savez(tmp_path / "other.npz", allow_pickle=False, **(arrays | {"contact_modes": np.array(modes)}))
        assert re.search(r"modes|not a run that to_npz wrote", refusal(lg.load, tmp_path / "other.npz"))


def test_balls_touch_in_pairs() -> None:
    a, b, c = lg.coordinates("a b c")
    contacts = lg.contacts_between({"a": a, "b": b, "c": c}, {"a": 1, "b": 2, "c": 3}, restitution=1)
    assert [str(each.gap) for each in contacts.values()] == ["-a(t) + b(t) - 3", "-a(t) + c(t) - 4", "-b(t) + c(t) - 5"]
    plane = lg.contacts_between({"a": (a, 0), "b": (b, c)}, 0.5)
    assert float(plane["a_b"].gap.subs({a: 1, b: 4, c: 4})) == 4
    kinetic, start = (a.dot**2 + b.dot**2) / 2, {b: 4, a.dot: 1}
    # Equal masses exchange their velocities; the radii 1 and 2 leave a gap of 1.
    run = lg.System(kinetic, contacts={"a_b": contacts["a_b"]}, initial=start).run(3.0).require()
    assert run.y[:, -1] == pytest.approx([1, 6, 0, 1]) and run.contacts["a_b"].impacts[0].t == pytest.approx(1)


# --- surfaces to draw: how they are stated, and where pictures, players and pages draw them --------------------


WIDTH = lg.parameters("w")


def ball(surfaces: Any, positions: Any = None) -> lg.System:
    return lg.System(
        (X.dot**2 + Y.dot**2) / 2,
        9.81 * Y,
        contacts={"floor": lg.contact(Y - sin(lg.t) / 10, restitution=0.5)},
        positions={"ball": (X, Y)} if positions is None else positions,
        surfaces=surfaces,
        parameters={WIDTH: 2},
        initial={Y: 1, X.dot: 1},
    )


FLOOR = {"floor": (WIDTH * (2 * lg.along - 1), sin(lg.t) / 10)}
RING = {"ring": (2 * cos(2 * pi * lg.along), 2 * sin(2 * pi * lg.along))}

REFUSED_SURFACES: dict[str, tuple[Any, dict[str, Any], str]] = {
    "one point": ({"floor": (0, 0)}, {}, "the surface floor is one point"),
    "a coordinate": ({"floor": (X + lg.along, 0)}, {}, "the surface floor contains x: write a surface in lg.along"),
    "another dimension": ({"floor": (lg.along, 0, 0)}, {}, "give a point of 2 expressions"),
    "a number": ({"floor": 3}, {}, "give a point of 2 expressions"),
    "no position": ({"floor": (lg.along, 0)}, {"positions": {}}, "the surface floor is drawn for a moving point"),
    "a name": ({"the floor": (lg.along, 0)}, {}, "'the floor' cannot name a surface"),
    "a list": ([(lg.along, 0)], {}, "surfaces is a list: give a dict from name to point"),
}


@pytest.mark.parametrize("case", REFUSED_SURFACES)
def test_a_surface_without_a_meaning_is_refused(case: str) -> None:
    surfaces, more, message = REFUSED_SURFACES[case]
    assert re.search(message, refusal(ball, surfaces, **more))


def test_a_straight_surface_has_two_points_and_a_curve_is_near_its_chords() -> None:
    outlines = ball(FLOOR | RING).statement.outlines
    assert [*outlines["floor"]] == ["floor[0]", "floor[1]"]
    places = np.array([[float(entry) for entry in point] for point in outlines["ring"].values()])
    assert (places[0] == places[-1]).all() or np.abs(places[0] - places[-1]).max() < 1e-15
    middles = (places[1:] + places[:-1]) / 2
    assert np.abs(np.hypot(*middles.T) / 2 - 1).max() < 2e-3


def test_a_scene_keeps_its_surfaces(tmp_path: Any) -> None:
    stated = ball(FLOOR | RING)
    path = stated.to_scene(tmp_path / "s.toml")
    read = lg.System.from_scene(path).statement
    assert "along" not in [parameter.name for parameter in read.parameters]
    for name, point in stated.statement.surfaces.items():
        assert all(sympy.simplify(a - b) == 0 for a, b in zip(point, read.surfaces[name], strict=True))
    path.write_text(path.read_text().replace("ring = [", "ring = 3 # "))
    with pytest.raises(lg.SceneError, match=r"surfaces\.ring is an integer: give a list of expressions, such as"):
        lg.System.from_scene(path)


def test_stills_draw_a_moving_surface_where_it_is_at_the_end_of_the_run() -> None:
    run = ball(FLOOR).run(2.0)
    lines = [np.asarray(line.get_xydata()) for line in run.plot(["path"]).axes[0].get_lines()]
    floor = np.array([(-2, np.sin(2.0) / 10), (2, np.sin(2.0) / 10)])
    assert any(line.shape == floor.shape and np.allclose(line, floor) for line in lines)


def test_frames_draw_a_moving_surface_without_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, marked = [], []
    monkeypatch.setattr(Pen, "line", lambda self, points, *look, **more: drawn.append(points))
    monkeypatch.setattr(Pen, "marks", lambda self, points, *look, **more: marked.append(points))
    animation = ball(FLOOR).run(2.0).animate()
    animation.frame(15)
    height = np.sin(animation.t[15]) / 10
    assert any(np.allclose(line, [(-2, 2), (height, height)]) for line in drawn if line.shape == (2, 2))
    assert not any(np.isclose(abs(points[0]), 2).any() for points in marked)


def test_scripts_find_the_points_of_surfaces_behind_the_named_ones() -> None:
    result = description(ball(FLOOR | RING).statement, 1.0, ("E",), "E")
    assert result["points"] == ["ball"] and result["surfaces"] == [[1, 2], [3, 65]] and result["drawn"] == 68


def test_exported_positions_have_the_points_of_surfaces(tmp_path: Any) -> None:
    free = lg.System(X.dot**2 / 2, positions={"p": (X, 0)}, surfaces={"floor": (lg.along, -1)})
    text = "".join(path.read_text() for path in free.export("python", tmp_path, contents=["positions"]).files)
    assert "floor[1]_x" in text
