"""Straight-line programs as procedures: one part runs once for a set of parameters, the other at every state."""
