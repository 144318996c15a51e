"""Matplotlib figures of runs, paths of points, ensembles, phase portraits, eigenvalues and stability regions."""
