"""Numerical data for phase portraits, sections and bifurcation diagrams. Public functions: show/dynamics.py."""
