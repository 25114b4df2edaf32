"""From a log to a joint's numbers, with intervals: delay, elasticity, gains."""
