"""Figures: runs, races, stability regions, eigenvalues."""
