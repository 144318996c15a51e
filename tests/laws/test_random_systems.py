"""Random systems in a plane: momenta of cyclic coordinates, and series of any order with switches."""

from functools import partial
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.statement.declare import declare
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Status
from tests.covering import examples
from tests.laws import mechanisms
from tests.laws.mechanisms import PLACES, RATES, functions_of, potentials, rationals

x, y, _ = PLACES
few = settings(max_examples=examples(6), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
some = settings(few, max_examples=examples(10))

kinetic_energies = partial(mechanisms.kinetic_energies, rates=RATES[:2])

exponents = st.sampled_from([sp.Rational(3, 2), sp.Rational(7, 4), sp.Rational(5, 3), sp.Rational(5, 2), sp.Integer(3)])


def bent_energies(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return kinetic energies with powers of abs, whose mass matrices depend on velocities and have switches."""

    def energy(g: Any, p: Any, q: Any, leaf: Any, c: Any) -> Any:
        bend = x.dot * sp.Abs(y.dot) ** p + sp.Abs(x.dot) ** q + y.dot**2 * sp.Abs(leaf - sp.Rational(3, 2)) ** (p / 2)
        return x.dot**2 + y.dot**2 + (g * y.dot) ** 2 / 16 + c * bend / 16

    return st.builds(energy, functions_of(*leaves), exponents, exponents, st.sampled_from(leaves), rationals)


velocities = st.tuples(st.floats(0.3, 0.9), st.sampled_from([-1.0, 1.0])).map(lambda pair: pair[0] * pair[1])
states = st.lists(st.floats(-0.9, 0.9), min_size=4, max_size=4).map(np.array)


def model(target: str, **options: Any) -> Model:
    return model_of(declare(coordinates=[x, y], **options), machine(target))


def run(compiled: Model, state: Any, end: float, options: RunOptions) -> Any:
    start = dict(zip(("x", "y", "x_dot", "y_dot"), map(float, state), strict=True))
    result, _ = trajectory_of(compiled, (0.0, end), start, options)
    return result


TIGHT = RunOptions("dop853", 1e-11, 1e-12, max_steps=20_000)


@few
@given(kinetic_energies(x), potentials(x), functions_of(x), states)
def test_the_momentum_of_a_cyclic_coordinate_is_conserved(T: Any, V: Any, A: Any, state: Any) -> None:
    compiled = model("llvm", lagrangian=T - V + A * y.dot, forces={x: -y.dot})
    assert compiled.equations.structure.cyclic == (1,)
    result = run(compiled, state, 1.0, TIGHT)
    assert result.status is Status.SUCCESS, result.message
    momentum = compiled.momenta(result.y[:2], result.y[2:])[1]
    assert np.abs(momentum - momentum[0]).max() < 1e-8 * (1 + np.abs(momentum[0]))


@some
@given(
    bent_energies(x, y),
    potentials(x, y),
    st.tuples(velocities, velocities, velocities, velocities).map(np.array),
    st.integers(4, 64) | st.integers(40, 64),
    st.sampled_from(["numpy", "llvm", "llvm"]),
)
def test_series_of_any_order_give_the_motion(T: Any, V: Any, state: Any, order: int, target: str) -> None:
    """Mass matrices have fractional powers of abs and depend on velocities. Orders go up to the highest.

    Above some order the series are computed in loops.
    """
    compiled, rtol = model(target, lagrangian=T - V), 1e-9 if order > 8 else 1e-6
    result = run(compiled, state, 0.1, RunOptions(Taylor(rtol=rtol, atol=rtol, order=order)))
    if result.status is Status.SINGULAR:
        # Now and then a system is drawn that loses its inertia on the way: then that is so.
        masses = (compiled.mass_matrix(y[:2], v=y[2:]) for y in (result.y[:, 0], result.y[:, -1]))
        first, last = (np.abs(np.linalg.eigvalsh(mass)).min() for mass in masses)
        assert last < 1e-3 * first
        return
    assert result.status is Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(run(compiled, state, 0.1, TIGHT).y[:, -1], abs=100 * rtol)
