"""Hamilton's form: momenta for velocities by the Legendre transform, H = p.v - L, brackets and equations.

dq/dt = dH/dp and dp/dt = -dH/dq + Q - dD/dv. The Lagrangian p.dq/dt - H, linear in velocities, has the same equations;
it is the statement of what is compiled.
Source: H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., 2002, sections 8.1, 8.5 and 9.5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import sympy

from lagrange.errors import StatementError, listing
from lagrange.machine.model import Model
from lagrange.mechanics.legendre import Legendre, legendre
from lagrange.mechanics.number_check import compared
from lagrange.mechanics.plain_form import PlainForm, fresh_name, names_of, number
from lagrange.mechanics.rewriting import with_origin
from lagrange.mechanics.simplification import simplest
from lagrange.statement.coordinate import coordinate_of, t, velocity_of
from lagrange.statement.declare import declare
from lagrange.statement.expression import expression as expression_of
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.parameters import in_own_parameters
from lagrange.statement.statement import Statement
from lagrange.statement.survey import Survey


@dataclass(frozen=True, eq=False)
class Hamiltonian(ShownAsPage):
    """H(q, p, t) of a system, in SymPy, and what follows from it.

    `momenta` maps each coordinate to its momentum p_q, a function of time; `velocities` maps it to dq/dt as a function
    of coordinates and momenta. `forces` are those that no potential has, Q - dD/dv, in the same. `statement` states the
    system of coordinates and momenta, by the Lagrangian p.dq/dt - H; `made` makes a System of it.
    """

    expression: Any
    momenta: Mapping[Any, Any]
    velocities: Mapping[Any, Any]
    forces: Mapping[Any, Any]
    statement: Statement
    made: Callable[[Statement], Any]

    def __repr__(self) -> str:
        return f"<Hamiltonian: {self.expression}>"

    def __reduce__(self) -> tuple[Any, ...]:
        views = (dict(self.momenta), dict(self.velocities), dict(self.forces))
        return Hamiltonian, (self.expression, *views, self.statement, self.made)

    def equations(self) -> list[Any]:
        """Return Hamilton's equations, a list of SymPy Eq: the rates of the coordinates, then those of the momenta."""
        rates = [sympy.Eq(velocity_of(q), self._slope(p), evaluate=False) for q, p in self.momenta.items()]
        for q, p in self.momenta.items():
            right = simplest(-self._slope(q)) + self.forces[q]
            rates.append(sympy.Eq(velocity_of(p), right, evaluate=False))
        return rates

    def poisson(self, f: Any, g: Any) -> Any:
        """Return the Poisson bracket {f, g} = sum df/dq dg/dp - df/dp dg/dq.

        `f` and `g` are expressions in coordinates, momenta, parameters and t; velocities are written in momenta first.
        Raises StatementError for an expression with anything else in it.
        """
        first, second = self._function(f, "the first function"), self._function(g, "the second function")
        form, pairs = self._form, list(self.momenta.items())
        terms = []
        for q, p in pairs:
            x, y = form.plain[q], form.plain[p]
            terms.append(first.diff(x) * second.diff(y) - first.diff(y) * second.diff(x))
        return form.written(simplest(sympy.Add(*terms)))

    @cached_property
    def system(self) -> Any:
        """The System of coordinates and momenta, of first order: it runs as the one with velocities does."""
        return self.made(self.statement)

    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Compile Hamilton's equations; the state is [q, p] and behind it their rates, (4n,)."""
        model: Model = self.system.compile(target, check=check)
        return model

    def run(self, *given: Any, **options: Any) -> Any:
        """Run Hamilton's equations as `System.run` does; rows are found by coordinate and by momentum."""
        return self.system.run(*given, **options)

    @cached_property
    def _form(self) -> PlainForm:
        return PlainForm(self.statement)

    def _slope(self, leaf: Any) -> Any:
        """Return the derivative of H by a coordinate or a momentum."""
        form = self._form
        return form.written(simplest(form.read(self.expression).diff(form.plain[leaf])))

    def _function(self, given: Any, what: str) -> Any:
        """Return a function of coordinates and momenta in plain symbols."""
        stated, survey = in_own_parameters(expression_of(given, what), self.statement.parameters), Survey()
        survey.add(stated, what)
        for leaf in (*survey.coordinates, *survey.parameters):
            if leaf not in (*self.statement.coordinates, *self.statement.parameters):
                raise StatementError(
                    f"{what} contains {leaf}, which this system does not have: its coordinates and momenta are "
                    f"{listing(self.statement.names)}."
                )
        rates = {velocity_of(q): self.velocities[q] for q in self.momenta}
        stated = stated.xreplace(rates)
        left = [rate for rate in survey.velocities if rate not in rates]
        if left:
            raise StatementError(f"{what} contains {left[0]}: give coordinates and momenta, not the rates of momenta.")
        return self._form.read(stated)


