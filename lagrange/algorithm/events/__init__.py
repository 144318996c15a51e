"""Events along a step: zeros of event functions and their order, and the loops over steps that stop at them."""
