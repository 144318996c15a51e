"""Targets whose packages are broken: messages name the package, and do not advise the same target again."""

import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

import lagrange as lg
from tests.systems import unit_pendulum


class Broken(ModuleType):
    """A finder that makes a package fail like one with a broken shared library."""

    def __getattr__(self, name: str) -> Any:
        raise OSError("Could not load shared object file: libllvmlite.so")


@pytest.fixture(params=["a module is missing", "a shared library is missing"])
def broken(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Break llvmlite, unload the modules that use it, and return the text that the message must contain."""
    users = [name for name in sys.modules if name.startswith("lagrange.machine.llvm_machine")]
    for name in users:
        monkeypatch.delitem(sys.modules, name)
    gone: Any = None
    if request.param == "a module is missing":
        monkeypatch.setitem(sys.modules, "lagrange.machine.llvm.engine", gone)
        yield "lagrange.machine.llvm.engine"
    else:
        monkeypatch.setitem(sys.modules, "lagrange.machine.llvm.engine", Broken("lagrange.machine.llvm.engine"))
        yield "libllvmlite.so"


def test_the_message_names_what_cannot_be_loaded(broken: str) -> None:
    system = unit_pendulum()
    with pytest.raises(lg.StatementError, match="target 'llvm' cannot be loaded") as refusal:
        system.run(1.0)
    assert broken in str(refusal.value) and "run(..., target='numpy')" in str(refusal.value)
    assert system.run(1.0, target="numpy").status is lg.Status.SUCCESS


def test_numpy_is_checked_without_llvm(broken: str) -> None:
    """The check of the numpy target must not compile for LLVM."""
    report = unit_pendulum().check(target="numpy")
    assert report
    assert "not compared with the target llvm" in str(report) and broken in str(report)


def test_a_broken_numpy_target_does_not_send_to_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    gone: Any = None
    monkeypatch.delitem(sys.modules, "lagrange.machine.numpy_machine", raising=False)
    monkeypatch.setitem(sys.modules, "lagrange.machine.python_source", gone)
    with pytest.raises(lg.StatementError, match="target 'numpy' cannot be loaded") as refusal:
        unit_pendulum().compile("numpy")
    assert "python_source" in str(refusal.value) and str(refusal.value).count("numpy") == 1
