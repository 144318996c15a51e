"""States and constraints: violations, projection onto the constraints, dependent constraints, discontinuities.

The symbols in this folder: phi are the p constraints on positions, psi the m constraints on velocities, including
dphi/dt, G = dpsi/dv is their gradient (m, n), and M the mass matrix (n, n). A constraint holds where it is zero.
"""
