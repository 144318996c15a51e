"""Rotations in space as part of a statement: R in SO(3), by the four entries of a quaternion of length one.

The entries are coordinates of the system. R and its rates do not depend on the length of the quaternion, so no force
acts along it. `with_length` adds an inertia there. The length then stays constant without a constraint.
Source: D. T. Greenwood, Advanced Dynamics, 2003, section 3.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, lru_cache
from itertools import chain
from typing import Any, NoReturn

import numpy as np
import sympy
from numpy.typing import ArrayLike
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, listing, shown
from lagrange.statement.coordinate import (
    COORDINATES,
    ROTATION,
    check_name,
    function_of_time,
    name_of,
    rotation_name,
    t,
    velocity_of,
)
from lagrange.statement.expression import RATE, SHORTHAND, as_typed, entries, expression, in_full
from lagrange.statement.number import real_number

x, y, z = (sympy.ImmutableMatrix([int(i == k) for i in range(3)]) for k in range(3))
"""Unit vectors along the axes."""

ENTRIES = "wxyz"
"""Suffixes of the names of a quaternion's entries: the scalar, then the vector."""

AXES = "xyz"
"""Suffixes of the names of axes: R_xz is an entry of the matrix, R_body_x a rate about an axis of the body."""

ROUNDING = 1e-9
"""Largest deviation of a start from a rotation: of M^T M from the unit matrix, or of a quaternion's length from one."""

Quaternion = tuple[Any, Any, Any, Any]


def product(a: Sequence[Any], b: Sequence[Any]) -> Quaternion:
    """Return the product of two quaternions."""
    (a0, a1, a2, a3), (b0, b1, b2, b3) = a, b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 + a2 * b0 + a3 * b1 - a1 * b3,
        a0 * b3 + a3 * b0 + a1 * b2 - a2 * b1,
    )


def conjugate(q: Sequence[Any]) -> Quaternion:
    """Return the conjugate of a quaternion: the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


def matrix_of(q: Sequence[Any]) -> list[list[Any]]:
    """Return the rotation matrix of a quaternion of any length, three rows."""
    w, i, j, k = q
    square = w**2 + i**2 + j**2 + k**2
    return [
        [(w**2 + i**2 - j**2 - k**2) / square, 2 * (i * j - w * k) / square, 2 * (i * k + w * j) / square],
        [2 * (i * j + w * k) / square, (w**2 - i**2 + j**2 - k**2) / square, 2 * (j * k - w * i) / square],
        [2 * (i * k - w * j) / square, 2 * (j * k + w * i) / square, (w**2 - i**2 - j**2 + k**2) / square],
    ]


def body_rates(q: Sequence[Any], velocities: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return the angular velocity about the axes of the body, three numbers or expressions.

    `q` is a quaternion of any length and `velocities` are its time derivatives, four each.
    """
    twice = 2 / sum(entry**2 for entry in q)
    _, i, j, k = product(conjugate(q), velocities)
    return twice * i, twice * j, twice * k


