"""Compare every compiled quantity with numerical derivatives of the stated energies, at random points (`check`).

A stated system is checked on both targets, llvm and numpy, and with accelerations derived as in a textbook. The numbers
of points are here; the accepted error is in `report`.
"""

from __future__ import annotations

import math
import random
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mpmath
import sympy

from lagrange.equations.derivation import too_large
from lagrange.equations.solve_plan import has_large_block
from lagrange.errors import StatementError, listing
from lagrange.evidence.differences import ConstraintSurface
from lagrange.evidence.precise import BeyondDoubles, OutsideDomain, Precise, all_ways, describe_way
from lagrange.evidence.quick_check import quick_check, solved_statement
from lagrange.evidence.reference import REFERENCE_DIGITS, Reference
from lagrange.evidence.report import (
    LIMIT,
    Columns,
    Comparison,
    Direction,
    ReferenceEntries,
    Report,
    computed,
    computed_batch,
    entry_labels,
)
from lagrange.machine.backend import MissingTargetError
from lagrange.machine.model import Model, Stated
from lagrange.statement.coordinate import acceleration_of, multiplier, t
from lagrange.statement.expression import in_full, whole_number
from lagrange.statement.random_states import DRAWS_PER_KIND, SAMPLE_KINDS, SamplePoint, Sampler
from lagrange.statement.rotation import of_quaternions
from lagrange.statement.statement import Statement

__all__ = ["check", "quick_check", "textbook_tape"]

FAR_POINTS = 300
"""Number of random points tried to reach branches of conditions in the energies that no other point reaches."""

POINTS, FEW_POINTS, MANY_COORDINATES = 5, 3, 200
"""Number of points of a check; number for a large system; number of coordinates above which a system is large."""

MOST_WORK = 60_000_000
"""Largest estimated time of the reference values of a check, in units of 0.2 us, if `points` is None.

All entries of a chain of 10 links in relative angles are compared at 5 points: 46 million units, which took 10 s.
"""

SMALL_ENTRY = 1e-12
"""Threshold for small coordinates and velocities, as a fraction of the largest one. In a random direction, an entry
below it gets the weight of the largest."""

MOST_CHECKED_POINTS = 10_000
"""Largest number of points of one check."""

MOST_FAR_POINTS = 6
"""Largest number of points added to cover branches of conditions."""

MOST_JACOBIAN_COLUMNS = 24
"""Largest number of Jacobian columns checked at a point. Five points cover all columns of 60 coordinates."""

COSTLY_REFUSALS = 25
"""Largest number of points that fail only after the differences are computed; then the check ends.

Such a point has a singular mass matrix, or lacks a derivative.
"""

QUANTITIES = {
    "lagrangian": "L",
    "momenta": "momenta dL/dv",
    "forces": "forces dL/dq + Q - dD/dv",
    "mass_matrix": "mass matrix d2L/dv2",
    "bias": "bias h of M a = h",
    "energy": "energy v.p - L",
    "accelerations": "accelerations",
    "rhs": "right-hand side",
    "jacobian": "Jacobian of it",
}
CONSTRAINT_QUANTITIES = {
    "constraints": "constraints phi, dphi/dt",
    "constraint_gradient": "gradients G of the constraints",
    "constraint_bias": "gamma of G a + gamma = 0",
    "multipliers": "multipliers",
    "constraint_forces": "constraint forces",
}
PRODUCTS = {"mass_matrix": "mass matrix times direction", "jacobian": "Jacobian times direction"}
"""Rows of the report of a large system, in place of the rows for all entries of the two matrices."""
TEXTBOOK = "textbook accelerations"
BATCH = "batch against single"


def check(
    model: Model,
    textbook: Textbook | None = None,
    other: Model | None = None,
    points: int | None = None,
    seed: int = 0,
) -> Report:
    """Compare every quantity of a compiled model with its definition, at random points inside the domain.

    The reference differentiates the stated energies and constraints numerically at 90 digits, without compiled code.
    Some of the points satisfy the constraints; the others need not.

    `textbook` maps each coordinate to its acceleration as a SymPy expression, derived in another way, and adds a row to
    the report. `other` is the same system compiled for another target, and adds a row as well. Equal seeds give equal
    points. If `points` is None, there are 5 points, or 3 for more than 200 coordinates. If the reference values at
    these points would take longer than about 10 s, there may be fewer points, and the mass matrix and the Jacobian are
    compared only along random directions. A note in the report then says so. The cost grows with the number of terms of
    L that contain each coordinate, and with the cube of the number of coordinates if all are coupled. Raises
    StatementError for fewer than one point, and for a textbook that lacks a coordinate.
    """
    points = None if points is None else whole_number(points, "points", 1, MOST_CHECKED_POINTS)
    seed = whole_number(seed, "seed", 0)
    session = _Session(model, textbook, other, points, seed)
    for k in range(session.point_count):
        session.take(k)
    session.cover_branches()
    return session.report()


