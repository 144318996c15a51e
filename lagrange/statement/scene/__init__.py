"""Scenes: the text of a statement as a TOML file, its reader, its writer, and the library."""
