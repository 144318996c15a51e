"""The pages of the reference of names: one for each group of functions and for each class, from the docstrings.

This module lists the names on each page; their texts are in the package. A public name without a page is an error.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import lagrange as lg

FUNCTIONS: dict[str, tuple[str, str, *tuple[tuple[str, ...], ...]]] = {
    "state": (
        "Stating a system",
        "The symbols of a statement, and energies of common parts.",
        ("coordinate", "coordinates", "parameters", "t", "given", "table", "multiplier", "event"),
        ("kinetic_energy", "rotational_energy", "gravity", "spring"),
        ("rotation", "turn", "x", "y", "z", "shape"),
        ("along", "contact", "contacts_between", "gap", "impact_speed"),
        ("scene", "scenes"),
    ),
    "run": (
        "Running and measuring",
        "What turns a model into numbers, and what says how good they are.",
        ("integrate", "flow", "load"),
        ("race", "trust_horizon", "targets"),
    ),
    "ensembles": (
        "Ensembles",
        "Many runs of one system: from many starts, or with many parameters.",
        ("ensemble",),
        ("grid", "sample"),
    ),
    "dynamics": (
        "Seeing dynamics",
        "Pictures of many motions, each with the numbers behind it; see :doc:`../dynamics`.",
        ("phase_portrait", "poincare", "bifurcation"),
    ),
    "show": (
        "Showing",
        "Figures beside those that solutions, races and methods draw of themselves.",
        ("plot", "figure"),
    ),
}
"""Pages of functions: a title, a line about it, and the names in their order; names in one tuple belong together."""

CLASSES = ("System", "Model", "Solution", "Status", "Event", "Race", "Ensemble", "TrustHorizon", "Trajectory")
WRITING_METHODS = ("Claims", "Integrator", "Problem")
ERRORS = ("LagrangeError", "StatementError", "SceneError", "RunError")
DATA = {
    "t": "The time, a SymPy symbol, in statements, events and ``solution.evaluate``.",
    "x": "The unit vector along the axis x, a SymPy matrix of three rows.",
    "y": "The unit vector along the axis y, a SymPy matrix of three rows.",
    "z": "The unit vector along the axis z, a SymPy matrix of three rows.",
    "along": "The part of a surface up to one of its points, from 0 to 1, a SymPy symbol, for `surfaces` of a System.",
    "impact_speed": "The speed -dgap/dt before an impact, a SymPy symbol, for the restitution of a contact.",
    "__version__": "The version of the package, a text.",
}
ELSEWHERE = ("methods",)
"""Modules that have pages of their own."""


def listed_names() -> list[str]:
    """Return all names that these pages list."""
    functions = [name for _, _, *groups in FUNCTIONS.values() for group in groups for name in group]
    return [*functions, *CLASSES, *WRITING_METHODS, *ERRORS, *ELSEWHERE, *DATA]


def unlisted_names() -> list[str]:
    """Return the public names that no page lists."""
    return sorted(set(lg.__all__) - set(listed_names()))


def members(kind: type) -> Iterator[str]:
    """Yield the public methods and properties of a class that this package documents, in alphabetical order."""
    for name in sorted(dir(kind)):
        attribute = inspect.getattr_static(kind, name)
        ours = any(name in vars(base) and base.__module__.startswith("lagrange.") for base in kind.__mro__)
        documented = not isinstance(attribute, (str, int, float, tuple, type(None)))
        if not name.startswith("_") and ours and documented:
            yield name


@cache
def link_targets() -> dict[str, str]:
    """Return the full names to which docstrings may link, by the names that docstrings use."""
    targets = {name: f"lagrange.{name}" for name in lg.__all__ if name not in ELSEWHERE}
    for kind in (*CLASSES, *WRITING_METHODS):
        targets |= {f"{kind}.{name}": f"lagrange.{kind}.{name}" for name in members(getattr(lg, kind))}
    targets |= {f"methods.{name}": f"lagrange.methods.{name}" for name in lg.methods.__all__}
    return {name: full for name, full in targets.items() if name not in ("t",)}


def heading(text: str, mark: str = "=") -> str:
    """Return a title in reStructuredText."""
    return f"{text}\n{mark * len(text)}\n"


def first_line(thing: Any) -> str:
    """Return the first sentence of a docstring, on one line."""
    return (inspect.getdoc(thing) or "").split("\n")[0]


def overview(kind: type) -> str:
    """Return a table of the members of a class, each with its line and a link."""
    if not (names := list(members(kind))) or issubclass(kind, Enum):
        return ""
    rows = "".join(
        f"   * - :py:obj:`{name} <lagrange.{kind.__name__}.{name}>`\n     - {escaped(first_line(member(kind, name)))}\n"
        for name in names
    )
    return f".. list-table::\n   :class: overview\n   :widths: 22 78\n\n{rows}\n"


def member(kind: type, name: str) -> Any:
    """Return a member whose docstring is wanted: a property is its own."""
    attribute = inspect.getattr_static(kind, name)
    return attribute.__func__ if isinstance(attribute, (classmethod, staticmethod)) else attribute


def escaped(line: str) -> str:
    """Return a line of a docstring for a table of reStructuredText."""
    from docstrings import marked

    return marked(line, {})


def class_directive(name: str) -> str:
    """Return the directives that document a class with its public members."""
    kind = getattr(lg, name)
    lines = [f".. autoclass:: lagrange.{name}", ""]
    if issubclass(kind, Enum):
        lines[1:1] = ["   :no-members:"]
        values = (f'   .. py:attribute:: {member.name}\n      :value: "{member.value}"\n' for member in kind)
        return "\n".join(lines) + "\n" + "\n".join(values) + "\n"
    for member in members(kind):
        attribute = inspect.getattr_static(kind, member)
        directive = "automethod" if callable(getattr(attribute, "__func__", attribute)) else "autoproperty"
        lines += [f"   .. {directive}:: lagrange.{name}.{member}", ""]
    return "\n".join(lines) + "\n"


def function_directive(name: str) -> str:
    """Return the directive of a function or a constant."""
    if name in DATA:
        return f".. py:data:: lagrange.{name}\n\n   {DATA[name]}\n\n"
    return f".. autofunction:: lagrange.{name}\n\n"


def pages() -> dict[str, str]:
    """Return the text of each page by its name."""
    if missing := unlisted_names():
        raise ValueError(f"public names that are not listed in docs/site/api.py: {', '.join(missing)}")
    texts: dict[str, str] = {}
    for name, (title, about, *groups) in FUNCTIONS.items():
        body = "\n".join(function_directive(function) for group in groups for function in group)
        texts[name] = f"{heading(title)}\n{about}\n\n{body}"
    for name in CLASSES:
        texts[name] = f"{heading(name)}\n{overview(getattr(lg, name))}\n{class_directive(name)}"
    texts["errors"] = heading("Errors") + "\n" + "".join(class_directive(name) for name in ERRORS)
    texts["methods"] = methods_page()
    texts["writing-methods"] = (
        heading("Interfaces of a method")
        + "\nWhat an integration method of another package satisfies; see :doc:`../dev/extending`.\n\n"
        + "".join(class_directive(name) for name in WRITING_METHODS)
    )
    texts["index"] = index_page()
    return texts


def methods_page() -> str:
    """Return the page of `lagrange.methods`."""
    makers = [name for name in lg.methods.__all__ if inspect.isfunction(getattr(lg.methods, name))]
    tools = [name for name in makers if name[0].islower()]
    classes = [name for name in lg.methods.__all__ if name not in tools]
    lines = [
        heading("lagrange.methods"),
        "Integration methods, such as ``lg.methods.RK4(step=0.01)``. :doc:`../choosing-an-integrator` says which to",
        "take, and :doc:`../tutorial-methods` how to write one.\n",
        ".. py:module:: lagrange.methods\n",
        heading("Functions", "-"),
        *(f".. autofunction:: lagrange.methods.{name}\n" for name in tools),
        heading("Methods", "-"),
        *(method_directive(name) for name in classes),
    ]
    return "\n".join(lines)


def method_directive(name: str) -> str:
    """Return the directive of a method: a class, or a function that makes one."""
    thing = getattr(lg.methods, name)
    if inspect.isclass(thing) and thing.__name__ != name:  # autodoc would call it an alias of what has no page
        return (
            f".. py:class:: lagrange.methods.{name}(max_step=inf, first_step=None)\n\n   {escaped(first_line(thing))}\n"
        )
    return f".. {'autoclass' if inspect.isclass(thing) else 'autofunction'}:: lagrange.methods.{name}\n"


def index_page() -> str:
    """Return the page that lists all of them."""
    tables = []
    for title, _, *groups in FUNCTIONS.values():
        rows = [(name, DATA.get(name) or escaped(first_line(getattr(lg, name)))) for group in groups for name in group]
        tables.append(f"{heading(title, '-')}\n{listing(rows)}")
    rows = [(name, escaped(first_line(getattr(lg, name)))) for name in (*CLASSES, *ERRORS, *WRITING_METHODS)]
    entries = (*FUNCTIONS, *CLASSES, "errors", "methods", "writing-methods")
    return (
        heading("Reference of names")
        + "\nEvery public name with its arguments, shapes, units and errors, from the docstrings. :doc:`../reference`"
        + " lists them with one line each.\n\n"
        + "\n".join(tables)
        + f"{heading('Classes', '-')}\n{listing(rows)}\n"
        + ".. py:module:: lagrange\n\n"
        + function_directive("__version__")
        + ".. toctree::\n   :hidden:\n\n"
        + "".join(f"   {entry}\n" for entry in entries)
    )


def listing(rows: list[tuple[str, str]]) -> str:
    """Return a table of names with a line each."""
    lines = "".join(f"   * - :py:obj:`{name} <lagrange.{name}>`\n     - {line}\n" for name, line in rows)
    return f".. list-table::\n   :class: overview\n   :widths: 22 78\n\n{lines}\n"


def write(folder: Path) -> None:
    """Write all pages into a folder."""
    from stage import write_changed

    for name, text in pages().items():
        write_changed(folder / f"{name}.rst", text)
