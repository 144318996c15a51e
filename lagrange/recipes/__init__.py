"""Models as functions for other Python libraries."""
