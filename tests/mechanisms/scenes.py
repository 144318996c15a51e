"""Every scene with constraints, or without inertia, formulated independently: reduced, by Kane's method, or by hand."""

from collections.abc import Callable, Sequence
from typing import Any

import sympy
from sympy import Matrix, Rational, acos, atan, cos, pi, sin, sqrt, symbols, tan
from sympy.physics.mechanics import KanesMethod, Point, ReferenceFrame, RigidBody, dot, dynamicsymbols, inertia

from lagrange.statement.coordinate import t
from tests.mechanisms.formulation import Bodies, Formulation, reduced
from tests.models import loaded


def symbol(name: str) -> Any:
    """Return the symbol of a scene's parameter."""
    return sympy.Symbol(name, real=True)


def known(names: str) -> list[Any]:
    """Return the symbols of parameters by their names."""
    return [symbol(name) for name in names.split()]


def of(scene: str) -> dict[Any, float]:
    """Return the values of some of a scene's parameters."""
    return dict(loaded(scene).defaults)


m, m1, m2, m3, g, l, l1, l2, l3, d, r, k, J, Jw, a, b, c = known("m m1 m2 m3 g l l1 l2 l3 d r k J Jw a b c")
z0, z1, z2, z3, z4, z5, z6, z7 = symbols("z:8", real=True)


def direction(angle: Any) -> Matrix:
    """Return the unit vector at an angle from the x axis."""
    return Matrix([cos(angle), sin(angle)])


def cartesian_pendulum() -> Formulation:
    """Formulate by the angle from the vertical."""
    x, y = l * sin(z0), -l * cos(z0)
    rates = [l * cos(z0) * z1, l * sin(z0) * z1]
    return Formulation(of("cartesian-pendulum"), [z0, z1], [x, y], rates, [z1, -g / l * sin(z0)], [2, 0])


def cartesian_double_pendulum() -> Formulation:
    """Formulate by the two angles from the vertical."""
    first = l1 * Matrix([sin(z0), -cos(z0)])
    second = first + l2 * Matrix([sin(z1), -cos(z1)])
    potential = m1 * g * first[1] + m2 * g * second[1]
    bodies = Bodies([(m1, first), (m2, second)], potential=potential, names=(z0, z1))
    return reduced(of("cartesian-double-pendulum"), [*first, *second], bodies, start=[pi / 6, pi / 6, 0, 0])


def slider_crank() -> Formulation:
    """Formulate by the angle of the crank; the rod follows by the law of sines."""
    J1, J2, rest, F = known("J1 J2 rest F")
    p = -sympy.asin(a * sin(z0))
    x = cos(p) + a * cos(z0)
    middles = (Matrix([x, 0]) - direction(p) / 2) - a * direction(z0) / 2
    spring = sqrt(middles.dot(middles))

    def force(s: Sequence[Any], rate: Sequence[Any]) -> list[Any]:
        damping = -c * sympy.diff(spring, z0) ** 2 * rate[0]
        return [damping + F * sympy.diff(x + cos(p), z0)]

    bodies = Bodies([(m, [x])], [(J1, z0), (J2, p)], k * (spring - rest) ** 2 / 2, force, (z0,))
    return reduced(of("slider-crank"), [z0, x, p], bodies, start=[pi / 2, 0])


def four_bar() -> Formulation:
    """Formulate by the angle of the crank; coupler and rocker follow by the law of cosines."""
    crank = l1 * direction(z0)
    along = Matrix([d, 0]) - crank
    diagonal = sqrt(along.dot(along))
    leaning = atan(along[1] / along[0])
    coupler = leaning + acos((l2**2 + diagonal**2 - l3**2) / (2 * l2 * diagonal))
    rocker = leaning + pi - acos((l3**2 + diagonal**2 - l2**2) / (2 * l3 * diagonal))
    middle = crank + l2 / 2 * direction(coupler)
    spins = [(m1 * l1**2 / 3, z0), (m2 * l2**2 / 12, coupler), (m3 * l3**2 / 3, rocker)]
    heights = m1 * crank[1] / 2 + m2 * middle[1] + m3 * l3 / 2 * sin(rocker)
    bodies = Bodies([(m2, middle)], spins, g * heights, None, (z0,))
    return reduced(of("four-bar"), [z0, coupler, rocker], bodies, start=[pi / 2, 0])


