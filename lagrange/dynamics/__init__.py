"""Numerical data for pictures of dynamics: portraits, sections, bifurcations, shapes of modes."""
