"""Event functions, switching surfaces and resets: where they vanish on a step, and what follows."""
