"""Coefficients of methods as data, and the conditions that they are checked against."""
