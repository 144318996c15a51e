"""The full check: right systems hold, and each kind of fault is found and named."""

import json
import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.compiler import model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.errors import StatementError
from lagrange.evidence.check import QUANTITIES, check
from lagrange.evidence.quick_check import quick_check
from lagrange.evidence.reference import Reference
from lagrange.evidence.report import Report, ReportRow
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.model import Model
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.statement.coordinate import acceleration_of, coordinate, parameters
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
from tests.evidence import statements
from tests.evidence.statements import Break, StandIn

x, y = coordinate("x"), coordinate("y")
m, k, c = parameters("m k c")


def checked(model: StandIn, points: int = 5, **more: Any) -> Report:
    return check(cast("Model", model), points=points, **more)


def failing(report: Report) -> list[str]:
    return [row.quantity for row in report.rows if not row.holds]


@pytest.mark.few(1)
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
def test_what_is_right_holds(make: Callable[[], Statement]) -> None:
    report = checked(StandIn(make()), seed=1)
    assert report, str(report)
    assert [row.quantity for row in report.rows] == [*QUANTITIES.values(), "batch against single"]
    assert all(row.points == len(report.points) >= 5 and row.error < 1e-13 for row in report.rows)


def at_first(change: Callable[[Any], Any]) -> Break:
    """Return an array with its first nonzero entry changed."""

    def fault(entries: list[Any]) -> list[Any]:
        i = next(i for i, entry in enumerate(entries) if entry != 0)
        return [*entries[:i], change(entries[i]), *entries[i + 1 :]]

    return fault


def swapped(entries: list[Any]) -> list[Any]:
    i = next((i for i in range(len(entries) - 1) if entries[i] != entries[i + 1]), None)
    if i is None:
        return [2 * entries[0], *entries[1:]]
    return [*entries[:i], entries[i + 1], entries[i], *entries[i + 2 :]]


FAULTS: dict[str, Break] = {
    "sign": at_first(lambda entry: -entry),
    "scale": at_first(lambda entry: entry * sp.Float(1 + 1e-9, 20)),
    "drop": at_first(lambda entry: sum(sp.Add.make_args(sp.expand(entry))[1:], sp.S.Zero)),
    "swap": swapped,
}


@pytest.mark.few
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_fault_in_any_quantity_is_caught(quantity: str, fault: str) -> None:
    report = checked(StandIn(statements.driven_oscillator(), {quantity: FAULTS[fault]}), points=2)
    assert not report
    assert QUANTITIES[quantity] in failing(report)
    assert any(text.startswith(QUANTITIES[quantity]) for text in report.failures)


def test_the_failure_names_entry_place_and_values() -> None:
    def wrong(entries: list[Any]) -> list[Any]:
        return [entry + (0.5 if i == 1 else 0) for i, entry in enumerate(entries)]

    report = checked(StandIn(statements.driven_oscillator(), {"momenta": wrong}), points=1)
    row = report.rows[1]
    assert not row.holds and row.entry == "y" and row.point == 1
    assert row.compiled - row.reference == pytest.approx(0.5)
    (failure,) = (text for text in report.failures if text.startswith("momenta"))
    for word in ("entry y", "x = ", "y_dot = ", "t = ", "omega = ", "compiled", "expected"):
        assert word in failure


def test_jacobian_entries_are_named_by_their_variables() -> None:
    def wrong(entries: list[Any]) -> list[Any]:
        return [*entries[:8], entries[8] + 1, *entries[9:]]

    row = checked(StandIn(statements.driven_oscillator(), {"jacobian": wrong}), points=1).rows[8]
    assert row.entry == "d x_ddot / d x"


@pytest.mark.parametrize("size", [1e-10, 1e-3])
def test_a_small_wrong_entry_beside_a_large_one_is_caught(size: float) -> None:
    """The error is at most 1e-20 of the largest entry of the mass matrix."""
    statement = declare(
        kinetic=sp.Float(1e20) * x.dot**2 / 2 + sp.Float(1e-6) * (2 + sp.cos(x)) * y.dot**2,
        potential=x * y,
        coordinates=[x, y],
        name="unequal",
    )
    report = checked(StandIn(statement, {"mass_matrix": lambda e: [*e[:3], e[3] * (1 + size)]}), points=1)
    assert QUANTITIES["mass_matrix"] in failing(report)


