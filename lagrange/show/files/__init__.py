"""Files that are written whole or not at all, and their contents."""

FILE_DPI = 150
"""Default resolution of a picture file, in dots per inch. The command line reads it without loading a figure."""
