"""Grade a student's equations of motion: compare them with those of the system, and name the wrong term."""
