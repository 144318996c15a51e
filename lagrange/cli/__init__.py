"""The command line `lagrange`: one function for each command, and the signals that end a command."""
