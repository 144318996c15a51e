"""FMUs: what describes them, and the sources in C that are in each."""
