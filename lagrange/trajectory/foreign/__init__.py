"""Solvers of other packages, driven step by step, with checks for failures that they do not report."""
