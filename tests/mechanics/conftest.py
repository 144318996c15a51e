"""Settings of the tests of mechanics."""

import pytest

from lagrange.mechanics.grading import time_limit


@pytest.fixture(autouse=True)
def _enough_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise time limits, so that wrong terms are also named on slow machines."""
    monkeypatch.setattr(time_limit, "SECONDS", float("inf"))
