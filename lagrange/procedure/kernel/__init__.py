"""Straight-line programs as procedures: what is computed once per parameters, and what at every state."""
