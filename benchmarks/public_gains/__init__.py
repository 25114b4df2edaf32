"""Delays and factors that public gains of public robots allow: rows.yaml has the gains.

`python -m benchmarks.public_gains` audits each row and writes its page.
"""
