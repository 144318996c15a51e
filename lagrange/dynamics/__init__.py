"""Data of phase portraits, sections and bifurcation diagrams. Their public functions are in show/dynamics.py."""