def four_bar_change_point() -> Formulation:
    """Formulate by the angle of the crank; the coupler stays parallel to the ground."""
    inertia_ = (m1 / 3 + m2 + m3 / 3) * l1**2
    slope = [z1, -g * l1 * cos(z0) * (m1 / 2 + m2 + m3 / 2) / inertia_]
    values = of("four-bar-change-point")
    return Formulation(values, [z0, z1], [z0, 0, z0], [z1, 0, z1], slope, [pi / 2, -1])


def four_bar_ladder() -> Formulation:
    """Formulate by the angle of the rods; all couplers stay parallel to the ground."""
    loops = 2
    pins = [Matrix([i * l, 0]) + l * direction(z0) for i in range(loops + 1)]
    inertia_ = (Rational(loops + 1, 3) + loops) * l**2
    slope = [z1, -g * l * cos(z0) * (Rational(loops + 1, 2) + loops) / inertia_]
    places = [x for pin in pins for x in pin]
    rates = [sympy.diff(x, z0) * z1 for x in places]
    return Formulation(of("four-bar-ladder"), [z0, z1], places, rates, slope, [pi / 2, -1])


def bead_on_wire() -> Formulation:
    """Formulate by the distance from the axis in the frame of the rotating wire."""
    Omega = symbol("Omega")
    places = [z0 * cos(Omega * t), z0 * sin(Omega * t), k * z0**2]
    rates = [sympy.diff(x, z0) * z1 + sympy.diff(x, t) for x in places]
    pull = (Omega**2 - 2 * g * k) * z0 - 4 * k**2 * z0 * z1**2
    return Formulation(of("bead-on-wire"), [z0, z1], places, rates, [z1, pull / (1 + 4 * k**2 * z0**2)], [1, 0])


def atwood_machine() -> Formulation:
    """Formulate by the depth of the first weight."""
    h = symbol("h")
    turn = (z0 - h) / r
    slope = [z1, (m1 - m2) * g / (m1 + m2 + J / r**2)]
    return Formulation(of("atwood-machine"), [z0, z1], [z0, 2 * h - z0, turn], [z1, -z1, z1 / r], slope, [1, 0])


def swinging_atwood_machine() -> Formulation:
    """Formulate by polar coordinates of the swinging weight."""
    M = symbol("M")
    places = [z0 * sin(z1), -z0 * cos(z1), l - z0]
    rates = [sympy.diff(x, z0) * z2 + sympy.diff(x, z1) * z3 for x in places]
    outward = (m * z0 * z3**2 + g * (m * cos(z1) - M)) / (M + m)
    slope = [z2, z3, outward, -(2 * z2 * z3 + g * sin(z1)) / z0]
    values = of("swinging-atwood-machine")
    return Formulation(values, [z0, z1, z2, z3], places, rates, slope, [1, pi / 2, 0, 0], 0.2)


def kane_of_the_disc() -> Any:
    """Return u1', u2', u3' of a rolling disc by Kane's method, in (q1, q2, q3, u1, u2, u3), as in SymPy's test."""
    q1, q2, q3, u1, u2, u3 = dynamicsymbols("q1 q2 q3 u1 u2 u3")
    plane = ReferenceFrame("N")
    yaw = plane.orientnew("Y", "Axis", [q1, plane.z])
    lean = yaw.orientnew("L", "Axis", [q2, yaw.x])
    disc = lean.orientnew("R", "Axis", [q3, lean.y])
    turning = disc.ang_vel_in(plane)
    disc.set_ang_vel(plane, u1 * lean.x + u2 * lean.y + u3 * lean.z)
    contact = Point("C")
    contact.set_vel(plane, 0)
    centre = contact.locatenew("D", r * lean.z)
    centre.v2pt_theory(contact, plane, disc)
    tensor = inertia(lean, m / 4 * r**2, m / 2 * r**2, m / 4 * r**2)
    body = RigidBody("B", centre, disc, m, (tensor, centre))
    kinematics = [dot(disc.ang_vel_in(plane) - turning, axis) for axis in lean]
    method = KanesMethod(plane, q_ind=[q1, q2, q3], u_ind=[u1, u2, u3], kd_eqs=kinematics)
    method.kanes_equations([body], [(centre, -m * g * yaw.z)])
    result = (method.mass_matrix.inv() * method.forcing).subs(method.kindiffdict())
    return result.subs(dict(zip((q1, q2, q3, u1, u2, u3), (z0, z1, z2, z5, z6, z7), strict=True)))


