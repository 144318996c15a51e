"""Event functions, switching surfaces and resets: their zeros on a step, and the changes of the motion at these."""
