"""Animations: frames of a run, as a player in HTML, GIF or MP4."""