def rolling_disc() -> Formulation:
    """Formulate by Kane's method: u1, u2, u3 are the rates about the axis of lean, the axle and their normal."""
    angles = [z7 / cos(z1), z5, z6 - z7 * tan(z1)]
    rates = [*angles, r * angles[2] * cos(z0), r * angles[2] * sin(z0)]
    start = [0, Rational(3, 10), 0, 0, 0, 0, 1, 0]
    state = [z0, z1, z2, z3, z4, z5, z6, z7]
    return Formulation(of("rolling-disc"), state, state[:5], rates, [*rates, *kane_of_the_disc()], start, spread=0.3)


def chaplygin_sleigh() -> Formulation:
    """Formulate by the speed along the blade and the rate of turning (Chaplygin's equations)."""
    rates = [z3 * cos(z2), z3 * sin(z2), z4]
    slope = [*rates, a * z4**2, -m * a * z3 * z4 / (J + m * a**2)]
    start = [0, 0, 0, -1, Rational(1, 10)]
    return Formulation(of("chaplygin-sleigh"), [z0, z1, z2, z3, z4], [z0, z1, z2], rates, slope, start)


def knife_edge() -> Formulation:
    """Formulate by the speed along the edge; the rate of turning is constant."""
    rates = [z3 * cos(z2), z3 * sin(z2), z4]
    slope = [*rates, g * sin(symbol("slope")) * cos(z2), 0]
    return Formulation(of("knife-edge"), [z0, z1, z2, z3, z4], [z0, z1, z2], rates, slope, [0, 0, 0, 0, 1])


def differential_drive() -> Formulation:
    """Formulate by the speed of the axle and the rate of turning, with Newton's and Euler's laws about its middle."""
    torques = known("torque_right torque_left")
    wheels = [(z5 + b * z6) / r, (z5 - b * z6) / r]
    pushes = [(torque - c * wheel) / r for torque, wheel in zip(torques, wheels, strict=True)]
    ahead = (m * d * z6**2 + pushes[0] + pushes[1]) / (m + 2 * Jw / r**2)
    turn = (b * (pushes[0] - pushes[1]) - m * d * z5 * z6) / (J + m * d**2 + 2 * Jw * b**2 / r**2)
    rates = [z5 * cos(z2), z5 * sin(z2), z6, *wheels]
    start = [0, 0, 0, 0, 0, Rational(1, 2), Rational(2, 5)]
    state = [z0, z1, z2, z3, z4, z5, z6]
    return Formulation(of("differential-drive"), state, state[:5], rates, [*rates, ahead, turn], start)


def turned(quaternion: Sequence[Any], spin: Sequence[Any]) -> list[Any]:
    """Return the rate of a quaternion: half its product with the angular velocity in the body."""
    w, x, y, z = quaternion
    p, q, s = spin
    return [
        (-x * p - y * q - z * s) / 2,
        (w * p + y * s - z * q) / 2,
        (w * q + z * p - x * s) / 2,
        (w * s + x * q - y * p) / 2,
    ]


