"""Code for other solvers: whole models as source text, each with a test of its own."""
