"""Procedures: algorithms with loops and memory, written once as Python functions for every machine and language."""
