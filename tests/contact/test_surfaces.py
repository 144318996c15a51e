"""Surfaces to draw: how they are stated, and where pictures, players and pages draw them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, pi, sin

import lagrange as lg
from lagrange.page.document import description
from lagrange.show.animation.film import Pen

X, Y = lg.coordinates("x y")
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

REFUSED: dict[str, tuple[Any, dict[str, Any], str]] = {
    "one point": ({"floor": (0, 0)}, {}, "the surface floor is one point"),
    "a coordinate": ({"floor": (X + lg.along, 0)}, {}, "the surface floor contains x: give it in lg.along"),
    "another dimension": ({"floor": (lg.along, 0, 0)}, {}, "give a point of 2 expressions"),
    "a number": ({"floor": 3}, {}, "give a point of 2 expressions"),
    "no position": ({"floor": (lg.along, 0)}, {"positions": {}}, "the surface floor is drawn for a moving point"),
    "a name": ({"the floor": (lg.along, 0)}, {}, "'the floor' cannot name a surface"),
    "a list": ([(lg.along, 0)], {}, "surfaces is a list: give a dict from name to point"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_surface_without_a_meaning_is_refused(case: str) -> None:
    surfaces, more, message = REFUSED[case]
    with pytest.raises(lg.StatementError, match=message) as caught:
        ball(surfaces, **more)
    assert len(str(caught.value)) <= 400


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
