"""Formulas of dense output: the polynomial of a step for each kind of method, and its values at many times."""
