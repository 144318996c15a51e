"""Dimensions and units of a statement: how they are written, and the check of all terms."""
