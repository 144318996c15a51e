"""The stored path of a run between its steps, for each kind of method; it calls the machines' dense output."""
