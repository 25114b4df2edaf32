"""Gains that somebody already has, one file per format: read as data, within bounds, never executed."""
