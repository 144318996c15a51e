"""Models handed to other Python libraries."""
