"""Symplectic splittings: coordinates and velocities are advanced in turn, if the equations of motion allow it.

With a constant mass matrix and accelerations a(q, t), drift (q with v) and kick (v with a) are each solved exactly.
Their composition is symplectic in (q, p = M v). If a force depends on time, time is advanced with the coordinates.

An order condition of a splitting belongs to each word, a sequence of the letters K (kick) and D (drift). A step is a
product of exponentials of h times the Lie derivatives K and D. It is a power series in two letters that do not commute,
and so is the exact flow exp(h (K + D)). They agree up to h^p if the coefficient of every word of n <= p letters is
1/n!. Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, I.1, II.5, III.3, III.5
and VI.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import groupby, pairwise, product
from math import factorial
from typing import Any

from lagrange.errors import StatementError, shown
from lagrange.machine.model import Model
from lagrange.program.step import StepProgram, trace
from lagrange.statement.expression import entries, real_array, real_number, text, whole_number
from lagrange.trajectory.dense_output import hermite_path
from lagrange.trajectory.integrator import Claims, Problem, built_in, method_repr
from lagrange.trajectory.methods.tolerances import check_options, fixed_settings
from lagrange.trajectory.plan import StepPlan
from lagrange.trajectory.run_loop import drive_by

SplittingStages = tuple[tuple[float, float], ...]

CUBE = 1 / (2 - 2 ** (1 / 3))
"""First and third coefficient of the triple jump: three steps of a method of order 2, of the sizes c h, (1 - 2 c) h and
c h. With this c their errors of order h^3 cancel."""

YOSHIDA6 = (0.78451361047755726381949763, 0.23557321335935813368479318, -1.17767998417887100694641568)
"""First three of the seven coefficients of Yoshida's symmetric composition of order 6. The middle one makes the sum
1."""

KAHAN_LI = (
    0.13020248308889008087881763,
    0.56116298177510838456196441,
    -0.38947496264484728640807860,
    0.15884190655515560089621075,
    -0.39590389413323757733623154,
    0.18453964097831570709183254,
    0.25837438768632204729397911,
    0.29501172360931029887096624,
)
"""First eight of the seventeen coefficients of Kahan and Li's symmetric composition of order 8. The middle coefficient
makes the sum 1."""


@dataclass(frozen=True)
class Splitting:
    """An integrator that composes kicks and drifts. `stages` are pairs (kick, drift) of fractions of the step h.

    In each pair the kick, of the velocities, comes first, then the drift of the coordinates. The sums of the fractions
    and every order condition up to `order` are checked. Raises StatementError with the condition that fails and its
    error.
    """

    name: str
    order: int
    stages: SplittingStages
    step: float | None = None
    source: str = field(default="", compare=False)

    def __repr__(self) -> str:
        return method_repr(self, step=self.step)

    def __post_init__(self) -> None:
        text(self.name, "name")
        object.__setattr__(self, "order", whole_number(self.order, "order", 1))
        object.__setattr__(self, "stages", _pairs(self.name, self.stages))
        check_options(self.step)
        for what, total in (("kicks", sum(k for k, _ in self.stages)), ("drifts", sum(d for _, d in self.stages))):
            if not abs(total - 1) <= 1e-14:
                raise StatementError(
                    f"the {what} of {self.name} add up to {total:.17g}: these fractions of the step must add up to 1."
                )
        check_words(self.name, self.order, self.flows)

    @property
    def flows(self) -> tuple[tuple[str, float], ...]:
        """The kicks and drifts of a step, in order, as pairs ("kick" or "drift", fraction of the step)."""
        pairs = [flow for kick, drift in self.stages for flow in (("kick", kick), ("drift", drift)) if flow[1]]
        grouped = groupby(pairs, key=lambda flow: flow[0])
        return tuple((what, sum(part for _, part in parts)) for what, parts in grouped)

    @property
    def symmetric(self) -> bool:
        """True if the kicks and drifts are the same in reverse order, so that a step of -h undoes a step of h."""
        return self.flows == self.flows[::-1]

    @cached_property
    def claims(self) -> Claims:
        """The claimed properties: the order, symplecticity, symmetry in time, and the order of the dense output."""
        return Claims(order=self.order, symplectic=True, symmetric=self.symmetric, dense=max(3, self.order - 1))

    @property
    def program(self) -> StepProgram:
        """The program that computes one step of the splitting."""
        return splitting_step(self.name, self.stages)

    def plan(self, problem: Problem) -> StepPlan:
        """Return the plan of a run of the splitting. Raises StatementError for a system that cannot be split."""
        tolerances = fixed_settings(self.name, problem, self.step, None, None)
        check_separable(self.name, problem.model)
        return StepPlan(self.program, tolerances, hermite_path(self.order))

    integrate = drive_by


def _pairs(name: str, stages: Any) -> SplittingStages:
    """Return the `stages` that a user gives for the splitting `name` as pairs of floats, (kick, drift)."""
    if isinstance(stages, tuple) and all(isinstance(x, tuple) and [*map(type, x)] == [float, float] for x in stages):
        return stages
    listed = entries(stages, f"the stages of {name}")
    pairs = [real_array(stage, f"stage {i} of {name}") for i, stage in enumerate(listed or ())]
    if any(pair.shape != (2,) for pair in pairs):
        raise StatementError(f"the stages of {name} are {shown(stages)}: give pairs (kick, drift).")
    return tuple((float(kick), float(drift)) for kick, drift in pairs)


def check_separable(name: str, model: Model) -> None:
    """Raise StatementError if method `name` cannot split a model into kicks and drifts.

    The mass matrix must be constant, no equation may be of first order, and accelerations may not depend on velocities.
    """
    structure = model.equations.structure
    position_only = structure.position_only or structure.decisions.position_only is True
    if not structure.constant_mass and structure.decisions.constant_mass is not True:
        reason = "its mass matrix changes along the motion"
        remedy = "Use variational-midpoint or galerkin4, which are symplectic for any mass matrix, or rk4 or dop853"
    elif model.equations.first_order:
        reason = "some of its equations are of first order"
        remedy = "Use taylor, dop853 or rk4"
    elif not position_only and len(model.equations.constraints):
        reason = "the forces of its constraints depend on velocities"
        remedy = "Use rattle, which is symplectic for constraints on coordinates, or taylor or dop853"
    elif not position_only:
        reason = "its accelerations depend on velocities, as with friction or a magnetic field"
        remedy = "With friction use rk4 or dop853; without, variational-midpoint or galerkin4, which are symplectic"
    else:
        return
    raise StatementError(
        f"{name} moves coordinates and velocities in turn. For {model.statement.name} it is not symplectic and does "
        f"not reach its order: {reason}. {remedy}."
    )


@lru_cache(maxsize=64)
def splitting_step(name: str, stages: SplittingStages) -> StepProgram:
    """Return the step program of a splitting with these stages, pairs (kick, drift) of fractions of the step.

    Time is advanced with the coordinates, by the drifts.
    """
    last = max(i for i, (_, drift) in enumerate(stages) if drift)

    def step(a: Callable[..., Any], t: Any, q: Any, v: Any, h: Any) -> tuple[Any, Any]:
        now = t
        passed = 0.0
        for i, (kick, drift) in enumerate(stages):
            if kick:
                v = v + a(now, q) * (h * kick)
            if drift:
                q = q + v * (h * drift)
                passed += drift
                now = t + h if i == last else t + h * passed
        return q, v

    return trace(name, step, law="accelerations")


def composition(
    coefficients: Sequence[float],
    *,
    name: str,
    order: int,
    first: str = "drift",
    step: float | None = None,
    source: str = "",
) -> Splitting:
    """Return the composition of successive Stormer-Verlet steps of the sizes `coefficients` times h.

    Each of these steps begins and ends with half a drift, or half a kick with `first="kick"`. Adjacent halves are
    joined. Coefficients that are the same in reverse order give a symmetric method, of even order. `source` names the
    publication. Raises StatementError if the coefficients do not add up to 1, or if the order differs from the claimed
    `order`.
    """
    if not isinstance(first, str) or first not in ("drift", "kick"):
        raise StatementError(f"first = {shown(first)}: give 'drift' or 'kick'.")
    listed = entries(coefficients, f"the coefficients of {text(name, 'name')}")
    if listed is None:
        raise StatementError(f"the composition {name} has coefficients = {shown(coefficients)}: give a list.")
    parts = [real_number(c, f"coefficient {i} of the composition {name}") for i, c in enumerate(listed)]
    if not parts:
        raise StatementError(f"the composition {name} has no coefficients: give at least one.")
    ends = [0.0, *parts, 0.0]
    halves = [(a + b) / 2 for a, b in pairwise(ends)]
    pairs = zip([0.0, *parts], halves, strict=True) if first == "drift" else zip(halves, [*parts, 0.0], strict=True)
    return Splitting(name, order, tuple(pairs), step, source)


@built_in("symplectic-euler")
def SymplecticEuler(step: float | None = None) -> Splitting:
    """Return the symplectic Euler method, order 1: velocities first, then coordinates with the new velocities."""
    return Splitting("symplectic-euler", 1, ((1.0, 1.0),), step, "de Vogelaere, 1956; Hairer, Lubich, Wanner, I.1.2")


@built_in("symplectic-euler-b")
def SymplecticEulerB(step: float | None = None) -> Splitting:
    """Return the other symplectic Euler method, order 1: coordinates first, then velocities at the new place."""
    stages = ((0.0, 1.0), (1.0, 0.0))
    return Splitting("symplectic-euler-b", 1, stages, step, "de Vogelaere, 1956; Hairer, Lubich, Wanner, I.1.2")


@built_in("verlet")
def Verlet(step: float | None = None) -> Splitting:
    """Return the Stormer-Verlet method in position form, order 2: half a drift, a kick, half a drift.

    The force is evaluated in the middle of the step. A step consists of the two symplectic Euler steps with half the
    step size; so does a step of the velocity form.
    """
    return composition((1.0,), name="verlet", order=2, step=step, source="Hairer, Lubich, Wanner, I.1.4")


@built_in("velocity-verlet")
def VelocityVerlet(step: float | None = None) -> Splitting:
    """Return the Stormer-Verlet method in velocity form, order 2: q + h v + h^2 a/2, then v with the mean of both a.

    The step is half a kick, a drift, half a kick. The last force of a step is the first of the next.
    """
    source = "Swope, Andersen, Berens, Wilson, J. Chem. Phys. 76, 1982; Hairer, Lubich, Wanner, I.1.4"
    return composition((1.0,), name="velocity-verlet", order=2, first="kick", step=step, source=source)


@built_in("leapfrog")
def Leapfrog(step: float | None = None) -> Splitting:
    """Return the leapfrog method, order 2: velocities are advanced at half steps, coordinates at full steps.

    v at t + h/2 is v at t - h/2 plus a kick, and the coordinates drift with it. To have both at the same time, a step
    begins and ends with half a kick, as in the velocity form, which is the same map. `verlet` begins and ends with half
    a drift instead and is conjugate to it. All three have the same long-term behaviour.
    """
    source = "Hockney, Eastwood, Computer Simulation Using Particles, 1981; Hairer, Lubich, Wanner, I.1.4"
    return composition((1.0,), name="leapfrog", order=2, first="kick", step=step, source=source)


@built_in("ruth3")
def Ruth3(step: float | None = None) -> Splitting:
    """Return Ruth's method of order 3: three kicks and three drifts, not symmetric."""
    stages = ((7 / 24, 2 / 3), (3 / 4, -2 / 3), (-1 / 24, 1.0))
    return Splitting("ruth3", 3, stages, step, "Ruth, IEEE Trans. Nucl. Sci. 30, 1983")


