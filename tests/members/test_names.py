"""Names of stored quantities are unique, in memory, in a data set and in a store."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg

STARTS = {"theta": [0.1, 0.2]}
theta, speed = lg.coordinate("theta"), lg.coordinate("theta").dot
ONE = sp.Rational(10**90 + 1, 10**90)
"""Written out it is longer than a name."""


def pendulum(**options: Any) -> lg.Ensemble:
    return lg.ensemble(lg.scene("pendulum"), 1.0, STARTS, **options)


def spring(name: str, **options: Any) -> lg.Ensemble:
    stiffness = sp.Symbol(name)
    system = lg.System(kinetic=speed**2 / 2, potential=stiffness * theta**2 / 2, parameters={stiffness: 1.0})
    return lg.ensemble(system, 1.0, {"theta": [1.0, 1.0]}, parameters={name: [1.0, 2.0]}, **options)


@pytest.mark.slow
def test_expressions_that_begin_alike_are_kept_apart() -> None:
    nearly, more = ONE * theta, ONE * theta**2
    runs = pendulum(keep=(("max", nearly), ("max", more), ("max", nearly)))
    first, second = (column.name for column in runs.columns if column.name.startswith("max"))
    for name, expression in ((first, nearly), (second, more)):
        alone = pendulum(keep=(("max", expression),))
        # Two expressions are compiled together, and one alone, which may round otherwise.
        assert np.allclose(runs[name], alone[alone.columns[-1].name], rtol=1e-14)
    assert (runs[second] < 0.5 * runs[first]).all()


KEPT: dict[str, tuple[Any, Any]] = {
    "letters that a name leaves out": (("max", ONE * theta), ("max", ONE * theta**2)),
    "last digits": (("max", sp.Float(0.1) * theta), ("max", sp.Float(np.nextafter(0.1, 1.0)) * theta)),
    "occurrences": (("events", 1), ("events", 2)),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "which", ["occurrences", *(pytest.param(name, marks=pytest.mark.slow) for name in [*KEPT][:-1])]
)
def test_a_store_of_other_expressions_is_refused(tmp_path: Path, which: str) -> None:
    pytest.importorskip("zarr")
    first, other = KEPT[which]
    given = {"events": [theta], "store": tmp_path / "runs.zarr"}
    pendulum(keep=(first,), **given)
    assert pendulum(keep=(first,), **given).form == "all members were stored"
    with pytest.raises(lg.StatementError, match=r"differs in (expressions|occurrences)"):
        pendulum(keep=(other,), **given)


@pytest.mark.parametrize("name", ["status", "t_end", "member", "steps", "theta_end", "theta_start"])
def test_a_parameter_called_as_what_is_kept_is_refused(name: str) -> None:
    with pytest.raises(lg.StatementError, match=f"^the system has the name {name!r}, which is also"):
        spring(name, keep=("end", "counts"))


def test_a_name_that_is_free_is_taken(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    assert np.array_equal(spring("steps")["steps"], [1.0, 2.0])
    assert np.array_equal(spring("checksum")["checksum"], [1.0, 2.0])
    with pytest.raises(lg.StatementError, match=r"^the system has the name 'checksum'"):
        spring("checksum", store=tmp_path / "runs.zarr")


@pytest.mark.parametrize("starts", [STARTS, lg.grid({"theta": [0.1, 0.2], "l": [1.0, 2.0]})], ids=["arrays", "grid"])
def test_a_data_set_tells_states_at_times_from_starts(starts: Any) -> None:
    pytest.importorskip("xarray")
    runs = lg.ensemble(lg.scene("pendulum"), 1.0, starts, t_eval=[0.0, 0.5, 1.0])
    result = runs.to_xarray()
    assert np.array_equal(np.unique(result["theta_start"]), [0.1, 0.2])
    assert np.array_equal(result["theta"].to_numpy().reshape(len(runs), 3), runs["theta"].T)
