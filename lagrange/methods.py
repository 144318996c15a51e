"""Integration methods: `lg.methods.RK4(step=0.01)`, `lg.methods.table()`."""

from lagrange.trajectory.methods.explicit import DOP853, RK4, Dopri5, Euler, Midpoint, RungeKutta, explicit_method
from lagrange.trajectory.methods.registry import names, table
from lagrange.trajectory.methods.splitting import Splitting, SymplecticEuler, Verlet

__all__ = [
    "DOP853",
    "RK4",
    "Dopri5",
    "Euler",
    "Midpoint",
    "RungeKutta",
    "Splitting",
    "SymplecticEuler",
    "Verlet",
    "explicit_method",
    "names",
    "table",
]
