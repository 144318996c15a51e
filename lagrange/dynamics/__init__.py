"""Data of phase portraits, sections and bifurcation diagrams. Public functions with defaults: show/dynamics.py."""
