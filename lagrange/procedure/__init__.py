"""Algorithms with loops and memory, stated once for every language."""
