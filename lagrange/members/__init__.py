"""Ensembles: values that vary between members, and runs of members in vector lanes, on threads and in processes."""
