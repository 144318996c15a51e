"""Grade a student's equations of motion: compare them with the correct ones, and name the wrong term."""
