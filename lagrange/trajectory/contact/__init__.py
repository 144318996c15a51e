"""Runs through contacts: modes, impacts, the choice of the next mode, and the history of contacts."""
