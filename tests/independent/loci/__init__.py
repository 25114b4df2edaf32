"""Characteristic loci of coupled loops, followed in Python: margins and limits that share no samples, searches or counts with the core."""
