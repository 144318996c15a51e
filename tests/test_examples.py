"""The examples run, and their output is right."""

import math
import re
from itertools import pairwise
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from examples import (
    beats,
    double_pendulum,
    euler_against_rk4,
    flip_times,
    magnet_pendulum,
    pendulum_period,
    phase_portraits,
    poincare_section,
    throw_in_wind,
)


def assert_is_a_picture(path: Path) -> None:
    pixels = matplotlib.image.imread(path)
    assert pixels.shape[0] > 300
    assert pixels.shape[1] > 300
    assert np.ptp(pixels) > 0.5


def numbers(line: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", line)]


def test_period_of_a_pendulum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = pendulum_period.main(tmp_path / "new")
    assert len(rows) == len(pendulum_period.DEGREES)
    for _degrees, measured, exact in rows:
        assert measured == pytest.approx(exact, rel=1e-10)
    # K(1/2) = Gamma(1/4)^2 / (4 sqrt(pi)): the period at 90 degrees without elliptic integrals of anybody's.
    quarter = math.gamma(0.25) ** 2 / (4 * math.sqrt(math.pi)) * math.sqrt(1.0 / 9.81)
    at_right_angles = next(measured for degrees, measured, _ in rows if degrees == 90)
    assert at_right_angles == pytest.approx(4 * quarter, rel=1e-12)
    table = capsys.readouterr().out.splitlines()
    printed = numbers(next(line for line in table if line.strip().startswith("90°")))
    assert printed[0] == pytest.approx(4 * quarter, abs=1e-11)
    assert printed[1] == pytest.approx(4 * quarter, abs=1e-11)
    assert printed[3] == pytest.approx(-15.279)
    assert_is_a_picture(tmp_path / "new" / "pendulum_period.png")


@pytest.mark.slow
def test_euler_against_rk4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = euler_against_rk4.main(tmp_path)
    over_the_top = 2 * 9.81
    start = 9.81 * (1 - math.cos(1.5))
    assert result["euler"][0] == pytest.approx(1.0, abs=0.05)
    assert result["rk4"][0] == pytest.approx(4.0, abs=0.05)
    assert result["euler"][1] > over_the_top
    assert result["rk4"][1] == pytest.approx(start, rel=1e-6)
    table = [numbers(line) for line in capsys.readouterr().out.splitlines()[1:6]]
    assert [row[0] for row in table] == pytest.approx([0.02, 0.01, 0.005, 0.0025, 0.00125])
    assert [b[1] / a[1] for a, b in pairwise(table)] == pytest.approx([1 / 2] * 4, rel=0.01)
    assert_is_a_picture(tmp_path / "euler_against_rk4.png")


@pytest.mark.slow
def test_double_pendulum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    solution = double_pendulum.main(tmp_path)
    assert solution["theta1"][0] == solution["theta2"][0] == math.pi / 2
    assert np.ptp(solution.energy) < 1e-9
    out = capsys.readouterr().out
    assert "l₁⋅l₂⋅m₂⋅sin(θ₁ - θ₂)" in out
    assert "the energy is conserved" in out
    assert "Everything holds." in out
    assert "double pendulum: success" in out
    assert_is_a_picture(tmp_path / "double_pendulum.png")


@pytest.mark.slow
def test_phase_portraits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = phase_portraits.main(tmp_path)
    for (method, step), row in result.items():
        assert row["order"] == pytest.approx(4 if method == "RK4" else 2, abs=0.05)
        if method != "RK4":
            # 3000 steps with angles up to 7000, whose spacing is 1e-12: two roundings of each are seen.
            assert row["recursion"] < 1e-11
        exact = method == "integrable"
        assert (row["invariant"] < 1e-9) is exact, (method, step)
        assert row["energy"] > 1e-5
    assert result["variational", 0.9]["invariant"] > 0.1
    assert result["RK4", 0.9]["energy"] > 1.0
    # With the other sign the map is that of the inverted pendulum, off by twice the force.
    theta, _ = phase_portraits.orbit("integrable", 0.1, 100, 1.0, 0.0)
    middle = theta[1:-1]
    kick = theta[:-2] - 2 * middle + theta[2:]
    assert np.abs(kick + 0.1**2 * np.sin(middle)).max() < 0.1**4 / 4
    assert phase_portraits.residual("variational", 0.1, theta) > 1e-6
    assert "integrable" in capsys.readouterr().out
    assert_is_a_picture(tmp_path / "phase_portraits.png")


@pytest.mark.slow
def test_poincare_section(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    orbits = poincare_section.main(tmp_path)
    result = np.concatenate(orbits)
    assert len(result) == 10_000
    # An event is located to round-off, and 500 crossings at rtol 1e-12 leave the energy within some 1e-12.
    assert np.abs(result[:, 0]).max() < 1e-14
    assert (result[:, 2] > 0).all()
    assert np.abs(poincare_section.energy(result) - poincare_section.ENERGY).max() < 1e-11
    out = capsys.readouterr().out
    assert "10000 crossings of 20 orbits" in out
    assert_is_a_picture(tmp_path / "poincare_section.png")


@pytest.mark.slow
def test_flip_times(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flip_times.flips, "__defaults__", (40, 20.0))
    runs = flip_times.main(tmp_path)
    times = flip_times.flip_times(runs)
    assert times.shape == (1600,)
    assert 0.3 < np.isfinite(times).mean() < 0.69
    assert "0 of these flipped" in capsys.readouterr().out
    assert_is_a_picture(tmp_path / "flip_times.png")


@pytest.mark.slow
def test_magnet_pendulum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(magnet_pendulum.rests, "__defaults__", (41,))
    runs = magnet_pendulum.main(tmp_path)
    labels = magnet_pendulum.nearest(runs)
    places = np.array([np.median(runs.y[:2, labels == k], axis=1) for k in range(3)])
    # At rest on the line from the middle to a magnet, where spring and magnets balance: three times the same distance.
    # At the end of the runs 3e-7 of an oscillation is left.
    distances = np.linalg.norm(places, axis=1)
    assert distances == pytest.approx([distances[0]] * 3, rel=1e-5) and 0.95 < distances[0] < 1.0
    assert np.degrees(np.arctan2(places[:, 1], places[:, 0])) == pytest.approx([90.0, -150.0, -30.0], abs=1e-3)
    # The mirror x -> -x exchanges the magnets to the left and to the right.
    exchanged = np.array([0, 2, 1])[labels.reshape(41, 41)][::-1]
    off_axis = np.abs(runs.given("x").reshape(41, 41)) > 1e-9
    assert (exchanged == labels.reshape(41, 41))[off_axis].mean() > 0.99  # a border is sensitive to rounding
    assert_is_a_picture(tmp_path / "magnet_pendulum.png")


@pytest.mark.slow
def test_beats(tmp_path: Path) -> None:
    modes, alone = beats.main(tmp_path)
    # At an amplitude of 0.02 the terms beyond second order are 1e-4 of the energy.
    assert np.ptp(modes, axis=1) == pytest.approx([0.0, 0.0], abs=3e-4 * modes.sum(axis=0)[0])
    assert alone[0, 0] == pytest.approx(alone[1].max(), rel=0.02)  # all of it goes to the other
    assert_is_a_picture(tmp_path / "beats.png")


@pytest.mark.slow
def test_throw_in_wind(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(throw_in_wind.throws, "__defaults__", (256, 1))
    runs = throw_in_wind.main(tmp_path)
    landed = runs.y_events[0][:, 0]
    assert np.abs(landed[:, 1]).max() < 1e-12 and (landed[:, 3] < 0).all()
    # Sobol's points are spread evenly: the mean of 256 is that of the distribution, 4 Gamma(3/2), within a hundredth.
    assert runs.given("w").mean() == pytest.approx(4 * math.gamma(1.5), rel=0.01)
    assert "correlation of the distance with the wind: +0.9" in capsys.readouterr().out
    assert_is_a_picture(tmp_path / "throw_in_wind.png")
