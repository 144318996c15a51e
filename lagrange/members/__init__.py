"""Ensembles: the values that vary between members, and runs of members in lanes, on threads and in other processes."""