def space_rates(q: Sequence[Any], velocities: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return the angular velocity about the axes of space; see `body_rates`."""
    twice = 2 / sum(entry**2 for entry in q)
    _, i, j, k = product(velocities, conjugate(q))
    return twice * i, twice * j, twice * k


def cross_matrix(vector: Sequence[Any]) -> Any:
    """Return the matrix of the vector products with a vector of three entries, (3, 3)."""
    a, b, c = vector
    return sympy.Matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])


def _refusal(instead: str) -> Callable[..., NoReturn]:
    """Return a method that refuses an operation on a rotation. `instead` is the remedy; {0} in it is the name."""

    def refuse(self: Rotation, *others: Any) -> NoReturn:
        del others
        raise StatementError(f"{self.name} is a rotation, a 3 by 3 matrix: {instead.format(self.name)}.")

    return refuse


class Rotation:
    """A rotation R in SO(3), from the axes of a body to those of space, made by `lagrange.rotation`.

    `body` and `space` are its rates about the axes of the body and of space, each a vector of three expressions.
    `R * v` is a vector of the body in the axes of space, `R.T * v` the opposite, and `R[i, j]` an entry.
    `quaternion` are the four coordinates: the scalar, then the vector. `turns` are small turns about the axes of the
    body, with the rates `body`; a derivation is written in them.
    """

    _op_priority = 100.0
    """SymPy leaves products with a matrix to the factor of the higher priority."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.quaternion = tuple(function_of_time(f"{name}_{entry}", {ROTATION: name}) for entry in ENTRIES)
        velocities = [velocity_of(q) for q in self.quaternion]
        pairs = [f"{a}{b}" for a in AXES for b in AXES]
        self.matrix = self._named(pairs, chain(*matrix_of(self.quaternion))).reshape(3, 3)
        self.body = self._named([f"body_{a}" for a in AXES], body_rates(self.quaternion, velocities))
        self.turns = tuple(
            function_of_time(f"{name}_turn_{a}", {RATE: rate}) for a, rate in zip(AXES, self.body, strict=True)
        )
        self.space = self._named([f"space_{a}" for a in AXES], space_rates(self.quaternion, velocities))

    def _named(self, names: Sequence[str], values: Iterable[Any]) -> Any:
        """Return a vector of functions of time that abbreviate expressions."""
        pairs = zip(names, values, strict=True)
        named = [function_of_time(f"{self.name}_{name}", {SHORTHAND: value}) for name, value in pairs]
        return sympy.ImmutableMatrix(named)

    @property
    def rates(self) -> dict[Any, Any]:
        """The rate about each axis of the body, by its turn."""
        return dict(zip(self.turns, self.body, strict=True))

    def __repr__(self) -> str:
        return f"<Rotation {self.name}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rotation) and other.name == self.name

    def __hash__(self) -> int:
        return hash((Rotation, self.name))

    @property
    def T(self) -> Any:
        """The inverse rotation: the transposed matrix."""
        return self.matrix.T

    def __getitem__(self, place: Any) -> Any:
        return self.matrix[place]

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Rotation):
            return self.matrix * other.matrix
        parts = entries(other, f"the vector that {self.name} turns")
        if parts is None or len(parts) != 3:
            given = shown(other) if parts is None else f"{len(parts)} entries"
            raise StatementError(f"{self.name} is a rotation and turns a vector of three entries, not {given}.")
        if isinstance(other, sympy.MatrixBase):
            return self.matrix * other
        return self.matrix * sympy.ImmutableMatrix([as_typed(part, "an entry of the vector") for part in parts])

    __add__ = __radd__ = __sub__ = __rsub__ = __neg__ = __pow__ = __truediv__ = _refusal(
        "use its entries {0}[i, j], its rates {0}.body and {0}.space, or a turned vector {0}*v"
    )
    _before = _refusal("it stands left of the vector that it turns, {0}*v or {0}.T*v")

    __matmul__ = __mul__

    def __rmul__(self, other: Any) -> Any:
        if isinstance(other, sympy.MatrixBase) and other.cols == 3:
            return other * self.matrix
        return self._before(other)


def rotation(name: str) -> Rotation:
    """Return the rotation of that name, from the axes of a body to those of space.

    `R.body` and `R.space` are its rates about these axes, `R*v` is a turned vector, `R.T*v` the vector turned back, and
    `R[i, j]` an entry. A System contains it through the four coordinates of its quaternion, such as R_w. Raises
    StatementError for a name that is not an identifier.
    """
    made = rotation_of(check_name(name, "rotation"))
    COORDINATES.declare(tuple(map(name_of, made.quaternion)))
    return made


rotation_of = cache(Rotation)
"""The rotation of a name, as `rotation` returns it, without entering it in the order of declaration."""


def turn(axis: ArrayLike, angle: float) -> Quaternion:
    """Return the start of a rotation that is turned by an angle in radians about an axis of any length.

    It is a quaternion of length one, scalar first. Raises StatementError for an axis that is not a vector of three
    numbers, or zero.
    """
    along = np.array([real_number(part, "an entry of the axis") for part in entries(axis, "the axis") or [axis]])
    size = float(np.linalg.norm(along))
    if along.shape != (3,) or size == 0:
        raise StatementError(f"the axis of a turn is {shown(axis)}: give three numbers that are not all zero.")
    half = real_number(angle, "the angle of a turn") / 2
    i, j, k = (float(part) for part in np.sin(half) * along / size)
    return float(np.cos(half)), i, j, k