@built_in("forest-ruth4")
def ForestRuth4(step: float | None = None) -> Splitting:
    """Return Forest and Ruth's method of order 4: the triple jump of Stormer-Verlet steps."""
    source = "Forest, Ruth, Physica D 43, 1990; Hairer, Lubich, Wanner, II.4, example 4.2"
    return composition((CUBE, 1 - 2 * CUBE, CUBE), name="forest-ruth4", order=4, step=step, source=source)


@built_in("yoshida6")
def Yoshida6(step: float | None = None) -> Splitting:
    """Return Yoshida's method of order 6, his solution A: seven Stormer-Verlet steps."""
    source = "Yoshida, Phys. Lett. A 150, 1990; digits: Hairer, Lubich, Wanner, V.3.2"
    return composition(_mirrored(YOSHIDA6), name="yoshida6", order=6, step=step, source=source)


@built_in("composition8")
def Composition8(step: float | None = None) -> Splitting:
    """Return Kahan and Li's method of order 8: seventeen Stormer-Verlet steps."""
    source = "Kahan, Li, Math. Comp. 66, 1997; digits: Hairer, Lubich, Wanner, V.3.2"
    return composition(_mirrored(KAHAN_LI), name="composition8", order=8, step=step, source=source)


def _mirrored(outer: tuple[float, ...]) -> tuple[float, ...]:
    """Return symmetric coefficients of a composition: `outer`, the one that makes the sum 1, and `outer` reversed."""
    return (*outer, 1 - 2 * sum(outer), *outer[::-1])


