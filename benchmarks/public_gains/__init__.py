"""What public gains of public robots allow: rows.yaml has them, `python -m benchmarks.public_gains` audits each row and writes its page."""
