"""Time domain: the sampled linear loop stepped exactly, and the virtual drive and testbed with friction, limits and encoders."""