class _Session:
    """One check of a compiled model: the sample points used so far, and the comparisons at these points."""

    def __init__(
        self, model: Model, textbook: Textbook | None, other: Model | None, points: int | None, seed: int
    ) -> None:
        self.started = time.perf_counter()
        self.model = model
        self.other = other
        self.statement = model.statement
        self.reference = Reference(self.statement, model.equations.first_order, model.equations.rates_are_solved)
        self.full_count = points or (FEW_POINTS if len(self.statement.coordinates) > MANY_COORDINATES else POINTS)
        # If the Jacobian has many columns, each point checks the next few of them in turn. If that takes too long, a
        # direction replaces the columns, and their number is 0.
        width = len(self.statement.state_names)
        columns = min(width, MOST_JACOBIAN_COLUMNS, max(8, math.ceil(width / self.full_count)))
        rest, column, along = self.reference.work()
        self.point_count, self.column_count = self.full_count, columns
        if points is None and self.full_count * (rest + columns * column) > MOST_WORK:
            self.point_count, self.column_count = min(max(MOST_WORK // along, 1), self.full_count), 0
        self.draw = random.Random(seed)
        self.textbook = None if textbook is None else textbook_tape(textbook, self.statement)
        self.sampler = Sampler(self.statement, seed)
        self.surface = ConstraintSurface(self.statement)
        self.quantities = QUANTITIES | (CONSTRAINT_QUANTITIES if self.statement.constraints else {})
        self.quantities |= {} if self.column_count else PRODUCTS
        self.used: list[SamplePoint] = []
        self.outside: Counter[str] = Counter()
        self.costly = 0
        self.ways: set[tuple[Any, int]] = set()
        rows = [*self.quantities.values(), BATCH]
        rows += [TEXTBOOK] if self.textbook else []
        self.other_label = "" if other is None else f"{other.target} against {model.target}"
        rows += [self.other_label] if other is not None else []
        self.comparison = Comparison(self.statement.names, rows)

    def take(self, k: int) -> None:
        """Compare all quantities with their reference values at one random point, number `k` of the check.

        Points are drawn until one is in the domain of L. Nothing is compared after too many draws, or after too many
        points that fail only after expensive computations.
        """
        for attempt in range(DRAWS_PER_KIND * len(SAMPLE_KINDS)):
            if self.costly > COSTLY_REFUSALS:
                return
            kind = SAMPLE_KINDS[(k + attempt // DRAWS_PER_KIND) % len(SAMPLE_KINDS)]
            point = self.sampler.point(kind, attempt % DRAWS_PER_KIND)
            if self._use(self._on_constraints(point) if kind.state == "initial" else point):
                return

    def _on_constraints(self, point: SamplePoint) -> SamplePoint:
        """Return the nearest point that satisfies the constraints, or `point` unchanged if none is found."""
        if not self.statement.constraints:
            return point
        try:
            q, v = self.surface.nearest(point.q, point.v, point.t, point.parameters)
        except OutsideDomain:
            return point
        return replace(point, q=tuple(map(float, q)), v=tuple(map(float, v)), kind=f"{point.kind}, on the constraints")

    def cover_branches(self) -> None:
        """Compare all quantities at more points, at which conditions, Abs, sign, Min or Max have new outcomes."""
        added, most = 0, MOST_FAR_POINTS if self.column_count else 1
        for _ in range(FAR_POINTS):
            if added == most or not self._missing():
                return
            point = self.sampler.far()
            try:
                fresh = self._ways_at(point) - self.ways
            except OutsideDomain:
                continue
            added += bool(fresh) and self._use(point)

    def report(self) -> Report:
        """Return the report of all comparisons so far."""
        width, share, notes = len(self.statement.state_names), self.column_count, []
        if not share:
            count = len(self.used)
            directions = "1 random direction" if count == 1 else f"{count} random directions, one at each point"
            notes = [
                f"The system is large. The mass matrix and the Jacobian are checked along {directions}, and not entry "
                f"by entry. The Jacobian of a batch is not compared. points={self.full_count} checks all of this."
            ]
        elif share * len(self.used) < width:
            checked, more = share * len(self.used), math.ceil(width / share)
            notes = [f"The Jacobian is checked in {checked} of its {width} columns: points={more} checks all of them."]
        covered = "found" if share else "checked"
        missing = (describe_way(switch, way, self.statement) for switch, way in self._missing())
        return Report(
            system=self.statement.name,
            target=self.model.target,
            rows=self.comparison.rows() if self.used else (),
            points=tuple(point.describe(self.statement.names) for point in self.used),
            outside=dict(self.outside),
            unexplained=tuple(self.comparison.unexplained),
            notes=(*(f"Not covered: no point was {covered} where {outcome}." for outcome in missing), *notes),
            limit=LIMIT,
            seconds=time.perf_counter() - self.started,
        )

    def _use(self, point: SamplePoint) -> bool:
        columns = self._columns(point)
        try:
            ways = self._ways_at(point)
            self.costly += 1
            entries = self.reference.at(point, columns)
            self.costly -= 1
        except OutsideDomain as reason:
            self.outside[str(reason)] += 1
            self._compare_absence(point)
            return False
        self.used.append(point)
        self.ways |= ways
        self.comparison.start(point, len(self.used))
        self._compare(self.model, point, entries, columns)
        if self.other is not None:
            self._compare(self.other, point, entries, columns)
        for name, part in entries.items():
            if name == "jacobian" and not self.column_count:
                continue
            labels = entry_labels(name, self.statement, columns)
            for many, single in computed_batch(self.model, name, point, columns):
                self.comparison.add(BATCH, labels, many, part.around(single))
        if self.textbook is not None:
            self._compare_textbook(self.textbook, point, entries["accelerations"])
        return True

    def _columns(self, point: SamplePoint) -> Columns:
        """Return the indices of the Jacobian's columns to check at the next point, or a random direction.

        The weight of an entry in the direction is of the size of the entry, or of the largest coordinate or velocity if
        the entry is much smaller.
        """
        width, start = len(self.statement.state_names), len(self.used) * self.column_count
        if self.column_count:
            return [(start + i) % width for i in range(self.column_count)]
        weights = []
        for part in (point.q, point.v):
            largest = max(map(abs, part)) or 1.0
            sizes = [abs(x) if abs(x) > SMALL_ENTRY * largest else largest for x in part]
            weights += [x * self.draw.choice((-1, 1)) * self.draw.uniform(0.5, 1.0) for x in sizes]
        mass = computed(self.model, "mass_matrix", point, [])
        return Direction(weights, mass.reshape(len(point.q), -1))

    def _compare(
        self, model: Model, point: SamplePoint, entries: Mapping[str, ReferenceEntries], columns: Columns
    ) -> None:
        for name, part in entries.items():
            row = self.quantities[name] if model is self.model else self.other_label
            labels = entry_labels(name, self.statement, columns)
            self.comparison.add(row, labels, computed(model, name, point, columns), part)

    def _compare_textbook(self, tape: Precise | SolvedTextbook, point: SamplePoint, part: ReferenceEntries) -> None:
        try:
            expected = tape(point.q, point.v, point.t, point.parameters)
        except OutsideDomain as reason:
            self.comparison.report_unexplained(f"The textbook accelerations have no value ({reason})")
            return
        labels = entry_labels("accelerations", self.statement, [])
        self.comparison.add(TEXTBOOK, labels, computed(self.model, "accelerations", point, []), part.around(expected))

    def _compare_absence(self, point: SamplePoint) -> None:
        """Report a failure if the compiled L has a value at a point where the stated L has none."""
        try:
            self.reference.lagrangian(point.q, point.v, point.t, point.parameters)
        except BeyondDoubles:
            return
        except OutsideDomain as reason:
            self.comparison.start(point, 0)
            (value,) = computed(self.model, "lagrangian", point, [])
            if math.isfinite(value):
                self.comparison.report_unexplained(f"L has no value ({reason}), but the compiled L is {value:.17g}")

    def _ways_at(self, point: SamplePoint) -> set[tuple[Any, int]]:
        ways = zip(self.reference.switches, self.reference.inspect(point), strict=True)
        return {(switch, way) for switch, way in ways if way is not None}

    def _missing(self) -> list[tuple[Any, int]]:
        every = dict.fromkeys((switch, way) for switch in self.reference.switches for way in all_ways(switch))
        return [pair for pair in every if pair not in self.ways]


class SolvedTextbook:
    """The accelerations of a textbook derivation with rotations, as a function of the state.

    A call solves a linear system for the accelerations of coordinates and of small rotations of bodies, and for the
    multipliers. The accelerations of quaternions are computed from those of the small rotations.
    """

    def __init__(self, derivation: Any, statement: Statement, prescribed: Mapping[Any, Any]) -> None:
        read = statement.as_read
        turns = {q: sympy.Dummy() for q in read.coordinates}
        unknown = {acceleration_of(q): symbol for q, symbol in turns.items()}
        unknown |= {multiplier(each.name): sympy.Dummy() for each in read.constraints}
        accelerations = of_quaternions(turns, statement.rotations)
        second = {acceleration_of(q): accelerations[q] for q in statement.coordinates}
        laws = [in_full((law.lhs - law.rhs).xreplace(unknown)) for law in derivation.equations[: len(turns)]]
        for each in statement.constraints:
            laws.append(each.expression.diff(t, 2 if each.holonomic else 1).xreplace(second))
        rows, symbols = [*laws, *(accelerations[q] for q in statement.coordinates)], list(unknown.values())
        still = dict.fromkeys(symbols, sympy.S.Zero)
        rest = [row.xreplace(still) for row in rows]
        # Each row is linear, so a difference gives a coefficient, in less time than a derivative.
        entries = [
            row.xreplace({**still, symbol: sympy.S.One}) - alone
            for row, alone in zip(rows, rest, strict=True)
            for symbol in symbols
        ] + rest
        self._tape = Precise([entry.xreplace(prescribed) for entry in entries], statement, REFERENCE_DIGITS)
        self._shape = len(laws), len(rows), len(symbols)

    def __call__(self, q: Any, v: Any, time: float, parameters: Any) -> list[Any]:
        """Return the accelerations (n,) of a state. Raises OutsideDomain for singular equations."""
        count, size, width = self._shape
        entries = self._tape(q, v, time, parameters)
        with mpmath.workdps(REFERENCE_DIGITS):
            slopes, rest = mpmath.matrix(size, width), mpmath.matrix(entries[size * width :])
            slopes[:, :] = mpmath.matrix([entries[i * width : (i + 1) * width] for i in range(size)])
            try:
                solved = mpmath.lu_solve(slopes[:count, :], -rest[:count])
            except ZeroDivisionError:
                raise OutsideDomain("its equations are singular") from None
            return list(slopes[count:, :] * solved + rest[count:])


Textbook = Mapping[Any, Any] | SolvedTextbook
"""Accelerations by coordinate, or the equations that determine them, which are solved at each point."""


def textbook_tape(textbook: Textbook, statement: Statement) -> Precise | SolvedTextbook:
    """Return a program that computes the accelerations of a textbook derivation to many digits, for any state.

    Raises StatementError if the acceleration of a coordinate is missing in `textbook`.
    """
    if isinstance(textbook, SolvedTextbook):
        return textbook
    accelerations = [textbook.get(q, textbook.get(acceleration_of(q))) for q in statement.coordinates]
    missing = [name for name, a in zip(statement.names, accelerations, strict=True) if a is None]
    if missing:
        raise StatementError(
            f"the textbook has no acceleration of {listing(missing)}: give the accelerations of all coordinates."
        )
    return Precise(accelerations, statement, REFERENCE_DIGITS)


MOST_DERIVED = 100
"""Largest number of coordinates for which the textbook derivation is compared; for 300 it takes about 10 s."""


def check_stated(system: Stated, target: str, points: int | None, seed: int) -> Report:
    """Return the report on a system compiled for `target`: every quantity is compared with its definition.

    `points` is the number of random states, and `seed` determines them. If `points` is None, the number depends on the
    size of the system. The textbook derivation and the other target are compared as well, if they are available.
    """
    model = system.compile(target, check=False)
    statement = solved_statement(model)
    if statement is not model.statement:
        names = listing(repr(constraint.name) for constraint in statement.constraints)
        report = check_stated(system.from_statement(statement), target, points, seed)
        return replace(report, notes=(*report.notes, f"checked with {names} alone: other constraints follow."))
    other, missing, second = None, tuple[str, ...](), "numpy" if target == "llvm" else "llvm"
    try:
        other = system.compile(second, check=False)
    except MissingTargetError as error:
        missing = (f"not compared with the target {second}: {error}",)
    textbook, notes = _textbook(system, model)
    report = check(model, textbook=textbook, other=other, points=points, seed=seed)
    return replace(report, notes=(*report.notes, *missing, *notes))


def _textbook(system: Stated, model: Model) -> tuple[Textbook | None, tuple[str, ...]]:
    """Return (accelerations of the textbook derivation, no notes), or (None, a note that they are too large).

    `model` is the compiled system.
    """
    # Expressions for the given functions of time in the accelerations.
    values_of_functions = dict(model.statement.prescribed)
    if len(system.statement.coordinates) > MOST_DERIVED:
        limit = f"which is done up to {MOST_DERIVED} coordinates."
        return None, (f"not compared with the textbook derivation, {limit}",)
    derivation, equations = system.derivation(), model.equations
    try:
        # The graph shows sooner than the derivation that a mass matrix is too large.
        nonzero = [[entry is not equations.graph.zero for entry in row] for row in equations.mass]
        if system.statement.reading is None and has_large_block(nonzero):
            raise too_large(system.statement)
        solved = derivation.accelerations
        if system.statement.reading is not None:
            solved = of_quaternions(solved, system.statement.rotations)
        return {q: a.xreplace(values_of_functions) for q, a in solved.items()}, ()
    except StatementError as refusal:
        if system.statement.reading is not None:
            return SolvedTextbook(derivation, system.statement, values_of_functions), ()
        return None, (f"not compared with the textbook derivation: {refusal}",)
