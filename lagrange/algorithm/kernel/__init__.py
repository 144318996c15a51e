"""Straight-line programs as procedures: a part that runs once for each set of parameters, and a part for each state."""
