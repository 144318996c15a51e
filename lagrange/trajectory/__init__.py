"""Integration over time: integrators, drivers, dense output."""
