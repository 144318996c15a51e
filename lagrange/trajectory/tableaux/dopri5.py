"""Dormand and Prince's method of order 5 with an embedded one of order 4, and a path of order 4 without more stages."""

from __future__ import annotations

from functools import cache

from lagrange.trajectory.tableaux.butcher import ButcherTableau, DenseOutput, ErrorEstimate, row, rows


@cache
def dopri5() -> ButcherTableau:
    """Return the tableau, built and checked at the first call."""
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
