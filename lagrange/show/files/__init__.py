"""Files that are written whole or not at all, and the data that they hold."""

FILE_DPI = 150
"""Dots per inch of a picture file, unless others are asked for."""
