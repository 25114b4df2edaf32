"""Golden outputs: what every command says about a table of inputs, recorded so that a change of it is seen and accepted knowingly."""
