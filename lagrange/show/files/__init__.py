"""Files of runs (CSV, npz, folders, pictures), written whole or not at all, and the reader of stored runs."""

FILE_DPI = 150
"""Default resolution of a picture file, in dots per inch. The command line reads it without loading a figure."""
