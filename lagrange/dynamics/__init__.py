"""Data for phase portraits, sections and bifurcation diagrams. Public functions and their defaults: show/dynamics.py."""
