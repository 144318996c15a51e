"""The reference value of every compiled quantity at one point, and the size to which its error is relative.

The size is measured. Every intermediate number of L, Q and D gets its own factor 1 + O(1e-20), and the equations
are differenced again. The change of an entry, divided by 1e-20, is its *size*: about the sum of the magnitudes of its
terms. Errors are relative to the size. Dividing by the entry itself would reject cancellation (1 - cos x near 0), and
dividing by the largest entry would miss a wrong small one.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from lagrange.evidence import laws
from lagrange.evidence.laws import (
    DifferenceSteps,
    Numbers,
    Row,
    Sources,
    StatedConstraints,
    acceleration_level,
    bordered,
    gradient,
    local_terms,
    reactions,
    velocity_level,
)
from lagrange.evidence.precise import BeyondDoubles, Precise
from lagrange.evidence.report import Columns, Direction, ReferenceEntries
from lagrange.statement.random_states import SamplePoint
from lagrange.statement.statement import Statement

REFERENCE_DIGITS = 90
"""Decimal digits of the evaluations: third differences with steps of 1e-18 leave 36 of them."""

DIFFERENCE_STEP = "1e-18"
"""Step of the differences, relative to the argument: their error is about 1e-36 before extrapolation."""

PERTURBATION = 1e-20
"""Relative perturbation of every intermediate number: far above the errors, and small enough for a linear response."""

VALUE_NOISE = "1e-89"
"""Amplitude of the noise added to each evaluation of a perturbed L, relative to the size of L: ten roundings."""

MASS_NOISE = "1e-80"
"""Second differences of L below this fraction of its size count as rounding.

Rounding and `VALUE_NOISE` make 1e-88. An inertia of 1e-40 of the largest makes 1e-76, with steps of `DIFFERENCE_STEP`.
"""

PERTURBED_COPIES = 2
"""Number of perturbed copies. One sum with random signs may be small by accident; two are hardly ever."""

SINGULAR = 2.0**-42
"""Pivot, relative to its row, below which a mass matrix counts as singular.

In double precision four digits of the accelerations are left there. The limit of compiled code may be slightly lower.
"""

LEAST_STEP_SIZE = 1e-20
"""Smallest size of a coordinate or velocity, relative to the largest, by which its step is chosen.

