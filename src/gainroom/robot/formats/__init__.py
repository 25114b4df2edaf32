"""URDF and MJCF, read as hostile input."""
