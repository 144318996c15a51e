"""The command line: one function for each command, and the signals that end it."""
