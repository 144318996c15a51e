from __future__ import annotations

import json
import math

from lagrange.evidence.report import Report, ReportRow

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
        "Points put aside, being outside the domain: 3 x logarithm of zero.",
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
