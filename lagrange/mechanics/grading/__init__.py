"""Comparison of equations of motion that somebody derived with those of the system."""