@pytest.mark.slow
def test_a_term_hidden_by_the_defaults_is_not_hidden() -> None:
    """Terms hidden by default values (equal masses, zero drag, a coupling of 1e-25) are tested with other values."""
    first, second, coupling = parameters("first second coupling")
    statement = declare(
        kinetic=first * x.dot**2 / 2 + second * y.dot**2 / 2,
        potential=k * x**2 / 2 + coupling * x * y,
        dissipation=c * x.dot**2 / 2,
        parameters={first: 1.0, second: 1.0, c: 0.0, k: 1.0, coupling: 1e-25},
        name="hidden",
    )

    def without(symbol: Any) -> Break:
        return lambda entries: [entry.subs(symbol, 0) for entry in entries]

    def exchanged(entries: list[Any]) -> list[Any]:
        return [entry.subs({first: second, second: first}, simultaneous=True) for entry in entries]

    for broken in (without(c), without(coupling), exchanged):
        assert not checked(StandIn(statement, {"accelerations": broken})), broken


def test_rarely_taken_branches_are_sought_out() -> None:
    def soft(entries: list[Any]) -> list[Any]:
        (entry,) = entries
        plain = statements.contact().plain[statements.x]
        return [sp.Piecewise((entry * (1 + sp.Float(1e-6)), plain > 10), (entry, True))]

    assert not checked(StandIn(statements.contact(), {"forces": soft}))
    right = checked(StandIn(statements.contact()))
    assert right and not right.notes and len(right.points) > 5


def test_a_branch_that_was_never_reached_is_said() -> None:
    never, far = (sp.Piecewise((x**3, condition), (x**2, True)) for condition in (x > sp.cosh(x), x > 10**9))
    report = checked(StandIn(declare(kinetic=m * x.dot**2, potential=never, name="never")))
    assert report
    assert report.notes == ("Not covered: no point was found where x > cosh(x) holds.",)
    assert report.notes[0] in str(report)
    assert checked(StandIn(declare(kinetic=m * x.dot**2, potential=far, name="far"))).notes == ()


def test_points_outside_the_domain_are_counted_and_replaced() -> None:
    report = checked(StandIn(statements.half_line()))
    assert report and len(report.points) == 5
    assert sum(report.outside.values()) > 0
    assert "logarithm of a negative number" in str(report)


def test_a_value_made_up_outside_the_domain_is_unexplained() -> None:
    report = checked(StandIn(statements.half_line(), late=lambda name, value: np.nan_to_num(value)))
    assert not report
    assert "L has no value (logarithm of a negative number), but the compiled L is" in report.unexplained[0]


def test_a_missing_value_inside_the_domain_is_unexplained() -> None:
    def lost(name: str, value: Any) -> Any:
        return np.where(np.asarray(value) > 0, np.nan, value) if name == "forces" else value

    report = checked(StandIn(statements.driven_oscillator(), late=lost))
    assert not report
    assert report.unexplained[0].startswith("forces dL/dq + Q - dD/dv, entry ")
    assert "gives nan" in report.unexplained[0] and "omega = " in report.unexplained[0]


def test_one_wrong_lane_of_a_batch_is_caught() -> None:
    def crossed(name: str, value: Any) -> Any:
        if np.ndim(value) < 2 or name != "momenta":
            return value
        value[..., 9] = value[..., 8]
        return value

    report = checked(StandIn(statements.driven_oscillator(), late=crossed), points=1)
    assert failing(report) == ["batch against single"]


def test_the_textbook_gets_a_row() -> None:
    statement = statements.kepler()
    model = StandIn(statement)
    back = {plain: stated for stated, plain in statement.plain.items()}
    solved = [a.xreplace(back) for a in model.expressions["accelerations"]]
    right = dict(zip(statement.coordinates, solved, strict=True))
    report = checked(model, points=2, textbook=right)
    assert report and report.rows[-1].quantity == "textbook accelerations"
    wrong = {acceleration_of(q): a * (1 + 1e-9) for q, a in right.items()}
    assert failing(checked(model, points=2, textbook=wrong)) == ["textbook accelerations"]


def test_a_textbook_with_a_gap_is_refused() -> None:
    with pytest.raises(StatementError, match="no acceleration of phi: give the accelerations of all coordinates"):
        checked(StandIn(statements.kepler()), textbook={statements.r: 1})


def test_a_textbook_that_divides_by_zero_is_unexplained() -> None:
    report = checked(StandIn(statements.pendulum()), textbook={statements.theta: sp.log(-1 - statements.theta**2)})
    assert "textbook accelerations have no value" in report.unexplained[0]


