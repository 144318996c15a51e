"""Integration methods, a file for each family: Runge-Kutta, splitting, implicit, variational, Taylor.

Each claims its properties.
"""
