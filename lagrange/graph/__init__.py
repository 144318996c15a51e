"""Expression graph with interned nodes, and its derivatives."""
