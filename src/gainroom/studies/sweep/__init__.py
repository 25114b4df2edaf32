"""Sweeps: gain limits over many postures, contact states and draws of the uncertainty, on one machine or many."""
