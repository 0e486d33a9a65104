"""Bench, sequence, campaign and fault files: YAML to validated records.

Data only; includes the packaged files.
"""
