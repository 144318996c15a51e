"""The equations of motion: as a graph for compilation, and in SymPy for people."""
