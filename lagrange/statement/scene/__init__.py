"""Scene files, which state a system in TOML: their reader, their writer, and the library of scenes."""
