"""lagrange: state kinetic and potential energy, get checked, compiled equations of motion and trajectories.

State a system: `coordinate`, `parameters`, `given`, `table`, `event`, `multiplier`, `t`, the energies `kinetic_energy`,
`rotational_energy`, `gravity` and `spring`, `contact` with `gap` and `impact_speed`,
`contacts_between`, `along`, `rotation` with `turn`, `x`, `y`, `z` and `shape`, and `System`; or `scene`, one of
`scenes()`.
Run it: `system.run()`, or `integrate` and `flow` with a compiled `Model`; `load` reads a run from a file.
Run many: `ensemble`, with `grid` or `sample`.
See dynamics: `phase_portrait`, `poincare`, `bifurcation`.
Judge: `race` compares methods, `trust_horizon` says how long a run can be trusted.
Draw: `plot` and `figure`, and the `plot` methods of results.
Extend: `methods`, and `Integrator` with `Problem` and `Claims`.

Names are loaded when they are first used, so that `import lagrange` is fast.
"""

from __future__ import annotations

import copyreg
from importlib import import_module
from types import MappingProxyType

__version__ = "0.1.0"


def _view(entries: dict[object, object]) -> MappingProxyType[object, object]:
    """Return a read-only view of a dict. Pickle finds this function by its name and calls it to restore views."""
    return MappingProxyType(entries)


copyreg.pickle(MappingProxyType, lambda view: (_view, (dict(view),)))


def _homes() -> dict[str, str]:
    """Return the module of each public name, read from the stub file `__init__.pyi`."""
    homes = {}
    with open(f"{__path__[0]}/__init__.pyi", encoding="utf-8") as stub:
        for line in stub:
            words = line.split()
            if words[:1] == ["from"]:
                homes[words[3]] = words[1]
    return homes


_HOMES = _homes()

__all__ = [*sorted(_HOMES), "__version__"]


def __getattr__(name: str) -> object:
    """Load a public name from the module that defines it (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'lagrange' has no attribute {name!r}")
    home = import_module(_HOMES[name])
    value = getattr(home, name) if hasattr(home, name) else import_module(f"{home.__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
