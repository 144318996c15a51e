"""What is computed for pictures of dynamics: portraits, sections, bifurcations, shapes of modes."""
