"""Studies: numerical results of the commands, without files or pictures."""
