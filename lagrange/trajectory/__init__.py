"""What happens over time: integrators, drivers, dense output."""
