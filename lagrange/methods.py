"""Integration methods: `lg.methods.RK4(step=0.01)`, `lg.methods.table()`.

The classes of SciPy's solvers carry its name: `lg.methods.ScipyRadau(max_step=0.1)`.
`lg.methods.CVODE()` needs `pip install scikit-sundae`.
"""

from lagrange.evidence.stability import Stability, growth, stability
from lagrange.show.stability_plot import plot_stability
from lagrange.trajectory.foreign import scipy_solvers
from lagrange.trajectory.foreign.sundials import CVODE
from lagrange.trajectory.methods.explicit import (
    BS3,
    DOP853,
    RK4,
    Dopri5,
    Euler,
    Heun,
    Midpoint,
    RungeKutta,
    Tsit5,
    Verner9,
    explicit_method,
    tableau,
)
from lagrange.trajectory.methods.implicit import (
    BDF2,
    BackwardEuler,
    Gauss2,
    Gauss3,
    ImplicitMethod,
    ImplicitMidpoint,
    Trapezoidal,
)
from lagrange.trajectory.methods.own import StepMethod, step_method
from lagrange.trajectory.methods.radau import Radau3, Radau5
from lagrange.trajectory.methods.registry import names, register, table
from lagrange.trajectory.methods.splitting import (
    Composition8,
    ForestRuth4,
    Leapfrog,
    Ruth3,
    Splitting,
    SymplecticEuler,
    SymplecticEulerB,
    VelocityVerlet,
    Verlet,
    Yoshida6,
    composition,
)
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.methods.variational import (
    DiscreteGradient,
    Galerkin4,
    Galerkin6,
    VariationalMidpoint,
    VariationalTrapezoid,
)
from lagrange.trajectory.tableaux.butcher import ButcherTableau

ScipyRK45 = scipy_solvers.RK45
ScipyRK23 = scipy_solvers.RK23
ScipyDOP853 = scipy_solvers.DOP853
ScipyRadau = scipy_solvers.Radau
ScipyBDF = scipy_solvers.BDF
ScipyLSODA = scipy_solvers.LSODA

__all__ = [
    "BDF2",
    "BS3",
    "CVODE",
    "DOP853",
    "RK4",
    "BackwardEuler",
    "ButcherTableau",
    "Composition8",
    "DiscreteGradient",
    "Dopri5",
    "Euler",
    "ForestRuth4",
    "Galerkin4",
    "Galerkin6",
    "Gauss2",
    "Gauss3",
    "Heun",
    "ImplicitMethod",
    "ImplicitMidpoint",
    "Leapfrog",
    "Midpoint",
    "Radau3",
    "Radau5",
    "RungeKutta",
    "Ruth3",
    "ScipyBDF",
    "ScipyDOP853",
    "ScipyLSODA",
    "ScipyRK23",
    "ScipyRK45",
    "ScipyRadau",
    "Splitting",
    "Stability",
    "StepMethod",
    "SymplecticEuler",
    "SymplecticEulerB",
    "Taylor",
    "Trapezoidal",
    "Tsit5",
    "VariationalMidpoint",
    "VariationalTrapezoid",
    "VelocityVerlet",
    "Verlet",
    "Verner9",
    "Yoshida6",
    "composition",
    "explicit_method",
    "growth",
    "names",
    "plot_stability",
    "register",
    "stability",
    "step_method",
    "table",
    "tableau",
]
