"""Dimensions and units of a statement: their notation, and the check of every term."""
