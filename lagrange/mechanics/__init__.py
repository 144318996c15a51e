"""Symbolic analysis in SymPy: conserved quantities, equilibria, modes, transformations; all verified numerically."""
