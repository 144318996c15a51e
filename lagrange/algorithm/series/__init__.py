"""The Taylor series of a motion as procedures: from a series program to a whole integrator."""
