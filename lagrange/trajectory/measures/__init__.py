"""Measures of a run: drifts, constraint violations and forces, stiffness, and positions of points."""
