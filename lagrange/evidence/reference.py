"""Compute reference values of all compiled quantities by differences of the stated energies, for `check`.

Errors are relative to the *size* of an entry: about the sum of the magnitudes of its terms. The size is measured. Every
intermediate number of L, Q and D gets its own factor 1 + O(1e-20), and the equations are differenced again. The change
of an entry, divided by 1e-20, is its size. Division by the entry itself would reject cancellation (1 - cos x near 0),
and division by the largest entry would miss a wrong small one.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from lagrange.evidence import differences
from lagrange.evidence.differences import DIFFERENCE_STEP, DifferenceSteps, Numbers, Row, Sources, StatedConstraints
from lagrange.evidence.precise import BeyondDoubles, Precise
from lagrange.evidence.report import Columns, Direction, ReferenceEntries
from lagrange.statement.random_states import SamplePoint
from lagrange.statement.statement import Statement

REFERENCE_DIGITS = 90
"""Decimal digits of the evaluations: third differences with steps of 1e-18 leave 36 of 90."""

PERTURBATION = 1e-20
"""Relative perturbation of every number. It is far above the errors, and small enough for a linear response."""

VALUE_NOISE = "1e-89"
"""Amplitude of the noise on each value of a perturbed L, relative to its size: ten times its rounding error."""

MASS_NOISE = "1e-80"
"""Second differences of L below this fraction of the size of L count as rounding.

Rounding and `VALUE_NOISE` cause 1e-88. An inertia of 1e-40 of the largest causes 1e-76, with steps of
`DIFFERENCE_STEP`.
"""

PERTURBED_COPIES = 2
"""Number of copies of the programs with random errors. Errors may cancel by chance in one copy, hardly ever in two."""

SINGULAR = 2.0**-42
"""Smallest pivot of a mass matrix that is not singular, relative to the largest entry in the row of the pivot.

At this pivot, four digits of the accelerations are correct in double precision. The limit of compiled code may be
slightly lower.
"""

LEAST_STEP_SIZE = 1e-20
"""Least ratio of difference steps: of an entry's step to the step of the largest coordinate or velocity.

