"""Hairer's DOP853: order 8, a combined error estimate of orders 5 and 3, and a path of order 7 by 3 more stages."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb

from lagrange.trajectory.tableaux.butcher import ButcherTableau, DenseOutput, ErrorEstimate, row
from lagrange.trajectory.tableaux.rooted_trees import Coefficients

_C = row("0 0.05260015195876773 0.0789002279381516 0.1183503419072274 0.2816496580927726") + row(
    "1/3 1/4 4/13 127/195 3/5 6/7 1 1"
)
"""Abscissae of the stages. Those before 1/3 are (12 - 2 r)/135, (6 - r)/45, (6 - r)/30 and (6 + r)/30, where r is the
square root of 6."""

_A = (
    (),
    row("0.05260015195876773"),
    row("0.0197250569845379 0.0591751709536137"),
    row("0.02958758547680685 0 0.08876275643042054"),
    row("0.2413651341592667 0 -0.8845494793282861 0.924834003261792"),
    row("1/27 0 0 0.17082860872947386 0.12546768756682242"),
    row("0.037109375 0 0 0.17025221101954405 0.06021653898045596 -0.017578125"),
    row("0.03709200011850479 0 0 0.17038392571223998 0.10726203044637328 -0.015319437748624402 0.008273789163814023"),
    row("""
        0.6241109587160757 0 0 -3.3608926294469414 -0.868219346841726 27.59209969944671 20.154067550477894
        -43.48988418106996
    """),
    row("""
        0.47766253643826434 0 0 -2.4881146199716677 -0.590290826836843 21.230051448181193 15.279233632882423
        -33.28821096898486 -0.020331201708508627
    """),
    row("""
        -0.9371424300859873 0 0 5.186372428844064 1.0914373489967295 -8.149787010746927 -18.52006565999696
        22.739487099350505 2.4936055526796523 -3.0467644718982196
    """),
    row("""
        2.273310147516538 0 0 -10.53449546673725 -2.0008720582248625 -17.9589318631188 27.94888452941996
        -2.8589982771350235 -8.87285693353063 12.360567175794303 0.6433927460157636
    """),
)

_B = row(
    """
    0.054293734116568765 0 0 0 0 4.450312892752409 1.8915178993145003 -5.801203960010585 0.3111643669578199
    -0.1521609496625161 0.20136540080403034 0.04471061572777259
    """
)

_EXTRA = (
    row("""
        0.056167502283047954 0 0 0 0 0 0.25350021021662483 -0.2462390374708025 -0.12419142326381637
        0.15329179827876568 0.00820105229563469 0.007567897660545699 -0.008298
    """),
    row("""
        0.03183464816350214 0 0 0 0 0.028300909672366776 0.053541988307438566 -0.05492374857139099 0 0
        -0.00010834732869724932 0.0003825710908356584 -0.00034046500868740456 0.1413124436746325
    """),
    row("""
        -0.42889630158379194 0 0 0 0 -4.697621415361164 7.683421196062599 4.06898981839711 0.3567271874552811 0 0 0
        -0.0013990241651590145 2.9475147891527724 -9.15095847217987
    """),
)

_INTERPOLANT = (
    row("""
        -8.428938276109013 0 0 0 0 0.5667149535193777 -3.0689499459498917 2.38466765651207 2.117034582445028
        -0.871391583777973 2.2404374302607883 0.6315787787694688 -0.08899033645133331 18.148505520854727
        -9.194632392478356 -4.436036387594894
    """),
    row("""
        10.427508642579134 0 0 0 0 242.28349177525817 165.20045171727028 -374.5467547226902 -22.113666853125306
        7.733432668472264 -30.674084731089398 -9.332130526430229 15.697238121770845 -31.139403219565178
        -9.35292435884448 35.81684148639408
    """),
    row("""
        19.985053242002433 0 0 0 0 -387.0373087493518 -189.17813819516758 527.8081592054236 -11.57390253995963
        6.8812326946963 -1.0006050966910838 0.7777137798053443 -2.778205752353508 -60.19669523126412
        84.32040550667716 11.99229113618279
    """),
    row("""
        -25.69393346270375 0 0 0 0 -154.18974869023643 -231.5293791760455 357.6391179106141 93.40532418362432
        -37.45832313645163 104.0996495089623 29.8402934266605 -43.53345659001114 96.32455395918828
        -39.17726167561544 -149.72683625798564
    """),
)

_E5 = row(
    """
    0.01312004499419488 0 0 0 0 -1.2251564463762044 -0.4957589496572502 1.6643771824549864 -0.35032884874997366
    0.3341791187130175 0.08192320648511571 -0.022355307863886294 0
    """
)

_E3 = tuple(b - bhat for b, bhat in zip(_B, row("31/127 0 0 0 0 0 0 0 12675/17272 0 0 3/136"), strict=True))

_SHAPES = ((1, 0), (1, 1), (2, 1), (2, 2), (3, 2), (3, 3), (4, 3))
"""Powers of theta and of 1 - theta in the seven polynomials that span the path."""


def _path_weights() -> tuple[Coefficients, ...]:
    """Return the weights of each stage in the dense output, by powers of theta.

    Hairer states the path by sums F_i of stages: y(t + theta h) = y + sum_i shape_i(theta) F_i with F_0 = dy = y_new
    - y, F_1 = h f - dy, F_2 = 2 dy - h (f + f_new), and the rest from the interpolant's table (contd8 in dop853.f).
    """
    extra = (Fraction(0),) * (len(_EXTRA) + 1)
    change = tuple(Fraction(b) for b in _B) + extra
    ends = [(int(j == 0), int(j == len(_B))) for j in range(len(change))]
    sums = [
        change,
        tuple(first - dy for dy, (first, _) in zip(change, ends, strict=True)),
        tuple(2 * dy - first - last for dy, (first, last) in zip(change, ends, strict=True)),
        *(tuple(Fraction(d) for d in line) for line in _INTERPOLANT),
    ]
    weights = [[Fraction(0)] * 7 for _ in change]
    for (up, down), line in zip(_SHAPES, sums, strict=True):
        for k in range(down + 1):
            for powers, value in zip(weights, line, strict=True):
                powers[up + k - 1] += (-1) ** k * comb(down, k) * value
    return tuple(tuple(map(float, powers)) for powers in weights)


@cache
def dop853() -> ButcherTableau:
    """Return the tableau of Hairer's DOP853, built and checked at the first call."""
    return ButcherTableau(
        name="dop853",
        order=8,
        A=(*_A, _B),
        b=(*_B, Fraction(0)),
        c=_C,
        error=ErrorEstimate(_E5, order=5, damping=(*_E3, Fraction(0)), damping_order=3),
        dense=DenseOutput(_path_weights(), order=7, stages=_EXTRA, c=row("1/10 1/5 7/9")),
        source="Hairer, Norsett, Wanner, Solving ODE I, 1993, II.5 and II.10, and the code dop853.f of 1993",
    )
