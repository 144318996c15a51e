"""Files that are written whole or not at all, and the data that they hold."""
