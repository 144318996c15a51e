"""The namespace `lg.methods` of integration methods: `lg.methods.RK4(step=0.01)`, `lg.methods.table()`.

Every method is available here under the name of the function or class that creates it. Classes for SciPy's solvers have
names that begin with Scipy: `lg.methods.ScipyRadau(max_step=0.1)`. `lg.methods.CVODE()` needs `pip install
scikit-sundae`.
"""

from typing import TYPE_CHECKING

from lagrange.evidence.method_stability import Stability, growth, stability
from lagrange.show.figures.dynamics_figures import plot_stability
from lagrange.trajectory.foreign import scipy_solvers
from lagrange.trajectory.foreign.sundials import CVODE
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.methods.registry import BUILT_IN, names, register, table
from lagrange.trajectory.methods.runge_kutta import RungeKutta, explicit_method, tableau
from lagrange.trajectory.methods.splitting import Splitting, composition
from lagrange.trajectory.methods.user_defined import StepMethod, step_method
from lagrange.trajectory.tableaux.butcher import ButcherTableau

if TYPE_CHECKING:  # signatures for type checkers; at run time the built-in methods are added below
    from lagrange.trajectory.methods.implicit import *
    from lagrange.trajectory.methods.radau import *
    from lagrange.trajectory.methods.runge_kutta import *
    from lagrange.trajectory.methods.splitting import *
    from lagrange.trajectory.methods.taylor import *
    from lagrange.trajectory.methods.variational import *

ScipyRK45 = scipy_solvers.RK45
ScipyRK23 = scipy_solvers.RK23
ScipyDOP853 = scipy_solvers.DOP853
ScipyRadau = scipy_solvers.Radau
ScipyBDF = scipy_solvers.BDF
ScipyLSODA = scipy_solvers.LSODA

_METHODS = {maker.__name__: maker for maker in BUILT_IN.values()}
globals().update(_METHODS)

__all__ = [
    "CVODE",
    "ButcherTableau",
    "ImplicitMethod",
    "RungeKutta",
    "ScipyBDF",
    "ScipyDOP853",
    "ScipyLSODA",
    "ScipyRK23",
    "ScipyRK45",
    "ScipyRadau",
    "Splitting",
    "Stability",
    "StepMethod",
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
__all__.extend(sorted(_METHODS))
