"""Drawn bodies: corners turn with the rotation, edges connect them, and corners have no marks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sympy import diag

import lagrange as lg
from lagrange.show.figures.run_figure import labels_of
from lagrange.statement.statement import EDGE, corners
from lagrange.trajectory.measures.times_and_points import points_at

R = lg.rotation("R")
x, y, z = lg.coordinates("x y z")


def thrown(**positions: Any) -> lg.System:
    kinetic = R.body.dot(diag(1, 2, 2.5) * R.body) / 2 + lg.kinetic_energy(1, (x, y, z))
    return lg.System(kinetic, z, initial={R.body: (1, 3, 2), x.dot: 1}, positions=positions, name="thrown")


def test_corners_of_a_box_turn_about_its_place() -> None:
    system = thrown(box=lg.shape("box", R, (4, 2, 1), at=(x, y, z)))
    run = system.run(1.0)
    result = points_at(run.model, run.t, run.y, run.parameters_at(run.t))
    corner = np.array(lg.shape("box", None, (4, 2, 1)).corners, dtype=float)
    assert {*map(tuple, corner.tolist())} == {(i, j, k) for i in (-2, 2) for j in (-1, 1) for k in (-0.5, 0.5)}
    centre = np.array([run[q] for q in (x, y, z)])
    expected = np.einsum("nij,cj->cin", run[R], corner) + centre
    assert np.abs(np.array([*result.values()]) - expected).max() < 1e-14
    links = system.statement.links
    sizes = [np.linalg.norm(result[a] - result[b], axis=0) for a, b, _ in links]
    assert sorted(np.round(size[-1], 9) for size in sizes) == [1] * 4 + [2] * 4 + [4] * 4


@pytest.mark.parametrize(("kind", "size", "count"), [("ellipsoid", (3, 2, 1), 72), ("disc", 2, 26), ("axes", 2, 3)])
def test_outlines_lie_on_their_surface(kind: str, size: Any, count: int) -> None:
    made = lg.shape(kind, None, size)
    places = np.array(made.corners, dtype=float)
    sizes = np.array(size) * np.ones(3)
    assert len(made.edges) == count
    on = np.linalg.norm(places / sizes, axis=1)
    assert np.all((np.abs(on - 1) < 1e-5) | (on == 0))
    assert (kind == "disc") == bool((places[:, 2] == 0).all())


def test_corners_have_neither_a_mark_nor_a_path() -> None:
    system = thrown(box=lg.shape("box", R, 1, at=(x, y, z)), centre=(x, y, z))
    hidden = corners(system.statement.links)
    assert len(hidden) == 8 and "centre" not in hidden
    axis = system.run(1.0).plot("path").axes[0]
    marks = [line for line in axis.lines if line.get_marker() == "o"]
    assert len(marks) == 2  # the start and the end of the centre


def test_a_picture_of_a_body_alone_has_its_time_as_title() -> None:
    figure = thrown(box=lg.shape("box", R, 1)).run(1.0).plot("path")
    assert figure.axes[0].get_title(loc="left") == "at t = 1"


def test_a_page_and_a_scene_have_the_edges(tmp_path: Path) -> None:
    system = thrown(disc=lg.shape("disc", R, 1, at=(x, y, z)), centre=(x, y, z))
    system.to_scene(tmp_path / "body.toml")
    again = lg.System.from_scene(tmp_path / "body.toml").statement
    assert again.links == system.statement.links and {link.kind for link in again.links} == {EDGE}
    assert list(again.positions) == list(system.statement.positions)


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a kind": (lambda: lg.shape("cube", R, 1), "the shape 'cube' is not known: give one of box, ellipsoid, disc"),
    "no rotation": (lambda: lg.shape("box", R.T, 1), "the rotation of a shape is .*: give a rotation R, or None"),
    "two sides": (lambda: lg.shape("box", R, (1, 2)), r"the size of a shape is \(1, 2\): give three values, or one"),
    "a place in the plane": (lambda: lg.shape("box", R, 1, at=(x, y)), "the place of a shape is .*: give three values"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_a_shape_is_refused(case: str) -> None:
    attempt, sentence = REFUSED[case]
    with pytest.raises(lg.StatementError, match=sentence) as refusal:
        attempt()
    assert len(str(refusal.value)) <= 400


def test_a_scene_states_a_body_by_its_shape(tmp_path: Path) -> None:
    system = thrown(disc=lg.shape("disc", R, (1, 2, 0), at=(x, y, z)), still=lg.shape("box", None, 2))
    path = tmp_path / "body.toml"
    path.write_text(STATED.replace("[1, 2, 0]", "[1, 'R_xx*0 + 2', 0]"))
    result = lg.System.from_scene(path).statement
    assert result.links == system.statement.links
    assert result.positions == system.statement.positions


STATED = """
coordinates = ["x", "y", "z"]
rotations = ["R"]
kinetic = "(x_dot**2 + y_dot**2 + z_dot**2 + R_body_x**2 + R_body_y**2 + R_body_z**2)/2"
potential = "z"
[positions]
disc = { shape = "disc", size = [1, 2, 0], rotation = "R", at = ["x", "y", "z"] }
still = { shape = "box", size = 2 }
"""

REFUSED_SCENES: dict[str, tuple[str, str, str]] = {
    "another key": ('shape = "box"', 'shape = "box", side = 2', "side.*is not a key of a shape"),
    "no size": ('shape = "box", size = 2', 'shape = "box"', 'has no shape or no size: write shape = "disc" and size'),
    "another rotation": (
        'rotation = "R"',
        'rotation = "S"',
        "the rotation of a shape must be one of this scene: R",
    ),
    "in the plane": (
        "[positions]",
        '[positions]\\ntip = ["x", "y"]',
        "positions mixes points in the plane",
    ),
}


@pytest.mark.parametrize("case", REFUSED_SCENES)
def test_what_is_not_a_shape_in_a_scene_is_refused_at_its_line(case: str, tmp_path: Path) -> None:
    old, new, sentence = REFUSED_SCENES[case]
    path = tmp_path / "body.toml"
    path.write_text(STATED.replace(old, new.replace("\\n", "\n")))
    with pytest.raises(lg.SceneError, match=sentence) as refusal:
        lg.System.from_scene(path)
    assert refusal.value.line is not None


def test_an_overview_has_the_rates_of_bodies() -> None:
    system = thrown()
    figure = system.run(1.0).plot()
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert sum("R_{" in title for title in titles) == 3
    run = system.run(1.0)
    shown = [np.asarray(axis.lines[0].get_ydata())[0] for axis in figure.axes[3:6]]
    assert np.allclose(shown, run[R.body][:, 0])


def test_runs_are_named_by_the_rates_that_they_start_with() -> None:
    system = thrown(tip=R * (1, 0, 0))
    runs = [system.run(1.0, {R.body: (rate, 0, 0)}) for rate in (1, 2)]
    assert labels_of(runs, None) == ["R_body_x = 1", "R_body_x = 2"]
