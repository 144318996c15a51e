"""The explicit Runge-Kutta methods of few stages, with a cubic Hermite path between the steps."""

from __future__ import annotations

from lagrange.trajectory.tableaux.butcher import ButcherTableau, ErrorEstimate, row

EULER = ButcherTableau(
    name="euler",
    order=1,
    A=((),),
    b=row("1"),
    source="Euler, Institutionum calculi integralis, vol. I, 1768, section 650",
).hermite()

HEUN = ButcherTableau(
    name="heun",
    order=2,
    A=((), row("1")),
    b=row("1/2 1/2"),
    source="Heun, Z. Math. Phys. 45, 1900; Hairer, Norsett, Wanner, Solving ODE I, 1993, II.1",
).hermite()

MIDPOINT = ButcherTableau(
    name="midpoint",
    order=2,
    A=((), row("1/2")),
    b=row("0 1"),
    source="Runge, Math. Ann. 46, 1895; Hairer, Norsett, Wanner, Solving ODE I, 1993, II.1, eq. 1.4",
).hermite()

RK4 = ButcherTableau(
    name="rk4",
    order=4,
    A=((), row("1/2"), row("0 1/2"), row("0 0 1")),
    b=row("1/6 1/3 1/3 1/6"),
    source="Kutta, Z. Math. Phys. 46, 1901; Hairer, Norsett, Wanner, Solving ODE I, 1993, II.1, table 1.2",
).hermite()

BS3 = ButcherTableau(
    name="bs3",
    order=3,
    A=((), row("1/2"), row("0 3/4"), row("2/9 1/3 4/9")),
    b=row("2/9 1/3 4/9 0"),
    error=ErrorEstimate(row("-5/72 1/12 1/9 -1/8"), order=2),
    source="Bogacki, Shampine, Appl. Math. Lett. 2, 1989",
).hermite()