def hamiltonian(statement: Statement, model: Model, made: Callable[[Statement], Any]) -> Hamiltonian:
    """Return Hamilton's form of a statement, tested against its model; `made` makes a System of a statement.

    Raises StatementError for constraints, and where momenta do not determine the velocities.
    """
    if statement.constraints:
        raise StatementError(
            f"{statement.name} has constraints ({listing(one.name for one in statement.constraints)}), whose forces "
            "Hamilton's equations lack: eliminate(...) makes a system without them, where they are on positions."
        )
    form = PlainForm(statement)
    momenta = _momenta(statement)
    found = legendre(form, [sympy.Symbol(p.func.__name__, real=True) for p in momenta])
    _check(form, found, model)
    return _record(form, momenta, found, made)


def _momenta(statement: Statement) -> list[Any]:
    """Return a function of time for each momentum, with a name that is free."""
    taken = list(names_of(statement))
    chosen = []
    for name in statement.names:
        taken.append(fresh_name(f"p_{name}"[:64], taken))
        chosen.append(coordinate_of(taken[-1]))
    return chosen


def _record(form: PlainForm, momenta: list[Any], found: Legendre, made: Callable[[Statement], Any]) -> Hamiltonian:
    """Return the record, with the statement of what is compiled."""
    statement = form.statement
    back = dict(zip(found.symbols, momenta, strict=True))
    in_momenta = dict(zip(form.v, found.velocities, strict=True))

    def stated(given: Any) -> Any:
        return form.written(given).xreplace(back)

    energy = stated(found.hamiltonian)
    forces = {
        q: stated(simplest(force.xreplace(in_momenta)))
        for q, force in zip(statement.coordinates, form.forces, strict=True)
    }
    pairs = list(zip(statement.coordinates, momenta, strict=True))
    first_order = declare(
        lagrangian=sympy.Add(*(p * velocity_of(q) for q, p in pairs)) - energy,
        coordinates=[*statement.coordinates, *momenta],
        forces={q: force for q, force in forces.items() if force != 0},
        parameters={p: statement.defaults.get(p) for p in statement.parameters},
        initial=_initial(form, momenta),
        positions={
            name: tuple(stated(form.read(x).xreplace(in_momenta)) for x in point)
            for name, point in statement.positions.items()
        },
        links=statement.links,
        name=f"{statement.name} in Hamilton's form",
    )
    return Hamiltonian(
        expression=energy,
        momenta=MappingProxyType(dict(pairs)),
        velocities=MappingProxyType(
            {q: stated(v) for q, v in zip(statement.coordinates, found.velocities, strict=True)}
        ),
        forces=MappingProxyType(forces),
        statement=with_origin(first_order, statement),
        made=made,
    )


def _initial(form: PlainForm, momenta: list[Any]) -> dict[Any, float]:
    """Return the initial coordinates, and the momenta where all parameters have values."""
    statement = form.statement
    n = len(statement.coordinates)
    start = dict(zip(statement.coordinates, statement.initial[:n], strict=True))
    if any(p not in statement.defaults for p in statement.parameters):
        return start
    values = {symbol: sympy.Rational(x) for symbol, x in zip((*form.q, *form.v), statement.initial, strict=True)}
    values |= {p: sympy.Rational(x) for p, x in statement.defaults.items()} | {t: sympy.S.Zero}
    for symbol, p in zip(momenta, form.momenta, strict=True):
        value = number(p, values)
        if value == value and value.imag == 0:
            start[symbol] = value.real
    return start


def _check(form: PlainForm, found: Legendre, model: Model) -> None:
    """Compare H, dH/dp and -dH/dq + Q with what is compiled, at random states."""
    slopes = [found.hamiltonian.diff(p) for p in found.symbols]
    pulls = [-found.hamiltonian.diff(q) + force for q, force in zip(form.q, form.forces, strict=True)]

    def values(point: Any) -> tuple[list[float], list[Any]]:
        numbers = form.at(point)
        momenta = model.momenta(point.q, point.v, point.t, point.parameters)
        numbers |= {p: sympy.Rational(float(x)) for p, x in zip(found.symbols, momenta, strict=True)}
        compiled = [
            model.energy(point.q, point.v, point.t, point.parameters),
            *point.v,
            *model.evaluate("forces", point.q, point.v, point.t, point.parameters),
        ]
        return compiled, [number(x, numbers) for x in (found.hamiltonian, *slopes, *pulls)]

    compared("the Hamiltonian", form.statement, values)
