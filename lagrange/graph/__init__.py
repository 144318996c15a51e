"""The expression graph, whose equal nodes are one object: derivatives, evaluation, and the way from and to SymPy."""
