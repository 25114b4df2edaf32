"""Files in and out: text that is written whole or not at all, bounded YAML, checked sections."""
