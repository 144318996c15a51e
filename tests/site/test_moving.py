"""The pictures of the gallery move as the run does, by themselves, and are small."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

import lagrange as lg

Module = Callable[[str], ModuleType]
SVG = "{http://www.w3.org/2000/svg}"


def places(circle: ET.Element) -> np.ndarray:
    """Return where a disc is at each time, (2, N)."""
    rows = {one.get("attributeName"): one.get("values", "") for one in circle.findall(f"{SVG}animate")}
    return np.array([[float(value) for value in rows[name].split(";")] for name in ("cx", "cy")])


def test_a_rod_keeps_its_length_and_the_bobs_are_where_the_run_has_them(module: Module) -> None:
    moving = module("moving")
    solution = lg.scene("double-pendulum").run(6.0, {"theta1": 2.0, "theta2": 2.5})
    text = moving.svg(solution)
    assert len(text) < 100_000
    root = ET.fromstring(text)
    discs = [circle for circle in root.iter(f"{SVG}circle") if "moving" in circle.get("class", "")]
    upper, lower = map(places, discs)
    rod = np.hypot(*(lower - upper))
    assert np.ptp(rod) < 0.3  # places are rounded to a tenth of a unit
    times = np.linspace(0.0, 6.0, upper.shape[1])
    theta = solution.at(times)
    expected = np.mean(rod) * np.array([np.sin(theta[1]), np.cos(theta[1])])  # the second axis points down
    assert np.abs((lower - upper) - expected).max() < 0.3
    assert [element.tag for element in root.iter() if element.tag.endswith("script")] == []


def test_a_spring_is_stretched_and_a_point_at_rest_does_not_move(module: Module) -> None:
    text = module("moving").svg(lg.scene("chain-of-springs").run())
    assert len(text) < 250_000
    kinds = [one.get("type") for one in ET.fromstring(text).iter(f"{SVG}animateTransform")]
    assert kinds.count("scale") == kinds.count("rotate") == 6
    assert text.count('class="base"') == 2


def test_a_system_without_positions_is_refused(module: Module) -> None:
    x = lg.coordinate("x")
    bare = lg.System(lg.kinetic_energy(1, x), 0, initial={x.dot: 1}, name="bare")
    with pytest.raises(ValueError, match="bare has no positions to draw"):
        module("moving").svg(bare.run(1.0))
