"""The equations of motion: as a graph for compilation, in SymPy for people, and tests that they have a solution."""
