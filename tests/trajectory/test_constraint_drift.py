"""How far a run is from its constraints: the numbers, the line on the card, and the files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from lagrange.trajectory.measures.constraint_drift import constraint_drift
from tests.models import shared_scene

x, y = lg.coordinates("x y")


def pendulum() -> lg.System:
    return shared_scene("cartesian-pendulum")


def test_the_error_is_that_of_the_largest_constraint_against_the_sizes_of_its_terms() -> None:
    """Written out for x**2 + y**2 - l**2 and its rate, off by the drift of a solver that is not projected."""
    solution = pendulum().run(2.0, method="scipy-rk45", rtol=1e-6)
    a, b, u, v = solution.y
    length = float(dict(zip(map(str, solution.parameters), solution.parameters.values(), strict=True))["l"])
    place = np.abs(a**2 + b**2 - length**2) / (a**2 + b**2 + length**2).max()
    rate = np.abs(a * u + b * v) / (np.abs(a * u) + np.abs(b * v)).max()
    assert solution.constraint_error.shape == solution.t.shape
    assert solution.constraint_error == pytest.approx(np.maximum(place, rate), rel=1e-9, abs=1e-16)
    assert solution.constraint_error.max() > 1e-8


def test_the_scale_is_that_of_the_run_where_nothing_moves_for_a_moment() -> None:
    """From rest: the velocities are zero at first, and round-off of them is none of later ones."""
    solution = pendulum().run(2.0, method="scipy-rk45", rtol=1e-10)
    assert solution.y[2:, 0].tolist() == [0.0, 0.0]
    assert solution.constraint_error[0] < 1e-15
    assert solution.constraint_error.max() < 1e-7


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_a_constraint_of_one_term_counts_beside_the_other_coordinates(scale: float) -> None:
    """Of y = 0 the only term is y itself: a drift of 1e-12 is small beside x = 1."""
    system = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=x**2 / 2 + x * y,
        constraints={"table": scale * y},
        initial={x: 1.0},
    )
    model = system.compile()
    states = np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 1e-12, 0.3, 0.0]]).T
    found = constraint_drift(model, np.array([0.0, 1.0]), states, {})
    assert found is not None
    assert found.error == pytest.approx([0.0, 1e-12], rel=1e-6)


def test_without_constraints_the_error_is_zero_and_the_card_is_silent() -> None:
    solution = shared_scene("pendulum").run(1.0)
    assert not solution.constraint_error.any()
    assert solution.constraint_error.shape == solution.t.shape
    assert solution.card()["constraints"] is None
    assert "constraint" not in repr(solution)


def test_card_and_files_have_the_drift(tmp_path: Path) -> None:
    solution = pendulum().run(1.0, method="rk4", step=0.01)
    card = json.loads(json.dumps(solution.card()))["constraints"]
    assert set(card) == {"positions", "velocities"}
    assert max(card.values()) == solution.constraint_error.max()
    line = next(line for line in repr(solution).splitlines() if line.startswith("constraint drift"))
    assert line.endswith(
        f"{card['positions']:.1e} in positions, {card['velocities']:.1e} in velocities, relative to their terms"
    )
    saved = np.load(solution.to_npz(tmp_path / "run.npz"))
    assert np.array_equal(saved["constraint_error"], solution.constraint_error)
    assert json.loads(str(saved["card"]))["constraints"] == card


def test_a_constraint_on_velocities_has_no_positions() -> None:
    solution = shared_scene("chaplygin-sleigh").run(1.0)
    assert set(solution.card()["constraints"]) == {"velocities"}
    assert "positions" not in repr(solution)


def test_a_run_without_output_has_no_drift() -> None:
    solution = pendulum().run(1.0, method="rk4", step=0.1, t_eval=[])
    assert solution.constraint_error.shape == (0,)
    assert solution.card()["constraints"] is None
