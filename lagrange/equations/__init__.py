"""The laws of motion: for machines as a graph, for people as SymPy."""
