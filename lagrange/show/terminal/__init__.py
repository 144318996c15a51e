"""Output to a terminal: tables, progress, and the language of a document."""
