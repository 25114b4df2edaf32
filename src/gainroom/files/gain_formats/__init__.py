"""Formats of gain files, one module each: read as data, within bounds, never executed."""
