"""Input and output: text that is written as a whole or not at all, bounded YAML, validated sections."""
