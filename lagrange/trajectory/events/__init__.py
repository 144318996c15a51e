"""Event functions, switching surfaces and resets: zeros on a step, and the changes of the motion at the zeros."""
