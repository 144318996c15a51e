"""Methods by name, by instance, of one's own, and the table of their claims."""

from __future__ import annotations

import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from lagrange.algorithm.series.cost import HIGHEST_ORDER
from lagrange.algorithm.taylor.constants import LOWEST_ORDER
from lagrange.errors import StatementError
from lagrange.show import methods
from lagrange.statement.coordinate import t
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.integrator import Claims, Integrator
from lagrange.trajectory.methods import registry
from lagrange.trajectory.methods.explicit import RK4
from lagrange.trajectory.methods.registry import BUILT_IN, GROUP, find, names, table
from lagrange.trajectory.methods.splitting import Splitting, SymplecticEuler, Verlet
from tests.models import model
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, STEPPED, run


def test_names_and_instances_are_found() -> None:
    for name in NAMES:
        assert find(name).name == name
    assert find(DEFAULT_METHOD).claims.adaptive
    instance = RK4(step=0.1)
    assert find(instance) is instance
    assert set(NAMES) <= set(names()) and names() == list(methods.names())


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("rk5", r"there is no method 'rk5'; the methods are euler, .* Did you mean 'rk4'\?"),
        ("", "there is no method ''"),
        (RK4, r"give a name, such as 'taylor', or an instance, such as lg\.methods\.RK4\(step=0\.01\)"),
        (Verlet, "give a name"),
        (4, "method is 4: give a name"),
        (Splitting, "give a name"),
    ],
)
def test_what_is_no_method_is_refused(method: Any, message: str) -> None:
    with pytest.raises(StatementError, match=message):
        run(model("oscillator"), 1.0, method)


class Standing:
    """The least integrator: it stays where it is, and says that it did."""

    name = "standing"
    claims = Claims(order=0)

    def integrate(self, problem: Any) -> Any:
        return RK4(step=abs(problem.t1 - problem.t0)).integrate(problem)


def test_anything_with_the_protocol_runs() -> None:
    integrator: Integrator = Standing()
    assert run(model("oscillator"), 1e-3, integrator).steps == 1


def test_events_are_refused_and_not_ignored_by_a_method_that_does_not_claim_them() -> None:
    with pytest.raises(StatementError, match="standing does not locate events: use taylor or another method"):
        run(model("oscillator"), 1e-3, Standing(), events=[t - 5e-4])


def test_the_table_of_methods() -> None:
    rows = {row.name: row for row in table()}
    assert set(NAMES) <= set(rows)
    assert rows["verlet"].claims == Claims(order=2, symplectic=True, symmetric=True, dense=3, events=True)
    text = str(table())
    assert text.splitlines()[0].split() == [
        "method", "order", "step", "symplectic", "symmetric", "energy", "A-stable", "dense", "about",
    ]  # fmt: skip
    assert "rk4" in text and "fixed" in text and "adaptive" in text
    markdown = table().to_markdown()
    assert "| `verlet` | 2 | fixed | yes | yes |  |  | 3 |" in markdown
    assert all(row.about for row in table())


def test_a_method_without_its_package_is_listed_and_refused_when_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("cvode", "lagrange.trajectory.foreign.sundials:CVODE", GROUP)
    monkeypatch.setattr(registry, "_offered", lambda: {"cvode": entry})
    monkeypatch.setitem(sys.modules, "sksundae", None)
    assert "cvode" in names() and find("cvode").claims == Claims(order=5, adaptive=True, explicit=False, events=True)
    assert {row.name: row for row in table()}["cvode"].about.startswith("CVODE of SUNDIALS")
    with pytest.raises(StatementError, match=r"needs scikit-sundae, .*: pip install scikit-sundae, or take"):
        run(model("oscillator"), 1.0, "cvode")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "bdf"}, "method = 'bdf' is not a family of CVODE's formulas: give 'BDF' or 'Adams'"),
        ({"max_step": 0.0}, "max_step = 0.0 cannot bound a step of cvode: give a positive time"),
        ({"first_step": float("nan")}, "first_step = nan cannot bound a step of cvode"),
        ({"max_order": 6}, "max_order = 6 is not an order of BDF formulas: give a whole number from 1 to 5"),
        ({"max_order": 2.5}, "max_order = 2.5 is not an order of BDF formulas"),
    ],
)
def test_options_of_cvode_that_cannot_be_meant(options: dict[str, Any], words: str) -> None:
    with pytest.raises(StatementError, match=words):
        methods.CVODE(**options)


@pytest.mark.parametrize("name", [*FIXED, *ADAPTIVE])
def test_claims_are_those_of_the_step(name: str) -> None:
    claims = find(name).claims
    assert claims.adaptive == (name in ADAPTIVE)
    assert claims.symplectic or not isinstance(find(name), Splitting)
    assert claims.dense > 0 or name not in STEPPED
    assert SymplecticEuler().claims.order == 1 and not SymplecticEuler().claims.symmetric


def test_every_built_in_method_stands_in_the_public_module() -> None:
    for make in BUILT_IN.values():
        name = getattr(make, "__name__", "")
        assert name in methods.__all__ and getattr(methods, name) is make


def test_a_method_is_entered_where_it_is_defined_and_listed_nowhere_else() -> None:
    folder = Path(registry.__file__).parent
    sources = {path.stem: path.read_text("utf-8") for path in sorted(folder.glob("*.py"))}
    families = [name for name, source in sources.items() if re.search(r"^@built_in\(", source, re.MULTILINE)]
    assert families == sorted(family.__name__.rpartition(".")[2] for family in registry.FAMILIES)
    public = Path(methods.__file__).read_text("utf-8")
    assert all(f"from lagrange.trajectory.methods.{name} import *" in public for name in families)
    for name, make in BUILT_IN.items():
        assert make.__module__.rpartition(".")[2] in families
        assert f'"{name}": ' not in public + sources["registry"]
        assert not re.search(rf"^ +\"?{make.__name__}\b", public + sources["registry"], re.MULTILINE)


def test_the_row_of_taylor_says_what_its_order_means() -> None:
    row = next(row for row in table() if row.name == "taylor")
    assert f"order by cost, {LOWEST_ORDER} to {HIGHEST_ORDER} (listed as {row.claims.order})" in row.about


@pytest.mark.parametrize(
    ("given", "meant"),
    [("RK45", "dopri5"), ("ode45", "dopri5"), ("RK4", "rk4"), ("BDF", "scipy-bdf"), ("gauss4", "gauss2")],
)
def test_names_from_elsewhere_are_understood(given: str, meant: str) -> None:
    with pytest.raises(StatementError, match=f"Did you mean '{meant}'"):
        find(given)


def test_a_tableau_is_a_method() -> None:
    method: Any = find("rk4")
    assert find(method.tableau).name == "rk4"


def test_an_entry_point_is_loaded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """To load it takes as long as a short run. Its class is called for each run."""
    first = find("scipy-rk45")
    monkeypatch.setattr(EntryPoint, "load", None)
    assert find("scipy-rk45") == first
