"""Ensembles: values that vary between members, runs in vector lanes, threads and processes, results and their store."""