@pytest.mark.slow
def test_another_target_gets_a_row() -> None:
    model = StandIn(statements.kepler())
    same = StandIn(statements.kepler(), target="elsewhere")
    report = checked(model, other=cast("Model", same))
    assert report and report.rows[-1].quantity == "elsewhere against stand-in"
    for quantity in QUANTITIES:
        other = StandIn(statements.kepler(), {quantity: FAULTS["scale"]}, target="elsewhere")
        report = checked(model, other=cast("Model", other), points=1)
        assert "elsewhere against stand-in" in failing(report), quantity


@pytest.mark.slow
def test_many_columns_are_looked_at_in_turn() -> None:
    many = [coordinate(f"x{i}") for i in range(6)]
    springs = sum((a - b) ** 4 for a, b in pairwise(many))
    statement = declare(kinetic=sum(q.dot**2 for q in many), potential=springs, coordinates=many, name="springs")

    def wrong(entries: list[Any]) -> list[Any]:
        return [*entries[:-1], entries[-1] + 1]

    model = StandIn(statement, {"jacobian": wrong})
    for points in (1, 2):
        report = checked(model, points=points)
        assert not report.rows[8].holds and report.rows[8].entry == "d x5_ddot / d x5_dot"


def along_directions(model: StandIn, monkeypatch: pytest.MonkeyPatch, **more: Any) -> Report:
    """Return the report of a check whose reference values would take too long."""
    monkeypatch.setattr("lagrange.evidence.check.MOST_WORK", 1)
    return check(cast("Model", model), **more)


def test_a_large_system_is_checked_along_a_direction_and_the_report_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    report = along_directions(StandIn(statements.kepler()), monkeypatch)
    assert report and len(report.points) == 1
    assert report.notes == (
        "The system is large. The mass matrix and the Jacobian are checked along 1 random direction, and not entry by "
        "entry. The Jacobian of a batch is not compared. points=5 checks all of this.",
    )
    rows = [row.quantity for row in report.rows]
    assert {"mass matrix times direction", "Jacobian times direction"} < {*rows} and QUANTITIES["jacobian"] not in rows


def test_as_many_points_are_taken_as_there_is_time_for(monkeypatch: pytest.MonkeyPatch) -> None:
    model = cast("Model", StandIn(statements.kepler()))
    work = Reference(model.statement).work()
    monkeypatch.setattr("lagrange.evidence.check.MOST_WORK", 2 * work[2])
    report = check(model)
    assert report and len(report.points) == 2 and "along 2 random directions, one at each point" in report.notes[0]


def test_a_number_of_points_that_is_given_is_checked_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    model = StandIn(statements.kepler())
    full, asked = checked(model, points=2), along_directions(model, monkeypatch, points=2)
    assert len(asked.points) == 2 and not asked.notes and asked.rows == full.rows


