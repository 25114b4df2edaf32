"""What the commands compute: numbers, no files and no pictures."""
