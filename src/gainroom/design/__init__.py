"""Gains to use: the stiffest that keep what is required."""