@pytest.mark.parametrize("statement", [statements.kepler, statements.driven_oscillator])
@pytest.mark.parametrize("quantity", ["mass_matrix", "accelerations", "jacobian"])
def test_a_wrong_entry_is_found_along_a_direction(
    quantity: str, statement: Callable[[], Statement], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {"mass_matrix": "mass matrix times direction", "jacobian": "Jacobian times direction"}
    count = len(StandIn(statement()).expressions[quantity])
    for k in range(count):

        def wrong(entries: list[Any], k: int = k) -> list[Any]:
            return [*entries[:k], entries[k] + sp.Rational(1, 10**6), *entries[k + 1 :]]

        report = along_directions(StandIn(statement(), {quantity: wrong}), monkeypatch)
        assert row.get(quantity, QUANTITIES[quantity]) in failing(report), k


def test_a_wrong_mass_matrix_does_not_excuse_wrong_accelerations(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong: dict[str, Break] = {
        "mass_matrix": lambda entries: [2 * entries[0]],
        "accelerations": lambda entries: [entries[0] / 2],
    }
    model = StandIn(statements.pendulum(), wrong)
    assert QUANTITIES["accelerations"] in failing(along_directions(model, monkeypatch))


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", ["double-pendulum", "four-bar", "knife-edge", "free-top"])
def test_right_systems_hold_along_a_direction(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lagrange.evidence.check.MOST_WORK", 1)
    report = lg.scene(scene).check()
    assert report and "along 1 random direction" in report.notes[0], report


@pytest.mark.parametrize("energy", [sp.log(-1 - x**2), sp.sqrt(-1 - x**2)])
def test_a_system_without_a_domain_fails_with_a_reason(energy: Any) -> None:
    report = checked(StandIn(declare(kinetic=m * x.dot**2 / 2, potential=energy, name="nowhere")))
    assert not report and not report.rows
    assert "no usable point was found: " in report.failures[0]
    assert "negative" in report.failures[0] and "initial state" in report.failures[0]


def test_a_singular_mass_matrix_everywhere_fails_with_a_reason() -> None:
    statement = declare(kinetic=(x.dot + y.dot) ** 2 / 2, potential=x * y, coordinates=[x, y], name="singular")
    regular = declare(kinetic=x.dot**2 + y.dot**2, potential=x * y, coordinates=[x, y], name="regular")
    model = StandIn(regular)
    model.statement = statement
    report = checked(model)
    assert not report
    assert "the mass matrix is singular" in report.failures[0]
    assert sum(report.outside.values()) < 30


@pytest.mark.parametrize("points", [0, -3])
def test_fewer_than_one_point_is_refused(points: int) -> None:
    with pytest.raises(StatementError, match=f"points = {points}: give a whole number from 1 to 10000"):
        checked(StandIn(statements.pendulum()), points=points)


def test_infinite_values_are_no_numbers() -> None:
    report = checked(StandIn(statements.pendulum(), late=lambda name, v: v * math.inf if name == "energy" else v))
    assert "energy" in report.unexplained[0]


# --- Models that were really compiled ---


HONEST = 1e-13
"""Rounding errors seen here are below 1e-14 of the size; the limit of the check is 2e-12."""


@pytest.mark.few(1)
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
def test_compiled_systems_hold_on_both_targets(make: Callable[[], Statement]) -> None:
    statement = make()
    equations = euler_lagrange(statement)
    model, other = model_of(statement, LlvmMachine(), equations), model_of(statement, NumpyMachine(), equations)
    report = check(model, other=other, points=3, seed=2)
    assert report, str(report)
    assert all(0 <= row.error < HONEST for row in report.rows), str(report)
    quick_check(model)
    quick_check(other)


# --- what a report says ---


GOOD = ReportRow("L", 1.5e-16, "lagrangian", 2, 5, 1.0, 1.0, holds=True)
BAD = ReportRow("accelerations", 0.25, "theta", 1, 5, 3.0, 4.0, holds=False)
LOST = ReportRow("momenta dL/dv", math.inf, "theta", 0, 5, 0.0, 0.0, holds=False)
UNSEEN = ReportRow("forces", -1.0, "-", 0, 0, 0.0, 0.0, holds=False)


def report(*rows: ReportRow, points: int = 2, unexplained: tuple[str, ...] = ()) -> Report:
    return Report(
        system="pendulum",
        target="llvm",
        rows=rows,
        points=tuple(f"theta = {i}.5" for i in range(points)),
        outside={"logarithm of zero": 3},
        unexplained=unexplained,
        notes=("Not covered: x > 10 holds.",),
        limit=2e-12,
        seconds=0.24,
    )


def test_a_good_report_is_true_and_says_so() -> None:
    good = report(GOOD)
    assert good and good.failures == ()
    lines = str(good).splitlines()
    assert lines[0] == "check of pendulum (llvm): 2 points"
    assert lines[2].split("  ")[0] == "quantity"
    assert lines[4].split() == ["L", "1.5e-16", "lagrangian", "2", "5", "holds"]
    assert lines[-3:] == [
        "Everything holds.",
        "Points left out because they are outside the domain: 3 x logarithm of zero.",
        "Not covered: x > 10 holds.",
    ]


def test_a_bad_report_is_false_and_says_where() -> None:
    bad = report(GOOD, BAD)
    assert not bad
    assert bad.failures == (
        "accelerations, entry theta: compiled 3, expected 4 (error 2.5e-01, limit 2.0e-12) at theta = 0.5",
    )
    assert "FAILS" in str(bad) and "1 found wrong:\n  accelerations, entry theta" in str(bad)


def test_missing_values_and_missing_comparisons_are_failures() -> None:
    assert report(GOOD, LOST, unexplained=("momenta lost",)).failures == ("momenta lost",)
    assert report(GOOD, UNSEEN).failures == ("forces: nothing could be compared",)


def test_no_points_are_a_failure_with_reasons_and_remedy() -> None:
    (failure,) = report(points=0).failures
    assert failure.startswith("no usable point was found: 3 x logarithm of zero. Give an initial state")


def test_it_is_plain_data_for_json() -> None:
    data = json.loads(json.dumps(report(GOOD, BAD).to_dict()))
    assert data["holds"] is False and data["system"] == "pendulum"
    assert data["rows"][1]["entry"] == "theta" and data["rows"][1]["holds"] is False
    assert data["outside"] == {"logarithm of zero": 3} and len(data["failures"]) == 1