A projected start may have velocities of 1e-37 that are rounding: with such steps the energy keeps no digits. Lengths
beside angles differ by 1e12 in units from 1e-12 to 1e12."""

ZERO_SIZE = 1e-12
"""Size of an entry that is zero, relative to the largest: second differences with steps of 1e-30 keep 30 digits."""

EXPONENT_LIMIT = 450
"""Largest binary exponent of an intermediate value: squares of it, as derivatives form them, still fit a double."""


class Reference:
    """The quantities of a statement by numerical differentiation, without compiled code.

    `first_order` are the indices of coordinates without inertia. Their equations of motion contain no accelerations, so
    the time derivatives of these equations are solved. If `settled`, the equations are linear in the velocities of
    these coordinates, and the right-hand side has their solutions in place of the velocities of the state.
    """

    def __init__(self, statement: Statement, first_order: Sequence[int] = (), settled: bool = False) -> None:
        self.statement, self.first_order, self.settled = statement, tuple(first_order), settled
        self.lagrangian = Precise([statement.lagrangian], statement, REFERENCE_DIGITS)
        self.loads = Precise([*statement.forces, statement.dissipation], statement, REFERENCE_DIGITS)
        self.held = Precise(
            [constraint.expression for constraint in statement.constraints], statement, REFERENCE_DIGITS
        )
        self.holonomic = tuple(constraint.holonomic for constraint in statement.constraints)
        self.number = self.lagrangian.context.mpf
        n = len(statement.coordinates)
        self.local = local_terms(statement, REFERENCE_DIGITS)
        same = [self.lagrangian] * n
        by_velocity, by_place = (self.local.by_velocity, self.local.by_place) if self.local else (same, same)
        # L is stored for p, for dL/dq and for M.
        self._energies = (by_velocity, by_place, by_velocity)
        self._loaded = any(force != 0 for force in statement.forces)
        self._samples = [_Perturbed.of(self, 6 * k) for k in range(PERTURBED_COPIES)]

    def at(self, point: SamplePoint, columns: Columns) -> dict[str, ReferenceEntries]:
        """Return lagrangian, momenta, forces, mass_matrix, bias, energy, accelerations, rhs and jacobian by name.

        With constraints it also returns constraints, constraint_gradient, constraint_bias, multipliers and
        constraint_forces. mass_matrix and constraint_gradient are flattened by rows. jacobian has the columns of d rhs
        / d(q, v) that `columns` lists, one after another. If `columns` is a direction, mass_matrix and jacobian are
        the products with it, and the accelerations are corrected solutions with the mass matrix that is given with
        the direction. Raises OutsideDomain if the point is not usable: the
        statement has no real, finite value or no derivative there, or the accelerations are not determined.
        """
        self.inspect(point)
        steps = self._steps(point)
        plain, on_constraints = self._plain(point)
        results = [self._laws(plain, on_constraints, point, steps.times(scale), columns) for scale in (1, 0.5)]
        results += [self._perturbed(k, point, steps, columns) for k in range(PERTURBED_COPIES)]
        unit = self.number(PERTURBATION)

        def size(value: Any, coarse: Any, samples: Sequence[Any]) -> Any:
            changes = (abs(sample - coarse) / unit for sample in samples if sample or coarse)
            return max(abs(value), *changes, 0) if value or any(samples) else 0

        n, along = len(point.q), isinstance(columns, Direction)
        count = 1 if along else len(columns)
        lengths = {"mass_matrix": n if along else n * n, "jacobian": n * count, "velocity_jacobian": n * count}
        entries = {}
        for name in results[0]:
            # A perturbed copy may exchange other rows, which fills other entries.
            indices = sorted(set().union(*(result[name] for result in results)))
            coarse, fine, *samples = ([result[name].get(index, 0) for index in indices] for result in results)
            value, error, _ = laws.extrapolated(coarse, fine)
            sizes = list(map(size, value, coarse, zip(*samples, strict=True)))
            length = lengths.get(name, len(indices))
            entries[name] = ReferenceEntries(*(_spread(x, indices, length) for x in (value, error, sizes)))
            entries[name].check_smooth()
        extent = max(1.0, *map(abs, (*point.q, *point.v)))
        longest = max(map(abs, columns.weights)) if isinstance(columns, Direction) else 1
        entries["jacobian"] = self._with_floor(entries["jacobian"], entries["accelerations"], extent / longest)
        velocities, slopes, rates = (entries.pop(name) for name in ("velocities", "jacobian", "velocity_jacobian"))
        jacobian = ReferenceEntries([], [], [])
        for k in range(count):
            jacobian = jacobian + rates.part(k * n, n) + slopes.part(k * n, n)
        return {**entries, "rhs": velocities + entries["accelerations"], "jacobian": jacobian}

    def work(self) -> tuple[int, int, int]:
        """Return the estimated times of one point: without the Jacobian, of one of its columns, and in a direction.

        The unit is 0.1 us. The estimates depend only on the statement.
        """
        n, (by_velocity, by_place, _) = len(self.statement.coordinates), self._energies
        column, copies = n // 2, 2 + PERTURBED_COPIES
        # Each central difference takes two values. The entry that is displaced last changes alone in one of them.
        momenta = sum(part.work() + part.work(n + i) for i, part in enumerate(by_velocity))
        forces = sum(part.work() + part.work(i) for i, part in enumerate(by_place)) + self.loads.work()
        constraints = 2 * n * self.held.work(column) + 8 * self.held.work() if self.holonomic else 0
        mass = sum(
            2 * sum(k >= n for k in part.entries) * part.work(n + i)  # 4 values for each entry on one side
            for i, part in enumerate(by_velocity)
        )
        touched = self.local.touched[column] if self.local else range(n)
        slopes = sum(8 * by_velocity[i].work(column) + 4 * by_place[i].work(column) for i in touched)
        base = 3 * momenta + forces + constraints
        along = base + 10 * momenta + 2 * (forces + constraints)
        return copies * (base + mass), copies * (slopes + 2 * constraints), copies * along

    def _with_floor(self, slopes: ReferenceEntries, accelerations: ReferenceEntries, extent: float) -> ReferenceEntries:
        """Return the entries `slopes` of the Jacobian of the accelerations, with a lower bound on their sizes.

        The size of an entry is the scale of its rounding error. Its bound is the size of the acceleration / `extent`,
        the size of the state. Second derivatives of V may cancel where V and its gradient do not: V = sqrt(x**2 + 1) at
        x = 1e3 has a gradient of 1 and a slope of 1e-9, which any formula computes as a difference of numbers of 1e-3.
        The sizes of the operations in V do not show it. A wrong slope is still found: its error exceeds 1e-12 of this
        bound.
        """
        n = len(accelerations.size)
        floors = [size / extent for size in accelerations.size]
        sizes = [max(size, floors[k % n]) for k, size in enumerate(slopes.size)]
        return ReferenceEntries(slopes.value, slopes.error, sizes)

    @property
    def switches(self) -> tuple[Any, ...]:
        """The conditions, Abs, sign, Min and Max in L, Q, D and the constraints: they select between formulas."""
        return self.lagrangian.switches + self.loads.switches + self.held.switches

    def inspect(self, point: SamplePoint) -> tuple[int | None, ...]:
        """Return the outcome of each switch (condition, Abs, sign, Min, Max) at a point, None without a value.

        Raises OutsideDomain if L, a force, the dissipation or a constraint has no value.
        """
        outcomes: tuple[int | None, ...] = ()
        for source in (self.lagrangian, self.loads, self.held):
            ways, largest = source.inspect(point.q, point.v, point.t, point.parameters)
            if largest > EXPONENT_LIMIT:
                raise BeyondDoubles("a number beyond the range of double precision")
            outcomes += ways
        return outcomes

    def _perturbed(self, k: int, point: SamplePoint, steps: DifferenceSteps, columns: Columns) -> dict[str, Row]:
        """Return all quantities, computed by the perturbed copy number `k` of the programs."""
        draw = random.Random(k)
        factors: dict[tuple[str, int], Any] = {}
        parameters = self._parameters(point)

        def nudge(name: str, index: int) -> Any:
            if (name, index) not in factors:
                factors[name, index] = 1 + self.number(PERTURBATION) * draw.choice((-1, 1)) * draw.uniform(0.5, 1.0)
            return factors[name, index]

        def noisy(tape: Precise, plain: Precise) -> laws.StateFunction:
            # Differencing magnifies the rounding of L itself, which is the only content of an entry that is zero by
            # structure. Noise ten times as large makes the size of such an entry larger than that rounding.
            exact, off = (f(point.q, point.v, point.t, parameters) for f in (plain, tape.about))
            unit, noise = self.number(PERTURBATION), self.number(VALUE_NOISE)
            amplitudes = [noise * max(abs(a), abs(b - a) / unit) for a, b in zip(exact, off, strict=True)]

            def values(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
                pairs = zip(tape(q, v, t, parameters), amplitudes, strict=True)
                return [x + amplitude * draw.uniform(-1.0, 1.0) for x, amplitude in pairs]

            return values

        sample = self._samples[k]
        sample.loads.about(point.q, point.v, point.t, parameters)
        scalars = [
            _each(zip(tapes, plain, strict=True), lambda tape, exact: _last(noisy(tape, exact)))
            for tapes, plain in zip(sample.energies, self._energies, strict=True)
        ]
        if self.local:
            pairs = zip(sample.drag, self.local.dissipation, strict=True)
            drag = [_last(noisy(tape, exact)) for tape, exact in pairs] if self.statement.dissipation != 0 else []
        else:
            drag = [_last(noisy(sample.loads, self.loads))] * len(point.q)
        whole = _last(noisy(sample.lagrangian, self.lagrangian)) if self.local else scalars[1][0]
        sources = self._sources(whole, scalars, sample.loads, drag, parameters, nudge)
        constraints = [noisy(tape, self.held) for tape in sample.held]
        stated = StatedConstraints(constraints[0], constraints[1], self.holonomic, nudge)
        return self._laws(sources, stated, point, steps, columns)

    def _plain(self, point: SamplePoint) -> tuple[Sources, StatedConstraints]:
        parameters = self._parameters(point)

        def exact(tape: Precise) -> laws.StateFunction:
            return lambda q, v, t: tape(q, v, t, parameters)

        scalars = [[_last(exact(tape)) for tape in tapes] for tapes in self._energies]
        whole = _last(exact(self.lagrangian))
        drag = [_last(exact(tape)) for tape in (self.local.dissipation if self.local else [self.loads] * len(point.q))]
        sources = self._sources(whole, scalars, self.loads, drag, parameters, laws.exactly)
        return sources, StatedConstraints.alike(exact(self.held), self.holonomic)

    def _sources(
        self,
        lagrangian: laws.StateFunction,
        energies: Sequence[Sequence[laws.StateFunction]],
        loads: Precise,
        dissipation: Sequence[laws.StateFunction],
        parameters: Mapping[Any, Any],
        nudge: laws.Nudge,
    ) -> Sources:
        for_momenta, for_forces, for_mass = energies
        n, local = len(for_momenta), self.local
        still = [self.number(0)] * n
        return Sources(
            lagrangian=lagrangian,
            for_momenta=for_momenta.__getitem__,
            for_forces=for_forces.__getitem__,
            for_mass=for_mass.__getitem__,
            forces=(lambda q, v, t: loads(q, v, t, parameters)[:-1]) if self._loaded else (lambda q, v, t: still),
            dissipation=dissipation.__getitem__ if self.statement.dissipation != 0 else None,
            nudge=nudge,
            read=lambda i: local.by_velocity[i].entries if local else range(len(self.statement.state_names)),
            touched=local.touched.__getitem__ if local else (lambda j: range(n)),
        )

    def _parameters(self, point: SamplePoint) -> dict[Any, Any]:
        return {p: self.number(x) for p, x in point.parameters.items()}

    def _steps(self, point: SamplePoint) -> DifferenceSteps:
        step = self.number(DIFFERENCE_STEP)
        least = [(part, self.number(max(map(abs, part)))) for part in (point.q, point.v)]
        sizes_q, sizes_v = (
            [max(abs(x), largest * (LEAST_STEP_SIZE if x else ZERO_SIZE)) or self.number(1) for x in part]
            for part, largest in least
        )
        # Along the motion a step must change no argument by more than its own step: in SI units a second is nothing
        # During the time step no coordinate may change by more than its own step. A step in proportion
        # to t alone would be too short for a planet in SI units: differences would lose all digits.
        times = [size / abs(x) for size, x in zip(sizes_q, point.v, strict=True) if x]
        if self.lagrangian.uses_time or self.held.uses_time or not times:
            times.append(abs(self.number(point.t)) or self.number(1))
        return DifferenceSteps([step * x for x in sizes_q], [step * x for x in sizes_v], step * min(times))

    def _laws(
        self,
        source: Sources,
        constraints: StatedConstraints,
        point: SamplePoint,
        steps: DifferenceSteps,
        columns: Columns,
    ) -> dict[str, Row]:
        """Return all quantities at a point by name, each as {index: entry}; zeros of matrices may be left out.

        `source` has L, Q and D. `columns` are the indices of the columns of the Jacobian to compute, or a direction.
        """
        q, v = [list(map(self.number, x)) for x in (point.q, point.v)]
        t, n, zero, nudge = self.number(point.t), len(point.q), self.number(0), source.nudge
        still, lagrangian = [zero] * n, source.lagrangian(q, v, t)
        p, f = laws.momenta(source, q, v, t, steps), laws.forces(source, q, v, t, steps)
        mass, product = self._inertia(source, (q, v, t), steps, columns)
        rate = laws.momentum_rate(source, q, v, still, t, steps)
        bias = [nudge("force", i) * x - nudge("rate", i) * y for i, (x, y) in enumerate(zip(f, rate, strict=True))]
        slopes = gradient(constraints, q, v, t, steps) if self.holonomic else []
        held_bias = acceleration_level(constraints, q, v, still, t, steps) if self.holonomic else []
        energy = abs(lagrangian) + sum(abs(x * y) for x, y in zip(p, v, strict=True))
        if not isinstance(columns, Direction):
            mass = self._without_noise(mass, energy, steps)
        matrix, right = bordered(mass, slopes), [*bias, *(-x for x in held_bias)]
        relations = self._relations(source, steps)

        velocities = self._settled(relations, t, steps, q, v)
        if self.settled:
            right[:n] = [-x for x in laws.residual(source, q, velocities, still, t, steps)]
        for i, (row, change) in self._first_order_rows(relations, q, velocities, t, steps).items():
            matrix[i], right[i] = row, -change
        solve = self._solver(matrix, nudge)
        solved = solve(dict(enumerate(right)))
        if isinstance(columns, Direction):
            trial = [solved.get(i, zero) for i in range(n)]
            for i, change in self._correction(source, (q, velocities, t), trial, mass, steps).items():
                right[i] += change
            solved = solve(dict(enumerate(right)))
        a, multipliers = [solved.get(i, zero) for i in range(n)], [-solved.get(i, zero) for i in range(n, len(matrix))]

        jacobians = self._slopes(source, constraints, relations, (q, v, t), (a, multipliers), steps, columns, solve)
        entries = {
            "lagrangian": [lagrangian],
            "momenta": p,
            "forces": f,
            "mass_matrix": product,
            "bias": bias,
            "energy": [laws.energy(source, v, p, lagrangian)],
            "accelerations": a,
            "velocities": velocities,
            **jacobians,
        }
        if self.holonomic:
            positions = constraints.chosen(constraints.for_rates(q, v, t), [0] * len(self.holonomic))
            entries["constraints"] = [*positions, *velocity_level(constraints, q, v, t, steps)]
            entries |= _of_gradient(slopes, multipliers, nudge) | {"constraint_bias": held_bias}
        return {name: part if isinstance(part, dict) else dict(enumerate(part)) for name, part in entries.items()}

    def _correction(
        self,
        source: Sources,
        state: tuple[Numbers, Numbers, Any],
        trial: Numbers,
        mass: Sequence[Row],
        steps: DifferenceSteps,
    ) -> Row:
        """Return the errors {row: M a - (dp/dt at a, less dp/dt at zero)} of a mass matrix M that may be wrong.

        `trial` are the accelerations a, and `state` is (q, v, t). Rows of coordinates without inertia are left out.
        """
        (q, v, t), still = state, [self.number(0)] * len(trial)
        start, moving = (laws.momentum_rate(source, q, v, a, t, steps) for a in (still, trial))
        return {
            i: sum(x * trial[j] for j, x in row.items()) - (moving[i] - start[i])
            for i, row in enumerate(mass)
            if i not in self.first_order
        }

    def _slopes(
        self,
        source: Sources,
        constraints: StatedConstraints,
        relations: StatedConstraints,
        state: tuple[Numbers, Numbers, Any],
        motion: tuple[Numbers, Numbers],
        steps: DifferenceSteps,
        columns: Columns,
        solve: Callable[[Row], Row],
    ) -> dict[str, Row]:
        """Return the derivatives of dq/dt and of the accelerations by entries of the state, by name.

        `columns` has the indices of these entries in (q, v), or is a direction. `state` is (q, v, t), `motion` has the
        accelerations and the multipliers there. `solve` solves the linear system for accelerations.
        """
        (q, v, t), (a, multipliers), n, zero = state, motion, len(state[0]), self.number(0)
        settled = partial(self._settled, relations, t, steps)
        whole = bool(self.first_order) or isinstance(columns, Direction)

        def further(q: Any, v: Any, t: Any) -> Any:
            """Return [dp/dt - f - G^T lambda, G a + gamma], or without dp/dt - f if it is differentiated below."""
            free, v = [zero] * n, settled(q, v)
            if whole:
                free = laws.residual(source, q, v, a, t, steps)
                rates = acceleration_level(relations, q, v, a, t, steps)
                for i, rate in zip(self.first_order, rates, strict=True):
                    free[i] = rate
            if not self.holonomic:
                return np.array(free)
            exerted = reactions(gradient(constraints, q, v, t, steps), multipliers)
            balance = [x - sum(column) for x, column in zip(free, zip(*exerted, strict=True), strict=True)]
            return np.array([*balance, *acceleration_level(constraints, q, v, a, t, steps)])

        if isinstance(columns, Direction):
            derivatives = [partial(laws.slope_along, q=q, v=v, t=t, steps=steps, direction=columns.weights)]
            slopes: list[Row] = [{}]
        else:
            derivatives = [partial(laws.slope, q=q, v=v, t=t, steps=steps, j=j) for j in columns]
            slopes = [{} for _ in columns]
            if not self.first_order:
                slopes = laws.residual_slopes(source, q, v, a, t, steps, columns)
        if whole or self.holonomic:
            for row, derivative in zip(slopes, derivatives, strict=True):
                for i, change in enumerate(derivative(further)):
                    row[i] = row.get(i, 0) + change
        moving = [derivative(lambda q, v, t: np.array(settled(q, v))) for derivative in derivatives]
        jacobian = map(solve, slopes)
        return {
            "velocity_jacobian": {k * n + i: x for k, column in enumerate(moving) for i, x in enumerate(column) if x},
            "jacobian": {k * n + i: -x for k, column in enumerate(jacobian) for i, x in column.items() if i < n},
        }

    def _inertia(
        self, source: Sources, state: tuple[Numbers, Numbers, Any], steps: DifferenceSteps, columns: Columns
    ) -> tuple[list[Row], Row]:
        """Return the rows of the mass matrix M, and its entries, flattened, or its product with a direction.

        With a direction, M is the compiled matrix `columns.mass`, and the product is computed from the stated energies.
        `state` is (q, v, t).
        """
        (q, v, t), n = state, len(state[0])
        if isinstance(columns, Direction):
            given = [{int(j): self.number(row[j]) for j in np.flatnonzero(row)} for row in columns.mass]
            direction = [0] * n + list(columns.weights[n:])
            copied = replace(source, for_momenta=source.for_mass)
            change = laws.slope_along(
                lambda q, v, t: np.array(laws.momenta(copied, q, v, t, steps)), q, v, t, steps, direction
            )
            return given, dict(enumerate(change))
        mass = laws.mass_matrix(source, q, v, t, steps)
        return mass, {i * n + j: x for i, row in enumerate(mass) for j, x in row.items()}

    def _relations(self, source: Sources, steps: DifferenceSteps) -> StatedConstraints:
        """Return the equations dp/dt - f = 0 of the coordinates without inertia, as constraints on velocities."""

        def values(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
            still = [self.number(0)] * len(q)
            residuals = laws.residual(source, list(q), list(v), still, t, steps)
            return [residuals[i] for i in self.first_order]

        return StatedConstraints(values, values, (False,) * len(self.first_order), source.nudge)

    def _first_order_rows(
        self, relations: StatedConstraints, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps
    ) -> dict[int, tuple[Row, Any]]:
        """Return {index of a coordinate without inertia: (g, c)}: its equation, differentiated, is g a + c = 0.

        a are all accelerations, and g is a row {index: entry}. `relations` are the equations of these coordinates
        before they are differentiated in time.
        """
        if not self.first_order:
            return {}
        rates = acceleration_level(relations, q, v, [self.number(0)] * len(q), t, steps)
        rows = map(dict, map(enumerate, gradient(relations, q, v, t, steps)))
        return dict(zip(self.first_order, zip(rows, rates, strict=True), strict=True))

    def _settled(self, relations: StatedConstraints, t: Any, steps: DifferenceSteps, q: Numbers, v: Numbers) -> Numbers:
        """Return the velocities v. If `self.settled`, those of coordinates without inertia are computed.

        They are the solutions of the first-order equations of these coordinates, `relations`.
        """
        if not self.settled:
            return v
        rows = [[row[i] for i in self.first_order] for row in gradient(relations, q, v, t, steps)]
        off = velocity_level(relations, q, v, t, steps)
        corrections = dict(zip(self.first_order, laws.solve_dense(rows, off, SINGULAR), strict=True))
        return [x - corrections.get(i, 0) for i, x in enumerate(v)]

    def _solver(self, matrix: Sequence[Row], nudge: laws.Nudge) -> Callable[[Row], Row]:
        """Return a function from a right-hand side to the solution of the linear system with this `matrix`.

        The system is scaled so that it does not depend on units. `nudge` gives the factors close to 1 that imitate
        rounding.
        """
        scales = laws.balance(matrix, len(matrix) - len(self.holonomic))

        def balanced(row: Row, scale: Any) -> Row:
            return {j: x * scale * scales[j] for j, x in row.items()}

        rows = list(map(balanced, matrix, scales))
        factored = rows if nudge is laws.exactly or self.first_order else self._as_factored(rows, nudge)
        solution = laws.factorized(factored, SINGULAR)

        def solve(right: Row) -> Row:
            scaled = {i: x * scales[i] for i, x in right.items()}
            return {i: x * scales[i] for i, x in solution(scaled).items()}

        return solve

    def _without_noise(self, mass: Sequence[Row], energy: Any, steps: DifferenceSteps) -> list[Row]:
        """Return M without entries that are only rounding of L: they would be pivots without a correct digit."""
        noise = self.number(MASS_NOISE) * energy
        return [
            {j: x for j, x in row.items() if abs(x) * a * steps.v[j] > noise}
            for row, a in zip(mass, steps.v, strict=True)
        ]

    def _as_factored(self, matrix: Sequence[Row], nudge: laws.Nudge) -> list[Row]:
        """Return a symmetric matrix, changed as rounding errors in its factorization would change it.

        `nudge` gives the factors close to 1 that imitate rounding.
        """
        sizes = laws.factorization_sizes(matrix, len(self.holonomic))
        off = [dict(row) for row in matrix]
        for i, row in enumerate(sizes):
            for j in sorted(j for j, size in row.items() if j <= i and size):
                change = row[j] * (nudge("factor", i * len(matrix) + j) - 1)
                off[i][j] = off[j][i] = off[i].get(j, 0) + change
        return off


def _of_gradient(slopes: Sequence[Numbers], multipliers: Numbers, nudge: laws.Nudge) -> dict[str, Numbers]:
    """Return the gradient G, the multipliers and the constraint forces by name; `slopes` are the rows of G."""
    exerted = reactions(slopes, [x * nudge("exerted", i) for i, x in enumerate(multipliers)])
    return {
        "constraint_gradient": list(chain.from_iterable(slopes)),
        "multipliers": multipliers,
        "constraint_forces": list(chain.from_iterable(exerted)),
    }


def _spread(numbers: Numbers, indices: Sequence[int], length: int) -> Numbers:
    """Return a list of `length` entries: `numbers` at the given indices, and zeros elsewhere."""
    whole = [0] * length
    for index, number in zip(indices, numbers, strict=True):
        whole[index] = number
    return whole


@dataclass(frozen=True)
class _Perturbed:
    """Copies of all programs of a `Reference`, in which each computed number has a random factor close to 1.

    `energies` has three rows of copies for L: for p, for dL/dq and for M.
    """

    lagrangian: Precise
    energies: Sequence[Sequence[Precise]]
    loads: Precise
    drag: Sequence[Precise]
    held: tuple[Precise, Precise]

    @classmethod
    def of(cls, reference: Reference, seed: int) -> _Perturbed:
        """Return copies of all programs of a `reference`; each has its own random factors."""

        def copies(tapes: Sequence[Precise], seed: int) -> Sequence[Precise]:
            numbered = ((tape, seed + 6 * PERTURBED_COPIES * i) for i, tape in enumerate(tapes))
            return _each(numbered, lambda tape, tape_seed: tape.perturbed(PERTURBATION, tape_seed))

        return cls(
            lagrangian=reference.lagrangian.perturbed(PERTURBATION, seed + 1),
            energies=[copies(tapes, seed + i) for i, tapes in enumerate(reference._energies)],
            loads=reference.loads.perturbed(PERTURBATION, seed + 3),
            drag=copies(reference.local.dissipation, seed + 3) if reference.local else (),
            held=(reference.held.perturbed(PERTURBATION, seed + 4), reference.held.perturbed(PERTURBATION, seed + 5)),
        )


def _each(pairs: Iterable[tuple[Precise, Any]], make: Callable[[Precise, Any], Any]) -> list[Any]:
    """Return the list of `make(program, other)` for each pair (program, other).

    If a program occurs again, its first result is used again.
    """
    results: dict[Precise, Any] = {}
    listed = []
    for tape, other in pairs:
        if tape not in results:
            results[tape] = make(tape, other)
        listed.append(results[tape])
    return listed


def _last(values: laws.StateFunction) -> laws.StateFunction:
    """Return a function of (q, v, t) that returns the last entry of the list `values(q, v, t)`."""
    return lambda q, v, t: values(q, v, t)[-1]
