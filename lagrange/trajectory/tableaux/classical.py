"""The explicit Runge-Kutta methods of up to seven stages."""

from __future__ import annotations

from functools import cache

from lagrange.trajectory.tableaux.butcher import ButcherTableau, DenseOutput, ErrorEstimate, row, rows

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


@cache
def dopri5() -> ButcherTableau:
    """Return the tableau of the method with this name, built and checked at the first call."""
    return ButcherTableau(
        name="dopri5",
        order=5,
        A=(
            (),
            *rows("""
                1/5
                3/40        9/40
                44/45       -56/15       32/9
                19372/6561  -25360/2187  64448/6561  -212/729
                9017/3168   -355/33      46732/5247  49/176    -5103/18656
                35/384      0            500/1113    125/192   -2187/6784   11/84
            """),
        ),
        b=row("35/384 0 500/1113 125/192 -2187/6784 11/84 0"),
        error=ErrorEstimate(row("71/57600 0 -71/16695 71/1920 -17253/339200 22/525 -1/40"), order=4, memory=0.04),
        dense=DenseOutput(
            rows("""
                1  -8048581381/2820520608    8663915743/2820520608    -12715105075/11282082432
                0  0                         0                        0
                0  131558114200/32700410799  -68118460800/10900136933 87487479700/32700410799
                0  -1754552775/470086768     14199869525/1410260304   -10690763975/1880347072
                0  127303824393/49829197408  -318862633887/49829197408 701980252875/199316789632
                0  -282668133/205662961      2019193451/616988883     -1453857185/822651844
                0  40617522/29380423         -110615467/29380423      69997945/29380423
            """),
            order=4,
        ),
        source="Dormand, Prince, J. Comp. Appl. Math. 6, 1980; path: Shampine, Math. Comp. 46, 1986; "
        "Hairer, Norsett, Wanner, Solving ODE I, 1993, II.5, table 5.2, and II.6",
    )


@cache
def tsit5() -> ButcherTableau:
    """Return the tableau of the method with this name, built and checked at the first call."""
    return ButcherTableau(
        name="tsit5",
        order=5,
        A=(
            (),
            *rows("""
                0.161
                -0.008480655492356989 0.335480655492357
                2.8971530571054935 -6.359448489975075 4.3622954328695815
                5.325864828439257 -11.748883564062828 7.4955393428898365 -0.09249506636175525
                5.86145544294642 -12.92096931784711 8.159367898576159 -0.071584973281401 -0.028269050394068383
                0.09646076681806523 0.01 0.4798896504144996 1.379008574103742 -3.290069515436081 2.324710524099774
            """),
        ),
        b=row("0.09646076681806523 0.01 0.4798896504144996 1.379008574103742 -3.290069515436081 2.324710524099774 0"),
        error=ErrorEstimate(
            row("""
                -0.00178001105222577714 -0.0008164344596567469 0.007880878010261995 -0.1447110071732629
                0.5823571654525552 -0.45808210592918697 1/66
            """),
            order=4,
        ),
        dense=DenseOutput(
            rows("""
                1 -2.763706197274826  2.9132554618219126 -1.0530884977290216
                0  0.1317             -0.2234             0.1017
                0  3.9302962368947516 -5.941033872131505  2.490627285651253
                0 -12.411077166933676 30.33818863028232   -16.548102889244902
                0  37.50931341651104  -88.1789048947664   47.37952196281928
                0 -27.896526289197286 65.09189467479366   -34.87065786149661
                0  3/2                -4                  5/2
            """),
            order=4,
        ),
        source="Tsitouras, Comput. Math. Appl. 62, 2011",
    )
