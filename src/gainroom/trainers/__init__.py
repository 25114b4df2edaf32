"""Actuators for reinforcement learning that have what limits gains on hardware, for mjlab and Isaac Lab.

elastic_delayed holds the model, of numpy or torch arrays alike; mjlab and isaaclab hold it behind the actuator interface of those programs,
which only they import.
"""
