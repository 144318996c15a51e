"""Checks of results: compiled numbers against numerical derivatives, work-precision, stability, and trusted times."""