def rigid_body(scene: str, inertias: Sequence[Any], weight: Any, start: Sequence[Any]) -> Formulation:
    """Formulate by Euler's equations. `weight` is m g l of a body that is fixed at a point of its third axis."""
    raw, spin = [z0, z1, z2, z3], [z4, z5, z6]
    size = sqrt(sum(item**2 for item in raw))
    w, x, y, z = unit = [item / size for item in raw]
    up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)]  # the vertical, seen from the body
    torque = [weight * up[1], -weight * up[0], 0]  # l e3 x (-m g up)
    I1, I2, I3 = inertias
    p, q, s = spin
    slope = [
        ((I2 - I3) * q * s + torque[0]) / I1,
        ((I3 - I1) * s * p + torque[1]) / I2,
        ((I1 - I2) * p * q + torque[2]) / I3,
    ]
    return Formulation(
        of(scene), [*raw, *spin], unit, turned(unit, spin), [*turned(raw, spin), *slope], start, spread=0.3
    )


def free_flip() -> Formulation:
    """Formulate by Euler's equations without a torque."""
    start = [1, 0, 0, 0, Rational(1, 10), 5, 0]
    return rigid_body("free-flip", known("I1 I2 I3"), sympy.Integer(0), start)


def spinning_top() -> Formulation:
    """Formulate by Euler's equations about the fixed point."""
    A, C = known("A C")
    return rigid_body("spinning-top", [A, A, C], m * g * l, [cos(pi / 12), sin(pi / 12), 0, 0, 0, 0, 60])


def hanging_chain() -> Formulation:
    """Formulate by the angles of the first two links; the joint of the others is at the intersection of two circles."""
    first = l * direction(z0)
    second = first + l * direction(z1)
    away = Matrix([d, symbol("h")]) - second
    distance = sqrt(away.dot(away))
    aside = Matrix([-away[1], away[0]]) / distance
    three = second + away / 2 - aside * sqrt(l**2 - distance**2 / 4)
    potential = m * g * (first[1] + second[1] + three[1])
    bodies = Bodies([(m, first), (m, second), (m, three)], potential=potential, names=(z0, z1))
    start = [-pi / 2, -atan(Rational(4, 3)), 0, 0]
    return reduced(of("hanging-chain"), [*first, *second, *three], bodies, start=start, spread=0.1)


def ladder() -> Formulation:
    """Formulate by the angle to the floor; the middle moves on a circle about the corner."""
    places = [l / 2 * cos(z0), l / 2 * sin(z0), z0]
    rates = [sympy.diff(x, z0) * z1 for x in places]
    return Formulation(of("ladder"), [z0, z1], places, rates, [z1, -3 * g / (2 * l) * cos(z0)], [Rational(7, 5), 0])


def particle_on_sphere() -> Formulation:
    """Formulate by spherical angles from the top."""
    R = symbol("R")
    places = [R * sin(z0) * cos(z1), R * sin(z0) * sin(z1), R * cos(z0)]
    rates = [sympy.diff(x, z0) * z2 + sympy.diff(x, z1) * z3 for x in places]
    slope = [z2, z3, sin(z0) * cos(z0) * z3**2 + g / R * sin(z0), -2 * cos(z0) / sin(z0) * z2 * z3]
    values = of("particle-on-sphere")
    return Formulation(values, [z0, z1, z2, z3], places, rates, slope, [Rational(1, 10), 0, 0, 0])


def two_point_vortices() -> Formulation:
    """Formulate by Kirchhoff's equations: each vortex moves with the flow of the other."""
    Gamma1, Gamma2 = known("Gamma1 Gamma2")
    across, along = z0 - z2, z1 - z3
    turn = 2 * pi * (across**2 + along**2)
    slope = [-Gamma2 * along / turn, Gamma2 * across / turn, Gamma1 * along / turn, -Gamma1 * across / turn]
    state = [z0, z1, z2, z3]
    return Formulation(of("two-point-vortices"), state, state, slope, slope, [0, 0, 1, 0], spread=0.3)


FORMULATIONS: dict[str, Callable[[], Formulation]] = {
    make.__name__.replace("_", "-"): make
    for make in (
        *(cartesian_pendulum, cartesian_double_pendulum, slider_crank, four_bar, four_bar_change_point),
        *(four_bar_ladder, bead_on_wire, atwood_machine, swinging_atwood_machine, rolling_disc, chaplygin_sleigh),
        *(knife_edge, differential_drive, free_flip, spinning_top, hanging_chain, ladder, particle_on_sphere),
        two_point_vortices,
    )
}
"""How to formulate each scene, by its name."""
