"""Runs through contacts: modes, impacts, the choice of the next mode, and what a run keeps of them."""
