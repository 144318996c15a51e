"""Runs of many members of an ensemble, by procedures that machine code computes for several members at once."""
