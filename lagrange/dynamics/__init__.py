"""What is computed for pictures of dynamics: portraits, sections, bifurcations, basins, energies along a run."""
