"""Given functions: known motions, inputs, and tables of measured values."""
