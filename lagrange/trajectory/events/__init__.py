"""Events and switching surfaces: zeros of their functions on a step, and the resets, switches or ends that follow."""