WORD_TOLERANCE = 1e-13
"""Tolerance with which the coefficient of a word has to satisfy its order condition, relative to the size of its terms.
A word is a sequence of kicks and drifts."""

HIGHEST_CHECKED = 10
"""The highest order of a splitting that is checked. Up to it there are 2046 order conditions."""


@lru_cache(maxsize=64)
def check_words(name: str, order: int, flows: tuple[tuple[str, float], ...]) -> None:
    """Raise StatementError if a composition of kicks and drifts is not of the claimed `order`.

    `flows` are its kicks and drifts in order, as pairs of "kick" or "drift" and a fraction of the step. `name` is the
    name of the method.
    """
    if not 1 <= order <= HIGHEST_CHECKED:
        raise StatementError(
            f"{name} claims order {order}: give an order from 1 to {HIGHEST_CHECKED}, which can be checked."
        )
    actual = word_coefficients(order, tuple((what[0], part) for what, part in flows))
    sizes = word_coefficients(order, tuple((what[0], abs(part)) for what, part in flows))
    for word, value in actual.items():
        expected = 1 / factorial(len(word))
        if not abs(value - expected) <= WORD_TOLERANCE * max(1.0, sizes[word]):
            flow_names = " ".join({"k": "kick", "d": "drift"}[letter] for letter in word)
            raise StatementError(
                f"{name} is not of order {order}: the coefficient of '{flow_names}', a condition of order "
                f"{len(word)}, is {value:.17g} instead of 1/{factorial(len(word))}."
            )


def word_coefficients(order: int, flows: tuple[tuple[str, float], ...]) -> dict[str, float]:
    """Return the coefficients of all words of 1 to `order` letters in the series of a step of a splitting, by word.

    The step is a product of exponentials exp(c * letter), whose letters do not commute. `flows` has the factors in
    order as pairs (letter, c); "k" is a kick, and "d" a drift.
    """
    words = ["".join(letters) for n in range(order + 1) for letters in product("dk", repeat=n)]
    result = dict.fromkeys(words, 0.0) | {"": 1.0}
    for letter, c in flows:
        powers = [c**n / factorial(n) for n in range(order + 1)]
        repeats = {word: len(word) - len(word.rstrip(letter)) for word in words}
        result = {
            word: sum(result[word[: len(word) - n]] * powers[n] for n in range(repeats[word] + 1)) for word in words
        }
    return {word: value for word, value in result.items() if word}
