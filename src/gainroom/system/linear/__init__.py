"""Transfer functions and state space with delay, exact sampling, and the border to python-control and scipy."""