A projected start may have velocities of 1e-37 that are rounding. With steps of this size the energy keeps no digits. In
a system with lengths and angles, sizes differ by up to 1e12 in units of length from 1e-12 to 1e12.
"""

ZERO_SIZE = 1e-12
"""Ratio of the step of an entry that is zero to the step of the largest coordinate or velocity. Second differences with
steps of 1e-30 keep 30 digits."""

EXPONENT_LIMIT = 450
"""Largest binary exponent of an intermediate value. Its square, as in derivatives, still fits into a double."""


class Reference:
    """The quantities of a statement by numerical differentiation, without compiled code.

    `first_order` are the indices of coordinates without inertia. Their equations of motion contain no accelerations, so
    the time derivatives of these equations are solved. If `rates_are_solved` is true, these equations are linear in the
    velocities of these coordinates, and the right-hand side has their solutions in place of the velocities of the
    state.
    """

    def __init__(self, statement: Statement, first_order: Sequence[int] = (), rates_are_solved: bool = False) -> None:
        self.statement, self.first_order, self.rates_are_solved = statement, tuple(first_order), rates_are_solved
        self.lagrangian = Precise([statement.lagrangian], statement, REFERENCE_DIGITS)
        self.loads = Precise([*statement.forces, statement.dissipation], statement, REFERENCE_DIGITS)
        self.constraints = Precise(
            [constraint.expression for constraint in statement.constraints], statement, REFERENCE_DIGITS
        )
        self.holonomic = tuple(constraint.holonomic for constraint in statement.constraints)
        self.number = self.lagrangian.context.mpf
        self.terms = terms = differences.terms_of(statement, self.lagrangian, self.loads, REFERENCE_DIGITS)
        energies = (terms.by_velocity, terms.by_place, terms.by_velocity)
        self._programs = _Programs(
            self.lagrangian, energies, self.loads, terms.dissipation, (self.constraints, self.constraints)
        )
        self._samples = [self._programs.perturbed(6 * k) for k in range(PERTURBED_COPIES)]

    def at(self, point: SamplePoint, columns: Columns) -> dict[str, ReferenceEntries]:
        """Return lagrangian, momenta, forces, mass_matrix, bias, energy, accelerations, rhs and jacobian by name.

        With constraints it also returns constraints, constraint_gradient, constraint_bias, multipliers and
        constraint_forces. mass_matrix and constraint_gradient are flattened by rows. jacobian has the columns of d
        rhs / d(q, v) that `columns` lists, one after another. If `columns` is a direction, mass_matrix and jacobian are
        their products with it, and the accelerations are corrected solutions with the mass matrix of the direction.
        Raises OutsideDomain if the point is not usable: the statement has no real, finite value or no derivative
        there, or the accelerations are not determined.
        """
        self.inspect(point)
        steps, parameters = self._steps(point), {p: self.number(x) for p, x in point.parameters.items()}

        def exact(program: Precise, _: Precise) -> differences.StateFunction:
            return lambda q, v, t: program(q, v, t, parameters)

        plain = self._functions(self._programs, exact, differences.exactly, parameters)
        quantities = [_Differences(self, *plain, point, steps.times(scale), columns).quantities() for scale in (1, 0.5)]
        quantities += [self._perturbed(k, point, steps, columns, parameters) for k in range(PERTURBED_COPIES)]
        unit = self.number(PERTURBATION)

        def size(value: Any, coarse: Any, samples: Sequence[Any]) -> Any:
            changes = (abs(sample - coarse) / unit for sample in samples if sample or coarse)
            return max(abs(value), *changes, 0) if value or any(samples) else 0

        n, along = len(point.q), isinstance(columns, Direction)
        count = 1 if along else len(columns)
        lengths = {"mass_matrix": n if along else n * n, "jacobian": n * count, "velocity_jacobian": n * count}
        entries = {}
        for name in quantities[0]:
            # In a perturbed copy elimination may exchange other rows, which fills other entries.
            indices = sorted(set().union(*(result[name] for result in quantities)))
            coarse, fine, *samples = ([result[name].get(index, 0) for index in indices] for result in quantities)
            value, error, _ = differences.extrapolated(coarse, fine)
            sizes = list(map(size, value, coarse, zip(*samples, strict=True)))
            rows = (dict(zip(indices, x, strict=True)) for x in (value, error, sizes))
            length = lengths.get(name, len(indices))
            entries[name] = ReferenceEntries(*([row.get(i, 0) for i in range(length)] for row in rows))
            entries[name].check_smooth()
        velocities, slopes, rates = (entries.pop(name) for name in ("velocities", "jacobian", "velocity_jacobian"))
        # The least size of a slope is the size of the acceleration divided by the size of the state. Second derivatives
        # of V may cancel where V and its gradient do not: V = sqrt(x**2 + 1) at x = 1e3 has a gradient of 1 and a slope
        # of 1e-9, which any formula computes as a difference of numbers of 1e-3. Perturbed operations in V do not show
        # this cancellation. A wrong slope is still found: its error exceeds 1e-12 of this bound.
        extent = max(1.0, *map(abs, (*point.q, *point.v)))
        longest = max(map(abs, columns.weights)) if isinstance(columns, Direction) else 1
        least_sizes = [least / (extent / longest) for least in entries["accelerations"].size]
        slopes = replace(slopes, size=[max(x, least_sizes[k % n]) for k, x in enumerate(slopes.size)])
        jacobian = ReferenceEntries([], [], [])
        for k in range(count):
            jacobian = jacobian + rates.part(k * n, n) + slopes.part(k * n, n)
        return {**entries, "rhs": velocities + entries["accelerations"], "jacobian": jacobian}

    def work(self) -> tuple[int, int, int]:
        """Return estimated times of the check at one point, in units of 0.2 us, from the statement alone.

        The first is without the Jacobian, the second is that of one column of the Jacobian, and the third is that of
        everything if a direction replaces the columns.
        """
        n, by_velocity, by_place = len(self.statement.coordinates), self.terms.by_velocity, self.terms.by_place
        column, copies = n // 2, 2 + PERTURBED_COPIES
        # A central difference takes two evaluations; in one of them only the displaced entry has changed.
        momenta = sum(part.work() + part.work(n + i) for i, part in enumerate(by_velocity))
        forces = sum(part.work() + part.work(i) for i, part in enumerate(by_place)) + self.loads.work()
        constraints = 2 * n * self.constraints.work(column) + 8 * self.constraints.work() if self.holonomic else 0
        mass = sum(
            2 * sum(k >= n for k in part.entries) * part.work(n + i)  # 4 values for each entry of a triangle
            for i, part in enumerate(by_velocity)
        )
        touched = self.terms.touched[column]
        slopes = sum(8 * by_velocity[i].work(column) + 4 * by_place[i].work(column) for i in touched)
        base = 3 * momenta + forces + constraints
        along = base + 10 * momenta + 2 * (forces + constraints)
        return copies * (base + mass), copies * (slopes + 2 * constraints), copies * along

    @property
    def switches(self) -> tuple[Any, ...]:
        """The conditions, Abs, sign, Min and Max in L, Q, D and the constraints: they select between formulas."""
        return self.lagrangian.switches + self.loads.switches + self.constraints.switches

    def inspect(self, point: SamplePoint) -> tuple[int | None, ...]:
        """Return the outcome of each switch (condition, Abs, sign, Min, Max) at a point, None without a value.

        Raises OutsideDomain if L, a force, the dissipation or a constraint has no value.
        """
        outcomes: tuple[int | None, ...] = ()
        for source in (self.lagrangian, self.loads, self.constraints):
            ways, largest = source.inspect(point.q, point.v, point.t, point.parameters)
            if largest > EXPONENT_LIMIT:
                raise BeyondDoubles("a number beyond the range of double precision")
            outcomes += ways
        return outcomes

    def _perturbed(
        self, k: int, point: SamplePoint, steps: DifferenceSteps, columns: Columns, parameters: Mapping[Any, Any]
    ) -> dict[str, Row]:
        """Return all quantities, computed by the perturbed programs number `k`."""
        draw = random.Random(k)
        factors: dict[tuple[str, int], Any] = {}
        unit, noise = self.number(PERTURBATION), self.number(VALUE_NOISE)

        def nudge(name: str, index: int) -> Any:
            if (name, index) not in factors:
                factors[name, index] = 1 + unit * draw.choice((-1, 1)) * draw.uniform(0.5, 1.0)
            return factors[name, index]

        def noisy(copy: Precise, program: Precise) -> differences.StateFunction:
            # Differences magnify the rounding of L itself. An entry that is zero by structure consists of this rounding
            # alone. With noise ten times as large, the size of such an entry exceeds its rounding.
            exact, off = (f(point.q, point.v, point.t, parameters) for f in (program, copy.about))
            amplitudes = [noise * max(abs(a), abs(b - a) / unit) for a, b in zip(exact, off, strict=True)]

            def values(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
                pairs = zip(copy(q, v, t, parameters), amplitudes, strict=True)
                return [x + amplitude * draw.uniform(-1.0, 1.0) for x, amplitude in pairs]

            return values

        self._samples[k].loads.about(point.q, point.v, point.t, parameters)
        functions = self._functions(self._samples[k], noisy, nudge, parameters)
        return _Differences(self, *functions, point, steps, columns).quantities()

    def _functions(
        self,
        programs: _Programs,
        values: Callable[[Precise, Precise], differences.StateFunction],
        nudge: differences.Nudge,
        parameters: Mapping[Any, Any],
    ) -> tuple[Sources, StatedConstraints]:
        """Return L, Q and D, and the constraints, as functions of (q, v, t) that `programs` compute.

        `values` returns the function for a program; its second argument is the same program without random factors.
        """
        plain, terms, loads = self._programs, self.terms, programs.loads
        still = [self.number(0)] * len(self.statement.coordinates)

        def scalars(row: Sequence[Precise], plain_row: Sequence[Precise]) -> Callable[[int], differences.StateFunction]:
            functions = _each(zip(row, plain_row, strict=True), values)
            return lambda i: lambda q, v, t: functions[i](q, v, t)[-1]

        for_momenta, for_forces, for_mass = map(scalars, programs.energies, plain.energies)
        sources = Sources(
            lagrangian=scalars([programs.lagrangian], [plain.lagrangian])(0),
            for_momenta=for_momenta,
            for_forces=for_forces,
            for_mass=for_mass,
            applied=(lambda q, v, t: loads(q, v, t, parameters)[:-1])
            if any(force != 0 for force in self.statement.forces)
            else (lambda q, v, t: still),
            dissipation=scalars(programs.drag, plain.drag) if self.statement.dissipation != 0 else None,
            nudge=nudge,
            read=terms.read.__getitem__,
            touched=terms.touched.__getitem__,
        )
        for_gradient, for_rates = map(values, programs.constraints, plain.constraints)
        return sources, StatedConstraints(for_gradient, for_rates, self.holonomic, nudge)

    def _steps(self, point: SamplePoint) -> DifferenceSteps:
        q, v, t, step = point.q, point.v, self.number(point.t), self.number(DIFFERENCE_STEP)
        largest = [self.number(max(map(abs, part))) for part in (q, v)]
        sizes = [
            [max(abs(x), most * (LEAST_STEP_SIZE if x else ZERO_SIZE)) or self.number(1) for x in part]
            for part, most in zip((q, v), largest, strict=True)
        ]
        timed = self.lagrangian.uses_time or self.constraints.uses_time
        return DifferenceSteps.at(q, v, t, step, timed=timed, sizes=sizes)


class _Differences:
    """All quantities at one point, computed by differences with given `steps`.

    `source` has L, Q and D as functions of (q, v, t). `columns` are the indices of the columns of the Jacobian to
    compute, or a direction. `relations` are the equations dp/dt - f = 0 of the coordinates without inertia, as
    constraints on velocities.
    """

    def __init__(
        self,
        reference: Reference,
        source: Sources,
        constraints: StatedConstraints,
        point: SamplePoint,
        steps: DifferenceSteps,
        columns: Columns,
    ) -> None:
        self.first_order, self.rates_are_solved = reference.first_order, reference.rates_are_solved
        self.number = reference.number
        self.source, self.constraints, self.steps, self.columns = source, constraints, steps, columns
        self.q, self.v = [list(map(self.number, x)) for x in (point.q, point.v)]
        self.t, self.n = self.number(point.t), len(point.q)
        self.still = [self.number(0)] * self.n

        def relations(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
            residuals = source.residual(list(q), list(v), t, steps, self.still)
            return [residuals[i] for i in self.first_order]

        self.relations = StatedConstraints(relations, relations, (False,) * len(self.first_order), source.nudge)

    def quantities(self) -> dict[str, Row]:
        """Return all quantities by name, each as {index: entry}; zeros of matrices may be left out."""
        source, constraints, nudge, n = self.source, self.constraints, self.source.nudge, self.n
        q, v, t, steps = here = self.q, self.v, self.t, self.steps
        lagrangian = source.lagrangian(q, v, t)
        p, f = source.momenta(*here), source.forces(*here)
        mass, product = self.inertia()
        rate = source.momentum_rate(*here, self.still)
        bias = [nudge("force", i) * x - nudge("rate", i) * y for i, (x, y) in enumerate(zip(f, rate, strict=True))]
        constrained = bool(constraints.holonomic)
        slopes = constraints.gradient(*here) if constrained else []
        constraint_bias = constraints.acceleration_level(*here, self.still) if constrained else []
        if not isinstance(self.columns, Direction):
            # Entries that are only rounding of L would be pivots without a correct digit.
            noise = self.number(MASS_NOISE) * (abs(lagrangian) + sum(abs(x * y) for x, y in zip(p, v, strict=True)))
            mass = [
                {j: x for j, x in row.items() if abs(x) * a * steps.v[j] > noise}
                for row, a in zip(mass, steps.v, strict=True)
            ]
        matrix, right = differences.bordered(mass, slopes), [*bias, *(-x for x in constraint_bias)]
        velocities = self.solved_velocities(q, v)
        if self.rates_are_solved:
            right[:n] = [-x for x in source.residual(q, velocities, t, steps, self.still)]
        if self.first_order:
            # The time derivative of the equation of a coordinate without inertia is g a + c = 0.
            constants = self.relations.acceleration_level(q, velocities, t, steps, self.still)
            gradients = self.relations.gradient(q, velocities, t, steps)
            for i, row, constant in zip(self.first_order, gradients, constants, strict=True):
                matrix[i], right[i] = dict(enumerate(row)), -constant
        solve = self.solver(matrix)
        solved = solve(dict(enumerate(right)))
        if isinstance(self.columns, Direction):
            # M may be wrong: the solution is corrected by the error of M a, where dp/dt gives the right value.
            a = [solved.get(i, 0) for i in range(n)]
            start, moving = (source.momentum_rate(q, velocities, t, steps, x) for x in (self.still, a))
            for i in set(range(n)).difference(self.first_order):
                right[i] += sum(x * a[j] for j, x in mass[i].items()) - (moving[i] - start[i])
            solved = solve(dict(enumerate(right)))
        a, multipliers = [solved.get(i, 0) for i in range(n)], [-solved.get(i, 0) for i in range(n, len(matrix))]
        entries = {
            "lagrangian": [lagrangian],
            "momenta": p,
            "forces": f,
            "mass_matrix": product,
            "bias": bias,
            "accelerations": a,
            "velocities": velocities,
            **self.slopes(a, multipliers, solve),
            "energy": [source.energy(v, p, lagrangian)],
        }
        if constrained:
            entries |= self.of_constraints(slopes, multipliers) | {"constraint_bias": constraint_bias}
        return {name: part if isinstance(part, dict) else dict(enumerate(part)) for name, part in entries.items()}

    def of_constraints(self, slopes: Sequence[Numbers], multipliers: Numbers) -> dict[str, Numbers]:
        """Return the constraints, their gradient, multipliers and forces; `slopes` are the rows of the gradient."""
        constraints, here = self.constraints, (self.q, self.v, self.t, self.steps)
        positions = constraints.chosen(constraints.for_rates(*here[:3]), [0] * len(multipliers))
        rates, nudge = constraints.velocity_level(*here), self.source.nudge
        exerted = differences.reactions(slopes, [x * nudge("exerted", i) for i, x in enumerate(multipliers)])
        return {
            "constraints": [*positions, *rates],
            "constraint_gradient": list(chain.from_iterable(slopes)),
            "multipliers": multipliers,
            "constraint_forces": list(chain.from_iterable(exerted)),
        }

    def slopes(self, a: Numbers, multipliers: Numbers, solve: Callable[[Row], Row]) -> dict[str, Row]:
        """Return the derivatives of dq/dt and of the accelerations by each of `columns`, flattened, by name.

        `a` and `multipliers` are the accelerations and multipliers at the point. `solve` solves the linear system for
        accelerations.
        """
        here, steps = (self.q, self.v, self.t, self.steps), self.steps
        source, constraints, columns, n = self.source, self.constraints, self.columns, self.n
        whole, constrained = bool(self.first_order) or isinstance(columns, Direction), bool(constraints.holonomic)

        def further(q: Any, v: Any, t: Any) -> Any:
            """Return [dp/dt - f - G^T lambda, G a + gamma] with constant a and lambda; dp/dt - f only if `whole`."""
            free, v = self.still, self.solved_velocities(q, v)
            if whole:
                free = source.residual(q, v, t, steps, a)
                rates = self.relations.acceleration_level(q, v, t, steps, a)
                for i, rate in zip(self.first_order, rates, strict=True):
                    free[i] = rate
            if not constrained:
                return np.array(free)
            exerted = differences.reactions(constraints.gradient(q, v, t, steps), multipliers)
            balance = [x - sum(column) for x, column in zip(free, zip(*exerted, strict=True), strict=True)]
            return np.array([*balance, *constraints.acceleration_level(q, v, t, steps, a)])

        if isinstance(columns, Direction):
            directions: list[dict[int, Any]] = [dict(enumerate(columns.weights))]
        else:
            directions = [{j: 1} for j in columns]
        slopes: list[Row] = [{} for _ in directions]
        if not isinstance(columns, Direction) and not whole:
            slopes = source.residual_slopes(*here, a, columns)
        if whole or constrained:
            for row, direction in zip(slopes, directions, strict=True):
                for i, change in enumerate(differences.slope(further, *here, direction)):
                    row[i] = row.get(i, 0) + change
        moving = [
            differences.slope(lambda q, v, t: np.array(self.solved_velocities(q, v)), *here, direction)
            for direction in directions
        ]
        return {
            "velocity_jacobian": {k * n + i: x for k, column in enumerate(moving) for i, x in enumerate(column) if x},
            "jacobian": {
                k * n + i: -x for k, column in enumerate(map(solve, slopes)) for i, x in column.items() if i < n
            },
        }

    def inertia(self) -> tuple[list[Row], Row]:
        """Return the rows of the mass matrix M, and its entries, flattened.

        For a direction, M is the compiled matrix, and the second result is the product of the stated M with the
        direction.
        """
        here, n, columns = (self.q, self.v, self.t, self.steps), self.n, self.columns
        if isinstance(columns, Direction):
            compiled = [{int(j): self.number(row[j]) for j in np.flatnonzero(row)} for row in columns.mass]
            direction = dict(enumerate(columns.weights[n:], n))
            copied = replace(self.source, for_momenta=self.source.for_mass)
            change = differences.slope(lambda q, v, t: np.array(copied.momenta(q, v, t, self.steps)), *here, direction)
            return compiled, dict(enumerate(change))
        mass = self.source.mass_matrix(*here)
        return mass, {i * n + j: x for i, row in enumerate(mass) for j, x in row.items()}

    def solved_velocities(self, q: Numbers, v: Numbers) -> Numbers:
        """Return the velocities v, for a coordinate without inertia as its first-order equation gives it.

        If `rates_are_solved` is false, v is returned unchanged.
        """
        if not self.rates_are_solved:
            return v
        rows = [[row[i] for i in self.first_order] for row in self.relations.gradient(q, v, self.t, self.steps)]
        off = self.relations.velocity_level(q, v, self.t, self.steps)
        corrections = dict(zip(self.first_order, differences.solve_dense(rows, off, SINGULAR), strict=True))
        return [x - corrections.get(i, 0) for i, x in enumerate(v)]

    def solver(self, matrix: Sequence[Row]) -> Callable[[Row], Row]:
        """Return a function that solves the linear system with this `matrix` for any right-hand side.

        The system is scaled so that it does not depend on units. In perturbed copies, a symmetric matrix is changed as
        rounding errors of its factorization would change it.
        """
        scales, nudge = differences.balance(matrix, self.n), self.source.nudge

        def balanced(row: Row, scale: Any) -> Row:
            return {j: x * scale * scales[j] for j, x in row.items()}

        rows = list(map(balanced, matrix, scales))
        if nudge is not differences.exactly and not self.first_order:
            for i, row in enumerate(differences.factorization_sizes(rows, len(matrix) - self.n)):
                for j in sorted(j for j, size in row.items() if j <= i and size):
                    change = row[j] * (nudge("factor", i * len(matrix) + j) - 1)
                    rows[i][j] = rows[j][i] = rows[i].get(j, 0) + change
        solution = differences.factorized(rows, SINGULAR)

        def solve(right: Row) -> Row:
            scaled = {i: x * scales[i] for i, x in right.items()}
            return {i: x * scales[i] for i, x in solution(scaled).items()}

        return solve


@dataclass(frozen=True)
class _Programs:
    """Programs for L, Q, D and the constraints, or copies in which each computed number has a factor close to 1.

    `energies` has three rows of programs for L: for p, for dL/dq and for M. `loads` has the forces Q, then D. The last
    result of an entry of `drag` is D, or the terms of D with one velocity. `constraints` has two programs for the
    constraints: for the gradient and for time derivatives.
    """

    lagrangian: Precise
    energies: Sequence[Sequence[Precise]]
    loads: Precise
    drag: Sequence[Precise]
    constraints: tuple[Precise, Precise]

    def perturbed(self, seed: int) -> _Programs:
        """Return copies of all programs; each has its own random factors."""

        def copies(programs: Sequence[Precise], seed: int) -> Sequence[Precise]:
            numbered = ((program, seed + 6 * PERTURBED_COPIES * i) for i, program in enumerate(programs))
            return _each(numbered, lambda program, own_seed: program.perturbed(PERTURBATION, own_seed))

        return _Programs(
            lagrangian=self.lagrangian.perturbed(PERTURBATION, seed + 1),
            energies=[copies(row, seed + i) for i, row in enumerate(self.energies)],
            loads=self.loads.perturbed(PERTURBATION, seed + 3),
            drag=copies(self.drag, seed + 3),
            constraints=(
                self.constraints[0].perturbed(PERTURBATION, seed + 4),
                self.constraints[1].perturbed(PERTURBATION, seed + 5),
            ),
        )


def _each(pairs: Iterable[tuple[Precise, Any]], make: Callable[[Precise, Any], Any]) -> list[Any]:
    """Return the list of `make(program, other)` for the pairs (program, other).

    If a program occurs several times, the result for its first pair is used for all.
    """
    results: dict[Precise, Any] = {}
    listed = []
    for tape, other in pairs:
        if tape not in results:
            results[tape] = make(tape, other)
        listed.append(results[tape])
    return listed
