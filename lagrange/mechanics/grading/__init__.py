"""Equations of motion that somebody derived, compared with those of the system."""
