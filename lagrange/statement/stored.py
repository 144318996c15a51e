"""A statement as JSON data, and back. Reading runs no code and builds from a fixed list of classes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE

from lagrange.errors import StatementError, shown
from lagrange.statement.choice import printable
from lagrange.statement.coordinate import coordinate, name_of, t
from lagrange.statement.declare import declare
from lagrange.statement.dimension import Dimension
from lagrange.statement.given import given
from lagrange.statement.lexer import SYMPY_CLASSES
from lagrange.statement.motion import Table, motion_of
from lagrange.statement.statement import RunSettings, Statement
from lagrange.statement.text import Guard, RefusalError, check_arguments, check_power

FORM = 1
"""Version of the stored form."""

FEW_PARTS, MANY_SHARED, MOST_PARTS = 100_000, 1_000, 5_000_000
"""Limits on the parts of an expression: always allowed, allowed per node, and the largest number.

A shared part counts each time it occurs, for SymPy walks it each time, in 2 us. A file of 12 KB could otherwise make it
walk for ever. 500 links in Cartesian coordinates share 800 times.
"""

LONGEST_NUMBER = 400
"""Most characters of a number: those of the smallest double, written out, and a few more."""

_CLASSES: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        *(sympy.Add, sympy.Mul, sympy.Pow, sympy.And, sympy.Or, sympy.Not, ITE, ExprCondPair),
        *(sympy.StrictLessThan, sympy.LessThan, sympy.StrictGreaterThan, sympy.GreaterThan),
        *(sympy.Equality, sympy.Unequality),
        *SYMPY_CLASSES,
    )
}
"""Classes of nodes that an expression may have, by name."""

_CONSTANTS: dict[str, Any] = {
    str(one): one
    for one in (sympy.pi, sympy.E, sympy.GoldenRatio, sympy.EulerGamma, sympy.Catalan, sympy.true, sympy.false)
}


def stored(statement: Statement) -> dict[str, Any]:
    """Return a statement as texts, numbers, lists and dicts."""
    statement = statement.open_form or statement
    writer = _Writer(statement)
    return {
        "form": FORM,
        "name": statement.name,
        "about": statement.about,
        "source": statement.source,
        "coordinates": list(statement.names),
        "symbols": [[p.name, p.is_positive, p.is_nonnegative, p.is_real] for p in statement.parameters],
        "parameters": {p.name: value for p, value in statement.defaults.items()},
        "given": {name_of(function): writer.motion(function) for function in statement.given},
        "lagrangian": statement.potential == 0 and statement.kinetic == statement.lagrangian,
        "kinetic": writer.place(statement.kinetic),
        "potential": writer.place(statement.potential),
        "dissipation": writer.place(statement.dissipation),
        "forces": [writer.place(force) for force in statement.forces],
        "constraints": [[one.name, writer.place(one.expression)] for one in statement.constraints],
        "redundant": statement.redundant,
        "positions": {label: [writer.place(x) for x in point] for label, point in statement.positions.items()},
        "links": [list(link) for link in statement.links],
        "initial": list(statement.initial),
        "run": [statement.run.t_end, statement.run.method, statement.run.rtol, statement.run.atol, statement.run.step],
        "dimensions": [
            [writer.place(symbol), [[name, str(power)] for name, power in one.exponents], one.factor, one.unit]
            for symbol, one in statement.dimensions.items()
        ],
        "nodes": writer.nodes,
    }


class _Writer:
    """Writes expressions as one list of nodes, each after its arguments."""

    def __init__(self, statement: Statement) -> None:
        self.nodes: list[list[Any]] = []
        self.places: dict[Any, int] = {}
        self.given = statement.given

    def place(self, expression: Any) -> int:
        """Return the index of an expression in the list, after adding it if it is new."""
        stack = [expression]
        while stack:
            node = stack[-1]
            parts = _parts(node)
            waiting = [part for part in parts if part not in self.places]
            if waiting:
                stack.extend(waiting)
                continue
            stack.pop()
            if node not in self.places:
                self.places[node] = len(self.nodes)
                self.nodes.append(_node(node, [self.places[part] for part in parts]))
        return self.places[expression]

    def motion(self, function: Any) -> Any:
        """Return the values of a given function: the index of an expression, a table, or None."""
        motion = motion_of(function)
        if motion is None or motion.values is None:
            return None
        if isinstance(motion.values, Table):
            return [list(motion.values.points), list(motion.values.values)]
        return self.place(motion.values)


def _parts(node: Any) -> tuple[Any, ...]:
    return () if isinstance(node, (AppliedUndef, sympy.Derivative)) or node.is_Atom else tuple(node.args)


def _node(node: Any, parts: list[int]) -> list[Any]:
    """Return the entry of the list for a node: its kind, then its data or the indices of its arguments."""
    if isinstance(node, sympy.Derivative):
        return ["rate", name_of(node.expr), len(node.variables)]
    if isinstance(node, AppliedUndef):
        return ["rate", name_of(node), 0]
    if isinstance(node, sympy.Symbol):
        return ["t"] if node == t else ["symbol", node.name]
    if isinstance(node, sympy.Rational):
        return ["rational", str(node.p), str(node.q)]
    if isinstance(node, sympy.Float):
        return ["float", str(node._mpf_[1] * (-1) ** node._mpf_[0]), int(node._mpf_[2]), int(node._prec)]
    if str(node) in _CONSTANTS:
        return ["constant", str(node)]
    return [type(node).__name__, *parts]


def restored(data: Any) -> Statement:
    """Return the statement that `stored` wrote. Raises StatementError for anything else."""
    try:
        return _read(data)
    except StatementError:
        raise
    except (
        *(KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, MemoryError),
        *(NotImplementedError, RefusalError),
    ) as error:
        reason = str(error)[:120]
        raise StatementError(f"the stored statement cannot be read ({type(error).__name__}: {reason}).") from error


def _read(data: Any) -> Statement:
    if data["form"] != FORM:
        raise StatementError(f"the stored statement has the form {shown(data['form'])}, and this version reads {FORM}.")
    coordinates = {name: coordinate(name) for name in data["coordinates"]}
    symbols = {name: _symbol(name, *flags) for name, *flags in data["symbols"]}
    reader = _Reader(data["nodes"], coordinates, symbols, data["given"])
    at = reader.expression
    energies = {"kinetic": at(data["kinetic"]), "potential": at(data["potential"])}
    if data["lagrangian"]:
        energies = {"lagrangian": at(data["kinetic"])}
    pairs = [*coordinates.values(), *(q.dot for q in coordinates.values())]
    dimensions = {
        at(place): Dimension(tuple((name, Fraction(power)) for name, power in exponents), factor, unit)
        for place, exponents, factor, unit in data["dimensions"]
    }
    statement = declare(
        **energies,
        coordinates=list(coordinates.values()),
        dissipation=at(data["dissipation"]),
        forces={q: at(place) for q, place in zip(coordinates.values(), data["forces"], strict=True)},
        constraints={name: at(place) for name, place in data["constraints"]},
        redundant=data["redundant"],
        parameters={symbols[name]: data["parameters"].get(name) for name in symbols},
        initial=dict(zip(pairs, data["initial"], strict=True)),
        positions={label: tuple(map(at, point)) for label, point in data["positions"].items()},
        links=data["links"],
        name=printable(data["name"], "name"),
        about=printable(data["about"], "about"),
        source=printable(data["source"], "source"),
        run=RunSettings(*data["run"]),
    )
    return replace(statement, dimensions=MappingProxyType(dimensions))


def _symbol(name: str, positive: bool | None, nonnegative: bool | None, real: bool | None) -> Any:
    """Return a parameter with its stored assumptions on sign and reality."""
    assumptions = {"positive": positive, "nonnegative": nonnegative, "real": real}
    return sympy.Symbol(name, **{key: True for key, value in assumptions.items() if value is True})


class _Reader:
    """Builds the expressions of a list of nodes, unevaluated: evaluation by SymPy might never end."""

    def __init__(
        self,
        nodes: Iterable[Any],
        coordinates: Mapping[str, Any],
        symbols: Mapping[str, Any],
        motions: Mapping[str, Any],
    ) -> None:
        self.functions = dict(coordinates)
        self.symbols = symbols
        self.motions = motions
        self.guard = Guard()
        self.made: list[Any] = []
        self.sizes: list[int] = []
        leaves: dict[str, Callable[..., Any]] = {
            "rate": self._rate,
            "t": lambda: t,
            "symbol": lambda name: self.symbols[name],
            "rational": lambda p, q: sympy.Rational(_whole(p), _whole(q)),
            "float": _float,
            "constant": lambda name: _CONSTANTS[name],
        }
        for kind, *parts in nodes:
            if kind in leaves:
                self.made.append(leaves[kind](*parts))
                self.sizes.append(1)
            else:
                self._count(parts)
                self.made.append(self._built(kind, [self.expression(part) for part in parts]))

    def _count(self, parts: list[int]) -> None:
        """Append the number of parts of the next node to `sizes`. Raises RefusalError for more than SymPy can walk."""
        self.sizes.append(1 + sum(self.sizes[part] for part in parts if self.expression(part) is not None))
        if self.sizes[-1] > min(max(FEW_PARTS, MANY_SHARED * len(self.sizes)), MOST_PARTS):
            raise RefusalError(f"an expression of {self.sizes[-1]:.3g} parts, most of them shared")

    def _built(self, kind: str, parts: list[Any]) -> Any:
        """Return the node of that kind with these arguments.

        Raises RefusalError for numbers that SymPy would take too long to compute.
        """
        numbers = [part for part in parts if isinstance(part, sympy.Number)]
        joined = kind in ("Add", "Mul") and len(numbers) > 1
        if joined or (kind == "Pow" and len(numbers) == 2 and isinstance(parts[1], sympy.Integer)):
            raise RefusalError(f"{kind} of {len(numbers)} numbers")
        if kind == "Pow":
            check_power(*parts)
        elif _CLASSES[kind] in SYMPY_CLASSES - {sympy.Piecewise}:
            check_arguments(_CLASSES[kind], parts)
        node = _CLASSES[kind](*parts, **_unevaluated(kind))
        self.guard.check(node)
        return node

    def expression(self, place: int) -> Any:
        """Return the expression at an index among those built so far."""
        if type(place) is not int or not 0 <= place < len(self.made):
            raise IndexError(f"there is no node {shown(place)}")
        return self.made[place]

    def _rate(self, name: str, order: int) -> Any:
        if name not in self.functions:
            motion = self.motions[name]
            self.functions[name] = given(name, self.expression(motion) if isinstance(motion, int) else motion)
        function = self.functions[name]
        return sympy.Derivative(function, (t, int(order))) if order else function


def _unevaluated(kind: str) -> dict[str, bool]:
    return {} if kind == ExprCondPair.__name__ else {"evaluate": False}


def _whole(text: str) -> Any:
    if len(text) > LONGEST_NUMBER:
        raise ValueError(f"a number of {len(text)} digits")
    return sympy.Integer(int(text))


def _float(mantissa: str, exponent: int, precision: int) -> Any:
    if not (abs(exponent) <= 2000 and 0 < precision <= 1000):
        raise ValueError(f"a number with the exponent {exponent}")
    return sympy.Float(_whole(mantissa) * sympy.Integer(2) ** exponent, precision=precision)
