"""The double pendulum: state it, read its equations, check it, run it, draw it.

L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., 1976, section 5, problem 1.

    python examples/double_pendulum.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

from sympy import cos, pi, sin
from sympy.physics.vector import vpprint

import lagrange as lg


def double_pendulum() -> lg.System:
    """Return two masses on two rods, the angles measured from below."""
    theta1, theta2 = lg.coordinates("theta1 theta2")
    m1, m2, l1, l2, g = lg.parameters("m1 m2 l1 l2 g")
    upper = (l1 * sin(theta1), -l1 * cos(theta1))
    lower = (upper[0] + l2 * sin(theta2), upper[1] - l2 * cos(theta2))
    return lg.System(
        kinetic=lg.kinetic_energy(m1, upper) + lg.kinetic_energy(m2, lower),
        potential=lg.gravity(m1, upper, g) + lg.gravity(m2, lower, g),
        parameters={m1: 1, m2: 1, l1: 1, l2: 1, g: 9.81},
        initial={theta1: pi / 2, theta2: pi / 2},
        positions={"upper": upper, "lower": lower},
        links=[("origin", "upper"), ("upper", "lower")],
        name="double pendulum",
    )


def main(folder: Path = Path("out")) -> lg.Solution:
    """Print the equations, what they conserve, the check and the run; save the picture and return the run."""
    system = double_pendulum()
    for equation in system.equations():
        print(vpprint(equation, wrap_line=False), end="\n\n")
    print("\n".join(system.structure), end="\n\n")
    report = system.check()
    print(report, end="\n\n")
    solution = system.run(10.0, rtol=1e-12, atol=1e-12).require()
    print(solution)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "double_pendulum.png"
    solution.plot().savefig(path, dpi=130)
    print(f"written to {path}")
    return solution


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
