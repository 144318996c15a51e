"""The modules that build the documentation site, which are scripts and no package."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

SITE = Path(__file__).resolve().parents[2] / "docs" / "site"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import one of the site's modules by its name."""
    monkeypatch.syspath_prepend(SITE)
    return import_module
