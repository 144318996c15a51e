"""Write runs to files (CSV, npz, folders, pictures), whole or not at all, and read stored runs."""

FILE_DPI = 150
"""Default resolution of a picture file, in dots per inch. The command line reads it without loading a figure."""
