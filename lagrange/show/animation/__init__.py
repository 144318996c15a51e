"""Animations: frames of a run, as a player in HTML, GIF or MP4."""

DEFAULT_FPS = 30.0
"""Frames per second unless others are requested. The command line reads it without loading an animation."""
