"""Solvers of other packages: driven step by step, with the faults that they hide."""