def quaternion_of(value: Any, name: str) -> Quaternion:
    """Return the quaternion of a start, which is a quaternion or a rotation matrix.

    Raises StatementError for one that is not a rotation, with its deviation.
    """
    given = np.array(value, dtype=object)
    try:
        numbers = given.astype(float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape not in ((4,), (3, 3)) or not np.isfinite(numbers).all():
        raise StatementError(
            f"the start of {name} is {shown(value)}: give lagrange.turn(axis, angle), a quaternion of four numbers, "
            "scalar first, or a matrix of 3 by 3 numbers."
        )
    if numbers.shape == (4,):
        size = float(np.linalg.norm(numbers))
        if abs(size - 1) > ROUNDING:
            raise StatementError(_of_length(name, size))
        return tuple((numbers / size).tolist())
    if (off := float(np.abs(numbers.T @ numbers - np.eye(3)).max())) > ROUNDING:
        raise StatementError(
            f"the start of {name} is not a rotation: its matrix times its transpose differs from the unit matrix by "
            f"{off:.3g}."
        )
    if np.linalg.det(numbers) < 0:
        raise StatementError(f"the start of {name} is a reflection, with determinant -1: change the sign of one axis.")
    from scipy.spatial.transform import Rotation as Matrix

    i, j, k, w = Matrix.from_matrix(numbers).as_quat().tolist()
    return w, i, j, k


def _of_length(name: str, size: float) -> str:
    """Return the message for a start of a rotation that is a quaternion of another length than one."""
    return (
        f"the start of {name} is a quaternion of length {size:.6g}: give one of length 1, such as "
        "lagrange.turn(axis, angle)."
    )


def names_rotations(table: Iterable[Any]) -> bool:
    """Return True if a key of a table is a rotation, or a vector such as its rates."""
    return any(isinstance(key, (Rotation, sympy.MatrixBase)) for key in table)


def in_coordinates(given: Mapping[Any, Any], values: Mapping[Any, Any], table: str = "initial") -> dict[Any, Any]:
    """Return a `table` of a state with entries of coordinates and velocities in place of those of rotations.

    Keys are rotations, {R: start}, and their rates, {R.body: three values} or {R.space: three values}, numbers or
    expressions. `values` has those of all coordinates and velocities that are not given. A start without rates keeps
    the rates about the axes of the body. Raises StatementError for what is not a rotation, and for both rates at once.
    """
    plain = {key: value for key, value in given.items() if not isinstance(key, (Rotation, sympy.MatrixBase))}
    turned = {each.name: each for each in given if isinstance(each, Rotation)}
    rates = {key: value for key, value in given.items() if isinstance(key, sympy.MatrixBase)}
    for key in rates:
        each = _of_rates(key, table)
        turned[each.name] = each
    if unknown := [name for name, each in turned.items() if not values.keys() >= {*each.quaternion}]:
        raise StatementError(f"{table} names the rotation {unknown[0]}, which is not in this system.")
    for name, each in turned.items():
        now = [values[q] for q in each.quaternion]
        q = quaternion_of(given[each], name) if each in given else now
        if each.body in rates and each.space in rates:
            raise StatementError(f"{table} gives both {name}.body and {name}.space: give one of the two.")
        if each.space in rates:
            moved = product((0, *_three(rates[each.space], f"{name}.space")), q)
        else:
            kept = body_rates(now, [values[velocity_of(entry)] for entry in each.quaternion])
            moved = product(q, (0, *(_three(rates[each.body], f"{name}.body") if each.body in rates else kept)))
        plain |= dict(zip(each.quaternion, q, strict=True))
        plain |= {velocity_of(entry): rate / 2 for entry, rate in zip(each.quaternion, moved, strict=True)}
    return plain


STRETCH = 1e-4
"""Largest deviation of the length of a quaternion from one at a start, and largest share of its velocity along itself.

A long run at loose tolerances ends with a deviation of 1e-5.
"""


def check_start(coordinates: Sequence[Any], values: Sequence[float]) -> None:
    """Raise StatementError for a state (q, v) in which a quaternion has not length one, or its length changes."""
    for each in _rotations_of(tuple(coordinates)):
        places = [coordinates.index(q) for q in each.quaternion]
        q, v = (np.array([values[place + shift] for place in places]) for shift in (0, len(coordinates)))
        size = float(np.linalg.norm(q))
        if abs(size - 1) > STRETCH:
            raise StatementError(_of_length(each.name, size))
        if abs(q @ v) > STRETCH * np.linalg.norm(v):
            raise StatementError(
                f"the start of {each.name} has velocities of {each.name}_w to {each.name}_z that change the length of "
                f"the quaternion: give {each.name}.body or {each.name}.space."
            )


@lru_cache(maxsize=256)
def _rotations_of(coordinates: tuple[Any, ...]) -> tuple[Rotation, ...]:
    """Return the rotations whose quaternions are among the coordinates. Raises StatementError for an incomplete one."""
    names = dict.fromkeys(name for name in map(rotation_name, coordinates) if name is not None)
    for each in map(rotation_of, names):
        if missing := [name_of(q) for q in each.quaternion if q not in coordinates]:
            raise StatementError(f"coordinates lacks {listing(missing)} of the rotation {each.name}: name all four.")
    return tuple(map(rotation_of, names))


def is_scalar(coordinate: Any) -> bool:
    """Return True for the scalar of a quaternion, which is one where nothing is turned."""
    name = rotation_name(coordinate)
    return name is not None and coordinate == rotation_of(name).quaternion[0]


def _three(value: Any, what: str) -> list[Any]:
    parts = entries(value, what)
    if parts is None or len(parts) != 3:
        raise StatementError(f"{what} is {shown(value)}: give three values, about the axes x, y and z.")
    return [part if isinstance(part, (int, float)) else expression(part, what) for part in parts]


def _of_rates(key: Any, table: str) -> Rotation:
    """Return the rotation R of a key R.body or R.space. Raises StatementError for other keys of the table."""
    names = {rotation_name(q) or "" for q in in_full(key).atoms(AppliedUndef)} - {""}
    for each in map(rotation_of, sorted(names)):
        if key in (each.body, each.space):
            return each
    raise StatementError(f"{table} names {shown(key)}: use R.body or R.space of a rotation R.")


def forces_on_coordinates(forces: Any) -> Any:
    """Return a table of forces with generalized forces in place of the torques of rotations.

    Torques are {R.body: three expressions} about the axes of the body, or {R.space: ...}. The generalized force on an
    entry of the quaternion is the sum of each torque times the derivative of its rate by the velocity of the entry.
    Raises StatementError for another number of torques, and for {R: ...}, which does not name axes.
    """
    if not isinstance(forces, Mapping) or not names_rotations(forces):
        return forces
    table: dict[Any, Any] = {}
    for key, value in forces.items():
        if isinstance(key, Rotation):
            raise StatementError(f"forces names the rotation {key.name}: give torques on {key.name}.body or .space.")
        if not isinstance(key, sympy.MatrixBase):
            table[key] = value
            continue
        each = _of_rates(key, "forces")
        torques = _three(value, f"the torque on {each.name}")
        for q in each.quaternion:
            rate = velocity_of(q)
            parts = (torque * sympy.diff(in_full(about), rate) for torque, about in zip(torques, key, strict=True))
            table[q] = table.get(q, sympy.S.Zero) + sum(parts)
    return table


def reading(
    energies: Mapping[str, Any], forces: Any, dissipation: Any, coordinates: Sequence[Any], names: Sequence[str]
) -> dict[str, Any] | None:
    """Return the parts of a statement in turns of the body and entries of R, as a derivation writes them.

    `energies` are L, or T and V. They, `forces` and `dissipation` are as typed. Returns None if they contain an entry
    of a quaternion.
    """
    turned = list(map(rotation_of, names))
    known: dict[Any, Any] = {}
    for each in turned:
        rates = [velocity_of(turn) for turn in each.turns]
        known |= dict(zip(each.body, rates, strict=True))
        known |= dict(zip(each.space, each.matrix * sympy.Matrix(rates), strict=True))
        moved = each.matrix * cross_matrix(rates)
        known |= {velocity_of(entry): rate for entry, rate in zip(each.matrix, moved, strict=True)}
    quaternions = {q for each in turned for q in each.quaternion}
    places = [q for q in coordinates if q not in quaternions] + [turn for each in turned for turn in each.turns]
    table = dict.fromkeys(places, sympy.S.Zero)
    for key, value in (forces or {}).items():
        if isinstance(key, sympy.MatrixBase):
            each = _of_rates(key, "forces")
            torques = sympy.Matrix([as_typed(part, "a torque") for part in value])
            torques = each.T * torques if key == each.space else torques
            table |= {turn: table[turn] + part for turn, part in zip(each.turns, torques, strict=True)}
        else:
            table |= {q: as_typed(value, "a force") for q in coordinates if key in (q, name_of(q))}
    if not quaternions.isdisjoint(table):
        return None
    kinetic, *rest = (energy.xreplace(known) for energy in energies.values())
    potential = rest[0] if rest else sympy.S.Zero
    drag = as_typed(dissipation, "the dissipation").xreplace(known)
    applied = tuple(force.xreplace(known) for force in table.values())
    if any(part.has(*quaternions) for part in (kinetic, potential, drag, *applied)):
        return None
    return {
        "kinetic": kinetic,
        "potential": potential,
        "lagrangian": kinetic - potential,
        "coordinates": tuple(places),
        "dissipation": drag,
        "forces": applied,
        "entries": tuple(tuple(each.matrix) for each in turned),
    }


def of_quaternions(accelerations: Mapping[Any, Any], names: Sequence[str]) -> dict[Any, Any]:
    """Return the accelerations of a derivation with those of quaternions in place of those of turns.

    They follow from dq/dt = q (s, w)/2, where w are the rates about the axes of the body and s = 2 |q|'/|q|, with
    |q|'' = 0.
    """
    solved = {q: in_full(value) for q, value in accelerations.items()}
    for each in map(rotation_of, names):
        q, rates = each.quaternion, [velocity_of(entry) for entry in each.quaternion]
        stretch = 2 * sum(a * b for a, b in zip(q, rates, strict=True)) / sum(a**2 for a in q)
        from_rates = product(rates, (stretch, *map(in_full, each.body)))
        from_accelerations = product(q, (-(stretch**2) / 2, *(solved.pop(turn) for turn in each.turns)))
        solved |= {entry: (a + b) / 2 for entry, a, b in zip(q, from_rates, from_accelerations, strict=True)}
    return solved


def shorter(formula: Any, names: Iterable[str]) -> Any:
    """Return an expression with the columns of rotations orthogonal and of length one, if that makes it shorter."""
    known = {}
    for each in map(rotation_of, names):
        for i in range(3):
            for j in range(i, 3):
                (a, b, c), (d, e, f) = each.matrix[:, i], each.matrix[:, j]
                known[c * f] = sympy.Integer(i == j) - a * d - b * e
    other = sympy.expand(sympy.expand(formula).subs(known))
    return other if other.count_ops() < formula.count_ops() else formula


def in_rates(formula: Any, names: Iterable[str]) -> Any:
    """Return an expression with the rates of the bodies in place of the derivatives of turns, as they are typed."""
    pairs = (pair for each in map(rotation_of, names) for pair in each.rates.items())
    return formula.xreplace({velocity_of(turn): rate for turn, rate in pairs})


def explanation(name: str, values: Mapping[Any, float]) -> str:
    """Return the sentences that explain a rotation in a derivation; `values` are those of the start."""
    matrix = f"{name}_xx to {name}_zz are the entries of the rotation {name}."
    rates, turns = (listing(f"{name}_{kind}_{axis}" for axis in AXES) for kind in ("body", "turn"))
    start = ", ".join(f"{values[q]:.6g}" for q in rotation_of(name).quaternion)
    return (
        f"{matrix} {rates} are its rates about the axes of the body. {turns} are small turns about these axes; the "
        f"derivative of L by a turn contains p x {name}_body, since the axes turn with the body. {name} starts as the "
        f"quaternion ({start})."
    )


def start_in_turns(names: Iterable[str], places: Iterable[Any], values: Mapping[Any, float]) -> tuple[float, ...]:
    """Return the state (q, v) of a statement that is read in turns, whose coordinates are `places`: turns are zero.

    `values` are those of the start by coordinate and velocity.
    """
    known = dict(values)
    for each in map(rotation_of, names):
        velocities = [values[velocity_of(entry)] for entry in each.quaternion]
        rates = body_rates([values[entry] for entry in each.quaternion], velocities)
        known |= dict.fromkeys(each.turns, 0.0)
        known |= {velocity_of(turn): rate for turn, rate in zip(each.turns, rates, strict=True)}
    places = tuple(places)
    return tuple(known[symbol] for symbol in (*places, *map(velocity_of, places)))


def with_length(kinetic: Any, coordinates: Sequence[Any]) -> tuple[Any, tuple[str, ...]]:
    """Return a kinetic energy with an inertia along each quaternion q, and the names of the rotations.

    The term is M (q . q')^2 / (2 q . q), where M is four times the mean moment of inertia: the mass matrix is then as
    well conditioned as that of the rates. Other coordinates in M are replaced by one. An energy that has the term
    already stays as it is. Raises StatementError for a rotation without inertia, and for an incomplete quaternion.
    """
    rotations = _rotations_of(tuple(coordinates))
    for each in rotations:
        scalar, *inertias = (row[i] for i, row in enumerate(_inertia(kinetic, each)))
        mean = sympy.cancel(sum(inertias) / 3)
        if mean.is_zero or mean.is_finite is False:
            raise StatementError(without_inertia(each.name))
        if scalar.is_zero:
            rates = map(velocity_of, each.quaternion)
            along = sum(q * rate for q, rate in zip(each.quaternion, rates, strict=True))
            kinetic += mean * along**2 / (2 * sum(q**2 for q in each.quaternion))
    return kinetic, tuple(each.name for each in rotations)


def without_inertia(name: str) -> str:
    """Return the message for a rotation that the kinetic energy does not contain."""
    return (
        f"the kinetic energy has no {name}.body, so {name} has no inertia: add its energy, such as "
        f"{name}.body.dot(J*{name}.body)/2."
    )


def _inertia(kinetic: Any, each: Rotation) -> list[list[Any]]:
    """Return d2T/dv2 by the velocities of a quaternion, (4, 4), where R is the identity.

    Other coordinates are one, and all velocities zero.
    """
    here = {q: sympy.Integer(q == each.quaternion[0]) for q in each.quaternion}
    others = [f for f in kinetic.atoms(AppliedUndef) if f not in here and f.args == (t,)]
    rates = {velocity_of(q): sympy.Dummy() for q in each.quaternion}
    still = {velocity_of(f): sympy.S.Zero for f in others}
    energy = kinetic.xreplace({**here, **dict.fromkeys(others, sympy.S.One), **still, **rates})
    rest = dict.fromkeys(rates.values(), sympy.S.Zero)
    return [[sympy.diff(energy, a, b).xreplace(rest) for b in rates.values()] for a in rates.values()]


def check_moments(kinetic: Any, name: str, values: Mapping[Any, float]) -> None:
    """Raise StatementError if the principal moments of inertia of a rotation break the triangle inequality.

    `values` are those of parameters. Inertias that contain anything else are not judged.
    """
    rows = [[entry.xreplace(dict(values)) / 4 for entry in row[1:]] for row in _inertia(kinetic, rotation_of(name))[1:]]
    if not all(entry.is_number for row in rows for entry in row):
        return
    least, middle, most = np.linalg.eigvalsh(np.array(rows, dtype=float))
    if least < -ROUNDING * most or most > (least + middle) * (1 + ROUNDING):
        raise StatementError(
            f"the moments of inertia of {name} are {least:.6g}, {middle:.6g} and {most:.6g}: no body has a moment "
            "above the sum of the other two."
        )
