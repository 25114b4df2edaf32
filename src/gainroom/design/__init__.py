"""Recommended gains: the stiffest that meet the requirements."""
