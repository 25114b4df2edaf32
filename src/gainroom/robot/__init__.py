"""The whole robot: links from a file, actuators, contacts, and the linear model about a posture.

Pinocchio and MuJoCo come with the extra `robot` and load when a model is first read.
"""

from .body import RigidBody
from .formats.model_files import load_model

__all__ = ["RigidBody", "load_model"]
