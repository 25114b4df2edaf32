"""Stability, margins, limits and gain regions of a loop, certified."""
