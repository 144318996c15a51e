"""What a terminal shows: tables, progress, and the language of a page."""
