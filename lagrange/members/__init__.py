"""Ensembles: what varies between members, and how they are run side by side, on threads and elsewhere."""
