"""Numerical data for pictures of dynamics: portraits, sections, bifurcations. Public functions: show/dynamics.py."""
