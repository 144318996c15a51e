"""Given functions of time: known motions, inputs, and tables of measured values."""
