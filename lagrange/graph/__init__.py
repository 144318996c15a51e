"""What is being computed, once each: an interned expression graph and its derivatives."""
