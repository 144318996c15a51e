"""The expression graph, in which equal nodes are one object: derivatives, evaluation, translation from and to SymPy."""
