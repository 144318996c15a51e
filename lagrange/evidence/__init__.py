"""Checks of results: compiled quantities against numerical derivatives of stated energies, and reference runs."""
