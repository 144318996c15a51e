"""The Whipple bicycle of the benchmark by Meijaard, Papadopoulos, Ruina and Schwab, stated in eight coordinates."""

from typing import Any

import sympy
from sympy import Matrix, cos, pi, sin, sqrt

import lagrange as lg

x, y, yaw, roll, pitch, steer, rear, front = lg.coordinates("x y yaw roll pitch steer rear front")
speed = lg.parameters("speed")

TILT, WHEELBASE, TRAIL = pi / 10, sympy.Rational("1.02"), sympy.Rational("0.08")
REAR_RADIUS, FRONT_RADIUS = sympy.Rational("0.3"), sympy.Rational("0.35")
STRAIGHT = {x.dot: speed, rear.dot: -speed / REAR_RADIUS, front.dot: -speed / FRONT_RADIUS}
"""Velocities of straight running."""


def bicycle() -> lg.System:
    """Return the bicycle on z = 0; x is forward, y to the right, z down."""
    lean = _turn(2, yaw) * _turn(0, roll)
    frame = lean * _turn(1, pitch)
    steering = _turn(1, TILT) * _turn(2, steer) * _turn(1, -TILT)
    fork = frame * steering
    rear_hub = Matrix([x, y, 0]) + lean * Matrix([0, 0, -REAR_RADIUS])
    hinge = rear_hub + frame * Matrix([WHEELBASE + TRAIL, 0, REAR_RADIUS])
    front_hub = hinge + fork * Matrix([-TRAIL, 0, -FRONT_RADIUS])
    body = rear_hub + frame * _numbers("0.3", 0, "-0.6")
    handlebar = hinge + fork * _numbers("-0.2", 0, "-0.7")
    rates = Matrix([roll.dot, yaw.dot * sin(roll), yaw.dot * cos(roll)])
    frame_rate = _turn(1, pitch).T * rates + Matrix([0, pitch.dot, 0])
    fork_rate = steering.T * frame_rate + steer.dot * Matrix([sin(TILT), 0, cos(TILT)])
    wheel_rate = fork_rate + Matrix([0, front.dot, 0])
    bodies = [
        (2, rear_hub, rates + Matrix([0, rear.dot, 0]), _inertia("0.0603", "0.12", "0.0603")),
        (85, body, frame_rate, _inertia("9.2", 11, "2.8", "2.4")),
        (4, handlebar, fork_rate, _inertia("0.05892", "0.06", "0.00708", "-0.00756")),
        (3, front_hub, wheel_rate, _inertia("0.1405", "0.28", "0.1405")),
    ]
    kinetic = sum(
        mass * place.diff(lg.t).dot(place.diff(lg.t)) / 2 + (rate.T * inertia * rate)[0] / 2
        for mass, place, rate, inertia in bodies
    )
    axle = fork[:, 1]
    drop = sqrt(1 - axle[2] ** 2)
    below = FRONT_RADIUS * (Matrix([0, 0, 1]) - axle[2] * axle) / drop
    slip = front_hub.diff(lg.t) + (fork * wheel_rate).cross(below)
    return lg.System(
        kinetic,
        -sympy.Rational("9.81") * sum(mass * place[2] for mass, place, _, _ in bodies),
        coordinates=[x, y, yaw, roll, pitch, steer, rear, front],
        constraints={
            "touch": front_hub[2] + FRONT_RADIUS * drop,
            "rear_x": x.dot + REAR_RADIUS * rear.dot * cos(yaw),
            "rear_y": y.dot + REAR_RADIUS * rear.dot * sin(yaw),
            "front_x": slip[0],
            "front_y": slip[1],
        },
        parameters={speed: 5},
        name="bicycle",
    )


def _turn(axis: int, angle: Any) -> Any:
    """Return the rotation about a coordinate axis."""
    c, s = cos(angle), sin(angle)
    rows = {
        0: [[1, 0, 0], [0, c, -s], [0, s, c]],
        1: [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        2: [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return Matrix(rows[axis])


def _numbers(*entries: Any) -> Any:
    return Matrix([sympy.Rational(entry) for entry in entries])


def _inertia(xx: Any, yy: Any, zz: Any, xz: Any = 0) -> Any:
    a, b, c, d = _numbers(xx, yy, zz, xz)
    return Matrix([[a, 0, d], [0, b, 0], [d, 0, c]])
