"""One question asked of many postures, contact states and draws of what is uncertain, on one machine or many."""
